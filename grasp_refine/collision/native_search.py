"""The compiled engine: the narrow phase and the whole search in C++ (see `native/`), behind the same calls.

It gives what the Python engine gives, to rounding, whatever the number of threads. The GIL is free meanwhile.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

# Loads coal's library, which _native needs.
from grasp_refine.collision.certified_distance import Tolerances
from grasp_refine.collision.narrowphase import Closest, coal_version
from grasp_refine.collision.relative import in_frame, relative
from grasp_refine.collision.shapes import build_shape, unit_of
from grasp_refine.collision.supports import CELLS
from grasp_refine.collision.table import PieceTable, Side
from grasp_refine.core.cores import usable_cores
from grasp_refine.core.profiling import stage
from grasp_refine.geometry.pieces import Piece

from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled  # isort: skip

_SOURCES = Path(__file__).with_name("native")

_ITEMS_PER_THREAD = 512
"""Fewer, about 2 ms of work, are not worth a thread, which also waits for more work for some milliseconds."""


def built_for() -> str:
    """The version of coal that the engine was built for."""
    return _native.coal_version


def has_threads() -> bool:
    """Whether the engine was built with OpenMP; without it, it works with one thread."""
    return _native.openmp


def mismatch() -> str:
    """Why the engine must not be used; empty: it may."""
    built, here = built_for(), coal_version()
    if here != built:
        return (
            f"built for coal {built}, but coal {here} is installed: pip install coal=={built}, or install grasp-refine "
            "again with --no-build-isolation"
        )
    if sources() not in (None, getattr(_native, "sources", None)):
        return "built from other sources than those that are here: install grasp-refine again"
    return ""


def sources(folder: Path = _SOURCES) -> str | None:
    """A hash of the engine's sources as `native/CMakeLists.txt` makes it; None: they are not here, as in a wheel."""
    files = sorted([*folder.glob("*.cpp"), *folder.glob("*.h")])
    hashes = "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)
    return hashlib.sha256(hashes.encode()).hexdigest() if files else None


class NativeNarrowPhase:
    """`narrowphase.NarrowPhase`, compiled."""

    def __init__(self, pieces_a: Sequence[Piece], pieces_b: Sequence[Piece], tolerances: Tolerances) -> None:
        """Prepare the pairs (pieces_a[k], pieces_b[k]), k = 0 .. K - 1."""
        t = tolerances
        units = [unit_of(a, b) for a, b in zip(pieces_a, pieces_b, strict=True)]
        sides = [[_shape_of(*both) for both in zip(pieces, units, strict=True)] for pieces in (pieces_a, pieces_b)]
        self.compiled = _native.NarrowPhase(*sides, units, t.gjk, t.epa, t.retry, t.slack)

    def closest(
        self,
        R: np.ndarray,
        t: np.ndarray,
        starts: np.ndarray,
        pair: np.ndarray,
        bound: np.ndarray,
        limit: np.ndarray,
        guess: np.ndarray | None = None,
        guess_valid: np.ndarray | None = None,
    ) -> Closest:
        """The closest piece pair of each item; arguments and answer as in `narrowphase.NarrowPhase.closest`."""
        M = len(R)
        winner, asked = np.empty((2, M), np.int64)
        found = Closest(np.empty(M), np.empty((M, 3)), np.empty((M, 3)), winner, asked, np.empty(M, bool))
        self.compiled.closest(
            R, t, starts, pair, bound, limit, guess, guess_valid,
            found.distance, found.point, found.normal, found.winner, found.num_queries, found.failed,
        )  # fmt: skip
        return found


