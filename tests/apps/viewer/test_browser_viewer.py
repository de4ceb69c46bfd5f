"""`refine-grasp view` in a real browser: what a person does with it, from the first click to what comes of it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

from browser import ViserPage, share_of, until
from grasp_refine.refinement.solvers.status import Status
from running_processes import PATIENCE_S
from viewer_process import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CONVERGED = Status.CONVERGED.label.capitalize()
THUMB = "/grasp/hand/20"
"""The last link of the embedded hand's thumb, which should touch and lies before the mug on the right."""


@pytest.fixture(scope="module")
def viewer(start_viewer: Callable[..., Viewer]) -> Viewer:
    """The embedded example."""
    return start_viewer()


@pytest.fixture(scope="module")
def opened(viewer: Viewer, browser: Browser) -> Iterator[ViserPage]:
    page = ViserPage(browser)
    page.open(viewer.address)
    page.wait_for_node(THUMB)
    yield page
    page.close()


@pytest.fixture
def page(opened: ViserPage) -> Iterator[ViserPage]:
    """One page for all tests of the example, with the first grasp as it came: loading takes longer than some tests."""
    opened.tab("Refine")
    if opened.button("Reset").is_enabled():
        opened.click("Reset")
    yield opened
    assert opened.errors == []


def place(page: ViserPage, name: str) -> np.ndarray:
    """Where a node is."""
    return page.pose(name)[:3, 3]


def oranges_and_blues(picture: np.ndarray) -> tuple[int, int]:
    """How many pixels have the colours of links that should touch, and of the object."""
    red, _, blue = picture.astype(int).transpose(2, 0, 1)
    return int((red > blue + 50).sum()), int((blue > red + 15).sum())


def remaining_gaps(page: ViserPage) -> np.ndarray:
    """The remaining gaps in the chart, mm; none without a chart."""
    return next((plot.lines["remaining gap"] for plot in page.plots() if "remaining gap" in plot.lines), np.zeros(0))


def marked(page: ViserPage) -> int:
    """At which iteration the chart has its upright line."""
    (plot,) = page.plots()
    return int(plot.x[np.isfinite(plot.lines["shown now"])][0])


def heading(page: ViserPage) -> str:
    """The line that says how good the shown grasp is."""
    return next(line for line in page.text().splitlines() if line.startswith(("contact error ", "remaining gap ")))


def refine(page: ViserPage) -> np.ndarray:
    """Click Start and wait for the end; returns the remaining gaps in the chart, mm."""
    page.tab("Refine")
    page.click("Start")
    page.wait_for_text(CONVERGED)
    page.wait_for_text("The best of all")
    # Iterations of starts that run side by side share a place in the chart, which follows the slider a moment later.

    def is_whole() -> bool:
        last = int(page.value("Iteration"))
        return any(plot.x[-1] == last for plot in page.plots())

    until(is_whole, "a chart of all iterations")
    return remaining_gaps(page)


def told(page: ViserPage, *named: str) -> str:
    """The words of the notification that names all of these, which is closed."""

    def found() -> list[str]:
        return [words for words in page.notifications() if all(name in words for name in named)]

    (words,) = until(found, f"a notification of {named}")
    page.close_notifications()
    return words


def trial_rows(page: ViserPage) -> list[list[str]]:
    """The cells of the table that says what simulation found."""
    return page.page.evaluate(
        "() => [...document.querySelectorAll('.gr-trial tbody tr')].map(r => [...r.cells].map(c => c.innerText))"
    )


