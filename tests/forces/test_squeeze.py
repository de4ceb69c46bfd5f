"""Squeezes: torques do the work of the forces, set points press and do not pull, actuators make what they can."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.collision.query import query
from grasp_refine.core.array_records import join
from grasp_refine.core.se3 import inverse, transform_from_pose, transform_points
from grasp_refine.forces.squeeze import (
    MIN_PRESSURE_SHARE,
    SOFT_SHARE,
    SQUEEZE_RIDGE,
    contacts,
    pressure_shortfall,
    set_point_offsets,
    squeeze,
    squeezed,
)
from grasp_refine.forces.wrench import PLANNING_FRICTION
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.hand_toml import Coupled
from grasp_refine.hands.hand import Actuator, Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.demand import TOTAL_PRESSURE_N
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import BALL, link, links, made_hand, slide
from single_load import single_load_forces


@pytest.fixture(scope="module")
def clamp(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Two balls that hold a ball of 5 cm; the right one is weak."""
    return made_hand(
        tmp_path_factory.mktemp("clamp"),
        link("base") + links("left", "right", inside=BALL),
        slide("l", "base", "left", at="0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1), effort=100),
        slide("r", "base", "right", at="-0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1), effort=5),
        name="clamp",
        toml="actuator = { kp = 5.0 }",
    )


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object("sphere:0.05", candidates=16)


@pytest.fixture(scope="module")
def mugs() -> Scene:
    """The example grasps of a mug, with a hand whose actuators have no limits."""
    grasps = load_grasps(resource_dir("robots") / "allegro" / "example_mug.npz").select(range(4))
    mug = load_object("mug", scale=float(grasps.scale[0]), candidates=16)
    hand = load_hand("allegro", candidates=16)
    return Scene(limitless(hand), mug, transform_from_pose(grasps.hand_pose), grasps.q)


def limitless(hand: Hand) -> Hand:
    return replace(hand, actuator=replace(hand.actuator, force_limit=np.full(len(hand.lower), np.inf)))


def forces_of(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the object and where links touch it (N, L, 3), as `squeezed` should have them."""
    known = HandObject.of(scene)
    T = known.chain(scene.T_world_root, scene.q).T_world_link
    witness = query(known.pairs, T, np.broadcast_to(np.eye(4), T.shape))
    points, axes = contacts(scene.hand, scene.object, scene.links, witness, T), scene.T_world_root[:, :3, :3]
    assert not points.patched.any()
    L, center = len(scene.links), scene.object.center_of_mass
    point, normal = points.point[:, :L], points.normal[:, :L]
    force = single_load_forces(point, normal, center, ridge=SQUEEZE_RIDGE, axes=axes).force
    return TOTAL_PRESSURE_N * force, witness.point_a


def test_a_clamp_presses_inward_with_half_the_total_each(clamp: Hand, ball: Object) -> None:
    """Joint values grow to the right; kp is 5 N/m, and the right pad makes 5 N at most."""
    scene = Scene(clamp, ball, np.eye(4)[None], np.array([[0.002, 0.0]]))
    found = squeezed(scene)
    np.testing.assert_allclose(found, [[0.002 - 15.0 / 5.0, 5.0 / 5.0]], atol=1e-6)
    np.testing.assert_allclose(squeezed(scene, total=4.0), [[0.002 - 2.0 / 5.0, 2.0 / 5.0]], atol=1e-6)
    assert found[0, 0] < clamp.lower[0], "set points may lie beyond the limits"


@pytest.mark.parametrize(
    ("mass", "limit", "newtons"), [(0.1, 100.0, 15.0), (1.0, 100.0, 30.0), (1.0, 22.0, 22.0), (1.0, 5.0, 5.0)]
)
def test_heavier_objects_are_pressed_harder_up_to_what_actuators_make(
    clamp: Hand, ball: Object, mass: float, limit: float, newtons: float
) -> None:
    """Objects of 1 kg ask for 60 N in all; the right pad makes `limit` at most, and no finger presses for it."""
    hand = replace(clamp, actuator=replace(clamp.actuator, force_limit=np.array([100.0, limit])))
    task = Task(PROTOCOLS["dexgraspbench"].with_mass(mass))
    found = squeezed(Scene(hand, ball, np.eye(4)[None], np.zeros((1, 2)), task=task))
    left = max(newtons, TOTAL_PRESSURE_N / 2)
    np.testing.assert_allclose(found, [[-left / 5.0, newtons / 5.0]], atol=1e-6)


def test_planned_forces_are_as_in_the_contacts(clamp: Hand, ball: Object) -> None:
    """Two balls press a ball with half of the total each, where they touch it, towards each other."""
    T, q = np.tile(np.eye(4), (3, 1, 1)), np.array([[0.002, 0.0], [0.0, 0.0], [0.1, 0.0]])
    T[1, 0, 3] = np.nan
    found = squeeze(Scene(clamp, ball, T, q), total=8.0).forces.flat()
    # The second grasp has no pose; in the third one link is out of reach, and the other presses alone.
    assert found.grasp.tolist() == [0, 0, 2] and found.link.tolist() == ["left", "right", "right"]
    np.testing.assert_allclose(found.point, [[0.05, 0, 0], [-0.05, 0, 0], [-0.05, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(found.normal, [[-1, 0, 0], [1, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(found.vector[:2], [[-4, 0, 0], [4, 0, 0]], atol=1e-6)
    assert [entry["link"] for entry in found.of_grasp(2)] == ["right"]


def test_planned_forces_leave_the_residual_of_an_independent_program_and_stay_in_their_cones(mugs: Scene) -> None:
    force, on_link = forces_of(mugs)
    found, center = squeeze(mugs).forces.flat(), mugs.object.center_of_mass
    for i in range(4):
        f, r = (values[found.grasp == i] for values in (found.vector, found.point - center))
        left = np.concatenate([f.sum(axis=0), np.cross(r, f).sum(axis=0)])
        wanted = np.concatenate([force[i].sum(axis=0), np.nansum(np.cross(on_link[i] - center, force[i]), axis=0)])
        np.testing.assert_allclose(left[:3], wanted[:3], atol=1e-4)
        # Those points are on the links, these on the object, a gap of at most millimetres away.
        np.testing.assert_allclose(left[3:], wanted[3:], atol=30.0 * 0.005)
    along = (found.vector * found.normal).sum(axis=1)
    across = np.linalg.norm(found.vector - along[:, None] * found.normal, axis=1)
    assert (along > -1e-9).all() and (across <= PLANNING_FRICTION * along + 1e-9).all()
    np.testing.assert_allclose(np.bincount(found.grasp, along), TOTAL_PRESSURE_N, rtol=1e-9)


def test_forces_on_objects_with_and_without_flat_faces_are_joined() -> None:
    """Where flat faces meet, there are up to four forces for a link; a ball has one."""
    hand = load_hand("franka_hand", candidates=16)
    T, q = np.eye(4)[None].copy(), np.array([[0.02]])
    T[0, 2, 3] = -0.1034
    parts = [squeeze(Scene(hand, load_object(name), T, q)).forces for name in ("box:0.06,0.04,0.02", "sphere:0.02")]
    found = join(*parts).flat()
    assert np.bincount(found.grasp).tolist() == [8, 2]
    for i in range(2):
        np.testing.assert_allclose(found.vector[found.grasp == i].sum(axis=0), 0.0, atol=1e-3)


def test_set_points_are_as_in_the_actuators_that_pull(clamp: Hand, ball: Object) -> None:
    """Another simulated hand is said by its actuators; what was prepared of the hand may stay."""
    other = replace(clamp.actuator, kp=np.array([500.0, 1.0]), force_limit=np.array([np.inf, 0.5]))
    scene = Scene(clamp, ball, np.eye(4)[None], np.array([[0.002, 0.0]]))
    found = squeezed(replace(scene, hand=replace(clamp, actuator=other)), HandObject.of(scene))
    np.testing.assert_allclose(found, [[0.002 - 15.0 / 500.0, 0.5]], atol=1e-6)


def test_torques_do_the_work_of_the_forces(mugs: Scene) -> None:
    """Virtual work: tau . dq is the sum of f . dx of the points of the links, for any dq."""
    force, on_link = forces_of(mugs)
    assert (np.abs(force).sum(axis=-1) > 0).sum(axis=1).min() >= 2
    torque = (squeezed(mugs) - mugs.q) * mugs.hand.actuator.kp
    chain = Chain(mugs.hand, mugs.links)
    material = transform_points(inverse(chain(mugs.T_world_root, mugs.q).T_world_link), on_link)
    rng = np.random.default_rng(0)
    for _ in range(5):
        dq = rng.normal(size=mugs.q.shape)
        ahead, behind = (
            transform_points(chain(mugs.T_world_root, mugs.q + step * dq).T_world_link, material)
            for step in (1e-6, -1e-6)
        )
        work = (force * (ahead - behind) / 2e-6).sum(axis=(1, 2))
        np.testing.assert_allclose((torque * dq).sum(axis=1), work, rtol=1e-6, atol=1e-7)


def test_hands_that_touch_nothing_do_not_squeeze(clamp: Hand, ball: Object) -> None:
    q = np.array([[0.05, -0.05], [0.011, -0.05], [0.0099, -0.05]])
    found = squeezed(Scene(clamp, ball, np.tile(np.eye(4), (3, 1, 1)), q))
    np.testing.assert_array_equal(found[:2], q[:2])
    # One finger in reach pushes alone, with all that there is.
    np.testing.assert_allclose(found[2], [0.0099 - 30.0 / 5.0, -0.05], atol=1e-6)


def test_grasps_that_are_not_finite_become_nan_and_harm_no_other(clamp: Hand, ball: Object) -> None:
    T, q = np.tile(np.eye(4), (3, 1, 1)), np.zeros((3, 2))
    T[0, 1, 1], q[2, 0] = np.nan, np.inf
    found = squeezed(Scene(clamp, ball, T, q))
    np.testing.assert_array_equal(np.isnan(found), [[True, True], [False, False], [True, True]])
    np.testing.assert_array_equal(found[1], squeezed(Scene(clamp, ball, T[1:2], q[1:2]))[0])


# actuators


def ending(hand: Hand, left: float) -> Hand:
    """The clamp without force limits, whose left pad has set points from `left` on."""
    ends = np.array([[left, np.inf], [-np.inf, np.inf]])
    return limitless(replace(hand, actuator=replace(hand.actuator, set_points=ends)))


@pytest.mark.parametrize(("newtons", "share"), [(20.0, 1.0), (10.0, 10.0 / 15.0), (1.0, MIN_PRESSURE_SHARE)])
def test_the_other_finger_presses_less_where_the_set_points_of_one_end(
    clamp: Hand, ball: Object, newtons: float, share: float
) -> None:
    """Both pads press with 15 N, or with what the left one can; the right one at least with `MIN_PRESSURE_SHARE`."""
    q = np.array([[0.002, 0.0]])
    hand = ending(clamp, 0.002 - newtons / 5.0)
    found = squeeze(Scene(hand, ball, np.eye(4)[None], q))
    left, right = 5.0 * (found.q - q)[0]
    np.testing.assert_allclose(np.linalg.norm(found.forces.flat().vector, axis=1), share * 15.0)
    # A force limit does not change the other actuators.
    weak = replace(hand, actuator=replace(hand.actuator, force_limit=np.array([np.inf, 5.0])))
    ahead = 5.0 * (squeezed(Scene(weak, ball, np.eye(4)[None], q)) - q)[0]
    np.testing.assert_allclose(ahead, [left, 5.0])
    assert right == pytest.approx(share * 15.0)
    assert left == pytest.approx(-min(newtons, 15.0))


@pytest.mark.parametrize("newtons", [0.0, 3.0, 20.0])
def test_a_shortfall_is_of_the_pressure_that_both_fingers_should_make(
    clamp: Hand, ball: Object, newtons: float
) -> None:
    q = np.array([[0.002, 0.0]])
    scene = Scene(ending(clamp, 0.002 - newtons / 5.0), ball, np.eye(4)[None], q)
    known = HandObject.of(scene)
    frames = known.chain(scene.T_world_root, q)
    T = frames.T_world_link
    witness = query(known.pairs, T, np.broadcast_to(np.eye(4), T.shape))
    points = contacts(scene.hand, ball, scene.links, witness, T)
    [found] = pressure_shortfall(scene.hand, ball, known.chain, frames, points)
    assert found == pytest.approx(1.0 - min(2.0 * newtons / (SOFT_SHARE * TOTAL_PRESSURE_N), 1.0), abs=1e-6)
    assert not pressure_shortfall(clamp, ball, known.chain, frames, points).any()


def tendons(hand: Hand, groups: tuple[Coupled, ...], limit: float) -> Hand:
    n = len(hand.lower)
    plain = np.zeros(n)
    return replace(hand, coupled=groups, actuator=Actuator(np.full(n, 4.0), np.full(n, limit), plain, plain, plain))


def tension(hand: Hand, ahead: np.ndarray, group: Coupled) -> np.ndarray:
    """What the actuator of a tendon pulls with when its set point is the sum of ratio x set point."""
    joints = [hand.joint_names.index(name) for name in group.joints]
    return 4.0 * ahead[:, joints] @ np.array(group.ratio)


def test_a_tendon_makes_the_nearest_torques_in_its_ratio(mugs: Scene) -> None:
    group = Coupled(mugs.hand.joint_names[5:8:2], (1.0, -0.5))
    hand = tendons(mugs.hand, (group,), np.inf)
    torque = np.random.default_rng(2).normal(size=(7, 16))
    made = tension(hand, set_point_offsets(hand, torque, np.zeros_like(torque)), group)[:, None] * np.array(group.ratio)
    # The rest is orthogonal to all that the tendon can make.
    np.testing.assert_allclose((torque[:, 5:8:2] - made) @ np.array(group.ratio), 0.0, atol=1e-12)


def test_no_actuator_is_asked_for_more_than_it_can(mugs: Scene) -> None:
    group = Coupled(mugs.hand.joint_names[2:4], (1.0, 1.0))
    hand = tendons(mugs.hand, (group,), 0.5)
    torque = np.full((1, 16), 3.0) * np.where(np.arange(16) % 4 == 0, -1.0, 1.0)
    ahead = set_point_offsets(hand, torque, np.zeros_like(torque))
    np.testing.assert_allclose(tension(hand, ahead, group), 0.5)
    single = np.delete(ahead, [2, 3], axis=1)
    np.testing.assert_allclose(np.abs(single), 0.5 / 4.0)
    np.testing.assert_array_equal(np.sign(single), np.sign(np.delete(torque, [2, 3], axis=1)))


def test_actuators_without_stiffness_are_not_moved(mugs: Scene) -> None:
    kp = np.full(16, 4.0)
    kp[[1, 2]] = 0.0
    group = Coupled(mugs.hand.joint_names[2:4], (1.0, 1.0))
    hand = replace(mugs.hand, coupled=(group,), actuator=replace(mugs.hand.actuator, kp=kp))
    ahead = set_point_offsets(hand, np.ones((1, 16)), np.zeros((1, 16)))
    np.testing.assert_array_equal(np.flatnonzero(ahead[0] == 0.0), [1, 2, 3])
