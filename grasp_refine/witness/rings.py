"""The neighbourhood of arXiv 2511.06267: mesh vertices within a few edges of the witness point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.array_records import index_distinct
from grasp_refine.core.errors import CollisionError
from grasp_refine.geometry.pieces import Piece
from grasp_refine.geometry.rings import Rings
from grasp_refine.witness.neighborhood import Neighbors


@dataclass(frozen=True)
class Neighbor:
    """Constant number of edges, whatever the target: its size in metres is that of the mesh; it ends with the piece.

    The mesh of a piece with a radius is generated, and the triangulation of its flat parts depends on rounding: in a
    world scaled by a factor that is not a power of two, other vertices may be drawn.
    """

    rings: int = 5
    """Edges between the vertex nearest to the witness point, on the piece that carries it, and the farthest one."""
    samples: int | None = 16
    """Vertices drawn at random from the neighbourhood; None: all of them."""

    def __post_init__(self) -> None:
        """Refuse a neighbourhood without width.

        Raises:
            CollisionError: fewer than one ring or two samples.
        """
        check_fields(self)
        if self.rings < 1 or (self.samples is not None and self.samples < 2):
            raise CollisionError(
                f"a neighbourhood needs at least 1 ring and 2 samples, got rings={self.rings}, samples={self.samples}"
            )


def choose_rings(
    rule: Neighbor,
    pieces_a: Sequence[Piece],
    pieces_b: Sequence[Piece],
    winner: np.ndarray,
    x: np.ndarray,
    offset: int,
    floor: np.ndarray,
) -> Neighbors:
    """Choose the neighbours of witness points on the closest pieces.

    Args:
        rule: Number of rings and samples.
        pieces_a: Pieces of the first bodies, indexed by `winner`.
        pieces_b: Pieces of the second bodies, indexed by `winner`.
        winner: Closest piece pair (B, P); -1: there are no witness points, any piece is used.
        x: Witness points (S, B, 3) on all first bodies, then on all second ones (S = 2 P), body frames, metres.
        offset: Start of the draw in the random order of each neighbourhood.
        floor: Smallest sensible spread of squared distances (S, 1), in square metres.
    """
    S, B, _ = x.shape
    carrier = np.maximum(winner.T, 0)
    # Many piece pairs share a piece.
    used, index = np.unique(carrier, return_inverse=True)
    distinct, slot = index_distinct([pieces[k] for pieces in (pieces_a, pieces_b) for k in used])
    piece = slot.reshape(2, -1)[:, index.reshape(-1)].reshape(-1)
    tables = [each.rings(rule.rings) for each in distinct]

    count = np.array([len(table.points) for table in tables])
    first = np.cumsum(count) - count
    points = np.concatenate([table.points for table in tables])
    normals = np.concatenate([table.normals for table in tables])
    members = np.concatenate([table.members for table in tables])
    before = np.cumsum([0, *(len(table.members) for table in tables[:-1])])
    start = np.concatenate([table.start[:-1] + shift for table, shift in zip(tables, before, strict=True)])
    size = np.concatenate([np.diff(table.start) for table in tables])

    rows = x.reshape(S * B, 3)
    vertex = first[piece] + _nearest(tables, piece, rows)
    size, start = size[vertex, None], start[vertex, None]
    width = int(size.max(initial=0)) if rule.samples is None else rule.samples
    rank = np.arange(width)
    mask = rank < size
    chosen = members[start + (offset % size + rank) % size] + first[piece][:, None]
    with_witness = np.concatenate([rows[:, None], points[chosen]], axis=1)
    away = ((with_witness[:, 1:] - rows[:, None]) ** 2).sum(axis=2)
    radius = np.sqrt(np.where(mask, away, 0.0).max(axis=1, initial=0.0))
    mask = np.concatenate([np.ones((S * B, 1), dtype=bool), mask], axis=1)
    return Neighbors(
        with_witness.reshape(S, B, -1, 3),
        normals[chosen].reshape(S, B, -1, 3),
        mask.reshape(S, B, -1),
        radius.reshape(S, B),
        floor,
    )


def _nearest(tables: Sequence[Rings], which: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Index (M,) of the vertex nearest to each x (M, 3) in its table `which` (M,)."""
    vertex = np.empty(len(x), dtype=np.int64)
    order = np.argsort(which, kind="stable")
    ends = np.cumsum(np.bincount(which, minlength=len(tables)))
    for table, rows in zip(tables, np.split(order, ends[:-1]), strict=True):
        vertex[rows] = table.tree.query(x[rows])[1]
    return vertex
