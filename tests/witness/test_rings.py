"""Rings of mesh vertices about the witness point: who is in them, and that chance is nobody else's business."""

import networkx
import numpy as np
import pytest
import trimesh

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.errors import CollisionError
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from grasp_refine.geometry.rings import Rings
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.neighborhood import Neighbors
from grasp_refine.witness.rings import Neighbor, choose_rings
from grasp_refine.witness.scene import WitnessScene
from refusals import refused
from shapes_for_tests import cluster_body, ellipsoid_hull, ring_body
from twists import poses_at_gap

PIECES = {
    "icosphere": lambda: hull(trimesh.creation.icosphere(subdivisions=2, radius=0.03).vertices),
    "grid": lambda: hull(grid()),
    "ellipsoid": lambda: ellipsoid_hull(0),
    "box": lambda: box([0.05, 0.04, 0.03]),
}


def grid(n: int = 11) -> np.ndarray:
    """A gently domed grid of n x n points over a flat base."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.05, 0.05, n)] * 2))
    top = np.stack([x, y, 0.02 - x**2 - 1.1 * y**2], axis=1)
    return np.concatenate([top, [(sx * 0.06, sy * 0.06, -0.02) for sx in (-1, 1) for sy in (-1, 1)]])


def graph(faces: np.ndarray) -> networkx.Graph:
    return networkx.Graph([tuple(edge) for corners in ([0, 1], [1, 2], [2, 0]) for edge in faces[:, corners].tolist()])


def row(rings: Rings, vertex: int) -> np.ndarray:
    return rings.members[rings.start[vertex] : rings.start[vertex + 1]]


def scene_of(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, w: Witness | None = None, key: int = 0) -> WitnessScene:
    columns = WitnessLayer(pairs, Distance()).columns(np.arange(len(pairs)))
    return WitnessScene(*columns, T_a, T_b, w or query(pairs, T_a, T_b), None, None, key)


def drawn(near: Neighbors, points: np.ndarray, s: int, b: int) -> np.ndarray:
    """Which of the points (V, 3) were chosen for item b of side s."""
    chosen = near.points[s, b, 1:][near.mask[s, b, 1:]]
    away = np.abs(points[None] - chosen[:, None]).max(axis=2)
    assert (away.min(axis=1) == 0.0).all(), "only vertices of the winning piece are chosen"
    return away.argmin(axis=1)


# the table


@pytest.mark.parametrize("edges", [1, 2, 5])
@pytest.mark.parametrize("name", PIECES)
def test_rings_are_the_vertices_within_so_many_edges(name: str, edges: int) -> None:
    piece = PIECES[name]()
    found, expected = piece.rings(edges), graph(piece.faces)
    assert len(found.start) == len(piece.vertices) + 1
    for vertex in range(len(piece.vertices)):
        assert sorted(row(found, vertex)) == sorted(networkx.ego_graph(expected, vertex, radius=edges))
    assert piece.rings(edges) is found  # built once


# the draw


def choose(piece: Piece, x: np.ndarray, rule: Neighbor, offset: int = 0) -> Neighbors:
    """The neighbours of points x (B, 3) of one piece, seen as both sides of a pair of two such pieces."""
    winner = np.zeros((len(x), 1), dtype=int)
    return choose_rings(rule, [piece], [piece], winner, np.stack([x, x]), offset, np.full((2, 1), 1e-6))


@pytest.mark.parametrize("rings", [1, 3])
@pytest.mark.parametrize("name", PIECES)
def test_without_a_limit_all_vertices_of_the_rings_are_taken(name: str, rings: int) -> None:
    piece = PIECES[name]()
    rng = np.random.default_rng(1)
    start = rng.integers(len(piece.vertices), size=12)
    x = piece.vertices[start] * 1.0001
    near = choose(piece, x, Neighbor(rings, None))
    for s in range(2):
        for b in range(12):
            expected = networkx.ego_graph(graph(piece.faces), start[b], radius=rings)
            index = drawn(near, piece.vertices, s, b)
            assert sorted(index) == sorted(expected)
            np.testing.assert_array_equal(near.normals[s, b][near.mask[s, b, 1:]], piece.rings(rings).normals[index])
            farthest = np.linalg.norm(piece.vertices[list(expected)] - x[b], axis=1).max()
            assert near.radius[s, b] == pytest.approx(farthest, rel=1e-12)


@pytest.mark.parametrize(
    ("piece", "on_surface"),
    [
        (sphere(0.03, (0.01, 0.0, 0.02)), lambda p: np.linalg.norm(p - [0.01, 0.0, 0.02], axis=-1)),
        (
            capsule(0.03, (0, 0, -0.05), (0, 0, 0.05)),
            lambda p: np.linalg.norm(p - np.clip(p, [0, 0, -0.05], [0, 0, 0.05]), axis=-1),
        ),
    ],
    ids=["sphere", "capsule"],
)
def test_neighbours_on_round_pieces_lie_on_the_true_surface(piece: Piece, on_surface: object) -> None:
    near = choose(piece, piece.mesh().vertices[::50] * 1.0, Neighbor(samples=None))
    assert (near.mask[..., 1:].sum(axis=2) >= 50).all()
    np.testing.assert_allclose(on_surface(near.points[..., 1:, :][near.mask[..., 1:]]), 0.03, rtol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(near.normals, axis=3), 1.0)
    # A few rings of the ball; the long edges of the capsule's side lead to its other end.
    assert near.radius.min() < 0.025


# in a scene


@pytest.mark.parametrize("gap", [0.01, -0.003])
def test_both_sides_draw_from_the_pieces_that_carry_the_witness_points(gap: float) -> None:
    pairs = Pairs((cluster_body(2), ring_body(1)), (ring_body(1), cluster_body(3)))
    T_a, T_b = (np.concatenate(side, axis=1) for side in zip(
        *(poses_at_gap(Pairs((a,), (b,)), 12, gap, seed=4) for a, b in zip(pairs.a, pairs.b, strict=True)), strict=True
    ))  # fmt: skip
    scene = scene_of(pairs, T_a, T_b)
    w = scene.witness
    assert len(np.unique(w.winner)) > 6  # otherwise nothing is tested
    sides, near = scene.neighbors(Neighbor(2), 0)
    for side, (pieces, T, x) in enumerate(zip(pairs.piece_pairs, (T_a, T_b), (w.point_a, w.point_b), strict=True)):
        local = transform_points(inverse(T), x)
        for b in range(12):
            for p in range(2):
                piece = pieces[w.winner[b, p]]
                start = np.linalg.norm(piece.vertices - local[b, p], axis=1).argmin()
                index = drawn(near, piece.vertices, 2 * side + p, b)
                assert set(index) <= set(networkx.ego_graph(graph(piece.faces), start, radius=2))
                np.testing.assert_allclose(near.points[2 * side + p, b, 0], local[b, p], atol=1e-12)
    np.testing.assert_array_equal(near.floor, scene.surfaces.floor)


@pytest.mark.parametrize(("rings", "samples"), [(0, 16), (5, 1)])
def test_a_neighbourhood_without_width_is_refused(rings: int, samples: int) -> None:
    with refused(CollisionError, "1 ring", "2 samples", f"rings={rings}", f"samples={samples}"):
        Neighbor(rings, samples)
