"""Mirror planes: found where an object is its own image, and right hands become left ones there, and back again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.objects.object import load_object
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.transferred import transferred
from grasp_refine.transfers.hand_frame import HandFrame
from grasp_refine.transfers.mirror import mirror_plane
from grasp_refine.transfers.source_grasps import source_grasps
from tripod import tripod


def lopsided() -> trimesh.Trimesh:
    """A box with a corner cut off, which no plane mirrors onto itself."""
    corners = np.array([[x, y, z] for x in (0, 0.05) for y in (0, 0.07) for z in (0, 0.1)])
    corners[-1] *= 0.7
    return trimesh.convex.convex_hull(corners)


@pytest.mark.parametrize("source", ["mug", "sphere:0.03", "box:0.03,0.04,0.05"])
def test_the_surface_is_its_own_image(source: str):
    plane = mirror_plane(load_object(source))
    assert plane is not None
    np.testing.assert_allclose(plane.points(plane.points(np.eye(3))), np.eye(3), atol=1e-12)


def test_the_plane_turns_with_the_object():
    box = load_object("box:0.03,0.04,0.05").mesh
    M = transform(exp_so3(np.array([0.4, 0.7, -0.2])), np.array([0.1, 0.2, -0.3]))
    plane = mirror_plane(load_object(box.copy().apply_transform(M)))
    assert plane is not None
    np.testing.assert_allclose(np.abs(plane.normal @ M[:3, :3]).max(), 1.0, atol=1e-6)
    np.testing.assert_allclose(plane.point, M[:3, 3], atol=1e-6)


def test_an_object_without_a_plane_has_none():
    assert mirror_plane(load_object(lopsided())) is None


def test_left_and_right_swapped_twice_give_the_same_grasps(tmp_path: Path):
    hands = []
    for at in (-0.03, 0.03):
        (folder := tmp_path / str(at)).mkdir()
        hands.append(tripod(folder, thumb_at=at))
    one, other = hands
    assert HandFrame.of(one).is_left != HandFrame.of(other).is_left
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, 2, 3] = -0.05
    T[1] = transform(exp_so3(np.array([0.2, 0.5, 1.0])), np.zeros(3)) @ T[1]
    grasps = GraspSet.of(one, T, np.full((2, 4), 0.25))
    first = problem_of(one, load_object("sphere:0.027"), grasps)
    there = transferred(first, other)
    back = transferred(there, one)
    swapped, again = (problem.groups[0].scene for problem in (there, back))
    np.testing.assert_allclose(again.T_world_root, T, atol=1e-6)
    np.testing.assert_allclose(again.q, grasps.q, atol=1e-6)
    # Contacts of the left hand are those of the right one, mirrored.
    plane = mirror_plane(first.groups[0].scene.object)
    assert plane is not None
    mirrored = plane.points(source_grasps(first.groups[0].scene).point)
    np.testing.assert_allclose(source_grasps(swapped).point, mirrored, atol=1e-4)
    assert any("mirrored" in note for note in there.notes)


def test_without_a_mirror_plane_the_problem_says_so(tmp_path: Path):
    hands = []
    for at in (-0.03, 0.03):
        (folder := tmp_path / str(at)).mkdir()
        hands.append(tripod(folder, thumb_at=at))
    mesh = lopsided()
    mesh.apply_translation(-mesh.center_mass)
    T = np.eye(4)[None].copy()
    T[0, 2, 3] = -0.09
    problem = problem_of(hands[0], load_object(mesh), GraspSet.of(hands[0], T, np.full((1, 4), 0.1)))
    assert any("no mirror plane" in note for note in transferred(problem, hands[1]).notes)
