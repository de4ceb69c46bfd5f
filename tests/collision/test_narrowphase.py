"""The narrow phase: closed forms, proofs of optimality, and every trap of coal that it guards against."""

from collections.abc import Callable

import coal
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from grasp_refine.collision.certified_distance import Tolerances
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query_items
from grasp_refine.collision.shapes import few_neighbours
from grasp_refine.core.se3 import exp_so3, inverse
from grasp_refine.geometry.pieces import Piece, box, capsule, cylinder, sphere
from shapes_for_tests import ellipsoid_hull, piece_body
from twists import random_poses

pytestmark = pytest.mark.usefixtures("engine")
only_python = pytest.mark.parametrize("engine", ["python"], indirect=True)

NOWHERE = -1.8e308  # minus infinity: what EPA was once seen to return
EVERY_TRY = 30  # two of the pieces as they lie, two moved apart along each of fourteen directions


def piece_pair(a: Piece, b: Piece) -> Pairs:
    return Pairs((piece_body(a),), (piece_body(b),))


def closest(
    pairs: Pairs, T: np.ndarray, cutoff: float = np.inf, pair: int = 0, previous: Witness | None = None
) -> Witness:
    """Query body b at the poses T (M, 4, 4) in the frame of body a."""
    at_rest = np.broadcast_to(np.eye(4), T.shape)
    return query_items(pairs, np.full(len(T), pair), at_rest, T, cutoff=cutoff, previous=previous)


def ask(a: Piece, b: Piece, T: np.ndarray) -> Witness:
    return closest(piece_pair(a, b), T)


def poses(count: int, seed: int, spread: float) -> np.ndarray:
    return random_poses(count, seed, spread)[:, 0]


def placed(*offsets: tuple[float, float, float]) -> np.ndarray:
    T = np.tile(np.eye(4), (len(offsets), 1, 1))
    T[:, :3, 3] = offsets
    return T


def on_b(found: Witness, T: np.ndarray) -> np.ndarray:
    """The witness point on body b, in its own frame."""
    return np.einsum("mji,mj->mi", T[:, :3, :3], found.point_b - T[:, :3, 3])


def support_gap(a: Piece, b: Piece, T: np.ndarray, u: np.ndarray) -> np.ndarray:
    """min over b of u . y minus max over a of u . x: a lower bound of the signed distance for every unit u (M, 3)."""
    y = b.vertices @ T[:, :3, :3].mT + T[:, None, :3, 3]
    return (y @ u[:, :, None]).min(axis=(1, 2)) - (u @ a.vertices.T).max(axis=1) - a.radius - b.radius


def hull_gap(a: Piece, b: Piece, T: np.ndarray) -> float:
    """Largest gap, by the facets of the hull of all differences y - x of vertices: exact in penetration."""
    y = b.vertices @ T[:3, :3].T + T[:3, 3]
    return float(ConvexHull((y[:, None] - a.vertices).reshape(-1, 3)).equations[:, 3].max())


def outside_by(piece: Piece, points: np.ndarray) -> np.ndarray:
    """Largest signed distance (M,) of points to the planes of a polytope: zero on its surface."""
    normals, offsets = piece.planes
    return (points @ normals.T - offsets).max(axis=1)


TIED = [
    pytest.param(cylinder(0.03, 0.02, sides=400), cylinder(0.02, 0.03), id="discs"),
    pytest.param(box([0.04] * 3), box([0.03] * 3), id="boxes"),
    pytest.param(capsule(0.01, (0, 0, -0.02), (0, 0, 0.03)), ellipsoid_hull(3), id="capsule"),
]
"""Pieces with faces, edges or ends that can be parallel."""


# closed forms


