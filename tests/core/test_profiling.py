"""The stopwatch: every second counts once, for the innermost stage, in errors and threads too."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from command_line import subprocess_environment
from grasp_refine.collision.engine import engines
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core import profiling as module
from grasp_refine.core.profiling import STAGES, Stopwatch, count_queries, cpu_seconds, stage
from grasp_refine.core.se3 import exp_se3
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.cli import main
from shapes_for_tests import cluster_body, ring_body


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """CPU and wall seconds that pass only when they are told to."""
    now = SimpleNamespace(cpu=5.0, wall=100.0)
    monkeypatch.setattr(module, "_now", lambda: (now.cpu, now.wall))
    return now


def passes(clock: SimpleNamespace, seconds: float) -> None:
    """CPU time passes, and twice as much on the clock."""
    clock.cpu += seconds
    clock.wall += 2.0 * seconds


def cpu(watch: Stopwatch) -> dict[str, float]:
    """The stages that took CPU time."""
    return {name: one.cpu_s for name, one in watch.spent.items() if one.cpu_s}


# The stopwatch itself


def test_an_inner_stage_counts_for_itself_only(clock: SimpleNamespace):
    passes(clock, 1000.0)
    with Stopwatch() as watch:
        passes(clock, 1.0)
        with stage("solver"):
            passes(clock, 2.0)
            for _ in range(2):
                with stage("broad phase"):
                    passes(clock, 4.0)
                    with stage("narrow phase"):
                        passes(clock, 8.0)
            with stage("derivative"), stage("narrow phase"):
                passes(clock, 16.0)
            passes(clock, 32.0)
        passes(clock, 64.0)
    passes(clock, 1000.0)
    assert cpu(watch) == {"other": 65.0, "solver": 34.0, "broad phase": 8.0, "narrow phase": 32.0}
    assert {name: one.calls for name, one in watch.spent.items() if one.calls} == {
        "solver": 1, "broad phase": 2, "narrow phase": 3, "derivative": 1,
    }  # fmt: skip
    assert all(one.wall_s == 2.0 * one.cpu_s for one in watch.spent.values())
    assert (watch.cpu_s, watch.wall_s) == (139.0, 278.0)
    assert watch.profile["narrow phase"] == [32.0, 64.0, 3]
    assert tuple(watch.profile) == STAGES


def test_a_function_is_a_stage_and_keeps_its_name_and_result(clock: SimpleNamespace):
    @stage("forces")
    def twice(number: int, *, plus: int = 0) -> int:
        """Says what it does."""
        passes(clock, 1.0)
        return 2 * number + plus if number > 1 else twice(number + 1)

    assert (twice.__name__, twice.__doc__) == ("twice", "Says what it does.")
    assert twice(3, plus=1) == 7
    with Stopwatch() as watch:
        assert twice(1) == 4
    assert (cpu(watch), watch.spent["forces"].calls) == ({"forces": 2.0}, 2)


def test_an_error_ends_its_stages(clock: SimpleNamespace):
    @stage("derivative")
    def breaks() -> None:
        passes(clock, 1.0)
        raise ValueError("broken")

    with Stopwatch() as watch, stage("solver"):
        with pytest.raises(ValueError, match="broken"), stage("broad phase"):
            passes(clock, 2.0)
            breaks()
        passes(clock, 4.0)
    assert cpu(watch) == {"derivative": 1.0, "broad phase": 2.0, "solver": 4.0}
    with pytest.raises(ValueError, match="broken"), watch, stage("solver"):
        breaks()
    passes(clock, 1000.0)
    assert cpu(watch) == {"derivative": 2.0, "broad phase": 2.0, "solver": 4.0}
    with stage("solver"):
        passes(clock, 1000.0)
    assert watch.cpu_s == 8.0


def test_a_stage_may_end_after_the_stopwatch_stopped(clock: SimpleNamespace):
    watch, late = Stopwatch(), stage("solver")
    with watch:
        late.__enter__()
        passes(clock, 1.0)
    passes(clock, 1000.0)
    late.__exit__(None, None, None)
    assert cpu(watch) == {"solver": 1.0}
    with watch:
        passes(clock, 2.0)
        # Nor does it end what began later.
        late.__exit__(None, None, None)
        passes(clock, 4.0)
    assert cpu(watch) == {"solver": 1.0, "other": 6.0}


def test_one_that_runs_does_not_begin_again(clock: SimpleNamespace):
    with Stopwatch() as watch, pytest.raises(AssertionError), watch:
        pass
    with watch:
        passes(clock, 1.0)
    assert cpu(watch) == {"other": 1.0}


def test_of_two_that_run_the_inner_one_has_the_stages(clock: SimpleNamespace):
    with Stopwatch() as outer, stage("measuring"):
        passes(clock, 1.0)
        with Stopwatch() as inner, stage("solver"):
            passes(clock, 2.0)
            count_queries(7)
        with stage("forces"):
            passes(clock, 4.0)
    assert (cpu(inner), inner.queries) == ({"solver": 2.0}, 7)
    # What happened meanwhile was measuring, to the outer one.
    assert (cpu(outer), outer.queries) == ({"measuring": 3.0, "forces": 4.0}, 0)


def test_another_thread_has_none(clock: SimpleNamespace):
    def work() -> None:
        with stage("simulating"):
            passes(clock, 1.0)
        with Stopwatch() as own, stage("forces"):
            passes(clock, 2.0)
        found.append(own)

    found: list[Stopwatch] = []
    with Stopwatch() as watch, stage("solver"):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    # Its time is time of the process.
    assert (cpu(watch), cpu(found[0])) == ({"solver": 3.0}, {"forces": 2.0})


def test_it_counts_the_cpu_time_of_threads_and_of_children_that_ended():
    code = "import time\nend = time.process_time() + 0.3\nwhile time.process_time() < end: pass"
    before = cpu_seconds()
    with Stopwatch() as watch:
        with stage("loading"):
            subprocess.run([sys.executable, "-c", code], check=True)
        with stage("measuring"):
            time.sleep(0.2)
    assert watch.spent["loading"].cpu_s > 0.29
    assert cpu_seconds() - before > 0.29
    assert watch.spent["measuring"].cpu_s < 0.1 <= watch.spent["measuring"].wall_s


def test_without_one_a_stage_costs_next_to_nothing():
    code = """
