"""The panel that lists the grasps, without a browser: clicks on the table, steps, filters and marks."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.listing import MARK, NO_MARK
from grasp_refine_apps.viewer.panels.browse_panel import NEXT, PREVIOUS, RANDOM, WORST, BrowsePanel
from made_results import save_example_results
from open_viewer import shown_panel
from websocket_page import Page, until

Shown = tuple[Controller, BrowsePanel, Page]


@pytest.fixture
def shown(tmp_path: Path) -> Iterator[Shown]:
    """Sixteen grasps of quality (7 i mod 16)/16, each with its page of the table."""
    path = save_example_results(tmp_path / "results.npz", 16)
    made = Controller(Collection.of(load_problem(ProblemSpec(grasps=path))), Settings())
    with shown_panel(BrowsePanel, made) as (panel, page):
        yield made, panel, page


def test_steps_follow_the_list_as_it_is_sorted(shown: Shown) -> None:
    made, panel, page = shown
    page.change(panel.clicks, "sort quality_after 0.5")
    until(lambda: (made.state.listing.key, made.state.listing.descending) == ("quality_after", True))
    until(lambda: "▼" in panel.table.content)
    order = sorted(range(16), key=lambda i: -(7 * i % 16))
    page.change(panel.clicks, f"open {order[1]} 0.6")
    until(lambda: made.state.number == order[1])
    for where, number in ((NEXT, order[2]), (PREVIOUS, order[1]), (PREVIOUS, order[0]), (PREVIOUS, order[-1])):
        page.change(panel.steps, where)
        until(lambda number=number: made.state.number == number)
    made.grasps.show(5)
    page.change(panel.steps, WORST)
    until(lambda: made.state.number == 0)
    page.change(panel.steps, RANDOM)
    until(lambda: made.state.number != 0)


def test_filters_marks_and_ranges_list_what_they_say(shown: Shown) -> None:
    made, panel, page = shown
    made.grasps.show(14)
    page.change(panel.marks, "Bad")
    until(lambda: made.state.collection.mark(14) == "bad")
    page.change(panel.filters["mark"], "bad")
    until(lambda: made.state.listing.mark == "bad" and "1 to 1 of 1" in panel.table.content)
    page.change(panel.filters["mark"], "all")
    page.change(panel.filters["status"], "stalled")
    until(lambda: (made.state.listing.mark, made.state.listing.status) == ("", "stalled"))
    until(lambda: "1 to 4 of 4" in panel.table.content)
    page.change(panel.filters["status"], "all")
    page.change(panel.filters["change"], "contacts moved")
    until(lambda: "1 to 5 of 5" in panel.table.content)
    page.change(panel.filters["change"], "all")
    page.change(panel.descending, True)
    page.change(panel.key, "Mark")
    until(lambda: (made.state.listing.key, made.state.listing.descending) == (MARK, False))
    quality = made.state.collection.columns["quality_after"].values
    panel.brush("quality_after 0.25 0.5")
    ((key, low, high),) = made.state.listing.ranges
    assert key == "quality_after"
    np.testing.assert_allclose([low, high], quality.min() + np.array([0.25, 0.5]) * np.ptp(quality))
    page.change(panel.beside, True)
    until(lambda: made.state.side_by_side)


def test_clicks_that_nobody_made_do_nothing_and_one_that_comes_twice_sorts_once(shown: Shown) -> None:
    """Whoever reaches the server may send any text as a click."""
    made, panel, _ = shown
    until(lambda: panel.table.content)
    before = panel.table.content
    pages = "page -1 1", "page x 1"
    for click in ("open 99 1", "open -1 1", "open ² 1", "open 1e3", *pages, "sort __class__ 1", "sort", ""):
        panel._click(click)
        assert made.state.number == 0 and made.state.listing.key == "number" and panel.table.content == before
    for _ in range(2):
        panel._click("sort quality_after 7.5")
    assert made.state.listing.descending
    panel._click("sort quality_after 8.5")
    assert not made.state.listing.descending


def test_the_last_page_goes_when_its_last_grasp_leaves_the_list(shown: Shown) -> None:
    made, panel, page = shown
    page.change(panel.clicks, "page 9999999999 1")
    until(lambda: "16 to 16 of 16" in panel.table.content)
    page.change(panel.filters["mark"], NO_MARK)
    until(lambda: made.state.listing.mark == NO_MARK)
    made.grasps.show(15)
    until(lambda: "16 to 16 of 16" in panel.table.content)
    made.grasps.mark(15, "bad")
    until(lambda: "1 to 15 of 15" in panel.table.content)
