"""Queries that a refinement skips: of bodies that are far, cannot win, or are rejected anyway; and its warm starts.

A refinement queries through `query_near`. To undo a skip, the whole refinement runs again with one of the functions
here. EngineResult are equal to rounding, and so are the results, unless rounding grows over many iterations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import partial

import numpy as np

from grasp_refine.collision.culling import nothing_near, query_near
from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.collision.table import PieceTable
from grasp_refine.refinement import grasp_problem
from grasp_refine.refinement.refine import Refinement
from grasp_refine_apps.bench.queries.skip import Example, Skip, measure_calls, replace_attribute

Near = Callable[[Pairs, np.ndarray, np.ndarray, np.ndarray, np.ndarray, Witness | None], Witness]
"""Signature of `query_near`: pairs, bounds, poses of both bodies, cutoffs, and the last answers."""


def query_skips(example: Example, rounds: int) -> Iterator[Skip]:
    """Undo each skip of queries in a whole refinement of the example."""
    # The compiled engine checks bounds in a loop of its own.
    python = {id(pairs): _in_python(pairs) for pairs in _pairs(example)}
    every = {id(pairs): unbounded(pairs) for pairs in _pairs(example)}
    ways: dict[str, Near] = {
        "usual": query_near,
        "far": query_far,
        "rejected": query_rejected,
        "cold": query_cold,
        "bounded": lambda pairs, *rest: query_near(python[id(pairs)], *rest),
        "unbounded": lambda pairs, *rest: query_near(every[id(pairs)], *rest),
    }
    for near in ways.values():
        with replace_attribute(grasp_problem, "query_near", near):
            example.warm_up()
    found = measure_calls({name: partial(refined, example, near) for name, near in ways.items()}, rounds)
    for name, way, usual, how in (
        ("links that are far from everything", "far", "usual", "every pair of bodies is queried"),
        ("pieces whose bounds cannot win", "unbounded", "bounded", "all pieces of these pairs are; both in Python"),
        ("pairs of links of steps that are rejected", "rejected", "usual", "they are queried as well"),
        ("last winner first, and warm starts", "cold", "usual", "the last answers are not used"),
    ):
        (before, cpu_without), (after, cpu_with) = found[way], found[usual]
        counts = int(before.queries.sum()), int(after.queries.sum())
        yield Skip(name, "queries", example.name, *counts, cpu_without, cpu_with, how, difference(before, after))


def refined(example: Example, near: Near) -> Refinement:
    """Refine the grasps of an example with other queries."""
    with replace_attribute(grasp_problem, "query_near", near):
        return example.refined()


def query_far(
    pairs: Pairs, bound: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, cutoff: np.ndarray, previous: Witness | None
) -> Witness:
    """Query every pair, and drop the answers that would have been skipped."""
    found = query(pairs, T_a, T_b, previous=previous)
    told = np.isinf(cutoff) | ~(bound > 0)
    hidden = ~told | (found.distance >= cutoff)
    nothing = nothing_near(np.where(told, cutoff, bound))
    for field in fields(Witness):
        if field.name != "num_queries":
            getattr(found, field.name)[hidden] = getattr(nothing, field.name)[hidden]
    return found


def query_rejected(
    pairs: Pairs, bound: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, cutoff: np.ndarray, previous: Witness | None
) -> Witness:
    """Query pairs of links even if the step is rejected."""
    return query_near(pairs, np.where(np.isposinf(bound), -np.inf, bound), T_a, T_b, cutoff, previous)


def query_cold(
    pairs: Pairs, bound: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, cutoff: np.ndarray, previous: Witness | None
) -> Witness:
    """Query without the last answers."""
    return query_near(pairs, bound, T_a, T_b, cutoff, None)


class _Unbounded(PieceTable):
    """Piece pairs without bounds, so that all must be queried."""

    def sphere_bound(self, pair: np.ndarray, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return no bounds; infinite in empty columns."""
        bound = np.where(self.id[pair] >= 0, -np.inf, np.inf)
        return bound, np.zeros(len(pair), dtype=np.int64)

    def gap_bound(self, item: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        """Return no bounds."""
        return np.full(len(item), -np.inf)

    def box_bound(self, pair: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        """Return no bounds."""
        return np.full(len(pair), -np.inf)


def unbounded(pairs: Pairs) -> Pairs:
    """Return pairs of which every piece pair is queried; in Python."""
    every = _in_python(pairs)
    table = PieceTable.of(pairs.a, pairs.b)
    # Replaces the cached property, which is then never built.
    every.__dict__["_table"] = _Unbounded(*(getattr(table, field.name) for field in fields(PieceTable)))
    return every


def _in_python(pairs: Pairs) -> Pairs:
    return Pairs(pairs.a, pairs.b, pairs.tolerances, engine="python")


def _pairs(example: Example) -> list[Pairs]:
    """Pairs that a refinement queries: links and object, and links that can touch each other."""
    both = example.prepared.pairs, example.prepared.self_collision_pairs
    return [pairs for pairs in both if pairs is not None]


def difference(found: Refinement, other: Refinement) -> float:
    """Largest difference of a pose or joint value between two refinements of the same grasps."""
    return float(max(np.abs(found.T_world_root - other.T_world_root).max(), np.abs(found.q - other.q).max()))