import time, timeit
from grasp_refine.core.profiling import stage
def alone(): pass
def best(call): return min(timeit.repeat(call, number=20000, repeat=7, timer=time.process_time)) / 20000
print(best(stage("solver")(alone)) - best(alone))
"""
    # Not here, where annotations may be checked at each call.
    environment = subprocess_environment()
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    # An iteration of a refinement takes milliseconds, and some twenty stages.
    assert float(said.stdout) < 2e-6


# What it measures in the package


@pytest.mark.parametrize("engine", engines())
def test_queries_are_counted_and_the_narrow_phase_has_its_own_time(engine: str):
    pairs = Pairs((ring_body(), cluster_body(3, 4)), (cluster_body(5, 4), ring_body()), engine=engine)
    T_a, T_b = exp_se3(np.random.default_rng(0).normal(size=(2, 6, 2, 6)) * ([0.05] * 3 + [1.0] * 3))
    with Stopwatch() as watch:
        found = query(pairs, T_a, T_b)
    assert watch.queries == found.num_queries.sum() > 0
    used = {name for name, one in watch.spent.items() if one.calls}
    assert used == {"loading", "narrow phase"}


def allegro(count: int = 3) -> Scene:
    """Hands around a box."""
    hand, box = load_hand("allegro"), load_object("rounded_box")
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, 3] = [[0.0, 0.0, -0.12 - 0.01 * i] for i in range(count)]
    return Scene(hand, box, T, np.tile(hand.rest, (count, 1)))


@pytest.mark.parametrize(
    ("config", "without"),
    [
        (Config(starts=1, contact_selection=ContactSelection(reach=0.1)), set()),
        (Config(solver=Adam(iterations=5), contact_selection=ContactSelection(reach=0.1)), {"forces"}),
    ],
    ids=["levenberg-marquardt", "adam"],
)
def test_the_stages_of_a_refinement_sum_to_its_time_and_change_nothing(config: Config, without: set[str]):
    torch.set_num_threads(1)
    scene = allegro()
    plain = refine(scene, config)
    scene = allegro()  # what is built for the first one is kept
    watch, start = Stopwatch(), time.process_time()
    with watch:
        found = refine(scene, config)
    whole = time.process_time() - start
    np.testing.assert_array_equal(found.q, plain.q)
    np.testing.assert_array_equal(found.T_world_root, plain.T_world_root)
    used = {name for name, one in watch.spent.items() if one.calls}
    inside = {"loading", "kinematics", "broad phase", "narrow phase", "derivative", "solver", "forces"}
    # The compiled engine does both phases in one call; Levenberg-Marquardt has bounds of its own before it.
    assert used | {"broad phase"} == inside - without
    assert watch.cpu_s == pytest.approx(whole, rel=0.03, abs=2e-3)
    assert watch.spent["other"].cpu_s < 0.1 * whole


# What people see


@pytest.mark.slow
@pytest.mark.usefixtures("workplace")
def test_run_reports_where_its_time_went(capfd: pytest.CaptureFixture[str]):
    quick = ("run", "--object", "rounded_box", "--iterations", "5", "--starts", "1", "--json", "run.json")
    assert main([*quick, "--index", "0"]) == 0
    assert "narrow phase" not in capfd.readouterr().out
    assert json.loads(Path("run.json").read_text())["profile"] is None
    assert main([*quick, "--profile", "--validate", "--overwrite"]) == 0
    out = capfd.readouterr().out
    assert "narrow phase" in out and "  simulating " in out
    document = json.loads(Path("run.json").read_text())
    profile, totals = document["profile"], document["totals"]
    assert tuple(profile) == STAGES and all(set(one) == {"cpu_s", "wall_s", "calls"} for one in profile.values())
    assert min(one["cpu_s"] for name, one in profile.items()) > 0.0
    # What is left out is the beginning of the command, which takes longer on a busy machine.
    assert 0.5 * totals["wall_s"] < sum(one["wall_s"] for one in profile.values()) <= totals["wall_s"]
    assert sum(one["cpu_s"] for one in profile.values()) == pytest.approx(totals["cpu_s"], rel=0.1, abs=0.1)
