"""Jobs are paused, taken step by step, and stopped at once."""

import threading
import time

import pytest

from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from running_processes import PATIENCE_S, soon


def nothing(share: float | None, what: str) -> None:
    pass


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


def test_a_paused_job_waits_goes_step_by_step_and_goes_on() -> None:
    control, passed = Control(nothing), []
    control.pause(True)

    def job() -> None:
        for k in range(5):
            control.check()
            passed.append(k)

    thread = threading.Thread(target=job)
    thread.start()
    time.sleep(0.05)
    assert passed == []
    control.step()
    assert soon(lambda: passed)
    time.sleep(0.05)
    assert passed == [0]
    control.step()
    control.step()
    assert soon(lambda: len(passed) == 3)
    time.sleep(0.05)
    assert passed == [0, 1, 2]
    control.pause(False)
    thread.join(PATIENCE_S)
    assert passed == [0, 1, 2, 3, 4]


def test_a_paused_job_can_be_stopped() -> None:
    control, ended = Control(nothing), threading.Event()
    control.pause(True)

    def job() -> None:
        with pytest.raises(Stopped):
            control.check()
        ended.set()

    threading.Thread(target=job).start()
    control.stop()
    assert ended.wait(PATIENCE_S)
