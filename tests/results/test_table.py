"""Reports on made-up outcomes: what a person reads, and what programs read."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from grasp_refine.measures.change import Change
from grasp_refine.refinement.refine import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.results.changed import Changed
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.results.table import grasp_table
from grasp_refine.results.verdict import BAR, HOLDS, Agreement, should_hold
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.trials import Reason
from made_results import error_in_millimetres, made_trials, with_measures, with_status
from refusals import assert_names


def with_quality(outcome: Outcome, **grasps: float) -> Outcome:
    """The outcome with the quality of refined grasps changed, such as g3=0.5."""
    quality = outcome.quality.copy()
    for name, value in grasps.items():
        quality[int(name[1:]), 1] = value
    return with_measures(outcome, quality=quality)


def aimed(outcome: Outcome) -> Outcome:
    """The outcome, as if there had been targets."""
    outcome = replace(outcome, target_point_link=np.zeros_like(outcome.target_point_link))
    return with_measures(outcome, starts=np.ones_like(outcome["starts"]))


GEOMETRY = Config(weights=Weights(wrench=0.0))


def text(
    outcome: Outcome,
    config: Config | None = None,
    simulated: SimulatedGrasps | None = None,
    *,
    width: int = 80,
    verbose: bool = False,
) -> list[str]:
    stream = io.StringIO()
    table = grasp_table(outcome, "claw", config or Config(), simulated, verbose=verbose)
    Console(file=stream, width=width, emoji=False).print(table)
    return stream.getvalue().splitlines()


# The table


def test_the_table_speaks_millimetres_and_says_what_changed():
    lines = text(error_in_millimetres(3))
    assert_names(lines[0], "claw", "mug", "3 grasps")
    (row,) = [line for line in lines if line.split()[:1] == ["2"]]
    assert " ".join(row.split()) == "2 20.00 → 2.00 2.00 → 0.10 7.0 kept 0.400 → 0.970 should hold"
    (median,) = [line for line in lines if line.startswith("median")]
    assert " ".join(median.split()) == "median 10.00 → 1.00 2.00 → 0.10 7.0 0.400 → 0.970"
    lower = text(with_quality(error_in_millimetres(3), g1=0.5))
    (worst,) = [line for line in lower if line.split()[:1] == ["worst"]]
    assert " ".join(worst.split()) == "worst 20.00 → 2.00 2.00 → 0.10 7.0 0.400 → 0.500"
    for line, named in zip(
        lines[-8:],
        (
            (f"quality {BAR}", "0 → 3 of 3", "`validate`"),
            ("3 of 3", "touch with all contact links"),
            ("change: 3 kept",),
            ("wrench residual", "3 of 3", "mean 0.200 → 0.050"),
            ("contact error", "2 of 2", "mean 10.000 → 1.000 mm"),
            ("penetration", "3 of 3", "mean 2.000 → 0.100 mm"),
            ("self-penetration", "3 of 3", "mean 1.000 → 0.000 mm"),
            ("2 / 2 starts", "123 / 123 iterations", "0.25 s / 0.25 s"),
        ),
        strict=True,
    ):
        assert_names(line, *named)


def test_what_the_verdict_is_depends_on_what_was_wanted():
    """Where grasps should hold it is by quality, with targets as well; by geometry alone it is how they ended."""
    outcome = with_status(with_quality(error_in_millimetres(3), g1=0.8), g1=Status.STALLED, g2=Status.STALLED)
    last = {
        name: [" ".join(line.split()[-2:]) for line in lines if "→" in line and line.split()[0] in "012"]
        for name, lines in (
            ("holds", text(outcome)),
            ("geometry", text(outcome, GEOMETRY)),
            ("targets", text(aimed(outcome))),
        )
    }
    assert last["holds"] == last["targets"] == ["should hold", "may slip", "should hold"]
    assert last["geometry"] == ["0.970 converged", "0.800 stalled", "0.970 stalled"]
    assert any(line.startswith(f"quality {BAR}") and "0 → 2 of 3" in line for line in text(outcome, GEOMETRY))
    assert_names(text(aimed(outcome))[-1], "123 / 123 iterations", "0.25 s / 0.25 s")
    assert "starts" not in text(aimed(outcome))[-1]


def test_a_quality_that_is_not_known_is_not_good():
    good = should_hold(np.array([np.nan, 0.0, HOLDS, 1.0, HOLDS - 1e-9]))
    assert good.tolist() == [False, False, True, True, False]


def counts(line: str) -> list[int]:
    """The numbers of a line after its title."""
    return [int(number) for number in re.findall(r"\d+", line.rpartition(": ")[2])]


def test_quality_is_reported_against_simulation():
    good, held = np.array([True, True, False, False, False]), np.array([True, False, True, True, False])
    agreement = Agreement.of(good, held)
    assert agreement == Agreement(good=2, good_held=1, others=3, others_held=2)
    assert agreement + Agreement.of(good[:2], held[:2]) == Agreement(4, 2, 3, 2)
    assert counts(agreement.line().plain) == [2, 5, 1, 2, 3], "of 5, 2 are good, 1 failed; 2 of 3 others held"
    assert counts(Agreement.of(good[2:], held[2:]).line().plain) == [0, 3, 2, 3]


def simulated(*pairs: tuple[bool, bool]) -> SimulatedGrasps:
    """What simulation says of grasps that held or not, before and after."""

    before, after = np.where(np.array(pairs).T, Reason.HELD, Reason.MOVED)
    return SimulatedGrasps(
        Protocol(),
        {"mujoco": made_trials(before[:, None])},
        {"pregrasp": "own", "squeeze": "own"},
        {"mujoco": made_trials(after[:, None])},
    )


def test_where_grasps_were_simulated_this_is_reported_first_and_before_as_well_as_after():
    outcome = with_quality(error_in_millimetres(4), g3=0.5)
    proof = simulated((True, True), (False, True), (True, False), (False, False))
    lines = text(outcome, simulated=proof, width=120)
    rows = [line for line in lines if "→" in line and line.split()[0] in "0123"]
    assert [line.split()[-3:] for line in rows] == [
        ["yes", "→", "yes"], ["no", "→", "yes"], ["yes", "→", "no"], ["no", "→", "no"]
    ]  # fmt: skip
    verdict = lines[lines.index("", 3) + 1 :]
    assert_names(verdict[0], "(dexgraspbench)", "2 → 2 of 4", "gained 1", "lost 1")
    assert verdict[2].startswith("before") and counts(verdict[2]) == [0, 4, 2, 4]
    assert verdict[3].startswith("after") and counts(verdict[3]) == [3, 4, 1]
    assert_names(verdict[4], "1 ", "(3)", "`starts`")
    assert max(map(len, text(outcome, simulated=proof))) <= 80


def test_the_worst_of_many_did_not_hold():
    outcome = with_quality(error_in_millimetres(41), g5=0.5)
    lines = text(outcome, simulated=simulated(*((True, i != 30) for i in range(41))))
    shown = [line.split()[0] for line in lines if "→" in line and line.split()[0].isdigit()]
    assert shown[:2] == ["30", "5"]


@pytest.mark.parametrize("width", [80, 100])
def test_the_table_loses_nothing_at_80_columns(width: int):
    outcome = with_status(error_in_millimetres(5), g0=Status.NOT_FINITE, g1=Status.NO_TARGET)
    outcome = with_measures(
        outcome,
        contact_error_m=outcome["contact_error_m"] * 40,
        penetration_m=outcome["penetration_m"] * 50,
        displacement_m=np.full(5, 0.1234),
    )
    outcome = replace(outcome, change=np.full(5, Change.MOVED.value))
    lines = text(outcome, width=width)
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)
    assert any("1600 → 160.0" in line for line in lines)


def test_good_inputs_that_moved_are_counted():
    """From the confidence on, farther than 5 mm, of grasps that were refined."""
    outcome = error_in_millimetres(7)
    quality = np.stack([np.array([0.94, 0.95, 0.96, 1.0, 0.99, 1.0, np.nan]), np.full(7, 0.97)], axis=1)
    displacement = 1e-3 * np.array([90.0, 2.0, 5.0, 5.4, 8.0, 90.0, 90.0])
    change = np.array(["kept", "kept", "contacts moved", "other links", "kept", "", "other grasp"])
    outcome = replace(with_measures(outcome, quality=quality, displacement_m=displacement), change=change)
    changed = Changed.of(outcome, Config(confidence=0.95).confidence)
    assert (changed.good, changed.moved, changed.median_m) == (4, 2, pytest.approx(5.2e-3))
    lines = text(outcome, width=120)
    at = lines.index("change: 3 kept, 1 contacts moved, 1 other links, 1 other grasp")
    assert_names(lines[at + 1], "4 input grasps", "0.95", "2 moved by over 5 mm", "median 5.2 mm")
    off = outcome["contact_error_m"][3:5, 0]
    assert changed.error_m == pytest.approx(np.median(off)) and f"{1e3 * np.median(off):.1f} mm" in lines[at + 1]
    assert_names(text(outcome, Config(confidence=0.97))[at + 1], "2 input grasps", "0.97", "2 moved")
    assert Changed.of(outcome, 0.999).good == 1
    assert [line for line in text(error_in_millimetres(2)) if "input grasp" in line] == []


def test_of_many_grasps_the_worst_are_listed():
    outcome = with_status(error_in_millimetres(41), g7=Status.NO_TARGET)

    def listed(outcome: Outcome, config: Config) -> list[str]:
        words = [line.split() for line in text(outcome, config) if "→" in line]
        return [first for first, *_ in words if first.isdigit()]

    assert listed(outcome, GEOMETRY) == ["7", *(str(i) for i in range(40, 31, -1))]
    # Made to hold, the worst are those that are likeliest to slip.
    outcome = with_quality(outcome, **{f"g{i}": 0.5 + 0.01 * i for i in range(10, 25)})
    assert listed(outcome, Config()) == ["7", *(str(i) for i in range(10, 19))]
    assert_names(text(outcome)[0], "41 grasps", "10", "`verbose`")
    for lines, count in ((text(outcome, verbose=True), 41), (text(error_in_millimetres(40)), 40)):
        assert sum("→" in line and line.split()[0].isdigit() for line in lines) == count
