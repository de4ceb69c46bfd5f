"""Rays hit what is first, and the nearest point of a surface is one that can touch."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls

from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, sphere
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine_apps.viewer.drawing.picking import hit_mesh, nearest_on_surface

CUBE = trimesh.creation.box(extents=(2, 2, 2))


def at(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return np.array([x, y, z], dtype=np.float64)


def turned(x: float, y: float, z: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def test_a_ray_hits_the_near_side_first():
    for origin, direction, place in (
        (at(-5, 0.3, 0.2), at(2), [-1, 0.3, 0.2]),
        (at(0, 0.3, 0.2), at(0, 0, 1), [0, 0.3, 1]),  # from inside
    ):
        np.testing.assert_allclose(hit_mesh(origin, direction, CUBE.vertices, CUBE.faces), place, atol=1e-12)


@pytest.mark.parametrize("ray", [(at(-5, 1.1), at(1)), (at(-5), at(-1)), (at(-5, 1.01), at(1, 0, 0.001))])
def test_a_ray_can_miss(ray: tuple[np.ndarray, np.ndarray]):
    assert hit_mesh(*ray, CUBE.vertices, CUBE.faces) is None


def test_a_ray_at_an_edge_between_faces_does_not_slip_through():
    for y in (0.0, 0.5):  # both triangles of a side share its diagonal
        hit = hit_mesh(at(-5, y, y), at(1), CUBE.vertices, CUBE.faces)
        assert hit is not None and hit[0] == pytest.approx(-1)


@pytest.mark.parametrize(
    ("point", "nearest"),
    [((0.9, 0.2, -0.3), (1, 0.2, -0.3)), ((1.4, 0.2, -0.3), (1, 0.2, -0.3)), ((2, 3, 4), (1, 1, 1))],
)
def test_the_nearest_point_of_a_box(point: tuple, nearest: tuple):
    body = build_body("box", [box((2, 2, 2))], candidates=16)
    np.testing.assert_allclose(nearest_on_surface(body, np.array(point, dtype=float)), nearest, atol=1e-12)


@pytest.mark.parametrize("scale", [0.3, 1.7])
def test_round_pieces_are_exact(scale: float):
    direction = np.array([0.6, 0.0, 0.8])
    ball = build_body("ball", [sphere(0.02, (1, 2, 3))], candidates=16)
    found = nearest_on_surface(ball, at(1, 2, 3) + 0.02 * scale * direction)
    np.testing.assert_allclose(found, at(1, 2, 3) + 0.02 * direction, atol=1e-15)
    pill = build_body("pill", [capsule(0.02, (0, -1, 0), (0, 1, 0))], candidates=16)
    found = nearest_on_surface(pill, at(0, 0.4, 0) + 0.02 * scale * direction)
    np.testing.assert_allclose(found, at(0, 0.4, 0) + 0.02 * direction, atol=1e-15)


@pytest.mark.parametrize("piece", [sphere(0.02), capsule(0.02, (0, -1, 0), (0, 1, 0))])
def test_the_middle_of_a_round_piece_is_as_far_from_everything(piece):
    found = nearest_on_surface(build_body("round", [piece], candidates=16), np.zeros(3))
    assert np.linalg.norm(found) == pytest.approx(0.02)


def two_boxes() -> Body:
    """A bar from x = -1 to 1, cut at x = 0."""
    return build_body("bar", [box((1, 1, 1), turned(x, 0, 0)) for x in (-0.5, 0.5)], candidates=64)


def test_cuts_between_pieces_are_no_surface():
    found = nearest_on_surface(two_boxes(), at(0.01, 0, 0.3))
    np.testing.assert_allclose(found, [0.01, 0, 0.5], atol=1e-12)


def test_surfaces_inside_another_piece_do_not_count():
    body = build_body("both", [box((2, 2, 2)), sphere(0.3), box((1, 1, 1), turned(1, 0, 0))], candidates=64)
    found = nearest_on_surface(body, at(0.31, 0, 0))
    # The ball is inside, and the sides of the small box begin at x = 1.
    assert np.abs(found).max() == pytest.approx(1.0)


def test_the_handle_of_a_mug_and_its_inside_are_surface():
    mug = load_object("mug", candidates=512).body
    for point, normal in zip(mug.candidates.points[::8], mug.candidates.normals[::8], strict=True):
        found = nearest_on_surface(mug, point + 2e-4 * normal)
        assert np.linalg.norm(found - point - 2e-4 * normal) < 2.1e-4
        assert np.linalg.norm(found - point) < 5e-4


def hull_distance(piece: Piece, point: np.ndarray) -> float:
    """Distance (m) of a point from the surface of a convex piece, by its planes inside, and outside by its vertices."""
    normals, offsets = piece.planes
    height = (normals @ point - offsets).max()
    if height <= 0:
        return -height
    # The nearest convex combination of the vertices.
    weight = 100.0 * np.ones((1, len(piece.vertices)))
    return float(nnls(np.concatenate([(piece.vertices - point).T, weight]), np.array([0.0, 0.0, 0.0, 100.0]))[1])


def test_it_agrees_with_what_collides(shared_assets: Path):
    """Where a point is nearest to a maker's fingertip, it is as far from there as from the convex hull."""
    hand = load_hand(
        "shadow", urdf=shared_assets / "hands" / "shadow" / "shadow_right.urdf", candidates=64, hull_limit=np.inf
    )
    body = hand.links_by_name["thdistal"].body
    assert body is not None and len(body.pieces) == 1
    low, high = body.pieces[0].bounds
    for point in np.random.default_rng(0).uniform(low - 0.01, high + 0.01, (40, 3)):
        found = nearest_on_surface(body, point)
        # The nearest point of a sliver is not exact.
        assert np.linalg.norm(found - point) == pytest.approx(hull_distance(body.pieces[0], point), abs=5e-5)
