"""Rows of results: numbers of each group of grasps by each method; agreement of engines; and some failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from grasp_refine.measures.measures import COMPARED
from grasp_refine.refinement.config import Config
from grasp_refine.validation.engine_agreement import EngineAgreement
from grasp_refine.validation.engine_table import ENGINES as ENGINE_TABLE
from grasp_refine_apps.bench.chart import Row, of_finite
from grasp_refine_apps.bench.success.measure import GROUPINGS, Measured, Method
from grasp_refine_apps.bench.success.trials import HELD, AnyTrial, Trial

ALL = "all"
"""Grouping of all grasps together."""

CASE = ("hand", "source", "object")
"""Names of `GROUPINGS` that are combined."""

ENGINES, FAILURE = "engines", "failure"
"""Entry `by` of rows of the agreement of two engines, and of single grasps that fail."""

FAILURES_PER_REASON = 4
"""Number of failures listed for each reason, of different hands and objects where there are enough."""

Statistic = Callable[[np.ndarray], float | None]


def _finite(statistic: Callable[..., Any]) -> Statistic:
    return lambda values: of_finite(statistic, values)


def _worst(statistic: Callable[..., Any]) -> Statistic:
    """Statistic for which grasps that could not be measured count as the worst."""
    return lambda values: float(statistic(np.nan_to_num(values, nan=np.inf, posinf=np.inf)))


def quantile(share: float) -> Callable[[np.ndarray], Any]:
    """Return the function that finds a quantile of values."""
    return lambda values: np.quantile(values, share, method="higher")


STATISTICS: Mapping[str, tuple[str, Statistic]] = {
    "cpu_mean_s": ("cpu_s", _finite(np.mean)),
    "cpu_median_s": ("cpu_s", _finite(np.median)),
    "wall_mean_s": ("wall_s", _finite(np.mean)),
    "wall_median_s": ("wall_s", _finite(np.median)),
    "starts_mean": ("starts", _finite(np.mean)),
    "displacement_median_m": ("displacement_m", _finite(np.median)),
    "displacement_q90_m": ("displacement_m", _finite(quantile(0.9))),
    "contacts_moved_median_m": ("contacts_moved_m", _finite(np.median)),
    "links_kept_mean": ("links_kept", _finite(np.mean)),
    "moved_palm_median_m": ("moved_palm_m", _finite(np.median)),
    "moved_palm_q90_m": ("moved_palm_m", _finite(quantile(0.9))),
    "moved_palm_median_rad": ("moved_palm_rad", _finite(np.median)),
    "moved_joints_median_rad": ("moved_joints_rad", _finite(np.median)),
    "penetration_mean_m": ("penetration_m", _worst(np.mean)),
    "penetration_q95_m": ("penetration_m", _worst(quantile(0.95))),
    "self_penetration_max_m": ("self_penetration_m", _worst(np.max)),
    "contact_error_median_m": ("contact_error_m", _finite(np.median)),
    "wrench_residual_median": ("wrench_residual", _worst(np.median)),
    "wrench_residual_q75": ("wrench_residual", _worst(quantile(0.75))),
    "quality_median": ("quality", lambda values: float(np.median(np.nan_to_num(values)))),
    "pushed_max_m": ("pushed_m", _finite(np.max)),
}
"""Key of a row -> value of `Measured`, and its statistic over the grasps."""

OF_GOOD = ("displacement_median_m", "displacement_q90_m", "moved_palm_median_m", "moved_palm_q90_m", "links_kept_mean")
"""Keys of `STATISTICS` that rows also have, with the prefix "good_", over the inputs that were good enough already."""


def key_of(name: str, column: str) -> str:
    """Key of a number of a trial; dots would separate the names of nested entries."""
    return f"{name}_{column.replace('-', '_').replace('.', '_')}"


def rows(done: Sequence[Sequence[Measured]], trials: Sequence[AnyTrial]) -> list[Row]:
    """Return flat rows.

    First come the rows of all grasps, then of each label of the `GROUPINGS` with several labels, and of combinations of
    hand, source and object that vary; a row for each method. The first method of a case decides which grasps held
    before, and which were good enough already: they passed the first trial, with a quality of `Config.confidence`.

    Args:
        done: Results of each case, by method.
        trials: Trials of the grasps.
    """
    methods = list(dict.fromkeys(one.method for case in done for one in case))
    columns = [column for trial in trials for column in trial.columns]
    varied = [name for name in GROUPINGS if len({str(each) for case in done for each in case[0].labels[name]}) > 1]
    whole = tuple(name for name in varied if name in CASE)
    pair = tuple(name for name in whole if name != "object")
    several = [by for by in dict.fromkeys((pair, whole)) if len(by) > 1]
    found = []
    for by in ((), *((name,) for name in varied), *several):
        labels = sorted({label for case in done for label in _labels(case[0], by)}) if by else [ALL]
        for label in labels:
            for method in methods:
                pairs = [(case[0], one) for case in done for one in case if one.method == method]
                masks = [np.array([not by or each == label for each in _labels(one, by)]) for one, _ in pairs]
                if pairs and any(mask.any() for mask in masks):
                    about = {"by": " and ".join(by) or ALL, "label": " ".join(label) if by else ALL}
                    found.append({**about, **_method(method), **_statistics(pairs, masks, trials)})
    return [*found, *_agreement(done, methods, trials), *_failures(done, columns)]


def _method(method: Method) -> Row:
    return {"method": method.name, "starts": method.starts, "refined": method.label}


def _labels(one: Measured, by: Sequence[str]) -> list[tuple[str, ...]]:
    """Label of each grasp in a grouping."""
    count = len(one.labels["hand"])
    return [tuple(str(one.labels[name][i]) for name in by) for i in range(count)]


def _statistics(
    pairs: Sequence[tuple[Measured, Measured]], masks: Sequence[np.ndarray], trials: Sequence[AnyTrial]
) -> Row:
    """Numbers of some grasps; the first entry of each pair has the verdicts and the quality before."""

    def join(get: Callable[[Measured], np.ndarray], side: int = 1) -> np.ndarray:
        return np.concatenate([get(pair[side])[mask] for pair, mask in zip(pairs, masks, strict=True)])

    first = pairs[0][1]
    good = join(lambda one: one.values["quality"], 0) >= Config.confidence
    for column in trials[0].columns:
        good &= join(lambda one, c=column: one.verdict[c], 0) == HELD  # type: ignore[misc]  # bound now
    row: Row = {"grasps": len(good), "good": int(good.sum())}
    for key, (name, statistic) in STATISTICS.items():
        if name in first.values:
            values = join(lambda one, name=name: one.values[name])  # type: ignore[misc]  # bound now
            row[key] = statistic(values)
            if key in OF_GOOD:
                row[f"good_{key}"] = statistic(values[good])
    quality = np.nan_to_num(join(lambda one: one.values["quality"]))
    for column in (column for trial in trials for column in trial.columns):
        before, after = (join(lambda one, c=column: one.verdict[c], side) for side in (0, 1))  # type: ignore[misc]
        held_before, held = before == HELD, after == HELD
        lost = int((held_before & ~held).sum())
        numbers = {
            "success": float(held.mean()),
            "held": int(held.sum()),
            "lost": lost / held_before.sum() if held_before.any() else None,
            "num_lost": lost,
            "auc": auc(quality, held),
            "reasons": dict(Counter(after[~held].tolist()).most_common()),
        }
        row |= {key_of(name, column): value for name, value in numbers.items()}
    return row


def auc(score: np.ndarray, success: np.ndarray) -> float | None:
    """Probability that a random success has a higher score than a random failure; ties count half.

    Args:
        score: Scores (N,).
        success: True for successes (N,).

    Returns:
        The area under the curve of hits against false alarms; None where all or none are successes.
    """
    yes, no = score[success], score[~success]
    if not len(yes) or not len(no):
        return None
    order = np.sort(no)
    below, upto = np.searchsorted(order, yes, "left"), np.searchsorted(order, yes, "right")
    return float((below + upto).mean() / (2 * len(no)))


def _agreement(
    done: Sequence[Sequence[Measured]], methods: Sequence[Method], trials: Sequence[AnyTrial]
) -> Iterator[Row]:
    """Yield the agreement of each two engines on the grasps of each method, for each protocol that both tried."""
    simulated = [trial for trial in trials if isinstance(trial, Trial)]
    for first, second in combinations(simulated, 2):
        if (first.protocol, first.name) != (second.protocol, second.name):
            continue
        titles = " and ".join(ENGINE_TABLE[trial.engine].title for trial in (first, second))
        for method in methods:
            those = [one for case in done for one in case if one.method == method]
            held = [np.concatenate([one.verdict[each.columns[0]] for one in those]) == HELD for each in (first, second)]
            found = EngineAgreement.of(*held)
            counts = {"first_only": found.first_only, "second_only": found.second_only}
            kappa = found.kappa if np.isfinite(found.kappa) else None
            shares = {"share": found.share, "kappa": kappa}
            label = f"{first.name or first.protocol.name}, {titles}"
            yield {"by": ENGINES, "label": label, **_method(method), "grasps": found.count, **shares, **counts}


def _failures(done: Sequence[Sequence[Measured]], columns: Sequence[str]) -> Iterator[Row]:
    """Yield some grasps that fail with the last method, by trial and reason, the most frequent reasons first."""
    for column in columns:
        places: dict[str, list[tuple[Sequence[Measured], int]]] = {}
        for case in done:
            for i, reason in enumerate(case[-1].verdict[column].tolist()):
                if reason != HELD:
                    places.setdefault(reason, []).append((case, i))
        for reason, at in sorted(places.items(), key=lambda entry: (-len(entry[1]), entry[0])):
            for case, i in _varied(at):
                yield {
                    **{"by": FAILURE, "label": f"{reason}, {column} ({len(at)} grasps)", "reason": reason},
                    **{"case": case[-1].case, "row": i, **_method(case[-1].method)},
                    **{name: str(case[-1].labels[name][i]) for name in GROUPINGS},
                    "measures": {
                        each.name: [float(one.values[each.name][i]) for one in (case[0], case[-1])] for each in COMPARED
                    },
                }


def _varied(at: Sequence[tuple[Sequence[Measured], int]]) -> list[tuple[Sequence[Measured], int]]:
    """Choose grasps of hands and objects that were not chosen before, as far as there are."""
    seen: Counter[str | tuple[str, str]] = Counter()
    ranked = []
    for number, (case, i) in enumerate(at):
        names = str(case[-1].labels["hand"][i]), str(case[-1].labels["object"][i])
        ranked.append((seen[names], sum(seen[name] for name in names), number))
        seen.update((names, *names))
    return [at[number] for *_, number in sorted(ranked)[:FAILURES_PER_REASON]]
