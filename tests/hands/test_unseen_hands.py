"""Hands that nobody tuned anything for: underactuated, with a coupled spread, on an arm, left; from URDF to a hold."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import spread_gripper as gripper_of_three
import underactuated as hand_of_five
from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.se3 import exp_se3, inverse, transform_from_pose
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.refine import Config, Refinement, Scene, refine
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from spread_gripper import spread_gripper
from underactuated import underactuated

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
"""What a left hand is of a right one, and back."""

MODULES = {"five fingers": hand_of_five, "three fingers": gripper_of_three}


@pytest.fixture(scope="module")
def hands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Hand]:
    folder = tmp_path_factory.mktemp("hands")
    return {
        "five fingers": underactuated(folder / "right"),
        "left": underactuated(folder / "left", left=True),
        "three fingers": spread_gripper(folder / "gripper"),
        "arm": spread_gripper(folder / "arm", arm=True),
    }


@pytest.fixture(params=MODULES)
def hand(request: pytest.FixtureRequest, hands: dict[str, Hand]) -> Hand:
    return hands[request.param]


def configurations(hand: Hand, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Root poses and joint values within the limits."""
    rng = np.random.default_rng(0)
    T = exp_se3(rng.normal(size=(count, 6)) * [0.1, 0.1, 0.1, 1, 1, 1])
    return T, rng.uniform(hand.lower, hand.upper, (count, len(hand.lower)))


def values(hand: Hand, q: np.ndarray) -> dict[str, np.ndarray]:
    """Values of all movable joints, worked out from each mimic joint and what it follows, one after the other."""
    found = {name: q[..., i] for i, name in enumerate(hand.joint_names)}
    waiting = [joint for joint in hand.joints if joint.mimic is not None]
    while waiting:
        joint = next(j for j in waiting if j.mimic.joint in found)
        found[joint.name] = joint.mimic.multiplier * found[joint.mimic.joint] + joint.mimic.offset
        waiting.remove(joint)
    return found


def links(hand: Hand) -> list[str]:
    return [link.name for link in hand.links]


# kinematics


def test_mujoco_has_the_links_where_we_have_them(hand: Hand) -> None:
    T, q = configurations(hand, 20)
    ours = Chain(hand, links(hand))(T, q).T_world_link
    made = urdf_model(hand)
    assert made.matrix.shape == (sum(j.movable for j in hand.joints), len(hand.joint_names))
    model = made.spec.compile()
    data, bodies = mujoco.MjData(model), {link: body for body, link in made.links.items()}
    for row, each in zip(inverse(T[:, None]) @ ours, q, strict=True):
        for name, value in values(hand, each).items():
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        for link, expected in zip(links(hand), row, strict=True):
            body = data.body(bodies[link])
            np.testing.assert_allclose(body.xpos, expected[:3, 3], atol=1e-9)
            np.testing.assert_allclose(body.xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)


def grasped(
    hand: Hand, spec: str, count: int = 3, config: Config | None = None
) -> tuple[Scene, HandObject, Refinement]:
    obj = load_object(spec, candidates=1024)
    prepared = HandObject(hand, obj)
    drawn = sample_grasps(hand, obj, count, prepared=prepared)
    scene = Scene(hand, obj, transform_from_pose(drawn.hand_pose), drawn.q)
    return scene, prepared, refine(scene, config, prepared=prepared)


def test_grasps_are_found_refined_and_hold(hand: Hand) -> None:
    scene, prepared, found = grasped(hand, "sphere:0.03")
    count = len(scene.q)
    assert count == 3 and (found.status == Status.CONVERGED).all()
    assert ((found.q >= hand.lower) & (found.q <= hand.upper)).all()
    for name, at in values(hand, found.q).items():
        joint = hand.joints_by_name[name]
        assert (at >= joint.lower - 1e-12).all() and (at <= joint.upper + 1e-12).all(), f"{name} keeps its own limits"
    measured = metrics(hand, scene.object, found.T_world_root, found.q)
    assert measured.limits_violated.sum() == 0
    assert np.median(measured.contact_distance_m) < 1e-5 and measured.penetration_m.max() < 2e-5
    assert measured.self_penetration_m.max() < 1e-5
    motion = closing_motion(replace(scene, T_world_root=found.T_world_root, q=found.q), prepared)
    world = build_world(urdf_model(hand), scene.object, Task(DEXGRASPBENCH))
    assert simulate(world, motion, threads=1).success.sum() >= count - 1


def test_only_the_hand_of_an_arm_moves(hands: dict[str, Hand]) -> None:
    alone, on_arm = hands["three fingers"], hands["arm"]
    assert on_arm.base_link == "palm" and on_arm.joint_names == alone.joint_names
    assert "camera" not in on_arm.links_by_name
    assert on_arm.notes[0] == (
        "the hand begins at its palm, link 'palm': the joints above it do not move (lift, wrist); "
        "`base_link='stand'` moves them too"
    )
    T, q = configurations(alone, 3)
    tips = [contact.link for contact in alone.contacts]
    np.testing.assert_array_equal(Chain(alone, tips)(T, q).T_world_link, Chain(on_arm, tips)(T, q).T_world_link)
    assert touching_pairs(alone) == touching_pairs(on_arm)


def test_a_left_hand_is_the_mirror_image_of_the_right_one(hands: dict[str, Hand]) -> None:
    right, left = hands["five fingers"], hands["left"]
    T, q = configurations(right, 10)
    poses = Chain(right, links(right))(T, q).T_world_link
    mirrored = Chain(left, links(left))(MIRROR @ T @ MIRROR, q).T_world_link
    np.testing.assert_allclose(mirrored, MIRROR @ poses @ MIRROR, atol=1e-12)
    for a, b in zip(right.links, left.links, strict=True):
        assert (a.body is None) == (b.body is None)
        for one, other in zip(a.body.pieces, b.body.pieces, strict=True) if a.body else ():
            volumes = [piece.mesh().volume if len(piece.vertices) > 3 else piece.radius for piece in (one, other)]
            assert volumes[0] == pytest.approx(volumes[1]) and volumes[0] > 0, "faces look outwards"
            np.testing.assert_allclose(one.bounds[:, 1:], other.bounds[:, 1:], atol=1e-12)
            np.testing.assert_allclose(one.bounds[:, 0], -other.bounds[::-1, 0], atol=1e-12)


def test_what_a_left_hand_comes_to_mirrors_what_the_right_one_comes_to(hands: dict[str, Hand]) -> None:
    """Balls and capsules are exact in contact, so that no sampled surface makes a difference between the two."""
    right, left = hands["five fingers"], hands["left"]
    obj = load_object("sphere:0.03", candidates=512)
    drawn = sample_grasps(right, obj, 4)
    T, config = transform_from_pose(drawn.hand_pose), Config(starts=1)
    one = refine(Scene(right, obj, T, drawn.q), config)
    other = refine(Scene(left, obj, MIRROR @ T @ MIRROR, drawn.q), config)
    assert (one.status == Status.CONVERGED).all() and (other.status == Status.CONVERGED).all()
    back = MIRROR @ other.T_world_root @ MIRROR
    assert np.abs(one.T_world_root - T).max() > 1e-4 and np.abs(one.q - drawn.q).max() > 1e-3, "both integrate"
    # The four pushes of the loss go to the corners of a tetrahedron, which is not its own mirror image: where they are
    # more than the contacts can take, hands may differ.
    same = np.abs(back - one.T_world_root).max(axis=(1, 2)) < 1e-6
    assert same.sum() >= 3
    np.testing.assert_allclose(other.q[same], one.q[same], atol=1e-6)
