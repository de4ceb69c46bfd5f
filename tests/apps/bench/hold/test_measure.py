"""A job: every method on the same grasps of a gripper around a ball, whose gaps are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.closing.motion import closing_motion
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.bench.hold.measure import GroupResult, GroupTask, Method, contact_gap, methods
from plate_gripper import URDF

RADIUS, OPEN = 0.03, 0.085
"""Of the ball, and between the middle of the gripper and a plate when it is open, metres."""


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    path: Path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF.replace('effort="1"', 'effort="50"'))
    return load_hand(path, candidates=64)


def scene(hand: Hand, q: np.ndarray, depth: float = 0.05) -> Scene:
    """Grasps of a ball whose centre is `depth` metres above the palm."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    T[:, 2, 3] = -depth
    return Scene(hand, load_object(f"sphere:{RADIUS}", candidates=64), T, q)


def test_gaps_in_closed_form(hand: Hand):
    touch = OPEN - RADIUS
    q = np.array([[touch, -touch], [touch + 0.001, -touch - 0.002], [touch - 0.002, -touch + 0.001]])
    assert contact_gap(scene(hand, q)) == pytest.approx([0.0, 0.002, 0.002], abs=1e-6)
    assert np.isnan(contact_gap(scene(hand, np.zeros((1, 2)), 0.2)))
    apart = scene(hand, np.array([[touch - 0.001, -touch + 0.004]]))
    for link, gap in (("left", 0.001), ("right", 0.004)):
        only = np.array([[name == link for name in apart.links]])
        assert contact_gap(apart, only) == pytest.approx([gap], abs=1e-6)


def test_references_come_first_and_no_number_of_starts_twice():
    found = methods((6, 1, 6), stages=True)
    assert [method.label for method in found] == ["input grasps", "own stages", "geometry only", "6 starts", "1 start"]
    # Without stages of the file, ours are no method of their own.
    assert Method("own-stages") not in methods((1,), stages=False)


def test_only_what_is_refined_has_settings():
    assert Method("as-came").config(0, 8) is None
    geometry, forces = Method("geometry-only", 1).config(3, 8), Method("forces", 4).config(3, 8)
    assert geometry is not None and not geometry.holds
    assert forces == Config(starts=4, seed=3, width=8) and forces.holds


@pytest.fixture(scope="module")
def results(hand: Hand) -> list[GroupResult]:
    # One that nearly touches, and one that is open all the way.
    grasps = scene(hand, np.array([[OPEN - RADIUS - 0.002, -OPEN + RADIUS + 0.002], [0.01, -0.01]]))
    # As they came, they never close.
    came = closing_motion(grasps)
    came.q[:] = 0.0
    shares: list[float] = []
    model = urdf_model(hand)
    settings = methods((1,), stages=True), {"dexgraspbench": DEXGRASPBENCH}, 4, 0, 1
    found = GroupTask("ball", grasps, came, model, *settings).run(shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    assert [one.method.label for one in found] == ["input grasps", "own stages", "geometry only", "1 start"]
    return found


def test_stages_of_the_file_are_simulated(results: list[GroupResult]):
    came, own = results[:2]
    assert (came.reason["dexgraspbench"] != Reason.HELD).all()
    assert own.reason["dexgraspbench"][0] == Reason.HELD
    assert np.isnan(came.values["stages_cpu_ms"]).all() and (own.values["stages_cpu_ms"] > 0).all()


def test_only_refinement_costs_and_moves(results: list[GroupResult]):
    for one in results[:2]:
        for name in ("cpu_ms", "wall_ms", "starts", "moved_palm_m", "moved_slides_m"):
            assert np.isnan(one.values[name]).all()
        assert one.values["contact_gap_m"][0] == pytest.approx(0.002, abs=1e-6)
    for one in results[2:]:
        assert all((one.values[name] > 0).all() for name in ("cpu_ms", "wall_ms", "starts"))
        assert one.values["contact_gap_m"][0] < 1e-4 and one.values["moved_slides_m"][0] > 0.001
        assert one.reason["dexgraspbench"][0] == Reason.HELD
