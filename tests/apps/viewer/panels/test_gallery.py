"""The gallery: a page of the list as pictures, redrawn where a grasp moved."""

import io
from base64 import b64decode
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.panels.browse_panel import BrowsePanel
from grasp_refine_apps.viewer.panels.gallery import Thumbnails
from open_viewer import shown_panel
from websocket_page import Page, until


@pytest.fixture
def shown(viewer: Controller) -> Iterator[tuple[BrowsePanel, Page]]:
    with shown_panel(BrowsePanel, viewer) as made:
        yield made


def picture(png: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(b64decode(png))).convert("RGB")).astype(int)


def test_pictures_of_a_page_are_drawn_and_an_edited_grasp_anew(viewer: Controller) -> None:
    thumbnails = Thumbnails(lambda: None)
    numbers = np.arange(2)

    def pictures() -> dict[int, np.ndarray] | None:
        state = viewer.state
        found = thumbnails.of(state.collection, state.works, numbers)
        return {n: picture(png) for n, png in found.items()} if len(found) == 2 else None

    before = until(pictures)
    for n in range(2):
        red, _, blue = before[n].transpose(2, 0, 1)
        # Fingertips are orange, the object is blue.
        assert (red > blue + 60).sum() > 100 and (blue > red + 20).sum() > 500
    assert (before[0] != before[1]).any(axis=2).mean() > 0.1
    viewer.editor.set_joint(1, viewer.state.pose.q[1] + 0.6)
    after = until(pictures)
    assert (before[0] != after[0]).any(axis=2).mean() > 0.01
    np.testing.assert_array_equal(before[1], after[1])
    # A grasp that cannot be drawn holds up no other.
    pose = viewer.state.pose
    viewer.set(pose=type(pose)(pose.T_object_root, np.full_like(pose.q, np.nan)))
    found = until(lambda: thumbnails.of(viewer.state.collection, viewer.state.works, numbers))
    assert set(found) == {1}
    thumbnails.close()


@pytest.mark.usefixtures("one_side")
def test_a_click_on_a_picture_opens_its_grasp_and_its_mark_is_below(
    shown: tuple[BrowsePanel, Page], viewer: Controller, problem: Problem
) -> None:
    panel, page = shown
    page.change(panel.gallery, True)
    until(lambda: panel.table.content.count("<figure") == 4)
    until(lambda: panel.table.content.count("data:image/png") == 4)
    assert "<th" not in panel.table.content
    page.change(panel.clicks, "open 2 0.1")
    until(lambda: viewer.state.number == 2)
    viewer.become(viewer.state.evolve(collection=viewer.state.collection.with_mark(2, "good")))
    until(lambda: "✓" in panel.table.content)
    page.change(panel.gallery, False)
    until(lambda: "<th" in panel.table.content)
