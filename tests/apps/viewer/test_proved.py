"""What simulation said of a grasp, in words and as HTML."""

from __future__ import annotations

from dataclasses import replace
from math import nan, radians

import pytest
from grasp_refine.apps.viewer.proved import Proved, Tried
from grasp_refine.apps.viewer.proved_html import motion_html, notes_html, proved_html

from grasp_refine.validation.protocol import AXES, FORCE_CLOSURE, TABLETOP, Protocol
from grasp_refine.validation.trials import Reason

OWN = {"pregrasp": "own", "squeeze": "own"}


def tried(direction: str, reason: Reason, mm: float = 2.0, degrees: float = 1.0, *, at: float = nan) -> Tried:
    angle = radians(degrees)
    return Tried(direction, reason, at, mm / 1e3, angle, mm / 1e3, angle, ("tip", "thumb", "palm", "ring"))


def proved(*reasons: Tried, protocol: Protocol = FORCE_CLOSURE, **known: float) -> Proved:
    """Those directions as said, the others held."""
    said = {one.direction: one for one in reasons}
    names = protocol.directions or ("lift",)
    all_of_them = tuple(said.get(name) or tried(name, Reason.HELD) for name in names)
    numbers = {"closing_m": 0.001, "closing_rad": 0.01, "penetration_m": 0.0, **known}
    return Proved(protocol, all_of_them, OWN, **numbers)


def everywhere(reason: Reason, **known: float) -> Proved:
    return proved(*(replace(tried(name, reason, nan, nan), links=()) for name in AXES), **known)


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (tried("+x", Reason.HELD, 1.57, 2.86), "stayed: moved by 1.6 mm, turned by 2.9°"),
        (tried("+x", Reason.MOVED, 61.0, 4.0, at=0.4), "moved by 61.0 mm after 0.4 s, 4 links still touched it"),
        (tried("+x", Reason.TURNED, 9.0, 15.2, at=0.2), "turned by 15.2° after 0.2 s, 4 links still touched it"),
        (
            replace(tried("+x", Reason.MOVED, 61.0, at=0.4), links=("palm",)),
            "moved by 61.0 mm after 0.4 s, 1 link still touched it",
        ),
        (
            replace(tried("+x", Reason.MOVED, 61.0, at=0.4), links=()),
            "moved by 61.0 mm after 0.4 s, no link touched it",
        ),
        (tried("+x", Reason.UNSTABLE, at=0.6), "the simulation became unstable after 0.6 s"),
        (
            tried("+x", Reason.NOT_FINITE),
            "the grasp holds NaN or infinite numbers, or is nowhere: its pose is no rigid motion, or beyond 1e6 m or "
            "rad",
        ),
        (tried("+x", Reason.IN_TABLE), "the hand is deeper than 10 mm in the table at the pregrasp"),
    ],
)
def test_every_end_has_its_words(one: Tried, words: str) -> None:
    assert proved(one).words(one) == words


def test_the_verdict_is_one_line() -> None:
    assert proved().held and proved().verdict == "Holds: the object stayed in all 6 directions"
    lost = proved(tried("+x", Reason.TURNED, at=0.2), tried("-z", Reason.MOVED, at=0.4))
    assert not lost.held and lost.before_push is None
    assert lost.verdict == "Does not hold: the object was lost in 2 of 6 directions (+x, -z)"
    barely = proved(tried("+y", Reason.HELD, 28.7, 7.0))
    assert barely.held and barely.barely and not proved(tried("+y", Reason.HELD, 24.9, 7.4)).barely
    assert barely.verdict == (
        "Holds: the object stayed in all 6 directions, but barely: it moved 29 mm and turned 7° at most"
    )
    lifted = proved(protocol=TABLETOP)
    assert lifted.verdict == "Holds: the object stayed in the hand while it was lifted by 10 cm"
    dropped = proved(tried("lift", Reason.MOVED, 55.0, at=1.0), protocol=TABLETOP)
    assert dropped.verdict == (
        "Does not hold: while it was lifted, the object moved by 55.0 mm after 1.0 s, 4 links still touched it"
    )
    broken = proved(tried("lift", Reason.UNSTABLE, at=1.0), protocol=TABLETOP)
    assert broken.verdict == "Does not hold: the simulation became unstable after 1.0 s"


def test_what_ends_before_the_push_is_told_once() -> None:
    thrown = everywhere(Reason.THROWN, closing_m=0.089, closing_rad=radians(31))
    assert thrown.before_push == Reason.THROWN and thrown.watchable
    assert thrown.verdict == (
        "Does not hold: closing the hand moved the object by 89 mm and turned it by 31°, before any push"
    )
    assert "<table>" not in proved_html(thrown)
    deep = everywhere(Reason.PENETRATES, penetration_m=0.0122)
    assert not deep.watchable
    assert deep.verdict == (
        "Does not hold: hand and object overlap by 12.2 mm before the hand closes, which would throw the object "
        "(at most 10 mm)"
    )
    unknown = replace(deep, penetration_m=nan)
    assert unknown.verdict.startswith("Does not hold: hand and object are deeper than 10 mm in each other")
    # A push that diverges at its first check is no end before it.
    assert proved(*(tried(name, Reason.UNSTABLE, at=0.2) for name in AXES)).before_push is None


def test_how_it_was_tested_is_told() -> None:
    assert proved().conditions == "force-closure: friction 0.6, an object of 100 g, pushed with 1 N for 2 s each"
    assert proved(protocol=TABLETOP).conditions == (
        "tabletop: friction 0.6, an object of 100 g, lifted off a table by 10 cm in 2 s"
    )
    assert proved().closed_by == "pregrasp and squeeze are our own"
    mixed = replace(proved(), closing={"pregrasp": "own", "squeeze": "file"})
    assert mixed.closed_by == "the pregrasp is our own, the squeeze of the file"
    assert replace(proved(), closing={}).closed_by == ""
    notes = notes_html(proved())
    assert "Lost is what moved by 50 mm or turned by 15°" in notes and "Pregrasp and squeeze are our own." in notes


def test_the_table_has_a_row_for_each_direction() -> None:
    page = proved_html(proved(tried("+x", Reason.TURNED, 9.0, 15.2, at=0.2)))
    assert page.count("<tr ") == 6 and page.count("✓ held") == 5
    assert "✗ turned, 0.2 s</td><td>9.0 mm</td><td>15.2°</td><td>4</td>" in page
    assert 'title="turned by 15.2° after 0.2 s, 4 links still touched it"' in page
    assert "gr-no" in page.split("</style>")[1] and "gr-yes" in proved_html(proved()).split("</style>")[1]
    assert "gr-unsure" in proved_html(proved(tried("+y", Reason.HELD, 40.0))).split("</style>")[1]
    unknown = proved(replace(tried("+x", Reason.UNSTABLE, nan, nan, at=0.2), links=()))
    assert "<td>–</td><td>–</td><td>0</td>" in proved_html(unknown)


def test_text_cannot_become_html() -> None:
    assert "<b>" not in motion_html("<b>", lost=True) and "&lt;b&gt;" in motion_html("<b>", lost=True)
