"""What is known of a hand and an object: bounding boxes along any axes."""

import gc
import weakref
from pathlib import Path

import numpy as np
import pytest

from claw import claw, objects
from grasp_refine.core.se3 import exp_so3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import capsule, sphere
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import MAX_KEPT, HandObject
from grasp_refine.scene.scene import Scene


@pytest.mark.parametrize("name", ["box", "round"])
def test_boxes_hold_the_object_and_touch_it(tmp_path: Path, name: str) -> None:
    obj = objects()["box"]
    if name == "round":
        pieces = [capsule(0.01, [0, 0, 0.1], [0, 0.1, 0.1]), sphere(0.02, [0.3, 0, 0])]
        obj = obj.with_body(build_body("round", pieces, candidates=64))
    prepared = HandObject(claw(tmp_path), obj)
    axes = np.concatenate([np.eye(3)[None], exp_so3(np.random.default_rng(0).normal(size=(600, 3)))])
    low, high = prepared.boxes(np.zeros(len(axes), dtype=int), axes)
    np.testing.assert_allclose([low[0], high[0]], prepared.box)
    for rotation, lower, upper in zip(axes, low, high, strict=True):
        bounds = np.array([[(p.vertices @ rotation - p.radius).min(0), (p.vertices @ rotation + p.radius).max(0)]
                           for p in obj.body.pieces])  # fmt: skip
        np.testing.assert_allclose([lower, upper], [bounds[:, 0].min(0), bounds[:, 1].max(0)], atol=1e-12)


def test_what_is_built_for_a_pair_is_built_once_and_kept_for_few_pairs() -> None:
    hand = load_hand("franka_hand")
    balls = [load_object(f"sphere:{0.02 + 0.001 * k}", candidates=16) for k in range(MAX_KEPT + 1)]
    scenes = [Scene(hand, ball, np.eye(4)[None], np.zeros((1, len(hand.joint_names)))) for ball in balls]
    first = HandObject.of(scenes[0])
    assert HandObject.of(scenes[0].select(np.array([0, 0]))) is first
    gone = weakref.ref(first)
    del first
    others = [HandObject.of(scene) for scene in scenes[1:]]
    gc.collect()
    assert gone() is None and [HandObject.of(scene) for scene in scenes[1:]] == others
