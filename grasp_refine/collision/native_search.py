"""The compiled engine: the narrow phase and the whole search in C++ (see `native/`), with the same interface.

Its answers equal those of the Python engine up to rounding, for any number of threads. It releases the GIL.
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
"""Fewest items for another thread: about 2 ms of work; a thread also waits some milliseconds for more work."""


def built_for() -> str:
    """Version of coal that the engine was built for."""
    return _native.coal_version


def has_threads() -> bool:
    """Return whether the engine was built with OpenMP; without it, it uses one thread."""
    return _native.openmp


def mismatch() -> str:
    """Reason why the engine must not be used; empty: it may."""
    built, here = built_for(), coal_version()
    if here != built:
        return (
            f"built for coal {built}, but coal {here} is installed: pip install coal=={built}, or install grasp-refine "
            "again with --no-build-isolation"
        )
    if sources() not in (None, getattr(_native, "sources", None)):
        return "built from other sources than the present ones: install grasp-refine again"
    return ""


def sources(folder: Path = _SOURCES) -> str | None:
    """Hash of the engine's sources as in `native/CMakeLists.txt`; None: there are no sources, as in a wheel."""
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
        """Return the closest piece pair of each item, as in `narrowphase.NarrowPhase.closest`."""
        M = len(R)
        winner, num_queries = np.empty((2, M), np.int64)
        found = Closest(np.empty(M), np.empty((M, 3)), np.empty((M, 3)), winner, num_queries, np.empty(M, bool))
        self.compiled.closest(
            R, t, starts, pair, bound, limit, guess, guess_valid,
            found.distance, found.point, found.normal, found.winner, found.num_queries, found.failed,
        )  # fmt: skip
        return found


class NativeSearch:
    """The search among the piece pairs of P body pairs, compiled."""

    def __init__(self, table: PieceTable, narrow_phase: NativeNarrowPhase) -> None:
        """Prepare the piece pairs of a table."""
        self._narrow_phase = narrow_phase.compiled
        self._compiled = _native.Search(
            narrow_phase.compiled, _side(table.a), _side(table.b), np.ascontiguousarray(table.id[:, 0])
        )

    @stage("narrow phase")
    def query(
        self,
        pair: np.ndarray | None,
        T_a: np.ndarray,
        T_b: np.ndarray,
        limit: np.ndarray,
        previous: tuple[np.ndarray, ...] | None,
        threads: int | None = None,
    ) -> tuple[np.ndarray, ...]:
        """Return the fields of a `query.Witness`, in its order and in the shape of `limit`, for M items in all.

        Args:
            pair: The body pair of each item (M,); None: all P pairs, repeated.
            T_a: Poses (M, 4, 4) of the first bodies in the world.
            T_b: Poses of the second bodies.
            limit: Signed distance in metres that an answer has to be below.
            previous: The winners, points on a, points on b and statuses of the last answer.
            threads: Number of threads; by default `OMP_NUM_THREADS`, or one a core, fewer for few items.
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
        """Return a function that only makes the narrow-phase queries of `query`: a lower bound for benchmarks.

        It returns all distances (N,), item after item.
        """
        queries = np.array(
            self._compiled.trace(pair, T_a, T_b, limit, *(previous or (None,) * 4)), dtype=np.int64
        ).reshape(-1, 2)
        # As in `query`: items with the same pieces follow each other, and only first queries are warm-started.
        queries = queries[np.argsort(pair[queries[:, 0]], kind="stable")]
        item, piece_pair = np.ascontiguousarray(queries.T)
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
    """Shape of a piece in a unit of length, built once."""
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
    """Number of threads for a number of items."""
    return max(1, min(items // _ITEMS_PER_THREAD, _available()))


@cache
def _available() -> int:
    """Number of threads that this process may use."""
    value = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    return int(value) if value.isdecimal() and int(value) > 0 else usable_cores()
