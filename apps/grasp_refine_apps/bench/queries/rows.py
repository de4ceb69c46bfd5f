"""Rows of measurements: one flat entry for each engine, cold and warm, and for each peer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from grasp_refine_apps.bench.queries.peers import PEERS
from grasp_refine_apps.bench.queries.runner import CaseResult

Row = dict[str, Any]


def backward_column(method: str) -> str:
    """Key of the time of a backward pass."""
    return f"backward_{method.replace('-', '_')}_us"


def rows(done: Sequence[CaseResult]) -> list[Row]:
    """Return all rows of a run, case by case: our engines first, then the peers.

    Times are medians over the rounds; ratios are medians of ratios within a round, in which all are timed alternately.
    """
    return [row for measured in done for row in (*_ours(measured), *_bare(measured), *_peers(measured))]


def _ours(measured: CaseResult) -> list[Row]:
    case, first = measured.case, next(iter(measured.engines.values()))
    found = []
    for (engine, warm), answers in measured.engines.items():
        asked, all_pairs = answers.num_queries, answers.poses * case.piece_pairs
        # Code around the query, and the derivative, are the same for all engines.
        shown = answers is first
        backward = {
            backward_column(method): _us(times) if shown else None for method, times in measured.backward_s.items()
        }
        found.append(
            {
                "table": "queries",
                **case.columns(),
                "by": engine,
                "peer": False,
                "warm": warm,
                "poses": answers.poses,
                "forward_us": _us(answers.forward_s),
                "layer_us": _us(measured.layer_s) if shown else None,
                **backward,
                "forward_ratio": float(np.median(answers.forward_s / first.forward_s)),
                "queries_asked": asked,
                "piece_pairs": all_pairs,
                "pruned": all_pairs - asked,
                "queries_warm": answers.warm,
                "distance_error_m": answers.error,
                "distance_error_median_m": None,
                "tolerance_m": None,
            }
        )
    return found


def _bare(measured: CaseResult) -> list[Row]:
    """Row of the bare loop over the queries of the compiled engine."""
    if measured.bare_s is None:
        return []
    (native,) = (row for row in _ours(measured) if row["by"] == "native" and not row["warm"])
    first = next(iter(measured.engines.values()))
    nothing = dict.fromkeys(["layer_us", "distance_error_m", *map(backward_column, measured.backward_s)])
    times = {
        "forward_us": _us(measured.bare_s),
        "forward_ratio": float(np.median(measured.bare_s / first.forward_s)),
    }
    return [{**native, **nothing, **times, "by": "bare-loop"}]


def _peers(measured: CaseResult) -> list[Row]:
    case, first = measured.case, next(iter(measured.engines.values()))
    tolerances: dict[str, float] = {peer.name: peer.tolerance_m for peer in PEERS}
    found = []
    for name, peered in measured.peers.items():
        all_pairs = peered.poses * case.piece_pairs
        found.append(
            {
                "table": "queries",
                **case.columns(),
                "by": name,
                "peer": True,
                "warm": False,
                "poses": peered.poses,
                "forward_us": _us(peered.forward_s),
                "layer_us": None,
                **{backward_column(method): None for method in measured.backward_s},
                "forward_ratio": float(np.median(peered.forward_s / first.forward_s)),
                "queries_asked": all_pairs,
                "piece_pairs": all_pairs,
                "pruned": 0,
                "queries_warm": 0,
                "distance_error_m": float(np.abs(peered.errors).max()),
                "distance_error_median_m": float(np.median(np.abs(peered.errors))),
                "tolerance_m": tolerances[name],
            }
        )
    return found


def _us(seconds: np.ndarray) -> float:
    return 1e6 * float(np.median(seconds))
