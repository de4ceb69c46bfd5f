"""One object in an increasing number of convex pieces: cut by planes, so that surface and distances are unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, hull


def can_be_sliced(body: Body) -> bool:
    """Return True where the body is one polytope."""
    return len(body.pieces) == 1 and body.pieces[0].radius == 0 and len(body.pieces[0].vertices) > 3


def slice_body(body: Body, count: int) -> Body:
    """Cut the body into `count` pieces: repeatedly, the longest one is halved along its longest side.

    Outside the body distances are unchanged. Inside, the way out of a piece may be shorter than that out of the body:
    penetrations are shallower, as they are between the pieces of any decomposition.
    """
    pieces = list(body.pieces)
    while len(pieces) < count:
        longest = max(range(len(pieces)), key=lambda k: np.ptp(pieces[k].bounds, axis=0).max())
        pieces[longest : longest + 1] = _halves(pieces[longest])
    return replace(body, pieces=tuple(pieces))


def _halves(piece: Piece) -> tuple[Piece, Piece]:
    """Cut a polytope in the middle of its longest side."""
    axis = np.ptp(piece.bounds, axis=0).argmax()
    vertices = piece.vertices
    height = vertices[:, axis] - piece.bounds[:, axis].mean()
    ends = np.unique(np.sort(np.concatenate([piece.faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0)
    ends = ends[height[ends].prod(axis=1) < 0]
    low, high = height[ends].T
    share = (low / (low - high))[:, None]
    cut = (1.0 - share) * vertices[ends[:, 0]] + share * vertices[ends[:, 1]]
    below, above = (hull(np.concatenate([vertices[side], cut])) for side in (height <= 0, height >= 0))
    return below, above
