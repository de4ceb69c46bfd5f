"""Statistics: counts and means that can be counted by hand, quantiles within a bin, and memory that does not grow."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from batch_rows import made_up_rows
from grasp_refine.measures.measures import METRE
from grasp_refine_apps.batch import statistics as module
from grasp_refine_apps.batch.histogram import Histogram
from grasp_refine_apps.batch.rows import Rows
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.worst import MAX_CASES_PER_PAIR, MAX_KEPT, NUM_CASES


def statistics(*parts: Rows) -> Statistics:
    found = Statistics.empty()
    for rows in parts:
        found.add(rows)
    return found


# Histograms


def test_a_histogram_counts_each_value_in_its_bin():
    its = Histogram(1.0, 1000.0, 3)
    its.add(np.array([0.0, 0.5, 1.0, 5.0, 10.0, 99.0, 100.0, 1000.0, 2000.0, np.nan, np.inf]))
    # The end of the last bin belongs to it.
    assert its.counts.tolist() == [2, 2, 2, 2, 1] and its.count == 9
    assert (its.least, its.most) == (0.0, 2000.0) and its.mean == pytest.approx(3215.5 / 9)
    assert Histogram(0.0, 1.0, 4, linear=True).mean != Histogram(0.0, 1.0, 4, linear=True).mean, "NaN of none"


def test_shares_are_of_all_values_and_neighbours_are_put_together():
    its = Histogram(0.0, 1.0, 4, linear=True)
    its.add(np.array([-1.0, 0.1, 0.3, 0.4, 0.6, 0.9, 1.0, 2.0]))
    assert its.shares(1).tolist() == [0.125, 0.125, 0.25, 0.125, 0.25, 0.125]
    assert its.shares(2).tolist() == [0.125, 0.375, 0.375, 0.125]


@pytest.mark.parametrize("share", [0.01, 0.05, 0.5, 0.9, 0.95, 1.0])
def test_quantiles_are_right_to_within_a_bin(share: float):
    values = np.exp(np.random.default_rng(0).normal(np.log(1e-3), 1.5, 4000))
    its = Histogram.of(METRE)
    its.add(values)
    width = 10 ** (1 / 20)
    assert np.quantile(values, share) / width < its.quantile(share) < np.quantile(values, share) * width
    assert its.quantile(1.0) == values.max() or share < 1.0


def test_quantiles_outside_of_the_bins_are_extremes():
    its = Histogram(1.0, 10.0, 1)
    its.add(np.array([0.0, 0.0, 0.0, 5.0, 70.0]))
    assert (its.quantile(0.5), its.quantile(1.0)) == (0.0, 70.0) and np.isnan(Histogram.of(METRE).quantile(0.5))
    # Within a bin as far as counts go, along the ratio of its edges, or along their difference.
    for edges, half in (((1.0, 1000.0, 3), 10 * 10**0.5), ((0.0, 30.0, 3, True), 15.0)):
        its = Histogram(*edges)
        its.add(np.array([10.5, 11.0, 12.0, 19.5 if edges[-1] is True else 99.0]))
        assert its.quantile(0.5) == pytest.approx(half)


def test_the_mean_of_many_values_is_exact():
    its = Histogram(1e-9, 1e9, 18)
    parts = [np.random.default_rng(k).lognormal(0, 8, 64) for k in range(200)]
    for values in parts:
        its.add(values)
    exact = sum(Fraction(value) for values in parts for value in values.tolist()) / (200 * 64)
    assert its.mean == pytest.approx(float(exact), rel=1e-15)


# Counts


def test_counts_are_as_in_the_rows():
    found = statistics(
        made_up_rows(
            6,
            status=np.array(["converged", "converged", "stalled", "budget", "no target", "not finite"]),
            good_before=[1, 0, 0, 0, 0, 0],
            good_after=[1, 1, 1, 0, 0, 0],
            held_before=[0, 1, 0, 0, 0, 0],
            held_after=[1, 1, 0, 1, 0, 0],
            reason_after=np.array(["", "", "moved", "", "penetrates", "moved"]),
            quality_after=[0.9, 0.8, 0.7, 0.6, np.nan, np.nan],
            penetration_m_after=[0, 1e-3, 2e-3, 0, 5e-3, np.nan],
            change=np.array(["kept", "contacts moved", "kept", "other grasp", "", ""]),
            quality_before=[0.95, 0.96, 0.94, 1.0, 1.0, np.nan],
            displacement_m=[1e-3, 6e-3, 0.1, 20e-3, 0.1, 0.1],
        ),
        made_up_rows(2, 1, object="bottle", held_before=[1, 1], held_after=[1, 0], good_before=0, good_after=1),
    )
    its = found.all
    assert (its.count, its.usable, its.converged, *its.good) == (8, 6, 4, 1, 5)
    assert found.held == (3, 4) and its.simulated == 8 and found.reasons == {"moved": 2, "penetrates": 1}
    assert found.statuses == {"converged": 4, "stalled": 1, "budget": 1, "no target": 1, "not finite": 1}
    assert found.totals() == {
        "n": 8, "converged": 4, "good_before": 1, "good_after": 5, "success_before": 3, "success_after": 4,
        "changes": {"kept": 2, "contacts moved": 1, "other links": 0, "other grasp": 1},
        "good_inputs": 3, "good_inputs_moved": 2, "good_inputs_displacement_median_m": pytest.approx(6e-3, rel=0.13),
    }  # fmt: skip
    pairs, rest = found.by_pair()
    assert [(pair, tally.count, tally.failures) for pair, tally in pairs] == [
        (("allegro", "mug"), 6, 3),
        (("allegro", "bottle"), 2, 1),
    ]
    assert rest.count == 0 and pairs[0][1].mean_quality[1] == pytest.approx(0.75) and pairs[0][1].deepest == 5e-3
    # What was not refined is no part of the distributions.
    assert found.distributions["quality_after"].count == 6 and found.distributions["penetration_m_after"].count == 6


def test_nothing_simulated_is_no_success():
    found = statistics(made_up_rows(3, held_before=np.nan, held_after=np.nan, good_after=[1, 0, 1]))
    assert found.held is None and found.totals()["success_after"] is None and found.all.failures == 1


def test_no_grasps_have_no_statistics():
    found = statistics(made_up_rows(0))
    assert found.all.count == 0 and found.by_pair()[0] == [] and found.worst() == () and found.totals()["n"] == 0


def test_of_too_many_objects_the_worst_are_kept(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "MAX_PAIRS", 10)
    found = Statistics.empty()
    for number in range(40):
        failing = 5 if number in (3, 17) else 1 + number % 2
        rows = made_up_rows(6, number, object=f"o{number:02d}", held_after=np.nan, good_after=np.arange(6) >= failing)
        found.add(rows)
        assert len(found.pairs) <= 10
    pairs, rest = found.by_pair(4)
    assert [name for (_, name), _ in pairs[:2]] == ["o03", "o17"] and len(pairs) == 4
    assert sum(tally.count for _, tally in pairs) + rest.count == found.all.count == 240
    assert sum(tally.failures for _, tally in pairs) + rest.failures == found.all.failures


# Worst cases


def test_the_worst_cases_have_the_lowest_quality_then_the_largest_depth():
    quality = np.array([0.5, 0.1, 0.1, 0.9, np.nan])
    rows = made_up_rows(
        5, 3, quality_after=quality, penetration_m_after=[0, 1e-3, 2e-3, 0, 0], held_after=np.nan, row=[4, 5, 6, 7, 8]
    )
    first, *others = statistics(rows).worst()
    # A grasp of which nothing can be said, because nothing touches, is worse than any other.
    assert first.row == 4 and np.isnan(first.measures["quality"][1]) and [case.row for case in others] == [2, 1, 0, 3]
    case = others[0]
    assert (case.shard, str(case.file), case.hand, case.object, case.held) == (
        3,
        "job/00003.npz",
        "allegro",
        "mug",
        None,
    )
    assert case.measures["penetration_m"][1] == 2e-3 and (case.source, case.source_row) == ("grasps.npz", 6)


def test_the_worst_of_a_file_of_many_are_kept():
    """Without a quality, or not simulated, or deep: of more grasps than are kept, wherever they are."""
    count = MAX_KEPT + 60
    depth, quality, held = np.arange(count) * 1e-5, np.full(count, 0.5), np.ones(count)
    rows = made_up_rows(count, quality_after=quality, penetration_m_after=depth, held_after=held)
    assert [case.row for case in statistics(rows).worst()] == [*range(count - 1, count - 1 - NUM_CASES, -1)]
    quality[3], held[5] = np.nan, np.nan
    rows = made_up_rows(count, quality_after=quality, penetration_m_after=depth, held_after=held)
    assert [case.row for case in statistics(rows).worst()][:3] == [5, 3, count - 1]


def test_what_was_not_refined_is_no_case():
    rows = made_up_rows(3, status=np.array(["no target", "converged", "not finite"]), quality_after=[0, 1, 0])
    assert [case.row for case in statistics(rows).worst()] == [1]


def test_what_fell_in_simulation_comes_before_what_held():
    rows = made_up_rows(3, quality_after=[0.1, 0.99, 0.5], held_after=[1, 0, 1], reason_after=["", "rotated", ""])
    cases = statistics(rows).worst()
    assert [(case.row, case.held, case.reason) for case in cases] == [
        (1, False, "rotated"), (0, True, ""), (2, True, ""),
    ]  # fmt: skip


def test_cases_are_of_several_objects_as_long_as_there_are_others():
    bad = made_up_rows(300, 0, object="bad", quality_after=0.01, held_after=np.nan)
    others = [made_up_rows(2, k, object=f"o{k}", quality_after=0.5, held_after=np.nan) for k in range(1, 4)]
    alone, mixed = statistics(bad).worst(), statistics(*others, made_up_rows(9, 9, quality_after=0.4)).worst()
    assert len(alone) == NUM_CASES and {case.object for case in alone} == {"bad"}
    assert len(mixed) == NUM_CASES and sum(case.object == "mug" for case in mixed) == 6 > MAX_CASES_PER_PAIR
    badness = [case.badness for case in mixed]
    assert badness == sorted(badness, reverse=True)


def test_the_worst_of_many_files_are_found_wherever_they_are():
    random = np.random.default_rng(0)
    quality = random.permutation(40 * 30) / 1200
    parts = [
        made_up_rows(30, k, object=f"o{k}", held_after=np.nan, quality_after=quality[30 * k : 30 * k + 30])
        for k in range(40)
    ]
    ranked = np.argsort(quality)
    taken, seen = [], {}
    for i in ranked[:MAX_KEPT].tolist():
        seen[i // 30] = seen.get(i // 30, 0) + 1
        if seen[i // 30] <= MAX_CASES_PER_PAIR and len(taken) < NUM_CASES:
            taken.append((i // 30, i % 30))
    assert [(case.shard, case.row) for case in statistics(*parts).worst()] == taken
