"""Labels: each grasp again with the object elsewhere; the mean decides, where a protocol asks for it."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.results.simulated import reason_lines, simulation_entry
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.robustness import holds_at, holds_without_squeeze, judge, noise_score
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Reason, Trials
from grasp_refine_apps.viewer.model.validated import TrialResult
from gripper import RADIUS, around, ball, gripper
from refusals import assert_names
from validation.test_protocol import lever

EDGE, HALF_PLATE = 0.002, 0.04
"""How far from the plates' lower edge the ball is touched, and half of the height of the plates, in metres."""

NOISE = Noise(count=12, offset=0.01, turn=0.0)
SHAKEN = replace(DEXGRASPBENCH, name="shaken", friction=0.1, noise=NOISE, required_label=0.5)

LOST_BELOW = 0.002
"""How far below the edge of the plates the middle of the ball must be, in metres, to be squeezed out against a friction
of 0.1: at R sin(atan 0.1) = 3 mm at the latest, and less with a push or with plates that meet it off their axis."""


def above_the_edge(edge: float = EDGE, count: int = 1) -> Motion:
    """Firm grasps whose plates touch the ball by so little above their lower edge."""
    motion = around(30.0, count=count, opening=2 * RADIUS + 0.05)
    T = motion.T_world_root.copy()
    T[..., 2, 3] += HALF_PLATE - edge
    return Motion(T, motion.q)


def expected(numbers: np.ndarray, lost_below: float) -> np.ndarray:
    """Labels (N,) by geometry: a ball that is so far below the edge is squeezed out, and held otherwise."""
    T = NOISE.poses(numbers, middle=np.zeros(3))
    return (T[..., 2, 3] > -EDGE - lost_below).mean(axis=1)


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(SHAKEN))


def test_the_label_is_the_share_of_the_offsets_at_which_plates_still_touch(world: World):
    numbers = np.array([22, 26, 10])
    least, most = (expected(numbers, LOST_BELOW + slack) for slack in (-0.001, 0.001))
    np.testing.assert_array_equal(least, most)
    trials = judge(world, above_the_edge(count=3), numbers=numbers)
    assert (trials.reason == Reason.HELD).all(), "centred, all hold"
    np.testing.assert_allclose(trials.label, [9 / 12, 10 / 12, 11 / 12])
    np.testing.assert_allclose(trials.label, least)
    assert judge(build_world(gripper(), ball(), Task(DEXGRASPBENCH)), above_the_edge()).label is None


def test_the_required_label_decides(world: World):
    label = float(judge(world, above_the_edge()).label[0])
    for required in (label, label + 0.01):
        one = build_world(gripper(), ball(), Task(replace(SHAKEN, required_label=required)))
        assert judge(one, above_the_edge()).success.tolist() == [required <= label]


@pytest.mark.slow
def test_labels_depend_on_the_row_and_nothing_else(world: World):
    numbers = np.array([5, 6, 7])
    motion = above_the_edge(count=3)
    labels = judge(world, motion, numbers=numbers).label
    alone = judge(world, motion.select(np.array([1])), numbers=numbers[[1]], threads=1).label
    assert labels[1] == alone[0] and len(set(labels)) > 1
    np.testing.assert_array_equal(labels, noise_score(world, motion, NOISE, middle=np.zeros(3), numbers=numbers))


@pytest.mark.slow
def test_further_trials_are_judged_alike(world: World):
    """With little friction nothing holds; with that of the protocol, as many as before; without squeeze, none."""
    motion, numbers = above_the_edge(count=3), np.array([3, 7, 11])
    success = judge(world, motion, numbers=numbers).success
    held = holds_at(world, motion, (0.01, SHAKEN.friction), numbers=numbers)
    np.testing.assert_array_equal(held, np.stack([np.zeros(3, dtype=bool), success], axis=1))
    assert not holds_without_squeeze(world, motion, numbers=numbers).any()
    assert simulate(world, motion).label is None


def test_a_grasp_that_holds_only_where_the_object_should_be_says_so(world: World):
    trials = judge(world, above_the_edge(0.0005))
    strict = replace(SHAKEN, required_label=0.9)
    trials = replace(trials, success=trials.label >= strict.required_label)
    assert trials.outcome.tolist() == [Reason.OFF_CENTRE]
    entry = simulation_entry(trials, 0, strict)
    assert (entry["success"], entry["reason"], entry["label"]) == (False, "off centre", trials.label[0])
    assert_names(entry["rule"], "all of +x", "90 %", "12 trials", "10 mm")
    (line,) = reason_lines(trials, strict)
    assert_names(line.plain, "1 off centre")
    seen = TrialResult.of(trials, 0, strict, {}, None)
    assert not seen.held
    assert_names(seen.verdict, "Does not hold", f"{trials.label[0]:.0%} of 12", "all 6 directions")


def test_offsets_stay_on_the_table_and_turn_the_object_about_its_middle(monkeypatch: pytest.MonkeyPatch):
    """About the centre of mass of two balls of which one is far aside, on a table that is not level."""
    seen: list[Conditions] = []

    def spy(world: World, motion: Motion, conditions: Conditions | None, **others: object) -> Trials:
        seen.extend([] if conditions is None else [conditions])
        return simulate(world, motion, conditions, **others)

    monkeypatch.setattr("grasp_refine.validation.robustness.simulate", spy)
    thing, arm = lever()
    normal = (0.6, 0.0, 0.8)
    middle = np.array([0.0, arm, 0.0])
    for offset, turn in ((0.01, 0.0), (0.0, 0.3)):
        protocol = replace(TABLETOP, noise=Noise(count=4, offset=offset, turn=turn))
        judge(build_world(gripper(), thing, Task(protocol, table=Plane(normal, offset=-0.05))), around(8.0))
    shifted, turned = (conditions.T_world_object for conditions in seen)
    assert np.abs(shifted[:, :3, 3] @ normal).max() < 1e-12 and np.abs(shifted[:, :3, 3]).max() > 1e-4
    np.testing.assert_allclose(turned[:, :3, :3] @ normal, np.tile(normal, (4, 1)), atol=1e-12)
    np.testing.assert_allclose(turned[:, :3, :3] @ middle + turned[:, :3, 3], np.tile(middle, (4, 1)), atol=1e-6)
    assert np.abs(turned[:, :3, 3]).max() > 1e-4


def test_offsets_move_with_the_pose_that_conditions_give(world: World):
    """A grasp and an object that are both somewhere else, and turned, have the label that they have at home."""
    T = transform(exp_so3(np.array([1.6, -0.9, 0.4])), np.array([0.0, 0.3, 0.1]))
    motion = above_the_edge()
    moved = Motion(T @ motion.T_world_root, motion.q)
    at = replace(Conditions.nominal(world, 1), T_world_object=T[None])
    numbers = np.array([22])
    assert judge(world, motion, numbers=numbers).label == judge(world, moved, at, numbers=numbers).label == 9 / 12
