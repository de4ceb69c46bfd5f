"""The hands that the browser tests have, each tried on a small viser page whose every answer is known."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import trimesh

from browser import DETAIL, ViserPage, share_of, until

if TYPE_CHECKING:
    from playwright.sync_api import Browser

viser = pytest.importorskip("viser", reason="the viewer comes with the extra 'viewer'")

RED, BLUE = ((90, 0, 0), (255, 90, 90)), ((0, 0, 90), (90, 90, 255))
HALF = 0.05
"""Half an edge of the red cube and the radius of the blue ball."""


@dataclass
class Toy:
    """A red cube at x = +0.1 and a blue ball at x = -0.1, seen from the front, and a widget of each kind."""

    server: Any
    cube: Any
    widgets: dict[str, Any] = field(default_factory=dict)
    heard: list[tuple[Any, ...]] = field(default_factory=list)
    """What callbacks were told, in order."""

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.get_port()}"


def build(server: Any) -> Toy:
    scene, gui = server.scene, server.gui
    gui.configure_theme(show_logo=False, show_share_button=False)
    gui.main_panel.dock_right()
    scene.configure_environment_map(None)
    scene.configure_default_lights(True, cast_shadow=False)
    scene.add_light_ambient("/light", intensity=2.0)
    scene.world_axes.visible = False
    server.initial_camera.position, server.initial_camera.look_at = (0.0, -0.5, 0.0), (0.0, 0.0, 0.0)
    box, ball = trimesh.creation.box((2 * HALF,) * 3), trimesh.creation.icosphere(3, HALF)
    cube = scene.add_mesh_simple("/there/cube", box.vertices, box.faces, color=(255, 0, 0), position=(0.1, 0.0, 0.0))
    blue = scene.add_mesh_simple("/there/ball", ball.vertices, ball.faces, color=(0, 0, 255), position=(-0.1, 0.0, 0.0))
    toy = Toy(server, cube)
    cube.on_click(lambda event: toy.heard.append(("cube", event.ray_origin, event.ray_direction)))
    blue.on_drag(lambda event: toy.heard.append((event.phase, event.start_position, event.end_position)))

    widgets = toy.widgets
    tabs = gui.add_tab_group()
    with tabs.add_tab("First"):
        widgets["Height"] = gui.add_slider("Height", -0.1, 0.1, 0.01, 0.0)
        widgets["Flag"] = gui.add_checkbox("Flag", False)
        widgets["Choice"] = gui.add_dropdown("Choice", ("one", "two"))
        widgets["Number"] = gui.add_number("Number", 1.5)
        widgets["Words"] = gui.add_text("Words", "before")
        widgets["Go"] = gui.add_button("Go")
        widgets["plot"] = gui.add_uplot(
            (np.arange(3.0), np.array([3.0, 2.0, 1.0])),
            ({}, viser.uplot.Series(label="error", stroke="red")),
            scales={"x": viser.uplot.Scale(time=False)},
        )
        with gui.add_folder("Closed", expand_by_default=False):
            widgets["Inside"] = gui.add_button("Inside")
    with tabs.add_tab("Second"):
        widgets["said"] = gui.add_markdown("nothing")
        widgets["Upload"] = gui.add_upload_button("Upload")

    def height_changed(event: Any) -> None:
        cube.position = (0.1, 0.0, event.target.value)

    def gone(event: Any) -> None:
        event.client.add_notification("Done", "and dusted", auto_close_seconds=None)
        toy.widgets["plot"].data = (np.arange(4.0), np.array([4.0, 3.0, 2.0, 1.0]))

    widgets["Height"].on_update(height_changed)
    widgets["Go"].on_click(gone)
    widgets["Inside"].on_click(lambda event: toy.heard.append(("inside",)))
    widgets["Upload"].on_upload(lambda event: toy.heard.append((event.target.value.name, event.target.value.content)))
    return toy


@pytest.fixture(scope="module")
def toy() -> Iterator[Toy]:
    with redirect_stdout(io.StringIO()):  # viser greets
        server = viser.ViserServer(host="127.0.0.1", port=0, label="Toy", verbose=False)
        try:
            yield build(server)
        finally:
            server.stop()


@pytest.fixture(scope="module")
def opened(toy: Toy, browser: Browser) -> Iterator[ViserPage]:
    page = ViserPage(browser)
    page.open(toy.address)
    page.wait_for_node("/there/cube")
    yield page
    page.close()


@pytest.fixture
def page(toy: Toy, opened: ViserPage) -> Iterator[ViserPage]:
    """One page for all tests of this file: loading it takes longer than any of them."""
    toy.heard.clear()
    yield opened
    assert opened.errors == []


def position(page: ViserPage, name: str) -> np.ndarray:
    return page.pose(name)[:3, 3]


def test_pixels_poses_and_the_camera_agree(page: ViserPage):
    picture = page.wait_for_scene()
    left, top, width, height = page.canvas_box()
    assert picture.shape == (height, width, 3) and 900 < width < 1200
    middle = int(width) // 2
    assert share_of(picture[:, middle:], *RED) > 0.01 > share_of(picture[:, :middle], *RED)
    assert share_of(picture[:, :middle], *BLUE) > 0.01 > share_of(picture[:, middle:], *BLUE)
    reds = np.argwhere(((picture >= RED[0]) & (picture <= RED[1])).all(-1))
    corner = np.array(page.pixel((0.1 + HALF, -HALF, -HALF))) - (left, top)
    assert reds.max(0)[::-1] == pytest.approx(corner, abs=1.0 / DETAIL + 1.0), "lower right corner of the cube"

    assert position(page, "/there/cube") == pytest.approx((0.1, 0.0, 0.0), abs=1e-6)
    np.testing.assert_allclose(page.pose("/there/cube")[:3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(page.camera()[:3, 3], (0.0, -0.5, 0.0), atol=1e-6)
    np.testing.assert_allclose(page.camera()[:3, 2], (0.0, -1.0, 0.0), atol=1e-6)  # it looks along +y


def test_a_click_on_a_point_comes_from_the_camera_and_meets_that_point(toy: Toy, page: ViserPage):
    point = np.array([0.1 + 0.02, -HALF, 0.03])
    page.click_point(point)
    until(lambda: toy.heard, "a click")
    name, origin, direction = toy.heard[0]
    assert name == "cube"
    np.testing.assert_allclose(origin, (0.0, -0.5, 0.0), atol=1e-6)
    toward = (point - origin) / np.linalg.norm(point - origin)
    np.testing.assert_allclose(direction, toward, atol=2e-3)  # one pixel is 0.002


def test_a_drag_starts_on_the_surface_and_ends_where_it_is_let_go(toy: Toy, page: ViserPage):
    start, end = np.array([-0.1, -0.05, 0.0]), np.array([-0.05, -0.05, 0.03])
    page.drag_point(start, end)
    until(lambda: toy.heard and toy.heard[-1][0] == "end", "the end of a drag")
    phases = [phase for phase, *_ in toy.heard]
    assert phases[0] == "start" and phases.count("start") == phases.count("end") == 1
    np.testing.assert_allclose(toy.heard[0][1], start, atol=2e-3)
    np.testing.assert_allclose(toy.heard[-1][2], end, atol=2e-3)


def test_widgets_are_moved_by_their_labels(toy: Toy, page: ViserPage):
    widgets = toy.widgets
    page.enter("Height", 0.05)
    until(lambda: position(page, "/there/cube")[2] == pytest.approx(0.05), "the cube follows the slider")
    page.drag_slider("Height", 0.5, 0.0)
    until(lambda: position(page, "/there/cube")[2] == pytest.approx(-0.1), "the cube follows the dragged slider")
    assert page.value("Height") == "-0.1"

    page.enter("Number", 2.5)
    page.enter("Words", "after")
    page.check("Flag")
    page.choose("Choice", "two")
    wanted = {"Number": 2.5, "Words": "after", "Flag": True, "Choice": "two"}
    until(lambda: {label: widgets[label].value for label in wanted} == wanted, f"the server has {wanted}")
    assert page.value("Choice") == "two"

    assert toy.heard == []
    page.folder("Closed")
    page.click("Inside")
    until(lambda: toy.heard == [("inside",)], "the button in the folder")


def test_a_button_brings_a_notification_and_new_lines_in_the_chart(page: ViserPage):
    (before,) = page.plots()
    assert before.lines["error"].tolist() == [3.0, 2.0, 1.0] or before.lines["error"].size == 4
    page.click("Go")
    page.wait_for_text("and dusted")
    (note,) = page.notifications()
    assert note.split() == ["Done", "and", "dusted"]
    until(lambda: page.plots()[0].lines["error"].tolist() == [4.0, 3.0, 2.0, 1.0], "four points")
    assert page.plots()[0].x.tolist() == [0.0, 1.0, 2.0, 3.0]
    page.close_notifications()


def test_tabs_texts_and_uploads(toy: Toy, page: ViserPage, tmp_path: Path):
    assert "nothing" not in page.text()
    page.tab("Second")
    page.wait_for_text("nothing")
    file = tmp_path / "some.bin"
    file.write_bytes(bytes(range(100)))
    page.upload("Upload", file)
    until(lambda: toy.heard == [("some.bin", file.read_bytes())], "the file")
    page.tab("First")
    page.wait_for_text("Height")


def test_visibility_is_that_of_the_node_and_all_above_it(toy: Toy, page: ViserPage):
    assert page.visible("/there/cube")
    with toy.server.atomic():
        toy.cube.visible = False
    until(lambda: not page.visible("/there/cube"), "the cube is hidden")
    until(lambda: share_of(page.picture(), *RED) == 0.0, "no red is drawn")
    toy.cube.visible = True
    until(lambda: page.visible("/there/cube"), "the cube is back")


def test_complaints_of_the_page_are_collected(page: ViserPage):
    page.page.evaluate("() => console.error('a complaint')")
    until(lambda: page.errors, "an error of the console")
    assert page.errors == ["a complaint"]
    page.errors.clear()
    until(lambda: page.frames_per_second(0.3) > 0.0, "a frame")
    assert all(address.split(":")[0] in ("http", "blob") and "127.0.0.1" in address for address in page.requests)
