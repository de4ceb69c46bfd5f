"""`refine-grasp view` from the command to what a person sees: the embedded example in a real browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from browser import ViserPage, until
from grasp_refine.refinement.solvers.status import Status
from viewer_process import Viewer

CONVERGED = Status.CONVERGED.label.capitalize()
FINGERTIP = "/grasp/hand/20"
"""The last link of the embedded hand: a tip that should touch."""


def oranges_and_blues(picture: np.ndarray) -> tuple[int, int]:
    """How many pixels have the colours of links that should touch, and of the object."""
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return int((red > blue + 50).sum()), int((blue > red + 15).sum())


def contact_errors(page: ViserPage) -> np.ndarray:
    """The contact errors in the chart, mm; none without a chart."""
    return next((plot.lines["contact error"] for plot in page.plots() if "contact error" in plot.lines), np.zeros(0))


def marked(page: ViserPage) -> int:
    """At which iteration the chart has its upright line."""
    (plot,) = page.plots()
    return int(plot.x[np.isfinite(plot.lines["shown now"])][0])


def heading(page: ViserPage) -> str:
    """The line that says how good the shown grasp is."""
    return next(line for line in page.text().splitlines() if line.startswith("contact error "))


@pytest.fixture(scope="module")
def viewer(start_viewer: Callable[..., Viewer]) -> Viewer:
    return start_viewer()


@pytest.fixture
def page(viewer: Viewer, open_page: Callable[..., ViserPage]) -> ViserPage:
    """The example as it came, in a new page."""
    page = open_page(viewer.address)
    page.wait_for_node(FINGERTIP)
    page.wait_for_text("contact error")
    if page.button("Reset").is_enabled():
        page.click("Reset")
    page.wait_for_text("contact error 1.94 mm")
    return page


def refine(page: ViserPage) -> np.ndarray:
    """Click Start and wait for the end; returns the contact errors in the chart, mm."""
    page.click("Start")
    page.wait_for_text(CONVERGED)
    until(lambda: len(contact_errors(page)) > 20, "a chart of all iterations")
    return contact_errors(page)


def test_hand_and_object_are_seen(viewer: Viewer, page: ViserPage):
    picture = page.wait_for_scene()
    orange, blue = oranges_and_blues(picture)
    assert orange > 3000 and blue > 3000
    assert page.visible(FINGERTIP) and page.visible("/grasp/object/mesh/0")
    assert not page.visible("/grasp/ghost/20"), "it is where it came"
    (line,) = viewer.output().strip().splitlines()
    assert line.startswith(viewer.address)


def test_a_click_refines_the_grasp_and_the_plotted_contact_error_falls(page: ViserPage):
    came = page.pose(FINGERTIP)
    errors = refine(page)
    assert errors[0] == pytest.approx(1.94, abs=0.01)
    assert errors[-1] < 0.1 and np.nanmin(errors) < 0.01
    assert (np.diff(np.fmin.accumulate(errors)) <= 0).all()
    assert heading(page).startswith("contact error 0.00 mm")
    until(lambda: np.linalg.norm(page.pose(FINGERTIP)[:3, 3] - came[:3, 3]) > 0.003, "the fingertip moved")
    np.testing.assert_allclose(page.pose("/grasp/ghost/20"), came, atol=1e-5)
    assert page.visible("/grasp/ghost/20")


def test_the_timeline_moves_the_hand(page: ViserPage):
    came = page.pose(FINGERTIP)
    count = len(refine(page)) - 1
    until(lambda: page.value("Iteration") != "0", "the timeline stands at the end")
    end = page.pose(FINGERTIP)

    page.drag_slider("Iteration", 0.98, 0.5, 0.0)
    until(lambda: page.value("Iteration") == "0", "the first iteration")
    until(lambda: np.allclose(page.pose(FINGERTIP), came, atol=1e-6), "the hand as it came")
    until(lambda: heading(page).startswith("contact error 1.94 mm"), "its numbers")
    until(lambda: marked(page) == 0, "the line in the chart")

    page.enter("Iteration", 5)
    until(lambda: not np.allclose(page.pose(FINGERTIP), came, atol=1e-4), "the fifth iteration")
    assert not np.allclose(page.pose(FINGERTIP), end, atol=1e-4)
    page.drag_slider("Iteration", 0.1, 1.0)
    until(lambda: np.allclose(page.pose(FINGERTIP), end, atol=1e-5), f"iteration {count}, the last")


def test_a_reload_keeps_the_state(page: ViserPage):
    refine(page)
    end = page.pose(FINGERTIP)
    page.enter("Iteration", 3)
    until(lambda: marked(page) == 3, "the line in the chart at that iteration")
    until(lambda: not np.allclose(page.pose(FINGERTIP), end, atol=1e-4), "the hand of that iteration")
    shown, words, errors = page.pose(FINGERTIP), heading(page), contact_errors(page)
    page.reload()
    page.wait_for_node(FINGERTIP)
    page.wait_for_text(words)
    until(lambda: np.allclose(page.pose(FINGERTIP), shown, atol=1e-6), "the same hand")
    assert page.value("Iteration") == "3"
    until(lambda: np.array_equal(contact_errors(page), errors), "the same chart")


def test_fifty_clicks_on_start_and_stop_leave_a_page_that_refines(page: ViserPage):
    start, stop = page.button("Start"), page.button("Stop")
    for k in range(50):
        (start, stop)[k % 2].dispatch_event("click")
    until(lambda: page.button("Start").is_enabled(), "nothing is being refined")
    page.click("Reset")
    until(lambda: heading(page).startswith("contact error 1.94 mm"), "the grasp as it came")
    assert refine(page)[-1] < 0.1


def test_two_pages_see_the_same_and_a_closed_one_stops_nothing(
    viewer: Viewer, page: ViserPage, open_page: Callable[..., ViserPage]
):
    other = open_page(viewer.address)
    other.wait_for_node(FINGERTIP)
    came = other.pose(FINGERTIP)
    page.click("Start")
    page.close()
    other.wait_for_text(CONVERGED)
    until(lambda: not np.allclose(other.pose(FINGERTIP), came, atol=1e-3), "the hand that the other page refined")
    assert heading(other).startswith("contact error 0.00 mm")
    assert viewer.process.poll() is None


def test_the_animation_that_is_downloaded_plays(page: ViserPage, tmp_path: Path, open_page: Callable[..., ViserPage]):
    refine(page)
    page.tab("Files")
    file = page.download("Animation (HTML)", tmp_path)
    assert file.suffix == ".html" and file.stat().st_size < 3e6
    page.close()
    film = open_page(file.as_uri(), size=(480, 360))
    film.wait_for_node("/hand/20")
    poses = [film.pose("/hand/20")]

    def moved() -> bool:
        poses.append(film.pose("/hand/20"))
        return np.ptp([pose[:3, 3] for pose in poses], axis=0).max() > 0.003

    until(moved, "the fingertip moves")
    assert oranges_and_blues(film.wait_for_scene())[0] > 300
    assert film.requests[0].startswith("file://") and len(film.requests) == 1
