"""Torques that a hand cannot make: forms of forces, their derivatives, and what springs of linkages hold of them."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptive_gripper import write_adaptive_gripper
from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.se3 import exp_so3, transform, transform_points
from grasp_refine.forces.infeasible_torques import LEVER_M, InfeasibleTorques, mode_shares
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.problem.facade import refine
from grasp_refine.scene.demand import TOTAL_PRESSURE_N
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import close
from grasp_refine.validation.validate import model_of


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return load_hand(write_adaptive_gripper(tmp_path_factory.mktemp("adaptive")), candidates=512)


def poses(count: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.stack([transform(exp_so3(rng.normal(size=3)), 0.1 * rng.normal(size=3)) for _ in range(count)])


def test_forces_through_the_centre_of_a_finger_do_not_turn_it(hand: Hand) -> None:
    """It is where the lines of its two bars meet, in the plane in which they move."""
    chain, q = Chain(hand, ("right_bar", "right_coupler", "right_finger")), np.array([[0.1], [0.3]])
    frames = chain(poses(2), q)
    row = [mode.joint for mode in hand.modes].index("right_bar")
    for T, forms_at in zip(frames.T_world_link, (0, 1), strict=True):
        anchor = transform_points(T[2], np.array([[0.02, 0.0, 0.0]]))[0]
        bar, coupler = T[2, :3, 3] - T[0, :3, 3], anchor - T[1, :3, 3]
        along = np.linalg.lstsq(np.stack([bar, -coupler], axis=1), T[1, :3, 3] - T[0, :3, 3], rcond=None)[0]
        centre = T[0, :3, 3] + along[0] * bar
        for shift, largest in ((0.0, 1e-3), (0.02, np.inf)):
            points = np.tile(centre + shift * T[2, :3, 0], (2, 3, 1))
            forms = InfeasibleTorques.of(hand, chain).forms(frames, points)
            assert forms is not None
            at_finger = np.linalg.norm(forms[forms_at, row, 2])
            assert at_finger < largest and (shift == 0.0 or at_finger > 0.1)


def test_changes_are_the_derivative_of_the_forms(hand: Hand) -> None:
    """Finite differences, for forces and points at rest while the hand moves."""
    links = links_of(hand)
    chain = Chain(hand, links)
    T, q = poses(3), np.array([[0.113], [0.207], [0.391]])
    rng = np.random.default_rng(5)
    L = len(links)
    p, f = 0.1 * rng.normal(size=(3, L, 3)), rng.normal(size=(3, 2, L, 3))
    infeasible = InfeasibleTorques.of(hand, chain)

    def torques(dx: np.ndarray) -> np.ndarray:
        frames = chain(integrate(T, np.tile(dx[:6], (3, 1))), q + dx[6:])
        forms = infeasible.forms(frames, p)
        assert forms is not None
        return np.einsum("mekx,mpkx->mpe", forms, f)

    frames = chain(T, q)
    for link in (np.arange(L), np.tile(np.arange(L), (3, 1))):
        found = infeasible.changes(frames, link, p, f)
        assert found.shape == (3, 2, 2, 7)
        for column in range(7):
            step = 1e-6 * np.eye(7)[column]
            expected = (torques(step) - torques(-step)) / 2e-6
            np.testing.assert_allclose(found[..., column], expected, atol=2e-5 * np.abs(found).max())


def test_shares_are_of_springs_on_one_side_and_none_on_the_other(hand: Hand) -> None:
    chain, q = Chain(hand, ("right_pad",)), np.array([[0.2]])
    frames = chain(np.eye(4)[None], q)
    (row,) = [e for e, mode in enumerate(hand.modes) if mode.joint == "right_bar"]
    least = hand.modes[row].bounds(q[:, 0])[0][0]
    point = transform_points(frames.T_world_link[:, 0], np.array([[[0.0, 0.0, 0.02]]]))
    force = np.array([1.0, 0.0, 0.0]) * np.array([[[1.0]], [[-1.0]]]).reshape(1, 2, 1, 1)
    found = mode_shares(hand, chain, frames, force, point, np.zeros((1, 1), dtype=np.int64), 0.0)[0, :, row]
    forms = InfeasibleTorques.of(hand, chain).forms(frames, point)
    assert forms is not None
    torque = LEVER_M * (force @ forms[0, row, 0])[0, :, 0]
    for share, made in zip(found, torque, strict=True):
        assert share == pytest.approx(made / least if made < 0.0 else 0.0, rel=1e-6)
    assert (found > 0.0).sum() == 1


def pinch(hand: Hand, above: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the hand and joint values at which its pads touch what is 5 cm wide at the origin.

    The centre about which a pad turns is `above` metres nearer to the palm; at 0 the pads do not move along x.
    """
    chain, values = Chain(hand, ("right_pad",)), np.linspace(hand.lower[0], hand.upper[0], 2001)
    T_pad = chain(np.tile(np.eye(4), (2001, 1, 1)), values[:, None]).T_world_link[:, 0]
    at = np.abs(T_pad[:, 0, 3] - 0.004 - 0.025).argmin()  # pads of 4 mm either way
    (mode,) = [mode for mode in hand.modes if mode.joint == "right_bar"]
    twist = mode.twist("right_pad", values[[at]])[0]
    centre = T_pad[at, 2, 3] - twist[0] / twist[4]
    return transform(np.eye(3), np.array([0.0, 0.0, -centre - above])), values[[at]]


def pressure(hand: Hand) -> float:
    """Pressure in newtons of both fingers on a box that stands between the middles of their pads, after the squeeze."""
    obj, (T, q) = load_object("box:0.05,0.03,0.01"), pinch(hand, 0.0)
    scene = Scene(hand, obj, T[None], q[None])
    world = build_world(model_of(hand), obj, Task(DEXGRASPBENCH, table=scene.table))
    closed = close(world, closing_motion(scene), Conditions.nominal(world, 1))
    data = mujoco.MjData(world.model)
    mujoco.mj_setState(world.model, data, closed.state[0], mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_step(world.model, data, nstep=200)
    force, total = np.zeros(6), 0.0
    for number in range(data.ncon):
        mujoco.mj_contactForce(world.model, data, number, force)
        total += force[0]
    return total


def test_squeezes_press_through_what_gives_way(hand: Hand) -> None:
    """The set point lies beyond by what the linkage takes: without that, a stiff actuator hardly presses."""
    assert pressure(hand) > max(0.5 * TOTAL_PRESSURE_N, 1.5 * pressure(replace(hand, compliance=None)))


def test_fingers_that_springs_hardly_hold_are_reported(tmp_path: Path, hand: Hand) -> None:
    """Springs resist forces beyond the centre about which a pad turns; nearer to the palm, stops of the joints do."""
    weak = load_hand(write_adaptive_gripper(tmp_path, spring=1e-4), candidates=512)
    T, q = (np.stack(parts) for parts in zip(*(pinch(hand, above) for above in (-0.01, 0.005, 0.01)), strict=True))
    ball, beyond = load_object("sphere:0.025"), np.array([False, True, True])
    firm, soft = (refine(one, ball, GraspSet.of(one, T, q)).outcome for one in (hand, weak))
    assert (firm.quality > 0.9).all()
    assert (soft.quality[:, 1] < 0.1).tolist() == beyond.tolist() and soft.quality[0, 1] > 0.9
    named = np.char.find(soft.weakness, "_bar, which no actuator drives, needs") >= 0
    assert named.tolist() == beyond.tolist() and "_bar" not in " ".join(firm.weakness)
