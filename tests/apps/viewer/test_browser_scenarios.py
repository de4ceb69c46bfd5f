"""What a person does with the viewer, from the first click to what comes out, in a real browser."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from browser import ViserPage, until
from command_line import call
from viewer_process import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

THUMB = "/grasp/hand/20"
"""The last link of the embedded hand's thumb, which lies before the mug on the right."""

MUG = "/grasp/object/mesh/0"


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
    """One page for all tests of the example: loading it takes longer than some of them."""
    yield opened
    assert opened.errors == []


def place(page: ViserPage, name: str) -> np.ndarray:
    """Where a node is."""
    return page.pose(name)[:3, 3]


def refine(page: ViserPage) -> None:
    """Click Start and wait for the end of a first refinement."""
    page.tab("Refine")
    page.click("Start")
    page.wait_for_text("Converged after", 60.0)


def told(page: ViserPage, title: str) -> str:
    """The words of the notification with this title, which is closed."""

    def found() -> list[str]:
        return [words for words in page.notifications() if words.startswith(title)]

    (words,) = until(found, f"a notification {title!r}", 30.0)
    page.close_notifications()
    return words.removeprefix(title).strip()


def proof_rows(page: ViserPage) -> list[list[str]]:
    """The cells of the table that says what simulation found."""
    return page.page.evaluate(
        "() => [...document.querySelectorAll('.gr-proof tbody tr')].map(r => [...r.cells].map(c => c.innerText))"
    )


def test_a_link_ends_where_two_clicks_in_the_scene_said(page: ViserPage):
    refine(page)
    page.tab("Steer")
    page.check("Set by clicks")
    page.wait_for_text("Click a link of the hand")
    page.click_point(place(page, "/grasp/contacts/link/3") + (0.01, 0.012, 0.0))  # the side that faces the camera
    page.wait_for_text("is chosen: now click the object")
    wanted = np.array([0.04 * np.cos(0.9), 0.04 * np.sin(0.9), 0.035])
    page.click_point(wanted)
    page.wait_for_text("miss, mm")
    page.wait_for_node("/grasp/targets/object/0")
    until(lambda: np.linalg.norm(place(page, "/grasp/targets/object/0") - wanted) < 0.002, "a target where I clicked")
    target = place(page, "/grasp/targets/object/0")
    before = place(page, "/grasp/targets/link/0")
    assert np.linalg.norm(before - target) > 0.008
    thumb = page.pose(THUMB)
    point_link = np.linalg.solve(thumb, np.append(before, 1.0))

    page.tab("Refine")
    page.click("Start")

    def reached() -> bool:
        return bool(np.linalg.norm((page.pose(THUMB) @ point_link)[:3] - target) < 0.002)

    until(reached, "the point of the thumb is at the target", 60.0)
    assert np.allclose(place(page, "/grasp/targets/object/0"), target)
    page.tab("Steer")
    page.check("Set by clicks", False)
    page.click("Auto")
    page.wait_for_text("None: links that are within reach")


def test_a_grasp_that_slips_is_tested_and_watched(page: ViserPage):
    page.tab("Refine")
    page.click("Reset")
    page.tab("Prove")
    page.enter("Friction", 0.15)
    page.click("Test in MuJoCo")
    until(lambda: len(proof_rows(page)) == 6, "six directions", 60.0)
    rows = {row[0]: row[1:] for row in proof_rows(page)}
    assert set(rows) == {"+x", "-x", "+y", "-y", "+z", "-z"}
    assert all(result.startswith(("✓", "✗")) and turned.endswith("°") for result, _, turned, _ in rows.values())
    print(rows)
    lost = next(direction for direction, row in rows.items() if row[0].startswith("✗"))

    assert np.allclose(page.pose("/grasp/object"), np.eye(4), atol=1e-6)
    page.click(lost)
    page.wait_for_text("Close replay", 60.0)
    page.drag_slider("Seconds", 0.5, 1.0)
    until(lambda: np.linalg.norm(place(page, "/grasp/object")) > 0.005, "the object moved")
    page.click("Close replay")
    until(lambda: np.allclose(page.pose("/grasp/object"), np.eye(4), atol=1e-6), "the object is back")


def test_meshes_that_cannot_be_used_are_refused_and_a_good_one_is_opened(page: ViserPage, tmp_path: Path):
    text, open_mesh, box = tmp_path / "bad.obj", tmp_path / "open.obj", tmp_path / "box.obj"
    text.write_text("this is no mesh\n", encoding="utf-8")
    whole = trimesh.creation.box((0.06, 0.06, 0.06))
    whole.export(box)
    trimesh.Trimesh(whole.vertices, whole.faces[2:], process=False).export(open_mesh)
    page.tab("Files")
    page.choose("Mesh unit", "metres")
    page.upload("Upload mesh, hand or grasps", text)
    print(told(page, "This did not work"))
    page.upload("Upload mesh, hand or grasps", open_mesh)
    print(told(page, "This did not work"))
    refine(page)
    page.tab("Files")
    page.upload("Upload mesh, hand or grasps", box)
    print(told(page, "grasp-refine"))
    page.wait_for_text("allegro on box")


def test_a_small_window_keeps_scene_and_panel(page: ViserPage):
    size = page.page.viewport_size
    assert size is not None
    page.page.set_viewport_size({"width": 700, "height": 500})
    until(lambda: page.canvas_box()[2] <= 700, "a smaller scene")
    print(page.canvas_box())
    page.tab("Refine")
    print(page.button("Start").bounding_box())
    page.wait_for_scene()
    page.page.set_viewport_size(size)
    until(lambda: page.canvas_box()[2] > 900, "the scene as large as before")
    print(page.canvas_box())
    page.wait_for_scene()


def test_a_port_that_is_taken_is_said_in_one_line(viewer: Viewer):
    again = call("view", "--port", str(viewer.port), "--no-open")
    assert (again.returncode, again.stdout) == (2, "")
    print(again.stderr)
    assert again.stderr.count("\n") == 1


def test_shadow_from_its_maker_is_refined_scrubbed_and_interrupted(
    start_viewer: Callable[..., Viewer], open_page: Callable[..., ViserPage], shared_assets: Path
):
    viewer = start_viewer(
        shared_assets / "grasps/normalised/bodex_shadow.npz",
        *("--hand", "shadow", "--urdf", shared_assets / "hands/shadow/shadow_right.urdf"),
        *("--objects", shared_assets / "grasps/bodex_shadow/example_object", "--index", "0", "1"),
    )
    page = open_page(viewer.address)
    tip = "/grasp/hand/22"
    page.wait_for_node(tip)
    page.wait_for_scene()
    came = page.pose(tip)
    refine(page)
    (plot,) = page.plots()
    errors = plot.lines["contact error"]
    print(errors[[0, -1]], len(errors))
    until(lambda: not np.allclose(page.pose(tip), came, atol=1e-4), "the thumb moved")
    page.drag_slider("Iteration", 0.98, 0.5, 0.0)
    until(lambda: np.allclose(page.pose(tip), came, atol=1e-6), "the thumb as it came")
    page.click("Start")
    until(lambda: not page.button("Start").is_enabled(), "it refines")
    page.close()
    viewer.process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert viewer.process.wait(10.0) == 0
    print("ended after", time.monotonic() - began, viewer.output())
