"""Sampled grasps touch with two groups of links, are deep in nothing, and differ; the seed says which they are."""

import re
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.errors import GraspRefineError, HandError
from grasp_refine.core.se3 import transform_from_pose, transform_points
from grasp_refine.forces.squeeze import contacts, grasp_forces
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.objects.object import Object, load_object
from grasp_refine.sampling.sample import (
    CONTACT_DISTANCE_M,
    MAX_DEPTH_M,
    MAX_GRASPS,
    MAX_HALVINGS,
    MIN_SPACING_M,
    sample_grasps,
)
from grasp_refine.scene.contact_selection import PALM, link_groups
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import links_of
from grasp_refine.scene.task import Task
from plate_gripper import PLATE, URDF
from refusals import refused


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    path: Path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF)
    return load_hand(path, candidates=64)


@pytest.fixture(scope="module")
def allegro() -> Hand:
    return load_hand("allegro", candidates=64)


@pytest.fixture(scope="module")
def box() -> Object:
    return load_object("box:0.05,0.06,0.07", candidates=256)


@pytest.fixture(scope="module")
def held(allegro: Hand, box: Object) -> GraspSet:
    return sample_grasps(allegro, box, 12)


def witness_of(hand: Hand, obj: Object, grasps: GraspSet) -> Witness:
    prepared = HandObject(hand, obj)
    T = prepared.chain(transform_from_pose(grasps.hand_pose), grasps.q).T_world_link
    return query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))


def groups_touching(hand: Hand, obj: Object, grasps: GraspSet) -> list[set[str]]:
    """The groups of links that touch in each grasp."""
    group = np.array(link_groups(hand, links_of(hand)))
    return [set(group[row]) for row in witness_of(hand, obj, grasps).distance <= CONTACT_DISTANCE_M]


def check(hand: Hand, obj: Object, grasps: GraspSet) -> None:
    """What holds of all sampled grasps."""
    assert np.isfinite(grasps.hand_pose).all()
    assert (grasps.q >= hand.lower).all() and (grasps.q <= hand.upper).all()
    assert witness_of(hand, obj, grasps).distance.min() >= -MAX_DEPTH_M
    assert self_penetration(hand, touching_pairs(hand), grasps.q).max(initial=0.0) <= MAX_DEPTH_M
    assert all(len(groups) >= 2 for groups in groups_touching(hand, obj, grasps))


def test_sampled_grasps_hold_the_object(allegro: Hand, box: Object, held: GraspSet):
    check(allegro, box, held)
    assert (held.hand, held.base_link, held.joint_names) == ("allegro", "base_link", allegro.joint_names)
    assert set(held.object) == {box.name}
    assert (held.scale == 1.0).all()
    assert len(held) == 12
    T = transform_from_pose(held.hand_pose)
    T_link = HandObject(allegro, box).chain(T, held.q).T_world_link
    points = contacts(allegro, box, links_of(allegro), witness_of(allegro, box, held), T_link)
    forces = grasp_forces(points, box, T[:, :3, :3])
    assert np.median(forces.residual) < 0.05, "most of them can squeeze the object without moving it"


def test_no_two_grasps_are_alike(allegro: Hand, held: GraspSet):
    points = transform_points(transform_from_pose(held.hand_pose)[:, None], 0.1 * np.eye(4)[:, :3])
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1).max(axis=-1)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > MIN_SPACING_M / 2**MAX_HALVINGS


def test_the_seed_says_which_grasps(gripper: Hand, box: Object):
    one, again, other = (sample_grasps(gripper, box, 4, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.hand_pose, again.hand_pose)
    np.testing.assert_array_equal(one.q, again.q)
    assert not np.isin(one.hand_pose[:, 0], other.hand_pose[:, 0]).any()


@pytest.mark.parametrize("source", ["sphere:0.03", "box:0.04,0.05,0.1", "cylinder:0.025,0.1"])
def test_jaws_hold_from_both_sides(gripper: Hand, source: str):
    obj = load_object(source, candidates=256)
    grasps = sample_grasps(gripper, obj, 8)
    check(gripper, obj, grasps)
    assert all({"left", "right"} <= groups for groups in groups_touching(gripper, obj, grasps)[:4])
    witness = witness_of(gripper, obj, grasps)
    facing = (witness.normal[:, 0] * witness.normal[:, 1]).sum(axis=-1)
    assert facing[0] < -0.9, "the best push against each other"


@pytest.mark.parametrize("urdf", ["shadow/shadow_right.urdf", "barrett/barrett.urdf"])
def test_a_bare_urdf_will_do(shared_assets: Path, box: Object, urdf: str):
    hand = load_hand(shared_assets / "hands" / urdf, candidates=64)
    grasps = sample_grasps(hand, box, 2)
    assert len(grasps) == 2
    check(hand, box, grasps)
    assert any(len(groups - {PALM}) >= 3 for groups in groups_touching(hand, box, grasps))


def test_no_link_is_below_the_table(gripper: Hand):
    obj, table = load_object("box:0.04,0.05,0.1", candidates=256), Plane(offset=-0.05)
    grasps = sample_grasps(gripper, obj, 8, task=Task(table=table))
    check(gripper, obj, grasps)
    prepared = HandObject(gripper, obj)
    T = prepared.chain(transform_from_pose(grasps.hand_pose), grasps.q).T_world_link
    assert transform_points(T, table.lowest(prepared.bodies, T))[..., 2].min() >= table.offset - MAX_DEPTH_M


@pytest.mark.parametrize("count", [0, -1, MAX_GRASPS + 1])
def test_a_count_is_in_range(gripper: Hand, box: Object, count: int):
    with refused(GraspRefineError, f"1 to {MAX_GRASPS}", count):
        sample_grasps(gripper, box, count)


def test_what_has_no_fingers_cannot_grip(tmp_path: Path, box: Object):
    path = tmp_path / "block.urdf"
    path.write_text(f'<robot name="block"><link name="palm">{PLATE}</link></robot>')
    with refused(HandError, "block"):
        sample_grasps(load_hand(path, candidates=16), box, 1)


def test_joints_with_equal_limits_cannot_grip(tmp_path: Path, box: Object):
    """SolidWorks exports all limits as 0."""
    path = tmp_path / "still.urdf"
    path.write_text(re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0" upper="0"', URDF))
    with refused(HandError, "still", "limits"):
        sample_grasps(load_hand(path, candidates=16), box, 1)


def test_why_no_grasp_was_found_is_said(gripper: Hand):
    """Closed jaws leave 3 cm between them."""
    with refused(GraspRefineError, "fewer than two fingers", "hand.toml"):
        sample_grasps(gripper, load_object("box:0.01,0.01,0.02", candidates=64), 1)
