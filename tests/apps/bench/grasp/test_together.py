"""Works in processes of their own: they begin together, and one that fails ends all."""

from __future__ import annotations

import multiprocessing
import os
from functools import partial

import pytest

from begun_together import dies_early, fails, waits
from grasp_refine_apps.bench.grasp.together import run_together
from refusals import refused


def test_all_begin_when_the_last_one_is_ready():
    found = run_together([partial(waits, seconds) for seconds in (0.0, 0.3)])
    processes, ready, began = zip(*found, strict=True)
    assert len({os.getpid(), *processes}) == 3
    assert min(began) >= max(ready)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(("bad", "named"), [(fails, "no luck"), (dies_early, "exit code 7")])
def test_one_that_fails_ends_all(bad: object, named: str):
    with refused(RuntimeError, named):
        run_together([partial(waits, 0.0), bad])
    assert not multiprocessing.active_children()
