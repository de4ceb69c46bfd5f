"""A job: every method on the same grasps of a gripper around a ball."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.motion import closing
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.urdf_model import urdf_model
from grasp_refine_apps.bench.hold.methods import methods
from grasp_refine_apps.bench.hold.runner import Group, GroupJob, GroupResult
from plate_gripper import URDF

RADIUS, OPEN = 0.03, 0.085
"""Of the ball, and between the middle of the gripper and a plate when it is open, metres."""


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[GroupResult, ...]:
    path: Path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF.replace('effort="1"', 'effort="50"'))
    hand, ball = load_hand(path, candidates=64), load_object(f"sphere:{RADIUS}", candidates=64)
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 2, 3] = -0.05
    # One that nearly touches, and one that is open all the way.
    q = np.array([[OPEN - RADIUS - 0.002, -OPEN + RADIUS + 0.002], [0.01, -0.01]])
    scene = Scene(hand, ball, T, q)
    # As they came, they never close.
    came = closing(scene)
    came.q[:] = 0.0
    told: list[float] = []
    job = GroupJob(
        Group("ball", scene, came), urdf_model(hand), methods((1,), stages=True), ("force-closure",), 4, 0, 1
    )
    found = job.do(told.append)
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)
    assert job.work == 2.0 and job.label == "ball"
    return found


def test_all_methods_are_tried_on_the_same_grasps(parts: tuple[GroupResult, ...]):
    assert [part.method.label for part in parts] == ["input grasps", "own stages", "geometry only", "1 start"]
    for part in parts:
        assert set(part.reason) == {"force-closure"} and part.reason["force-closure"].shape == (2,)


def test_stages_of_the_file_are_those_that_are_simulated(parts: tuple[GroupResult, ...]):
    came, own = parts[:2]
    assert (came.reason["force-closure"] != Reason.HELD).all()
    assert own.reason["force-closure"][0] == Reason.HELD
    assert np.isnan(came.stages_cpu_s).all() and (own.stages_cpu_s > 0).all()


def test_only_refinement_costs_and_moves(parts: tuple[GroupResult, ...]):
    for part in parts[:2]:
        assert np.isnan([part.cpu_s, part.wall_s, part.starts]).all() and not part.moved.joints_rad.any()
        assert part.measures.contact_gap_m[0] == pytest.approx(0.002, abs=1e-6)
    for part in parts[2:]:
        assert (part.cpu_s > 0).all() and (part.wall_s > 0).all() and (part.starts >= 1).all()
        assert part.measures.contact_gap_m[0] < 1e-4 and part.moved.joints_rad[0] > 0.001
        assert part.reason["force-closure"][0] == Reason.HELD
