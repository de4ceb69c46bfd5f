"""Score of grasps with two fingers: edges under them, and their way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.forces.squeeze import contacts
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.judging import judge
from grasp_refine.refinement.pinches import EDGE_WEIGHT, ROOM_M, ROOM_WEIGHT, edge_shares, finger_room, pinch_score
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

BETWEEN_M = 0.085
"""Distance of the base link of the gripper from the middle between its jaws."""


@pytest.fixture(scope="module")
def gripper() -> Hand:
    return load_hand(Path(__file__).parent.parent / "two_jaws.urdf", candidates=64)


@pytest.fixture(scope="module")
def box() -> Object:
    return load_object("box:0.05,0.05,0.12")


def beside(place: list[float], count: int) -> np.ndarray:
    """Poses (count, 4, 4) of grippers that come along z, with the middle between the jaws at a place."""
    x, y, z = place
    return np.tile(exp_se3(np.array([x, y, z - BETWEEN_M, 0.0, 0.0, 0.0])), (count, 1, 1))


def test_half_of_the_surface_around_an_edge_turns_away(box: Object) -> None:
    surface, height = box.body.candidates, np.linspace(-0.03, 0.03, 41)
    face, edge = (np.stack([0.025 + 0.0 * height, y + 0.0 * height, height], axis=-1)[None] for y in (0.0, 0.025))
    first, second = np.array([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])

    def shares(point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return edge_shares(surface, point, np.tile(normal, (1, len(height), 1)))

    np.testing.assert_allclose(shares(face, first), 0.0, atol=1e-12)
    # The points of each face are at right angles to the normal of the other.
    np.testing.assert_allclose(shares(edge, first) + shares(edge, second), 1.0, atol=1e-12)
    assert (shares(edge, first) > 0.0).mean() > 0.9
    np.testing.assert_allclose(shares(edge, (first + second) / np.sqrt(2.0)), 1.0 - np.sqrt(0.5), atol=1e-12)


def test_the_other_side_of_a_thin_wall_is_no_edge() -> None:
    wall = load_object("box:0.1,0.002,0.1").body.candidates
    point, normal = np.array([[[0.0, 0.001, 0.0]]]), np.array([[[0.0, -1.0, 0.0]]])
    assert edge_shares(wall, point, normal)[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_room_is_what_the_limits_leave_on_either_side(gripper: Hand, box: Object) -> None:
    """Slides of 0 to 55 mm on each side of a box of 50 mm, which the hand grasps beside its middle."""
    prepared = HandObject(gripper, box)
    shift = np.array([0.0, 0.01, 0.0295, -0.0246])
    T = np.concatenate([beside([0.0, y, 0.0], 1) for y in shift])
    q = np.stack([0.025 - shift, 0.025 + shift], axis=1)
    q = q if gripper.joint_names == ("left_slide", "right_slide") else q[:, ::-1]
    frames = prepared.chain(T, q)
    witness = query(prepared.pairs, frames.T_world_link, np.broadcast_to(np.eye(4), frames.T_world_link.shape))
    touching = np.abs(witness.distance) < 1e-6
    assert touching.sum(axis=1).tolist() == [2] * 4
    room = finger_room(prepared, frames, witness, touching)
    np.testing.assert_allclose(room, np.minimum(q, 0.055 - q).clip(0.0).min(axis=1), atol=1e-9)
    assert np.isinf(finger_room(prepared, frames, witness, np.zeros_like(touching))).all()


def test_a_finger_at_its_stop_costs(gripper: Hand) -> None:
    """Two boxes that differ only in what they leave of the stroke."""
    scores = []
    for width in (0.1, 0.11):
        prepared = HandObject(gripper, load_object(f"box:0.1,{width},0.12"))
        frames = prepared.chain(beside([0.0, 0.0, 0.0], 1), np.full((1, 2), width / 2.0))
        scores.append(judge(prepared, frames)[0][0])
    assert scores[1] - scores[0] > 0.9 * ROOM_WEIGHT and ROOM_M < 0.005


def test_the_worse_finger_counts_by_the_middle_of_its_patch(gripper: Hand) -> None:
    """Jaws whose patches end at the rim of a box, and one of which is at a corner of another one."""
    block = load_object("box:0.05,0.05,0.12", candidates=2048)
    prepared = HandObject(gripper, block)
    T = np.concatenate([beside([x, 0.0, z], 1) for x, z in ((0.0, 0.0), (0.028, 0.0), (0.0, 0.065))])
    q = np.full((3, 2), 0.025)
    frames = prepared.chain(T, q)
    poses = frames.T_world_link
    witness = query(prepared.pairs, poses, np.broadcast_to(np.eye(4), poses.shape))
    points = contacts(gripper, block, prepared.chain.links, witness, poses)
    assert points.patched.all()
    edges, room = np.zeros(3), []
    for row in range(3):
        for link in np.unique(points.link[row][np.isfinite(points.point[row, :, 0])]):
            own = (points.link[row] == link) & np.isfinite(points.point[row, :, 0])
            middle, normal = points.point[row, own].mean(axis=0), points.normal[row, own].mean(axis=0)
            share = edge_shares(block.body.candidates, middle[None, None], normal[None, None])[0, 0]
            edges[row] = max(edges[row], share)
    room = np.minimum(q, 0.055 - q).min(axis=1)
    expected = EDGE_WEIGHT * edges + ROOM_WEIGHT * (1.0 - np.minimum(room / ROOM_M, 1.0))
    np.testing.assert_allclose(pinch_score(prepared, frames, witness, points), expected, atol=1e-9)
    assert edges[0] < 1e-9 and edges[1:].max() > 0.1


def test_grippers_leave_edges_and_use_their_jaws_alone(gripper: Hand, box: Object) -> None:
    """Jaws that come diagonally turn to faces, also where the palm is as near as a contact."""
    T = beside([0.0, 0.0, 0.0], 3) @ exp_se3(np.array([[0, 0, 0, 0, 0, turn] for turn in (0.5, 0.7, 0.9)]))
    T[:, 2, 3] = -0.06 - 0.06 - 0.002  # The palm ends 60 mm above its frame, and the box 60 mm below its own.
    found = refine(Scene(gripper, box, T, np.full((3, 2), 0.037)), Config())
    prepared = HandObject(gripper, box)
    links = np.array(prepared.chain.links)
    assert not found.touching[:, links == "palm"].any() and (found.touching.sum(axis=1) == 2).all()
    frames = prepared.chain(found.T_world_root, found.q)
    witness = query(prepared.pairs, frames.T_world_link, np.broadcast_to(np.eye(4), frames.T_world_link.shape))
    normal = np.abs(witness.normal[found.touching])
    assert (normal.max(axis=1) > 0.99).all(), "each jaw looks along the normal of a face"
    assert judge(prepared, frames)[0].max() < EDGE_WEIGHT
    palm = links[ContactSelection().choose(gripper, tuple(links), replace(witness, distance=0.0 * witness.distance))[0]]
    assert set(palm) == {"left_jaw", "right_jaw"}


def test_two_fingers_touch_in_patches_unless_set_otherwise(gripper: Hand, tmp_path: Path) -> None:
    assert gripper.patches and gripper.has_two_fingers and set(gripper.fingers) == {"left_jaw", "right_jaw"}
    assert not load_hand("allegro", candidates=16).patches
    urdf = Path(__file__).parent.parent / "two_jaws.urdf"
    (tmp_path / "hand.toml").write_text(f'urdf = "{urdf}"\npatches = false')
    assert not load_hand(tmp_path, candidates=16).patches
