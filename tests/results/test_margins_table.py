"""Tables and documents of margins: the numbers of each grasp, of the set, and of what changed."""

import json
import re

import numpy as np
import pytest

from grasp_refine.core.json_files import dumps
from grasp_refine.results.console import text_of
from grasp_refine.results.margins_document import margins_entry, margins_row, margins_totals
from grasp_refine.results.margins_table import LIMITS, margins_comparison, margins_table
from grasp_refine.validation.margins.draws import draw
from grasp_refine.validation.margins.factors import Factors
from grasp_refine.validation.margins.intervals import difference_interval, wilson
from made_results import made_margins

OBJECTS, INDEX = np.array(["mug", "mug", "bowl"]), np.array([4, 7, 0])


def cells(text: str, first: str) -> list[str]:
    """The words of the line that begins with a word."""
    (line,) = [line for line in text.splitlines() if line.split()[:1] == [first]]
    return line.split()


def test_each_grasp_has_its_probability_worst_factor_and_limits() -> None:
    text = text_of(margins_table(made_margins(), OBJECTS, INDEX, "claw"))
    assert "claw on mug: 2 grasps" in text and "claw on bowl: 1 grasp" in text
    low, high = wilson(np.array([2, 6]), 8)
    assert cells(text, "4")[:6] == ["4", "0.25", f"{low[0]:.2f}", f"{high[0]:.2f}", "friction", "0.50"]
    assert " ".join(cells(text, "4")[6:]) == "none < 0.5 < 0.02"
    assert cells(text, "7")[4:] == ["mass", "0.25", "0.4", "2", "0.1"]
    # What every factor leaves as it is has no worst one.
    assert cells(text, "0")[4:] == ["-", "-", "0.1", "5", "0.3"]


def test_each_factor_has_its_mean_its_cost_and_the_grasps_that_it_costs_most() -> None:
    text = text_of(margins_table(made_margins(), OBJECTS, INDEX, "claw"))
    assert cells(text, "friction")[1] == f"{10 / 12:.3f}"
    assert cells(text, "friction")[4] == f"{1 / 12:.3f}" and cells(text, "friction")[7] == "1"
    assert cells(text, "mass")[4] == f"{3 / 12:.3f}" and cells(text, "mass")[7] == "1"
    assert cells(text, "push")[4] == "0"
    assert re.search(r"lowest friction: 0\.4 / none", text) and re.search(r"largest force, N: 2 / < 0\.5", text)


def test_before_and_after_are_compared_in_the_same_draws() -> None:
    before, after = made_margins(), made_margins(better=1)
    text = text_of(margins_comparison(before, after, "claw"))
    change, low, high = difference_interval(before.held["all"], after.held["all"])
    assert change == pytest.approx(2 / 24)
    assert cells(text, "all") == [
        "all", f"{16 / 24:.3f}", f"{18 / 24:.3f}", f"{change:+.3f}", f"{low:+.3f}", f"{high:+.3f}", "2", "0"
    ]  # fmt: skip
    assert cells(text_of(margins_comparison(after, before, "claw")), "all")[-2:] == ["0", "2"]


def test_documents_and_rows_have_all_of_it() -> None:
    before, after, draws = made_margins(), made_margins(better=1), draw(Factors(), 8)
    totals = json.loads(dumps(margins_totals([before, after], Factors(), draws)))
    assert totals["files"][0]["mass"]["probability"] == pytest.approx(8 / 12)
    assert totals["files"][0]["mass"]["cost"]["probability"] == pytest.approx(3 / 12)
    assert totals["change"]["all"]["change"] == pytest.approx(2 / 24)
    assert totals["ranges"]["mass"] == [0.02, 0.5] and len(totals["draws"]["direction"]) == 8
    assert totals["cpu_s"] == 12.0
    entry = json.loads(dumps(margins_entry(before, 0)))
    assert entry["trials"]["all"]["held"] == [True, True, *[False] * 6] and entry["worst"] == "friction"
    assert entry["lowest_friction"] is None and entry["largest_force_n"] == 0.0
    row = margins_row(before, 1)
    assert row["margins_all"] == 0.75 and row["margins_worst"] == "mass" and row["margins_largest_torque_nm"] == 0.1
    interval = [float(value) for value in wilson(np.asarray(6), 8)]
    assert [row["margins_all_low"], row["margins_all_high"]] == pytest.approx(interval)
    assert margins_row(before, 2)["margins_worst"] is None


def test_values_at_the_ends_of_the_searched_range_are_bounds() -> None:
    friction, force, _ = LIMITS
    low, high = force.range
    assert force.text(high * 0.99) == f"> {high * 0.99:.2g}" and force.text(high / 2) == f"{high / 2:.2g}"
    assert force.text(0.0) == f"< {low:.2g}" and friction.text(np.inf) == "none"
    assert friction.text(friction.range[0] * 1.01).startswith("< ")
