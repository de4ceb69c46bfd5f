"""Jobs are run in turn or side by side; neither failures nor interruptions lose what is done."""

from __future__ import annotations

from grasp_refine_apps.bench.jobs import run_jobs
from worker_tasks import fake_job


def test_a_failed_job_does_not_end_the_others():
    told: list[tuple[float, str]] = []
    results, problems, interrupted = run_jobs(
        [fake_job("a"), fake_job("bad"), fake_job("b", 2.0)], 1, lambda *what: told.append(what)
    )
    assert results == ["a", "b"] and not interrupted
    (problem,) = problems
    assert problem.startswith("bad: Traceback") and problem.endswith("ValueError: no luck")
    assert told == [(0.125, "a"), (0.375, "bad"), (0.75, "b")]


def test_an_interruption_keeps_what_is_done():
    results, problems, interrupted = run_jobs([fake_job("a"), fake_job("stop"), fake_job("b")], 1, lambda *_: None)
    assert (results, problems, interrupted) == (["a"], [], True)


def test_processes_give_results_in_order_and_a_crash_ends_its_job_only():
    """All jobs of a pool once ended with one whose process crashed."""
    told: list[float] = []
    jobs = [fake_job("a"), fake_job("bad"), fake_job("crash"), fake_job("b", 5.0), fake_job("c", 2.0)]
    results, problems, interrupted = run_jobs(jobs, 2, lambda share, label: told.append(share))
    assert results == ["a", "b", "c"] and not interrupted
    bad, crash = sorted(problems)
    assert bad.startswith("bad: Traceback") and bad.endswith("ValueError: no luck")
    assert crash.startswith("crash: ") and "SIGSEGV" in crash
    assert told == sorted(told) and told[-1] == 1.0
