"""Dataclasses that hold arrays print in a line or two that say how many there are of what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from grasp_refine.closing.motion import closing_motion
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.core.short_repr import brief, labels, spread, tallied
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import compare
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import model_of, validate

LONGEST = 400
"""Characters that a person reads at a glance."""


@pytest.fixture(scope="module")
def things() -> dict[str, object]:
    """One of each kind, of two grasps of which one is not finite."""
    hand, box = load_hand("allegro", candidates=64), load_object("rounded_box", candidates=64)
    grasps = load_grasps(hand.urdf.parent / "example_rounded_box.npz").select([0, 1])
    T, q = transform_from_pose(grasps.hand_pose), match_joints(grasps, hand)[0]
    T[1] = np.nan
    scene = Scene(hand, box, T, q, task=Task(table=-0.1))
    result = refine(scene, Config(solver=LevenbergMarquardt(iterations=2), starts=1))
    prepared = HandObject(hand, box)
    T_link = prepared.chain(T, q).T_world_link
    world = build_world(model_of(hand), box, Task(Protocol(moves=1, steps_per_move=1, checks=1, steps_per_check=1)))
    motion = closing_motion(scene, prepared)
    rows = np.arange(2)
    return {
        "Hand": hand,
        "Link": hand.links[0],
        "Joint": hand.joints[0],
        "Object": box,
        "Body": box.body,
        "Piece": box.body.pieces[0],
        "Candidates": box.body.candidates,
        "GraspSet": grasps,
        "Scene": scene,
        "Refinement": result,
        "HandObject": prepared,
        "Frames": prepared.chain(T, q),
        "Pairs": prepared.pairs,
        "Witness": query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape)),
        "Metrics": metrics(hand, box, T, q),
        "Motion": motion,
        "HandModel": world.hand,
        "World": world,
        "Outcome": compare(scene, result, motion, margin=0.0, name="box", scale=1.0, row=rows, index=rows),
        "Trials": simulate(world, motion),
        "Validated": validate(scene, name="box", scale=1.0, rows=rows, index=rows, world=world, motion=motion),
    }


def test_descriptions_are_short_and_name_the_class(things: dict[str, object]):
    for kind, thing in things.items():
        text = repr(thing)
        assert text.startswith(kind) and len(text) <= LONGEST and "array(" not in text, text
        assert str(thing) == text


def test_labels_are_the_statuses_in_words(things: dict[str, object]):
    result, trials = things["Refinement"], things["Trials"]
    assert result.labels[1] == "not finite" and result.status[1] == Status.NOT_FINITE
    assert result.labels.shape == (2,) and trials.labels.shape == trials.reason.shape == (2, 6)
    assert trials.labels[1].tolist() == ["not finite"] * 6
    assert labels(Reason, np.array([[0, 1]])).tolist() == [["held", "moved"]]
    assert labels(Status, np.zeros((0,), int)).shape == (0,)


@dataclass(frozen=True, eq=False)
class Record:
    number: float
    rows: np.ndarray
    tensor: torch.Tensor
    names: tuple[str, ...]
    text: str
    nothing: int | None = None

    __repr__ = brief


def test_arrays_are_shown_by_type_and_shape():
    record = Record(0.5, np.zeros((2, 3)), torch.zeros(4, dtype=torch.float32), ("a",) * 20, "x" * 500)
    text = repr(record)
    assert "number=0.5" in text and "float64[2, 3]" in text and "float32[4]" in text and "20" in text
    assert "nothing" not in text and len(text) < 200
    assert "nothing=3" in repr(replace(record, nothing=3))


@pytest.mark.parametrize(
    ("summary", "wanted"),
    [
        (lambda: tallied(["a", "b", "b"]), "2 b, 1 a"),
        (lambda: tallied([]), ""),
        (lambda: spread(np.array([0.25, np.nan, 1.0])), "0.25 to 1"),
        (lambda: spread(np.array([2.0])), "2"),
        (lambda: spread(np.array([np.nan])), "unknown"),
    ],
)
def test_summaries(summary: Callable[[], str], wanted: str):
    assert summary() == wanted
