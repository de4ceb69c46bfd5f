"""A scene in a real browser: what is around the object is drawn, and the trajectory is planned and played."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from browser import ViserPage, until
from viewer_process import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TABLE = "/grasp/environment/0/mesh/0"


@pytest.fixture(scope="module")
def page(start_viewer: Callable[..., Viewer], browser: Browser) -> Iterator[ViserPage]:
    viewer = start_viewer("--scene", "mug-on-table", "--hand", "allegro", "--grasps", "sample:1")
    opened = ViserPage(browser)
    opened.open(viewer.address)
    opened.wait_for_node(TABLE)
    yield opened
    assert opened.errors == []
    opened.close()


def test_the_trajectory_over_the_table_is_planned_and_played(page: ViserPage) -> None:
    assert page.visible(TABLE)
    start = page.pose("/grasp/object")[2, 3]
    page.tab("Validate")
    assert page.value("Protocol") == "scene"
    page.click("Plan the trajectory")
    page.wait_for_text("The trajectory is free")
    # It plays by itself, to the end of the lift.
    until(lambda: page.pose("/grasp/object")[2, 3] > start + 0.099, "the object is lifted by 10 cm")
    np.testing.assert_allclose(page.pose(TABLE)[:2, 3], 0.0, atol=0.5)
    page.click("Close replay")
    until(lambda: abs(page.pose("/grasp/object")[2, 3] - start) < 1e-6, "the object is where it was")