def test_spheres() -> None:
    a, b = sphere(0.02, [0.01, 0.02, 0.03]), sphere(0.03, [0, -0.01, 0])
    T = poses(50, 1, 0.04)
    found = ask(a, b, T)
    offset = T[:, :3, :3] @ b.vertices[0] + T[:, :3, 3] - a.vertices[0]
    length = np.linalg.norm(offset, axis=1)
    assert (length > 0.05).any() and (length < 0.05).any()
    np.testing.assert_allclose(found.distance, length - 0.05, atol=1e-15)
    np.testing.assert_allclose(found.normal, offset / length[:, None], atol=1e-12)
    np.testing.assert_allclose(found.point_a, a.vertices[0] + 0.02 * offset / length[:, None], atol=1e-12)


def segments_distance(p: np.ndarray, q: np.ndarray) -> float:
    """Distance of two segments (2, 3), by the four ends and the common perpendicular."""

    def to_segment(x: np.ndarray, s: np.ndarray) -> float:
        axis = s[1] - s[0]
        return float(np.linalg.norm(x - s[0] - np.clip((x - s[0]) @ axis / (axis @ axis), 0, 1) * axis))

    ends = min([to_segment(x, q) for x in p] + [to_segment(x, p) for x in q])
    (u, v), w = (p[1] - p[0], q[1] - q[0]), p[0] - q[0]
    s, t = np.linalg.lstsq(np.stack([u, -v], axis=1), -w, rcond=None)[0]
    if 0 <= s <= 1 and 0 <= t <= 1:
        return min(ends, float(np.linalg.norm(w + s * u - t * v)))
    return ends


def test_capsules() -> None:
    a = capsule(0.01, [0.01, 0, -0.03], [0.02, 0.01, 0.04])
    b = capsule(0.015, [-0.02, 0, 0], [0.01, 0.03, 0.02])
    T = poses(100, 2, 0.04)
    found = ask(a, b, T)
    expected = [segments_distance(a.vertices, b.transformed(pose).vertices) - 0.025 for pose in T]
    assert np.min(expected) < -0.01 and np.max(expected) > 0.02
    np.testing.assert_allclose(found.distance, expected, atol=1e-8)


def test_a_sphere_in_and_outside_of_a_box() -> None:
    half = np.array([0.03, 0.02, 0.05])
    centers = np.random.default_rng(3).uniform(-1.6, 1.6, (200, 3)) * half
    found = ask(box(2 * half), sphere(0.01), placed(*centers))
    beyond = np.abs(centers) - half
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    expected = np.where(outside > 0, outside, beyond.max(axis=1)) - 0.01
    assert (beyond.max(axis=1) < 0).any() and (expected > 0).any()
    np.testing.assert_allclose(found.distance, expected, atol=2e-8)


def test_the_normal_proves_the_distance_of_hulls_apart_and_the_points_attain_it() -> None:
    a, b = ellipsoid_hull(7, 60), ellipsoid_hull(8, 60)
    T = poses(300, 9, 0.05)
    found = ask(a, b, T)
    assert (found.distance > 0).sum() > 50 and (found.distance < 0).sum() > 50
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0, atol=1e-12)
    # Weak duality: the gap along any direction is at most the distance; between two points it is at least that.
    np.testing.assert_allclose(support_gap(a, b, T, found.normal), found.distance, atol=1e-8)
    np.testing.assert_allclose(outside_by(a, found.point_a), 0.0, atol=1e-8)
    np.testing.assert_allclose(outside_by(b, on_b(found, T)), 0.0, atol=1e-8)


def test_a_radius_moves_the_surface_out() -> None:
    a, b = ellipsoid_hull(10, 40), ellipsoid_hull(11, 40)
    thick = Piece(a.vertices, a.faces, radius=0.01)
    T = poses(200, 12, 0.05)
    plain, swept = ask(a, b, T), ask(thick, b, T)
    # As long as the cores stay apart the radius is taken off exactly, and the point moves out by it.
    apart = plain.distance > 1e-6
    assert (swept.distance[apart] < 0).sum() > 10, "shallow contact is covered"
    np.testing.assert_allclose(swept.distance[apart], plain.distance[apart] - 0.01, atol=2e-8)
    flat = outside_by(a, swept.point_a - 0.01 * swept.normal)
    np.testing.assert_allclose(flat[apart], 0.0, atol=2e-8)
    # Where they overlap the proof is the gap along the normal.
    np.testing.assert_allclose(support_gap(thick, b, T, swept.normal), swept.distance, atol=2e-8)


