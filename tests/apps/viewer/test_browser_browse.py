"""The panel of the table in a real browser: clicks on rows and headers, filters, marks, and names like scripts."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from browser import ViserPage, until
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import STATUS
from grasp_refine_apps.viewer.model.listing import NO_MARK
from grasp_refine_apps.viewer.panels.browse_panel import BrowsePanel
from made_results import save_example_results


@dataclass
class Shown:
    """A page with nothing but the panel."""

    controller: Controller
    panel: BrowsePanel
    address: str

    def wait_for_number(self, number: int) -> None:
        until(lambda: self.controller.state.number == number, f"grasp {number} opened")


def opened(path: Path) -> Collection:
    return Collection.of(load_problem(ProblemSpec(grasps=path)))


@pytest.fixture
def show() -> Iterator[Callable[[Collection], Shown]]:
    """Shows collections, each in a server of its own."""
    ends: list[Callable[[], None]] = []

    def one(collection: Collection) -> Shown:
        with redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        controller = Controller(collection, Settings())
        ends.extend([server.stop, controller.close])
        panel = BrowsePanel(server, controller)
        panel.draw(controller.state)
        controller.listen(panel.draw)
        return Shown(controller, panel, f"http://127.0.0.1:{server.get_port()}")

    yield one
    for end in ends:
        end()


def rows(page: ViserPage) -> list[list[str]]:
    """The cells of all rows that are shown."""
    return page.page.evaluate(
        "() => [...document.querySelectorAll('.gr-table tbody tr')].map(r => [...r.cells].map(c => c.innerText))"
    )


def first(page: ViserPage) -> str:
    found = rows(page)
    return found[0][0] if found else ""


def wait_for_first(page: ViserPage, name: str) -> None:
    until(lambda: first(page) == name, f"grasp {name} in the first row, not {first(page)}")


def sort(page: ViserPage, label: str) -> None:
    page.page.locator(".gr-table th", has_text=label).click()


@pytest.mark.slow
def test_a_table_of_a_hundred_is_sorted_opened_and_marked(
    show: Callable[[Collection], Shown], open_page: Callable[..., ViserPage], tmp_path: Path
) -> None:
    path = save_example_results(tmp_path / "results.npz", 100)
    shown = show(opened(path))
    page = open_page(shown.address)
    wait_for_first(page, "0")
    # The quality of grasp i is 7 i mod 100 hundredths: 57 has 0.99, 14 has 0.98.
    sort(page, "Quality")
    wait_for_first(page, "57")
    page.page.locator(".gr-table tbody tr").nth(1).click()
    shown.wait_for_number(14)
    page.wait_for_text("mug 14")
    assert page.page.locator(".gr-open td").first.inner_text() == "14"
    sort(page, "Quality")
    wait_for_first(page, "0")

    # Steps follow the order of the table: before 14 come 71 (0.97) and, back again, 14.
    page.click("◀ Previous")
    shown.wait_for_number(71)
    page.click("Next ▶")
    shown.wait_for_number(14)
    page.click("Worst")
    shown.wait_for_number(0)
    page.click("Random")
    until(lambda: shown.controller.state.number != 0, "another grasp")

    shown.controller.grasps.show(14)
    page.click("Bad")
    until(lambda: shown.controller.state.collection.mark(14) == "bad", "grasp 14 is marked bad")
    assert opened(path).mark(14) == "bad"
    page.click("Next ▶")
    shown.wait_for_number(57)
    page.click("Good")
    until(lambda: shown.controller.state.collection.mark(57) == "good", "grasp 57 is marked good")
    page.folder("Sort and filter")
    page.choose("Marked", "good")
    until(lambda: [row[0] for row in rows(page)] == ["57"], "the only good one")
    page.choose("Marked", "all")
    page.choose("Status", "stalled")
    # Every fourth from 2 on; 28 hundredths is 4, which did converge, so 2 + 4 k with the lowest 7 i mod 100 is first.
    stalled = sorted(range(2, 100, 4), key=lambda i: 7 * i % 100)
    until(lambda: [row[0] for row in rows(page)] == [str(i) for i in stalled[:15]], "stalled ones")
    page.check("Largest first")
    wait_for_first(page, str(stalled[-1]))
    page.choose("Sort by", "Penetration, mm")
    wait_for_first(page, "2")

    page.check("Before and after")
    until(lambda: shown.controller.state.side_by_side, "side by side")

    # Whoever reloads, or looks from elsewhere, sees the same list.
    other = open_page(shown.address)
    wait_for_first(other, "2")


def test_a_row_is_opened_again_after_another_way_of_leaving_it(
    show: Callable[[Collection], Shown], open_page: Callable[..., ViserPage], tmp_path: Path
) -> None:
    """A text widget tells only values that are new; every click must be one."""
    shown = show(opened(save_example_results(tmp_path / "results.npz", 5)))
    page = open_page(shown.address)
    for _ in range(2):
        page.page.locator(".gr-table tbody tr").nth(3).click()
        shown.wait_for_number(3)
        shown.controller.grasps.show(1)
        until(lambda: page.page.locator(".gr-open td").first.inner_text() == "1", "grasp 1 in the table")


def test_clicks_that_nobody_made_do_nothing(show: Callable[[Collection], Shown], tmp_path: Path) -> None:
    """Whoever reaches the server may send any text as a click."""
    shown = show(opened(save_example_results(tmp_path / "results.npz", 5)))
    before = shown.panel.table.content
    for click in (
        "open 99 1",
        "open -1 1",
        "open ² 1",
        "open 1e3",
        "page 9999999999 1",
        "sort __class__ 1",
        "sort",
        "",
    ):
        shown.panel._click(click)
        assert shown.controller.state.number == 0
        assert shown.panel.table.content == before


def test_one_click_sent_twice_sorts_once(show: Callable[[Collection], Shown], tmp_path: Path) -> None:
    shown = show(opened(save_example_results(tmp_path / "results.npz", 5)))
    for _ in range(2):
        shown.panel._click("sort quality_after 7.5")
    assert "▼" in shown.panel.table.content
    shown.panel._click("sort quality_after 8.5")
    assert "▲" in shown.panel.table.content


def test_the_last_page_goes_when_its_last_grasp_leaves_the_list(
    show: Callable[[Collection], Shown], tmp_path: Path
) -> None:
    shown = show(opened(save_example_results(tmp_path / "results.npz", 16)))
    shown.panel._list(mark=NO_MARK)
    shown.controller.grasps.show(15)
    assert "16 to 16 of 16" in shown.panel.table.content
    shown.controller.grasps.mark(15, "bad")
    content = shown.panel.table.content
    assert "16 to 16" not in content and "1 to 15 of 15" in content and "16" in content.partition("1 to 15 of 15")[2]


def test_names_in_files_run_no_scripts(
    show: Callable[[Collection], Shown], open_page: Callable[..., ViserPage], tmp_path: Path
) -> None:
    evil = '<img src=x onerror="window.evil=1">"\'><script>window.evil=1</script>{window.evil=1}'
    collection = opened(save_example_results(tmp_path / "results.npz", 5))
    (group,) = collection.problem.groups
    problem = replace(collection.problem, groups=(replace(group, object=evil),))
    collection = replace(collection, problem=problem).with_columns(STATUS.with_values(np.full(5, evil)))
    page = open_page(show(collection).address)
    page.wait_for_text(f"{evil} 0")
    page.page.locator(".gr-table tbody tr").nth(1).click()
    page.wait_for_text(f"{evil} 1")
    assert page.page.evaluate("() => window.evil") is None


def test_raw_grasps_are_measured_on_request(
    show: Callable[[Collection], Shown], open_page: Callable[..., ViserPage]
) -> None:
    shown = show(opened(resource_dir("robots") / "allegro" / "example_rounded_box.npz"))
    page = open_page(shown.address)
    until(lambda: page.button("Measure all").is_visible(), "something left to measure")
    assert "Quality" not in page.page.locator(".gr-table").inner_text()
    page.click("Measure all")
    until(lambda: not unmeasured(shown.controller.state.collection).any(), "measured")
    page.wait_for_text("Quality")
    assert len(rows(page)[0]) == 5  # number, quality, gap, depth, mark
    until(lambda: not page.button("Measure all").is_visible(), "nothing left to measure")
