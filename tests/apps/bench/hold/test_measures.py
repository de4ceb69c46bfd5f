"""Measures of grasps: a clamp around a ball in closed form, and agreement with what `validate` measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.metrics import metrics
from grasp_refine_apps.bench.hold.measures import measure_grasps
from plate_gripper import URDF

RADIUS = 0.03
NAN = np.nan


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> HandObject:
    path: Path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF)
    return HandObject(load_hand(path, candidates=16), load_object(f"sphere:{RADIUS}", candidates=16))


def poses(*height: float) -> np.ndarray:
    """The palm so far below the ball's centre, in metres."""
    T = np.tile(np.eye(4), (len(height), 1, 1))
    T[:, 2, 3] = [-z for z in height]
    return T


def test_a_clamp_in_closed_form(prepared: HandObject):
    # The inner faces of the plates are at 8.5 cm from the middle, less the joint values.
    touch = 0.085 - RADIUS
    opened = np.array([[touch, -touch], [touch + 0.001, -touch - 0.002], [touch - 0.002, -touch + 0.001], [0.0, 0.0]])
    found = measure_grasps(prepared, poses(0.05, 0.05, 0.05, 0.2), opened)
    assert found.penetration_m == pytest.approx([0.0, 0.002, 0.0, 0.0], abs=1e-6)
    assert found.contact_gap_m == pytest.approx([0.0, 0.002, 0.002, NAN], abs=1e-6, nan_ok=True)
    assert found.self_penetration_m == pytest.approx(0.0)
    assert found.wrench_residual[0] < 1e-5 and np.isnan(found.wrench_residual[3])
    assert found.quality[0] > found.quality[1] and found.quality[3] == 0.0


def test_links_that_touch_may_be_named(prepared: HandObject):
    touch = 0.085 - RADIUS
    q, links = np.array([[touch - 0.001, -touch + 0.004]]), prepared.chain.links
    for link, gap in (("left", 0.001), ("right", 0.004)):
        only = np.array([[name == link for name in links]])
        assert measure_grasps(prepared, poses(0.05), q, only).contact_gap_m == pytest.approx([gap], abs=1e-6)


def test_they_are_those_of_validate(prepared: HandObject):
    hand = prepared.hand
    random = np.random.default_rng(0)
    q = random.uniform(hand.lower, hand.upper, (6, 2))
    T = poses(*random.uniform(0.03, 0.07, 6))
    T[5, 0, 3] = NAN
    found, known = measure_grasps(prepared, T, q), metrics(hand, prepared.object, T, q)
    for name in ("penetration_m", "self_penetration_m", "wrench_residual"):
        assert getattr(found, name) == pytest.approx(getattr(known, name), abs=1e-9, nan_ok=True), name
    assert np.isnan(found.penetration_m[5]) and np.isnan(found.contact_gap_m[5]) and found.quality[5] == 0.0