# traps


def test_a_hull_with_hundreds_of_neighbours_is_the_same_body() -> None:
    disc = cylinder(0.03, 0.02, sides=400)
    assert np.bincount(disc.faces.ravel()).max() > 255
    faces = few_neighbours(disc)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    assert (times == 2).all() and len(disc.vertices) - len(unique) + len(faces) == 2
    assert np.bincount(unique.ravel()).max() <= 8
    again = Piece(disc.vertices, faces).mesh()
    assert again.is_winding_consistent and again.volume == pytest.approx(disc.mesh().volume, rel=1e-12)


def test_a_disc_of_400_sides_in_closed_form() -> None:
    disc = cylinder(0.03, 0.02, sides=400)
    side = 0.03 * np.cos(np.pi / 400)
    middle = np.pi / 400
    beyond = 0.05 * np.array([np.cos(middle), np.sin(middle), 0])
    T = placed((0, 0, 0.02), (0.05, 0, 0), tuple(beyond), (0, 0, 0.012), (0, 0, 0.006), tuple(0.6 * beyond))
    found = ask(disc, sphere(0.005), T)
    expected = [0.005, 0.05 - 0.03 - 0.005, 0.05 - side - 0.005, -0.003, -0.009, 0.03 - side - 0.005]
    np.testing.assert_allclose(found.distance, expected, atol=2e-8)
    # And against another polytope: the gap along the normal proves it.
    other = ellipsoid_hull(3, 60)
    T = poses(100, 14, 0.04)
    found = ask(disc, other, T)
    assert (found.distance > 0).any() and (found.distance < 0).any()
    np.testing.assert_allclose(support_gap(disc, other, T, found.normal), found.distance, atol=2e-8)


