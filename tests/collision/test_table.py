"""The table of piece pairs: which piece pair stands where, and that its bounds are those of just that pair."""

from dataclasses import dataclass

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.collision.table import PieceTable, Side
from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from shapes_for_tests import ellipsoid_hull
from twists import random_poses

BATCH = 40


def scattered_pieces(name: str, seed: int, count: int) -> Body:
    rng = np.random.default_rng(seed)
    make = (
        lambda c: hull(rng.normal(size=(20, 3)) * 0.015 + c),
        lambda c: sphere(0.01, c),
        lambda c: capsule(0.006, c, c + rng.normal(size=3) * 0.02),
        lambda c: Piece(ellipsoid_hull(seed).vertices * 0.2 + c, ellipsoid_hull(seed).faces, radius=0.004),
        lambda c: box([0.02, 0.03, 0.01]).transformed(np.block([[np.eye(3), c[:, None]], [np.zeros(3), 1.0]])),
    )
    parts = [make[k % len(make)](center) for k, center in enumerate(rng.normal(size=(count, 3)) * 0.03)]
    return build_body(name, parts, candidates=16)


@dataclass(frozen=True, eq=False)
class Setting:
    """Body pairs of other numbers of pieces, at poses from deep penetration to far apart."""

    bodies_a: tuple[Body, ...]
    """First body of each pair."""
    bodies_b: tuple[Body, ...]
    """Second body of each pair."""
    R: np.ndarray
    """Rotations (BATCH, P, 3, 3) of bodies b in the frames of bodies a."""
    t: np.ndarray
    """Their origins (BATCH, P, 3)."""
    normal: np.ndarray
    """Normals (BATCH, P, 3) of the closest piece pairs, in the frames of bodies a."""
    every: list[np.ndarray]
    """True signed distances (BATCH, pieces of a, pieces of b) of each body pair."""


@pytest.fixture(scope="module")
def setting() -> Setting:
    large, small, middle = scattered_pieces("l", 1, 7), scattered_pieces("s", 2, 1), scattered_pieces("m", 3, 5)
    bodies_a, bodies_b = (large, small, middle, large), (middle, large, small, large)
    T_a, T_b = (np.concatenate([random_poses(BATCH, s + p, 0.012) for p in range(4)], axis=1) for s in (1, 50))
    relative = inverse(T_a) @ T_b
    every = []
    for p, (a, b) in enumerate(zip(bodies_a, bodies_b, strict=True)):
        singles = [[build_body("piece", [piece], candidates=16) for piece in body.pieces] for body in (a, b)]
        firsts = tuple(x for x in singles[0] for _ in singles[1])
        seconds = tuple(singles[1]) * len(singles[0])
        poses = [np.repeat(T[:, p : p + 1], len(firsts), axis=1) for T in (T_a, T_b)]
        every.append(query(Pairs(firsts, seconds), *poses).distance.reshape(BATCH, len(a.pieces), len(b.pieces)))
    normal = query(Pairs(bodies_a, bodies_b), np.broadcast_to(np.eye(4), relative.shape), relative).normal
    return Setting(bodies_a, bodies_b, relative[..., :3, :3], relative[..., :3, 3], normal, every)


def padded(setting: Setting, table: PieceTable) -> np.ndarray:
    """The true distances in the columns of the table (BATCH, P, K_a, K_b), infinite in empty ones."""
    out = np.full((BATCH, 4, table.a.width, table.b.width), np.inf)
    for p, distance in enumerate(setting.every):
        out[:, p, : distance.shape[1], : distance.shape[2]] = distance
    return out


def test_every_piece_pair_has_its_column(setting: Setting) -> None:
    table = PieceTable.of(setting.bodies_a, setting.bodies_b)
    assert len(table) == 4 and table.id.shape == (4, 7 * 7)
    ids = table.id.reshape(4, 7, 7)
    seen = 0
    for p, (a, b) in enumerate(zip(setting.bodies_a, setting.bodies_b, strict=True)):
        for i, piece_a in enumerate(a.pieces):
            for j, piece_b in enumerate(b.pieces):
                k = ids[p, i, j]
                assert k == seen and table.pieces_a[k] is piece_a and table.pieces_b[k] is piece_b
                assert table.column[k] == i * 7 + j
                seen += 1
    assert seen == len(table.pieces_a) == len(table.pieces_b) == (table.id >= 0).sum()


def test_a_side_has_each_body_once(setting: Setting) -> None:
    side = Side.of(setting.bodies_a)
    assert len(side.bodies) == 3 and side.width == 7
    assert [side.bodies[k] for k in side.body] == list(setting.bodies_a)
    assert np.isneginf(side.bounding_spheres(np.arange(4)).radius).sum(axis=1).tolist() == [0, 6, 2, 0]


@pytest.mark.parametrize("kind", ["ball", "box", "gap", "gap along the normal"])
def test_bounds_never_exceed_the_signed_distance(setting: Setting, kind: str) -> None:
    table = PieceTable.of(setting.bodies_a, setting.bodies_b)
    true = padded(setting, table)
    assert (true < 0).sum() > 500 and (np.isfinite(true) & (true > 0)).sum() > 500
    batch, pair, i, j = np.nonzero(np.isfinite(true))
    distance, column = true[batch, pair, i, j], i * table.b.width + j
    R, t = setting.R.reshape(-1, 3, 3), setting.t.reshape(-1, 3)
    item = batch * 4 + pair
    if kind == "ball":
        every, likeliest = table.sphere_bound(np.arange(len(R)) % 4, R, t)
        assert np.isinf(every[np.isinf(true.reshape(every.shape))]).all()
        assert (table.id[np.arange(len(likeliest)) % 4, likeliest] >= 0).all()
        bound = every[item, column]
    elif kind == "box":
        bound = table.box_bound(pair, column, np.moveaxis(R[item], 0, -1), t[item].T)
    else:
        u = np.random.default_rng(0).normal(size=(len(R), 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        if kind != "gap":
            u = setting.normal.reshape(-1, 3)
        bound = table.gap_bound(item, column, np.arange(len(R)) % 4, u, R, t)
    # 1e-8 is the tolerance of EPA.
    assert (bound <= distance + 1e-8).all()
    if kind == "gap along the normal":
        # Along the normal of the closest piece pair, its gap is its distance but for the coarseness of the table.
        winner = true.reshape(len(R), -1).argmin(axis=1)
        tight = table.gap_bound(np.arange(len(R)), winner, np.arange(len(R)) % 4, u, R, t)
        excess = true.reshape(len(R), -1).min(axis=1) - tight
        assert excess.max() < 4e-3 and np.median(excess) < 1e-3
