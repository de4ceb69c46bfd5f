"""The numbers and names that simulation told of a grasp, in a line and as HTML."""

import re
from dataclasses import replace
from math import nan, radians

import pytest

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import AXES, Protocol
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.model.validated import DirectionResult, TrialResult
from grasp_refine_apps.viewer.panels.validate_panel import motion_html, notes_html, trial_html  # noqa: E402
from refusals import assert_names

OWN = {"pregrasp": "own", "squeeze": "own"}


def result(
    direction: str, reason: Reason, mm: float = 2.0, degrees: float = 1.0, *, at: float = nan
) -> DirectionResult:
    angle = radians(degrees)
    return DirectionResult(direction, reason, at, mm / 1e3, angle, mm / 1e3, angle, ("tip", "thumb", "palm", "ring"))


def trial(*reasons: DirectionResult, protocol: Protocol = DEXGRASPBENCH, **known: float) -> TrialResult:
    """Those directions as said, the others held."""
    said = {one.direction: one for one in reasons}
    names = protocol.directions or ("lift",)
    all_of_them = tuple(said.get(name) or result(name, Reason.HELD) for name in names)
    numbers = {"closing_m": 0.001, "closing_rad": 0.01, "penetration_m": 0.0, **known}
    return TrialResult(protocol, all_of_them, OWN, **numbers)


def everywhere(reason: Reason, **known: float) -> TrialResult:
    return trial(*(replace(result(name, reason, nan, nan), links=()) for name in AXES), **known)


@pytest.mark.parametrize(
    ("one", "named"),
    [
        (result("+x", Reason.HELD, 1.57, 2.86), ("1.6 mm", "2.9°")),
        (result("+x", Reason.MOVED, 61.0, 4.0, at=0.4), ("61.0 mm", "0.4 s", "4 links")),
        (result("+x", Reason.ROTATED, 9.0, 15.2, at=0.2), ("15.2°", "0.2 s", "4 links")),
        (replace(result("+x", Reason.MOVED, 61.0, at=0.4), links=("palm",)), ("61.0 mm", "0.4 s", "1 link ")),
        (replace(result("+x", Reason.MOVED, 61.0, at=0.4), links=()), ("61.0 mm", "0.4 s", "no link")),
        (result("+x", Reason.UNSTABLE, at=0.6), ("unstable", "0.6 s")),
        (result("+x", Reason.NOT_FINITE), ("NaN", "1e6 m")),
        (result("+x", Reason.IN_TABLE), ("10 mm", "table")),
    ],
)
def test_every_end_names_its_numbers(one: DirectionResult, named: tuple[str, ...]) -> None:
    assert_names(trial(one).words(one), *named)


HOLDS, FAILS = "Holds", "Does not hold"


def test_the_verdict_is_one_line() -> None:
    assert trial().held
    assert_names(trial().verdict, HOLDS, "6")
    lost = trial(result("+x", Reason.ROTATED, at=0.2), result("-z", Reason.MOVED, at=0.4))
    assert not lost.held and lost.before_push is None
    assert_names(lost.verdict, FAILS, "2 of 6", "+x, -z")
    barely = trial(result("+y", Reason.HELD, 28.7, 7.0))
    assert barely.held and barely.barely and not trial(result("+y", Reason.HELD, 24.9, 7.4)).barely
    # Either half of the way counts, but only of directions that held.
    assert trial(result("+y", Reason.HELD, 25.1)).barely and trial(result("+y", Reason.HELD, 2.0, 7.6)).barely
    five = replace(DEXGRASPBENCH, required_share=5 / 6)
    enough = trial(result("+x", Reason.ROTATED, 9.0, 15.2, at=0.2), protocol=five)
    assert enough.held and not enough.barely
    assert_names(enough.verdict, HOLDS, "5 directions", "1 of 6", "(+x)")
    two = trial(*(result(name, Reason.MOVED, 61.0, at=0.4) for name in ("+x", "-z")), protocol=five)
    assert not two.held
    assert_names(two.verdict, FAILS, "2 of 6", "+x, -z")
    assert_names(barely.verdict, HOLDS, "6", "29 mm", "7°")
    lifted = trial(protocol=TABLETOP)
    assert_names(lifted.verdict, HOLDS, "10 cm")
    dropped = trial(result("lift", Reason.MOVED, 55.0, at=1.0), protocol=TABLETOP)
    assert_names(dropped.verdict, FAILS, "55.0 mm", "1.0 s", "4 links")
    broken = trial(result("lift", Reason.UNSTABLE, at=1.0), protocol=TABLETOP)
    assert_names(broken.verdict, FAILS, "unstable", "1.0 s")


def test_what_ends_before_the_push_is_reported_once() -> None:
    ejected = everywhere(Reason.EJECTED_WHILE_CLOSING, closing_m=0.089, closing_rad=radians(31))
    assert ejected.before_push == Reason.EJECTED_WHILE_CLOSING and ejected.watchable
    assert_names(ejected.verdict, FAILS, "89 mm", "31°")
    assert "<table>" not in trial_html(ejected)
    deep = everywhere(Reason.PENETRATES, penetration_m=0.0122)
    assert not deep.watchable
    assert_names(deep.verdict, FAILS, "12.2 mm", "10 mm")
    unknown = replace(deep, penetration_m=nan)
    assert_names(unknown.verdict, FAILS, "10 mm")
    assert "nan" not in unknown.verdict
    # A push that diverges at its first check is no end before it.
    assert trial(*(result(name, Reason.UNSTABLE, at=0.2) for name in AXES)).before_push is None


def test_how_it_was_tested_is_reported() -> None:
    assert_names(trial().conditions, "dexgraspbench", "friction 0.6", "100 g", "1 N", "2 s")
    assert_names(trial(protocol=TABLETOP).conditions, "tabletop", "friction 0.6", "100 g", "10 cm", "2 s")
    for closing in ({"pregrasp": "own", "squeeze": "file"}, {"pregrasp": "file", "squeeze": "own"}):
        mixed = replace(trial(), closing=closing).closed_by
        # Each stage comes before its source.
        places = [mixed.index(word) for pair in closing.items() for word in pair]
        assert places == sorted(places)
    assert replace(trial(), closing={}).closed_by == "" and "file" not in trial().closed_by
    notes = notes_html(trial())
    assert "50 mm" in notes and "15°" in notes and "squeeze" in notes


def test_the_table_has_a_row_for_each_direction() -> None:
    page = trial_html(trial(result("+x", Reason.ROTATED, 9.0, 15.2, at=0.2)))
    assert page.count("<tr ") == 6 and page.count("✓ held") == 5
    assert "✗ rotated, 0.2 s</td><td>9.0 mm</td><td>15.2°</td><td>4</td>" in page
    (title,) = (found for found in re.findall(r'<tr title="([^"]*)"', page) if "15.2°" in found)
    assert_names(title, "0.2 s", "4 links")
    assert "gr-no" in page.split("</style>")[1] and "gr-yes" in trial_html(trial()).split("</style>")[1]
    assert "gr-unsure" in trial_html(trial(result("+y", Reason.HELD, 40.0))).split("</style>")[1]
    unknown = trial(replace(result("+x", Reason.UNSTABLE, nan, nan, at=0.2), links=()))
    assert "<td>–</td><td>–</td><td>0</td>" in trial_html(unknown)


def test_text_cannot_become_html() -> None:
    assert "<b>" not in motion_html("<b>", lost=True) and "&lt;b&gt;" in motion_html("<b>", lost=True)
