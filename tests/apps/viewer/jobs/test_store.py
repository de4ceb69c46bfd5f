"""Jobs are paused, taken step by step and stopped at once; a stopped one changes nothing any more."""

import threading
from typing import Any

import pytest

from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from open_viewer import ignored, settled
from refusals import assert_names
from running_processes import PATIENCE_S
from websocket_page import until


def test_a_stopped_job_ends_at_its_next_check_and_is_not_heard_any_more() -> None:
    said: list[str] = []
    control = Control(lambda share, what: said.append(what))
    control.report(0.5, "half")
    control.check()
    control.stop()
    control.report(0.6, "more")
    assert said == ["half"] and control.stopped
    with pytest.raises(Stopped):
        control.check()


def test_a_paused_job_passes_as_many_checks_as_it_is_given_steps() -> None:
    control, ended = ignored(), []

    def check() -> None:
        try:
            control.check()
        except Stopped:
            ended.append("stopped")

    control.pause(True)
    control.step()
    control.step()
    control.check()
    control.check()
    for resume in (lambda: control.pause(False), control.stop):
        waiting = threading.Thread(target=check)
        waiting.start()
        waiting.join(0.05)
        assert waiting.is_alive()
        resume()
        waiting.join(PATIENCE_S)
        assert not waiting.is_alive()
        # Steps that were left do not count after another pause.
        control.step()
        control.pause(True)
    assert ended == ["stopped"]


def test_a_job_that_is_stopped_just_before_it_returns_changes_nothing(viewer: Controller) -> None:
    began, release, jobs = threading.Event(), threading.Event(), []

    def late(control: Control) -> Any:
        began.set()
        release.wait(PATIENCE_S)
        viewer.update_from_job(control, gizmo="object", what="late")
        return lambda state: state.evolve(gizmo="hand")

    assert viewer.run_job("export", "late", late) and began.wait(PATIENCE_S)
    viewer.stop()
    assert viewer.state.job is None
    assert viewer.run_job("export", "next", lambda control: jobs.append(viewer.state.job))
    release.set()
    until(lambda: jobs)
    settled(viewer)
    assert viewer.state.gizmo == "none"
    assert jobs[0] is not None and jobs[0].what == "next", "the end of the first job is not that of the next one"


def test_a_job_that_breaks_is_reported_and_the_next_one_runs(
    viewer: Controller, capsys: pytest.CaptureFixture[str]
) -> None:
    def work(control: Control) -> None:
        raise RuntimeError("broken")

    viewer.run_job("export", "breaking", work)
    settled(viewer)
    assert viewer.state.notice.bad
    assert_names(viewer.state.notice.text, "RuntimeError", "broken")
    assert "Traceback" in capsys.readouterr().err
    assert viewer.run_job("export", "next", lambda control: lambda state: state.evolve(gizmo="hand"))
    settled(viewer)
    assert viewer.state.gizmo == "hand"


def test_only_one_job_runs_at_a_time_but_measuring_gives_way(viewer: Controller) -> None:
    def wait(control: Control) -> None:
        control.pause(True)
        control.check()

    assert viewer.run_job("export", "waiting", wait)
    viewer.refinement.start()
    assert viewer.state.job.kind == "export"
    viewer.stop()
    assert viewer.run_job("measure", "waiting", wait)
    assert viewer.run_job("export", "next", lambda control: None) and viewer.state.job.kind == "export"
    settled(viewer)