class NativeSearch:
    """The search among the piece pairs of P body pairs, compiled."""

    def __init__(self, table: PieceTable, narrow_phase: NativeNarrowPhase) -> None:
        """Prepare the pairs of a table."""
        self._narrow_phase = narrow_phase.compiled
        self._compiled = _native.Search(
            narrow_phase.compiled, _side(table.a), _side(table.b), np.ascontiguousarray(table.id[:, 0])
        )

    @stage("narrow phase")
    def ask(
        self,
        pair: np.ndarray | None,
        T_a: np.ndarray,
        T_b: np.ndarray,
        limit: np.ndarray,
        previous: tuple[np.ndarray, ...] | None,
        threads: int | None = None,
    ) -> tuple[np.ndarray, ...]:
        """The fields of a `query.Witness`, in its order and in the shape of `limit`, for M items in all.

        Args:
            pair: The body pair of each item (M,); None: all P of them, over and over.
            T_a: Poses (M, 4, 4) of the first bodies in the world.
            T_b: Those of the second bodies.
            limit: Signed distance that an answer has to beat.
            previous: The winners, points on a, points on b and statuses of the last answer.
            threads: How many; by default `OMP_NUM_THREADS`, or one a core, fewer where there is little to do.
        """
        shape = limit.shape
        points = np.empty((3, *shape, 3))
        found = (
            *points, np.empty(shape), np.empty(shape, np.int8), np.empty(shape, np.int64), np.empty(shape, np.int64)
        )  # fmt: skip
        self._compiled.query(pair, T_a, T_b, limit, *(previous or (None,) * 4), *found, threads or _threads(limit.size))
        return found

    def bare_loop(
        self,
        pair: np.ndarray,
        T_a: np.ndarray,
        T_b: np.ndarray,
        limit: np.ndarray,
        previous: tuple[np.ndarray, ...] | None,
        threads: int | None = None,
    ) -> Callable[[], np.ndarray]:
        """What asks the piece pairs that `ask` would, and does nothing else: a yardstick for benchmarks.

        The call returns all distances (N,), item after item.
        """
        asked = np.array(
            self._compiled.trace(pair, T_a, T_b, limit, *(previous or (None,) * 4)), dtype=np.int64
        ).reshape(-1, 2)
        # Stage by stage as in `ask`: items with the same pieces follow each other, and only first queries are warm.
        asked = asked[np.argsort(pair[asked[:, 0]], kind="stable")]
        item, piece_pair = np.ascontiguousarray(asked.T)
        R, t = relative(T_a, T_b)
        guess, valid = np.zeros((len(item), 3)), np.zeros(len(item), dtype=bool)
        if previous is not None:
            winner, point_a, point_b, status = previous
            guess[:] = in_frame(T_a, point_a - point_b)[item]
            valid[:] = (status[item] == 0) & np.append(True, np.diff(item) != 0)
        distance = np.empty(len(item))

        def run() -> np.ndarray:
            self._narrow_phase.distances(item, piece_pair, R, t, guess, valid, distance, threads or _threads(len(pair)))
            return distance

        return run


def _shape_of(piece: Piece, unit: float) -> "_native.Shape":
    """The shape of a piece in a unit of length, built once."""
    shapes = piece.derived.setdefault("native", {})
    if unit not in shapes:
        scaled = piece.scaled(1.0 / unit)
        shapes[unit] = build_shape(scaled, _native.Shape)
        shapes[unit].set_core(np.ascontiguousarray(scaled.vertices.T, dtype=np.float64), scaled.radius)
    return shapes[unit]


def _side(side: Side) -> "_native.Side":
    bounds = side.piece_bounds
    center, half = (np.ascontiguousarray(array.T) for array in (bounds.center, bounds.half))
    return _native.Side(
        side.body, side.first, center, half, np.ascontiguousarray(np.moveaxis(bounds.axes, -1, 0)), bounds.radius,
        side.supports.table, CELLS,
    )  # fmt: skip


def _threads(items: int) -> int:
    """How many threads these items are worth."""
    return max(1, min(items // _ITEMS_PER_THREAD, _available()))


@cache
def _available() -> int:
    """The threads that we may use."""
    told = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    return int(told) if told.isdecimal() and int(told) > 0 else usable_cores()