def test_a_grasp_is_seen_refined_scrubbed_and_reloaded(viewer: Viewer, page: ViserPage):
    orange, blue = oranges_and_blues(page.wait_for_scene())
    assert orange > 3000 and blue > 3000
    assert page.visible(THUMB) and page.visible("/grasp/object/mesh/0")
    assert not page.visible("/grasp/ghost/20"), "it is where it came"
    (line,) = viewer.output().strip().splitlines()
    assert line.startswith(viewer.address)

    came = page.pose(THUMB)
    assert heading(page).startswith("contact error 1.94 mm")
    errors = refine(page)
    # Over the links that touch in the end, one of which was far away.
    assert errors[0] == pytest.approx(19.29, abs=0.01)
    assert errors[-1] < 0.1 and np.nanmin(errors) < 0.01
    assert (np.diff(np.fmin.accumulate(errors)) <= 0).all()
    assert heading(page).startswith("contact error 0.00 mm")
    until(lambda: np.linalg.norm(page.pose(THUMB)[:3, 3] - came[:3, 3]) > 0.003, "the fingertip moved")
    np.testing.assert_allclose(page.pose("/grasp/ghost/20"), came, atol=1e-5)
    assert page.visible("/grasp/ghost/20")

    until(lambda: page.value("Iteration") != "0", "the timeline stands at the end")
    end = page.pose(THUMB)
    page.drag_slider("Iteration", 0.98, 0.5, 0.0)
    until(lambda: page.value("Iteration") == "0", "the first iteration")
    until(lambda: np.allclose(page.pose(THUMB), came, atol=1e-6), "the hand as it came")
    until(lambda: heading(page).startswith("contact error 1.94 mm"), "its numbers")
    until(lambda: marked(page) == 0, "the line in the chart")
    page.drag_slider("Iteration", 0.1, 1.0)
    until(lambda: np.allclose(page.pose(THUMB), end, atol=1e-5), "the last iteration")

    page.enter("Iteration", 3)
    until(lambda: marked(page) == 3, "the line in the chart at that iteration")
    until(lambda: not np.allclose(page.pose(THUMB), end, atol=1e-4), "the hand of that iteration")
    # The chart and the heading are drawn independently.
    until(lambda: heading(page).startswith("remaining gap"), "its numbers")
    shown, numbers, errors = page.pose(THUMB), heading(page), remaining_gaps(page)
    page.reload()
    page.wait_for_node(THUMB)
    page.wait_for_text(numbers)
    until(lambda: np.allclose(page.pose(THUMB), shown, atol=1e-6), "the same hand")
    assert page.value("Iteration") == "3"
    until(lambda: np.array_equal(remaining_gaps(page), errors), "the same chart")


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
    other.wait_for_node(THUMB)
    came = page.pose(THUMB)
    other.click("Start")
    other.close()
    page.wait_for_text(CONVERGED)
    until(lambda: not np.allclose(page.pose(THUMB), came, atol=1e-3), "the hand that the other page refined")
    assert heading(page).startswith("contact error 0.00 mm")
    assert viewer.process.poll() is None


@pytest.mark.slow
def test_the_animation_that_is_downloaded_plays(page: ViserPage, tmp_path: Path, open_page: Callable[..., ViserPage]):
    refine(page)
    page.tab("Files")
    file = page.download("Animation (HTML)", tmp_path)
    assert file.suffix == ".html" and file.stat().st_size < 3e6
    film = open_page(file.as_uri(), size=(480, 360))
    film.wait_for_node("/hand/20")
    poses = [film.pose("/hand/20")]

    def moved() -> bool:
        poses.append(film.pose("/hand/20"))
        return np.ptp([pose[:3, 3] for pose in poses], axis=0).max() > 0.003

    until(moved, "the fingertip moves")
    # From where the page looked, most of the links that should touch are behind the mug.
    until(lambda: oranges_and_blues(film.wait_for_scene())[0] > 20, "the fingertips in one of the frames")
    np.testing.assert_allclose(film.camera()[:3, 3], page.camera()[:3, 3], atol=1e-3)
    assert film.requests[0].startswith("file://") and len(film.requests) == 1


