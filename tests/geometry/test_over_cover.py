"""How far convex pieces stand out of meshes, in closed form."""

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry.nearest_triangle import Triangles
from grasp_refine.geometry.over_cover import MAX_OVERESTIMATE, over_cover
from grasp_refine.geometry.pieces import Piece, box, hull


def boxes(*bounds: list[float]) -> trimesh.Trimesh:
    """Boxes, each from its lower and upper corner, as one mesh; where they touch they are united."""
    return trimesh.boolean.union([trimesh.creation.box(bounds=np.reshape(corners, (2, 3))) for corners in bounds])


def stands_out(mesh: trimesh.Trimesh, *pieces: Piece, least: float = 0.01) -> float:
    return over_cover(pieces or [hull(mesh.vertices)], Triangles(np.asarray(mesh.triangles)), least=least)


def above(truth: float) -> object:
    """What may come back where this is true: no less, and up to `MAX_OVERESTIMATE` more."""
    return pytest.approx(truth * (1 + MAX_OVERESTIMATE / 2), rel=MAX_OVERESTIMATE / 2 + 1e-9)


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_l_shape(size: float) -> None:
    """Two legs of length 3 and width 1: the slope from (3, 1) to (1, 3) is sqrt(2) away at its middle."""
    shape = boxes([0, 0, 0, 3, 1, 1], [0, 0, 0, 1, 3, 1]).apply_scale(size)
    assert stands_out(shape, least=0.01 * size) == above(size)
    # The point of the slope that is farthest from both legs is (2, 2), 1 away from each.


def test_a_notch_as_deep_as_it_is_narrow() -> None:
    """Across a notch of width 2 w and depth d the hull is at most min(w, d) away from walls and floor."""
    for width, depth in [(1.0, 3.0), (4.0, 0.5)]:
        shape = boxes([0, 0, 0, 10, 5, 1], [0, 0, 0, 5 - width, 5, 1 + depth], [5 + width, 0, 0, 10, 5, 1 + depth])
        assert stands_out(shape) == above(min(width, depth))


def test_two_boxes_apart() -> None:
    assert stands_out(boxes([0, 0, 0, 1, 1, 1], [7, 0, 0, 8, 1, 1])) == above(3)


def test_pieces_of_the_very_bodies_do_not_stand_out() -> None:
    shape = boxes([0, 0, 0, 3, 1, 1], [0, 0, 0, 1, 3, 1])
    legs = hull([[x, y, z] for x in (0, 3) for y in (0, 1) for z in (0, 1)]), box([1, 3, 1], at(0.5, 1.5, 0.5))
    assert stands_out(shape, *legs) == 0
    # Cut along x = 1: the cut faces the other piece, and counts for nothing.
    parts = box([2, 1, 1], at(2, 0.5, 0.5)), box([1, 3, 1], at(0.5, 1.5, 0.5))
    assert stands_out(shape, *parts) == 0
    longer = box([2.25, 1, 1], at(2.125, 0.5, 0.5))
    assert stands_out(shape, longer, parts[1]) == above(0.25)


def test_convex_meshes_of_any_triangulation_do_not_stand_out() -> None:
    for mesh in (
        trimesh.creation.icosphere(subdivisions=3),
        trimesh.creation.cylinder(1, 3, sections=48),
        boxes([0, 0, 0, 3, 2, 1]).subdivide().subdivide(),
        trimesh.creation.capsule(2, 1),
    ):
        assert stands_out(mesh, least=0.01) == 0


def test_what_is_least_is_nothing() -> None:
    shape = boxes([0, 0, 0, 10, 5, 1], [0, 0, 0, 4, 5, 1.5], [6, 0, 0, 10, 5, 1.5])
    assert stands_out(shape, least=0.49) == above(0.5)
    assert stands_out(shape, least=0.51) == 0


def test_an_open_mesh_counts_as_a_surface() -> None:
    """Without its lid a cube of side 2 is 1 away from the middle of where that was."""
    mesh = trimesh.creation.box([2, 2, 2])
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    assert stands_out(mesh) == above(1)


def at(*origin: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = origin
    return T
