"""Times are taken in turn and with one thread; shares of CPU time can be counted by hand."""

from __future__ import annotations

import time

import numpy as np
import pytest

from grasp_refine.collision.engine import why_not_native
from grasp_refine.core.profiling import Stopwatch
from grasp_refine_apps.bench.timing import MAX_CALLS, WARM_UP_CALLS, cpu_share, cpu_times, one_thread, split_stages


def test_times_are_taken_in_turn_after_a_warm_up():
    called = []
    runs = {name: (lambda name=name: called.append(name)) for name in "ab"}
    times = cpu_times(runs, 3, 0.0)
    assert "".join(called) == "a" * WARM_UP_CALLS + "b" * WARM_UP_CALLS + "ababab"
    assert all(found.shape == (3,) and (found >= 0).all() for found in times.values())
    called.clear()
    cpu_times(runs, 1, 1.0)
    assert len(called) <= 2 * (WARM_UP_CALLS + MAX_CALLS)
    assert np.isfinite(list(times.values())).all()


def test_times_are_as_in_one_call(monkeypatch: pytest.MonkeyPatch):
    clock = [0.0]

    def run() -> None:
        clock[0] += 0.25

    monkeypatch.setattr(time, "process_time", lambda: clock[0])
    assert cpu_times({"a": run}, 3, 2.0)["a"] == pytest.approx([0.25] * 3)


def test_the_compiled_engine_works_with_one_thread_for_a_while(monkeypatch: pytest.MonkeyPatch):
    if why_not_native():
        pytest.skip(f"no compiled engine: {why_not_native()}")
    from grasp_refine.collision import native_search

    monkeypatch.setattr(native_search, "_available", lambda: 8)
    with pytest.raises(KeyError), one_thread():
        assert native_search.threads_for(10**6) == 1
        raise KeyError
    assert native_search.threads_for(10**6) == 8


def test_shares_are_of_the_time_of_all_stopwatches():
    parts = split_stages("broad phase", "narrow phase")
    one, other = Stopwatch(), Stopwatch()
    assert cpu_share([one, other], parts) == dict.fromkeys(parts)
    one.spent["broad phase"].cpu_s, one.spent["forces"].cpu_s = 1.0, 2.0
    other.spent["broad phase"].cpu_s, other.spent["other"].cpu_s = 3.0, 2.0
    assert cpu_share([one, other], parts) == pytest.approx({"broadphase": 0.5, "narrowphase": 0.0, "solver": 0.5})