SHAPES = {
    "cubes": (box([1.0] * 3), box([0.5, 0.7, 0.9])),
    "plate": (box([1.0, 1.0, 1e-4]), box([0.3] * 3)),
    "needles": (box([1.0, 0.01, 0.01]), box([0.01, 1.0, 0.02])),
    "round": (capsule(0.2, (0, 0, -0.3), (0, 0, 0.3)), sphere(0.3)),
    "hulls": (ellipsoid_hull(3, 60), ellipsoid_hull(4, 40)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_bodies_of_any_size_get_the_same_answer_in_proportion(name: str) -> None:
    """coal's tolerances are lengths: bodies of a millimetre were taken for touching, plates of 0.1 mm were 50 % off."""
    a, b = SHAPES[name]
    T = poses(80, 5, 0.5)
    whole = ask(a, b, T)
    assert (whole.distance > 0).any() and (whole.distance < 0).any()
    for scale in (8.0**-7, 1e-4, 1e-2, 0.3, 8.0, 10.0, 8.0**4):
        smaller = T.copy()
        smaller[:, :3, 3] *= scale
        found = ask(a.scaled(scale), b.scaled(scale), smaller)
        if np.log2(scale) % 3 == 0:  # the same bits
            np.testing.assert_array_equal(found.distance, scale * whole.distance)
            np.testing.assert_array_equal(found.point_a, scale * whole.point_a)
        np.testing.assert_allclose(found.distance / scale, whole.distance, rtol=0, atol=2e-9)


@pytest.mark.parametrize("turn", [np.pi / 2, 1.0, 1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_capsules_whose_axes_cross_are_parted_across_both(turn: float, offset: float) -> None:
    """The depth was right, but the normal lay in the plane of the axes, or was zero."""
    rng = np.random.default_rng(7)
    R = exp_so3(rng.normal(size=(8, 3)))
    along, perpendicular = R[:, :, 2], R[:, :, 0]
    T = np.tile(np.eye(4), (8, 1, 1))
    T[:, :3, :3] = exp_so3(turn * perpendicular)
    T[:, :3, 3] = offset * along
    for i in range(8):
        a = capsule(0.1, -0.4 * along[i], 0.4 * along[i])
        found = ask(a, a, T[i : i + 1])
        assert found.distance[0] == pytest.approx(-0.2, abs=1e-11)
        assert abs(found.normal[0] @ perpendicular[i]) == pytest.approx(1.0, abs=1e-6)
        assert support_gap(a, a, T[i : i + 1], found.normal)[0] == pytest.approx(-0.2, abs=1e-9)


def test_depths_of_balls_of_hundreds_of_vertices_are_as_in_the_hull_of_their_differences() -> None:
    """After 64 iterations EPA had said up to 1 mm too much of half of them."""
    a, b = (ellipsoid_hull(seed, 200, (0.05, 0.05, 0.05)) for seed in (2, 52))
    T = poses(12, 22, 0.002)
    np.testing.assert_allclose(ask(a, b, T).distance, [hull_gap(a, b, pose) for pose in T], rtol=0, atol=1e-9)


GAPS = {
    "vertex on face": (box([1.0] * 3), box([0.5] * 3), [np.pi / 4, np.arctan(np.sqrt(0.5)), 0.0]),
    "edges": (box([1.0] * 3), box([0.5] * 3), [0.0, 0.0, np.pi / 4]),
    "needles": (box([1.0, 0.01, 0.01]), box([0.01, 1.0, 0.01]), [0.0, 0.0, 0.1]),
    "faces": (box([1.0] * 3), box([0.5] * 3), [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("size", [1e-3, 0.1, 10.0])
@pytest.mark.parametrize("name", GAPS)
def test_gaps_far_below_the_tolerance_of_gjk_are_gaps(name: str, size: float) -> None:
    """To GJK a gap below its tolerance is contact: 1e-10 m came back as 0, with any normal."""
    a, b, turn = GAPS[name]
    R = exp_so3(np.array([turn[0], 0, 0])) @ exp_so3(np.array([0, turn[1], 0])) @ exp_so3(np.array([0, 0, turn[2]]))
    lowest = (b.vertices @ R.T)[:, 2].min()
    gaps = np.array([1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 0.0, -1e-12, -1e-10, -1e-8])
    T = np.tile(np.eye(4), (len(gaps), 1, 1))
    T[:, :3, :3], T[:, 2, 3] = R, a.vertices[:, 2].max() - lowest + gaps
    T[:, :3, 3] *= size
    found = ask(a.scaled(size), b.scaled(size), T)
    np.testing.assert_allclose(found.distance / size, gaps, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.normal, np.tile([0.0, 0.0, 1.0], (len(gaps), 1)), atol=1e-7)


@pytest.mark.parametrize("scale", [1e-3, 0.1, 10.0])
def test_bodies_a_thousand_diagonals_apart_are_measured_exactly(scale: float) -> None:
    """GJK's tolerance grows with the distance: a box was 6e-7 of its size off, and points were off by 3 %."""
    a, b = box([scale] * 3), box([scale, 0.01 * scale, 0.01 * scale])
    T = poses(100, 6, 0.5)
    rng = np.random.default_rng(6)
    u = rng.normal(size=(100, 3))
    T[:, :3, 3] = 1000 * scale * u / np.linalg.norm(u, axis=1, keepdims=True)
    found = ask(a, b, T)
    gap = support_gap(a, b, T, found.normal)
    assert (found.distance >= gap - 1e-12 * scale * 1000).all()  # no distance is below a gap
    np.testing.assert_allclose(found.distance, gap, rtol=0, atol=1e-8 * scale)
    assert np.abs(outside_by(a, found.point_a)).max() < 1e-9 * scale


def replace_answers(monkeypatch: pytest.MonkeyPatch, answer: Callable[[int, float], float]) -> list[float]:
    """Pass each answer of coal through `answer(call, value)`; returns the EPA tolerances that it was asked with."""
    tolerances: list[float] = []
    compute = coal.distance

    def tampered(*arguments: object) -> float:
        tolerances.append(arguments[4].epa_tolerance)
        return answer(len(tolerances) - 1, compute(*arguments))

    monkeypatch.setattr(coal, "distance", tampered)
    return tolerances


@only_python
@pytest.mark.parametrize("wild", [NOWHERE, -np.inf, np.nan, np.inf, 1.8e308, -1.6])
def test_a_wild_answer_is_asked_again_with_the_looser_tolerance(monkeypatch: pytest.MonkeyPatch, wild: float) -> None:
    asked_with = replace_answers(monkeypatch, lambda call, value: wild if call == 0 else value)
    # Two cubes in balls of 3.5 cm, 3.5 cm apart: no penetration deeper than 3.5 cm can be true.
    found = ask(box([0.04] * 3), box([0.04] * 3), placed((0.035, 0, 0)))
    assert asked_with == [Tolerances().epa, Tolerances().retry]
    assert found.distance[0] == pytest.approx(-0.005, abs=1e-6)
    assert found.valid[0] and found.num_queries[0] == 1


@only_python
def test_two_wild_answers_are_resolved_by_moving_the_pieces_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    asked_with = replace_answers(monkeypatch, lambda call, value: NOWHERE if call < 2 else value)
    found = ask(box([0.04] * 3), box([0.04] * 3), placed((0.035, 0.001, 0.002)))
    assert len(asked_with) > 2 and found.valid[0]
    assert found.distance[0] == pytest.approx(-0.005, abs=1e-15)
    np.testing.assert_allclose(found.normal[0], [1, 0, 0], atol=1e-12)


@only_python
def test_an_answer_that_stays_wild_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_answers(monkeypatch, lambda call, value: NOWHERE if call < EVERY_TRY else value)
    found = ask(box([0.04] * 3), box([0.04] * 3), placed((0.035, 0, 0), (0.06, 0, 0)))
    assert found.status.tolist() == [QueryStatus.FAILED, QueryStatus.SEPARATED]
    assert np.isnan(found.distance[0]) and found.distance[1] == pytest.approx(0.02, abs=1e-8)


@pytest.mark.parametrize(("a", "b"), TIED)
def test_an_answer_does_not_depend_on_what_was_asked_before(a: Piece, b: Piece) -> None:
    """Where support points are not unique a query once began its search for them where the last one had ended."""
    T = poses(20, 18, 0.05)
    T[::2, :3, :3] = np.eye(3)
    fresh = [ask(a, b, pose[None]) for pose in T]
    used = Pairs((piece_body(a), piece_body(b)), (piece_body(b), piece_body(a)))
    guess = closest(used, poses(20, 19, 0.1))
    for order in (np.arange(20), np.random.default_rng(0).permutation(20)):
        found = closest(used, T[order])
        closest(used, inverse(T), pair=1)
        closest(used, T, previous=guess)
        for name in ("distance", "point_a", "normal"):
            np.testing.assert_array_equal(getattr(found, name), [getattr(fresh[i], name)[0] for i in order])


@pytest.mark.parametrize(("slack", "status"), [(1e-6, [1, 0, 2]), (-1e-6, [3, 3, 2])])
def test_an_answer_below_its_bound_is_a_failure(slack: float, status: list[int]) -> None:
    """A slack below zero makes answers at their bounds wrong: for spheres, these are the distances."""
    ball = (piece_body(sphere(0.01)),)
    T = placed((0.015, 0, 0), (0.05, 0, 0), (0.08, 0, 0))
    assert closest(Pairs(ball, ball, Tolerances(slack=slack)), T, cutoff=0.05).status.tolist() == status