@pytest.mark.slow
def test_a_link_ends_where_two_clicks_in_the_scene_said(page: ViserPage):
    refine(page)
    page.tab("Edit")
    page.check("Set by clicks")
    # A place on the thumb that the camera sees and that can touch, and one on the mug above it, both clear of edges.
    side = place(page, "/grasp/contacts/link/3") + (0.0015, 0.0067, 0.0097)
    wanted = place(page, "/grasp/contacts/object/3") + (-0.0062, 0.0007, 0.0182)

    def chosen() -> bool:
        page.click_point(side)
        return "link_15.0" in page.text()

    until(chosen, "a click on the thumb chooses it")

    def aimed() -> bool:
        page.click_point(wanted)
        page.page.wait_for_timeout(1000)
        return "/grasp/targets/object/0" in page.nodes()

    until(aimed, "a target where I clicked")
    target = place(page, "/grasp/targets/object/0")
    before = place(page, "/grasp/targets/link/0")
    assert np.linalg.norm(target - wanted) < 0.003 and np.linalg.norm(before - target) > 0.008
    thumb = page.pose(THUMB)
    point_link = np.linalg.solve(thumb, np.append(before, 1.0))

    page.tab("Refine")
    page.click("Start")

    def reached() -> bool:
        return bool(np.linalg.norm((page.pose(THUMB) @ point_link)[:3] - target) < 0.002)

    until(reached, "the point of the thumb is at the target")
    assert np.allclose(place(page, "/grasp/targets/object/0"), target)
    page.tab("Edit")
    page.check("Set by clicks", False)
    page.click("Auto")
    until(lambda: "link_15.0" not in page.text(), "no target")


def test_a_grasp_that_slips_is_tested_and_watched(page: ViserPage):
    page.tab("Browse")
    page.click("Next ▶")
    page.wait_for_text("mug 1")  # the first example that holds with the usual friction
    page.tab("Validate")
    page.enter("Friction", 0.15)
    page.click("Test in MuJoCo")
    until(lambda: len(trial_rows(page)) == 6, "six directions")
    rows = {row[0]: row[1:] for row in trial_rows(page)}
    assert set(rows) == {"+x", "-x", "+y", "-y", "+z", "-z"}
    assert all(result.startswith(("✓", "✗")) and turned.endswith("°") for result, _, turned, _ in rows.values())
    lost = next(direction for direction, row in rows.items() if row[0].startswith("✗"))

    assert np.allclose(page.pose("/grasp/object"), np.eye(4), atol=1e-6)
    page.click(lost)
    page.wait_for_text("Close replay")
    page.drag_slider("Seconds", 0.5, 1.0, steps=3)
    until(lambda: np.linalg.norm(place(page, "/grasp/object")) > 0.005, "the object moved")
    page.click("Close replay")
    until(lambda: np.allclose(page.pose("/grasp/object"), np.eye(4), atol=1e-6), "the object is back")


@pytest.mark.slow
def test_another_tab_ends_a_replay_and_what_was_made_is_listed(page: ViserPage):
    page.tab("Browse")
    page.page.locator(".gr-table tbody tr").nth(1).click()
    refine(page)
    page.tab("Validate")
    page.click("Test in MuJoCo")
    until(lambda: len(trial_rows(page)) == 6, "six directions")
    page.click("+x")
    page.wait_for_text("Close replay")
    page.tab("Browse")
    page.wait_for_text("contact error 0.00 mm")
    page.click("Next ▶")
    page.wait_for_text("mug 2 as in its file")
    row = page.page.locator(".gr-table tbody tr").nth(1)
    until(lambda: row.locator("td").all_inner_texts()[-2] == "R T", "the refined and tested grasp in the table")
    page.choose("Grasps", "all")
    page.click("Refine")
    page.wait_for_text("grasps refined")
    table = page.page.locator(".gr-table tbody tr")
    until(lambda: all("R" in cells for cells in table.all_inner_texts()), "all grasps refined")
    page.click("◀ Previous")
    page.wait_for_text("mug 1 refined")
    page.close_notifications()


