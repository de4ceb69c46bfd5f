"""Shares of CPU time: numbers that can be counted by hand."""

from __future__ import annotations

import pytest

from grasp_refine.core.profiling import STAGES, Stopwatch
from grasp_refine_apps.bench.shares import cpu_share, split_stages


def test_what_is_not_told_apart_is_one_part():
    parts = split_stages("broad phase", "derivative")
    assert list(parts) == ["broadphase", "derivative", "solver"]
    assert parts["broadphase"] == ("broad phase",)
    assert sorted(stage for part in parts.values() for stage in part) == sorted(STAGES)


def test_shares_are_of_the_time_of_all_stopwatches():
    parts = split_stages("broad phase", "narrow phase")
    one, other = Stopwatch(), Stopwatch()
    assert cpu_share([one, other], parts) == dict.fromkeys(parts)
    one.spent["broad phase"].cpu_s, one.spent["forces"].cpu_s = 1.0, 2.0
    other.spent["broad phase"].cpu_s, other.spent["other"].cpu_s = 3.0, 2.0
    assert cpu_share([one, other], parts) == pytest.approx({"broadphase": 0.5, "narrowphase": 0.0, "solver": 0.5})
