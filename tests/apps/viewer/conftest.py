"""The example, its controller and scene, a server, and pages in headless Chromium."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

from browser import VIEWPORT, ViserPage, chromium, headless
from grasp_refine.objects.object import load_object
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.files import hand_files, opening, uploads
from grasp_refine_apps.viewer.jobs.controller import Controller
from made_hands import BALL, joint, link, links, made_hand, slide
from open_viewer import controller, example

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One headless Chromium for all tests."""
    pytest.importorskip("playwright", reason="playwright comes with the extra 'test'")
    if chromium() is None:
        pytest.skip("there is no chromium: apt-get install chromium")
    with headless() as opened:
        yield opened


@pytest.fixture(scope="session")
def problem() -> Problem:
    """The embedded example grasps of Allegro on the mug."""
    return example()


@pytest.fixture(scope="session")
def clamp(tmp_path_factory: pytest.TempPathFactory) -> HandObject:
    """Two balls of 1 cm that hold a ball of 5 cm, and one far away: joint values are the gaps of the two."""
    hand = made_hand(
        tmp_path_factory.mktemp("clamp"),
        link("base") + links("left", "right", "far", inside=BALL),
        slide("l", "base", "left", at="0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1), effort=None, velocity=None),
        slide("r", "base", "right", at="-0.06 0 0", axis="-1 0 0", limits=(-0.1, 0.1), effort=None, velocity=None),
        joint("f", "base", "far", "fixed", at="0 0 0.3"),
        name="clamp",
        toml="".join(f'[[contact]]\nlink = "{side}"\ngroup = "{side}"\n' for side in ("left", "right")),
    )
    return HandObject(hand, load_object("sphere:0.05", candidates=16))


@pytest.fixture
def server() -> Iterator[Any]:
    """A viser server with nothing on it."""
    import viser

    opened = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield opened
    opened.stop()


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    """A controller that shows the first grasp of the problem."""
    made = controller(problem)
    yield made
    made.close()


@pytest.fixture
def view(server: Any, viewer: Controller) -> View:
    """The scene of the viewer, drawn on a server without a browser."""
    made = View(server, viewer)
    made.draw(viewer.state)
    return made


@pytest.fixture
def untried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes are not loaded in a child process first, which takes a second for each and has tests of its own."""
    for module in (hand_files, opening, uploads):
        monkeypatch.setattr(module, "try_meshes", lambda *given: None)


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., ViserPage]]:
    """Opens addresses, each in a page of its own; no page may have complained when the test ends."""
    pages: list[ViserPage] = []

    def open_one(address: str, size: tuple[int, int] = VIEWPORT, query: str = "") -> ViserPage:
        page = ViserPage(browser, size)
        pages.append(page)
        page.open(address, query=query)
        return page

    yield open_one
    complaints = [page.errors for page in pages]
    for page in pages:
        page.close()
    assert not any(complaints), f"errors in the console: {complaints}"