def test_meshes_that_cannot_be_used_are_refused_and_a_good_one_is_opened(page: ViserPage, tmp_path: Path):
    ball, upload = trimesh.creation.icosphere(2, 0.04), "Upload mesh, hand or grasps"
    half = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] > 0.0])
    (tmp_path / "text.obj").write_text("this is no mesh\n", encoding="utf-8")
    half.export(tmp_path / "half.obj")
    ball.export(tmp_path / "ball.obj")
    page.tab("Files")
    page.upload(upload, tmp_path / "text.obj")
    assert str(tmp_path) not in told(page, "text.obj", "faces")
    page.upload(upload, tmp_path / "half.obj")
    assert str(tmp_path) not in told(page, "half.obj", "Mesh holes", "cap flat holes")
    page.wait_for_text("allegro on mug")
    refine(page)

    page.tab("Files")
    page.upload(upload, tmp_path / "ball.obj")
    told(page, "ball.obj", "1 grasp of allegro on ball")
    page.wait_for_text("allegro on ball")


def test_a_small_window_has_scene_and_panel(viewer: Viewer, open_page: Callable[..., ViserPage]):
    page = open_page(viewer.address, size=(700, 500))
    page.wait_for_node(THUMB)
    until(lambda: page.scene_size() == (312.0, 500.0), "a scene beside the panel")
    assert share_of(page.wait_for_scene(), (0, 0, 0), (235, 235, 235)) > 0.05
    page.tab("Refine")

    def whole() -> bool:
        box = page.button("Start").bounding_box()
        return box is not None and box["x"] > 312 and box["x"] + box["width"] < 700

    # The panel is laid out after the scene.
    until(whole, "a button as wide as the panel")


@pytest.mark.slow
def test_shadow_from_its_maker_is_refined_scrubbed_and_interrupted(
    start_viewer: Callable[..., Viewer], open_page: Callable[..., ViserPage], shared_assets: Path
):
    viewer = start_viewer(
        shared_assets / "grasps/normalised/bodex_shadow.npz",
        *("--hand", "shadow", "--urdf", shared_assets / "hands/shadow/shadow_right.urdf"),
        *("--objects", shared_assets / "grasps/bodex_shadow/example_object", "--index", "0", "1"),
    )
    page, thumb = open_page(viewer.address, size=(900, 900)), "/grasp/hand/22"
    page.wait_for_node(thumb)
    assert share_of(page.wait_for_scene(), (0, 0, 0), (235, 235, 235)) > 0.05
    page.wait_for_text("2.91 mm")
    came = page.pose(thumb)

    errors = refine(page)
    # Over the links that touch in the end.
    assert errors[0] == pytest.approx(13.84, abs=0.01) and errors[-1] < 0.01
    until(lambda: not np.allclose(page.pose(thumb), came, atol=1e-4), "the thumb moved")
    until(lambda: page.value("Iteration") != "0", "the timeline stands at the end")
    page.enter("Iteration", 0)
    until(lambda: np.allclose(page.pose(thumb), came, atol=1e-6), "the thumb as it came")

    page.choose("Solver", "descent")  # which takes its time
    page.wait_for_text("Derivative")  # an option of descent: the choice has arrived
    page.click("Start")
    until(lambda: len(remaining_gaps(page)) > 20, "it refines again")
    until(lambda: not np.allclose(page.pose(thumb), came, atol=1e-4), "the thumb is elsewhere than in the file")
    page.close()  # which stops nothing
    assert viewer.process.poll() is None
    viewer.process.send_signal(signal.SIGINT)
    # A refined grasp is not saved: it asks.
    until(lambda: "1 grasp " in viewer.output(), "a question")
    viewer.process.send_signal(signal.SIGINT)
    assert viewer.process.wait(PATIENCE_S) == 0
    assert "Traceback" not in viewer.output()
