"""The compiled engine: the narrow phase and the whole search in C++, contact forces and bounded steps (see `native/`).

Its answers are the same for any number of threads. It releases the GIL.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

# Loads coal's library, which _native needs.
from grasp_refine.collision.bounds import CELLS, bounds_of, support_table
from grasp_refine.collision.certified_distance import Tolerances, coal_version
from grasp_refine.collision.shapes import build_shape, unit_of
from grasp_refine.core.array_records import index_distinct
from grasp_refine.core.cores import usable_cores
from grasp_refine.core.profiling import stage
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece

from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled  # isort: skip

_SOURCES = Path(__file__).with_name("native")

_ITEMS_PER_THREAD = 512
"""Fewest items for another thread: about 2 ms of work; a thread also waits some milliseconds for more work."""

_STEPS_PER_THREAD = 128
"""Fewest steps of a solver for another thread."""

_PRODUCTS_PER_THREAD = 2**20
"""Fewest multiplications for another thread."""

_PROGRAMS_PER_THREAD = 128
"""Fewest programs of contact forces for another thread, likewise."""


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


class NativeSearch:
    """The search among the piece pairs of P body pairs, compiled."""

    def __init__(self, a: Sequence[Body], b: Sequence[Body], tolerances: Tolerances) -> None:
        """Prepare the pairs (a[p], b[p])."""
        t, both = tolerances, list(zip(a, b, strict=True))
        piece_pairs = [(one, other) for first, second in both for one in first.pieces for other in second.pieces]
        counts = [len(first.pieces) * len(second.pieces) for first, second in both]
        units = [unit_of(*pair) for pair in piece_pairs]
        shapes = (
            [_shape_of(pair[side], unit) for pair, unit in zip(piece_pairs, units, strict=True)] for side in (0, 1)
        )
        self._narrow_phase = _native.NarrowPhase(*shapes, units, t.gjk, t.epa, t.retry, t.slack)
        self._compiled = _native.Search(self._narrow_phase, _side(a), _side(b), np.cumsum([0, *counts[:-1]]))

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
        """Return the answers, as `search.Search` says.

        Args:
            pair: As there, like the arguments that follow.
            T_a: As there.
            T_b: As there.
            limit: As there.
            previous: As there.
            threads: Number of threads; by default `OMP_NUM_THREADS`, or one a core, fewer for few items.
        """
        shape = limit.shape
        points = np.empty((3, *shape, 3))
        found = (
            *points, np.empty(shape), np.empty(shape, np.int8), np.empty(shape, np.int64), np.empty(shape, np.int64)
        )  # fmt: skip
        threads = threads or threads_for(limit.size)
        if threads > 1:
            # Skipped items are no work; few items need no count.
            threads = min(threads, threads_for(limit.size - int(np.isnan(limit).sum())))
        self._compiled.query(pair, T_a, T_b, limit, *(previous or (None,) * 4), *found, threads)
        return found

    def bare_loop(
        self, pair: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, limit: np.ndarray
    ) -> Callable[[], np.ndarray]:
        """Return a function that only makes the narrow-phase queries of `query`: a lower bound for benchmarks.

        It returns all distances (N,), item after item.
        """
        queries = np.array(self._compiled.trace(pair, T_a, T_b, limit), dtype=np.int64).reshape(-1, 2)
        # As in `query`: items with the same pieces follow each other.
        item, piece_pair = np.ascontiguousarray(queries[np.argsort(pair[queries[:, 0]], kind="stable")].T)
        distance = np.empty(len(item))

        def run() -> np.ndarray:
            self._narrow_phase.distances(item, piece_pair, T_a, T_b, distance, threads_for(len(pair)))
            return distance

        return run


def solve_forces(
    G: np.ndarray,
    there: np.ndarray,
    outer: np.ndarray,
    start: np.ndarray | None,
    friction: float,
    share: float,
    ridge: float,
    threads: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the results of `forces.programs.solve_programs`, no pressure being above `share` of all."""
    (N, P), K = outer.shape[:2], G.shape[1]
    local, solved = np.empty((N, P, K, 3)), np.empty((N, P), dtype=bool)
    threads = threads or threads_for(solved.size, _PROGRAMS_PER_THREAD)
    _native.solve_forces(G, there, outer, start, friction, share, ridge, local, solved, threads)
    return local, solved


def bounded_steps(
    *arrays: np.ndarray, unilateral: np.ndarray | None, passes: int, threads: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps and predicted falls of `bounded_step`, which has the same arguments, the arrays in its order."""
    contiguous = [np.ascontiguousarray(part, dtype=np.float64) for part in arrays]
    dx, predicted = np.empty(contiguous[-1].shape), np.empty(len(contiguous[0]))
    threads = threads or threads_for(len(predicted), _STEPS_PER_THREAD)
    _native.bounded_steps(*contiguous, unilateral, passes, dx, predicted, threads)
    return dx, predicted


def products(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return the products (..., R, U) of matrices (..., R, K) and (..., K, U), each sum in order of its terms.

    Zeros among the terms change no bit, and the result is the same on all processors; BLAS adds in lanes.
    """
    lead, (R, K), U = A.shape[:-2], A.shape[-2:], B.shape[-1]
    out = np.empty((*lead, R, U))
    A, B = (np.ascontiguousarray(each.reshape(-1, *each.shape[-2:]), dtype=np.float64) for each in (A, B))
    _native.products(A, B, out, threads_for(out.size * K, _PRODUCTS_PER_THREAD))
    return out


def _shape_of(piece: Piece, unit: float) -> "_native.Shape":
    """Shape of a piece in a unit of length, built once."""
    shapes = piece.derived.setdefault("native", {})
    if unit not in shapes:
        scaled = piece.scaled(1.0 / unit)
        shapes[unit] = build_shape(scaled, _native.Shape)
        shapes[unit].set_core(np.ascontiguousarray(scaled.vertices.T, dtype=np.float64), scaled.radius)
    return shapes[unit]


def _side(bodies: Sequence[Body]) -> "_native.Side":
    """The bodies on one side of the pairs, each of them once."""
    distinct, body = index_distinct(bodies)
    first = np.cumsum([0, *(len(one.pieces) for one in distinct)])
    bounds = bounds_of([piece for one in distinct for piece in one.pieces])
    table = support_table([one.pieces for one in distinct])
    return _native.Side(body, first, bounds.center, bounds.half, bounds.axes, bounds.radius, table, CELLS)


def threads_for(items: int, fewest: int = _ITEMS_PER_THREAD) -> int:
    """Number of threads for a number of items, one for every `fewest` items."""
    return max(1, min(items // fewest, _available()))


@cache
def _available() -> int:
    """Number of threads that this process may use."""
    value = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0]
    return int(value) if value.isdecimal() and int(value) > 0 else usable_cores()
