"""Progress of a refinement: a bar in a terminal, single lines elsewhere."""

import io
import re
from dataclasses import replace

import numpy as np
from rich.console import Console

from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Group
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.report.progress import Reporter
from refusals import assert_names


def grasps_on(name: str, count: int) -> Group:
    """So many grasps on an object, of which only the number matters."""
    (group,) = load_problem(ProblemSpec(object="rounded_box")).groups
    return replace(group, object=name, rows=np.arange(count))


def test_progress_is_single_lines_without_a_terminal():
    stream = io.StringIO()
    with Reporter(Console(file=stream, width=40)) as reporter:
        reporter.say("note: a line that is longer than the console is wide, kept in one piece")
        reporter.start("claw", 3, 100)
        progress = reporter.refining([grasps_on("mug", 3)])
        progress(0, 1, 1e-4)
        progress(3, 2, 0.0)
    note, line = stream.getvalue().splitlines()
    assert note == "note: a line that is longer than the console is wide, kept in one piece"
    assert_names(line, "3 grasps", "claw", "100 iterations")
    stream.truncate(0)
    with Reporter(Console(file=stream, width=40)) as reporter:
        reporter.wait("sampling")
        reporter.start("claw", 1, 100, starts=1)
    assert re.search(r"\b1 grasp\b.*\bclaw\b.*\b1 start\n$", stream.getvalue())


def test_progress_is_a_bar_in_a_terminal():
    stream = io.StringIO()
    with Reporter(Console(file=stream, width=100, force_terminal=True)) as reporter:
        reporter.start("claw", 4, 100)
        reporter.refining([grasps_on("mug", 2)])(2, 10, 1e-4)
        reporter.refining([grasps_on("can", 2)])(1, 20, 2.5e-5)
        reporter._bar.refresh()
    for named in ("can", "3/4", "iteration 20", "2.5e-05 m²"):
        assert named in stream.getvalue()


def test_the_bar_counts_good_grasps_where_they_are_made_to_hold():
    stream = io.StringIO()
    with Reporter(Console(file=stream, width=100, force_terminal=True)) as reporter:
        reporter.wait("sampling grasps of claw")
        reporter._bar.refresh()
        reporter.start("claw", 4, 100, starts=6)
        progress, done = reporter.refining([grasps_on("mug", 4)]), []
        for finished, iteration in ((0, 10), (1, 20), (1, 250), (3, 260)):
            progress(finished, iteration, 1e-4)
            done.append(reporter._bar.tasks[0].completed)
        reporter._bar.refresh()
    # The bar never goes back, and is never full before all are.
    assert done == sorted(done) and done[0] > 0 and done[-1] <= 4
    assert "sampling grasps of claw" in stream.getvalue() and "3/4 good" in stream.getvalue()
    assert "iteration 260" in stream.getvalue()
