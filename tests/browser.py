"""A viser page in Debian's headless Chromium: what it draws, and hands for its widgets and its scene.

A test reads what a person would see (pixels, texts, charts), and poses of scene nodes from the objects of three.js.
Points and poses are in the world frame of viser (z up), lengths in metres, pixels from the window's upper left corner.
"""

from __future__ import annotations

import shutil
import time
from base64 import b64decode
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Locator, Page

VIEWPORT = (1400, 900)
"""Width and height in pixels; viser's panel needs a window of at least 1200."""

FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL without a graphics card, as root in a container."""

NOISE = ("Unable to preventDefault inside passive event listener",)
"""What viser's page complains of when nothing is wrong: here, while a node is dragged."""

DETAIL = 0.2
"""Pixels drawn per pixel of the window, along each axis: without a graphics card a scene takes a second at 1."""

SECONDS = 120.0
"""How long a helper waits for what it was asked for before the test fails."""

POSE = """name => {
    const nodes = window.__viserMutable.nodeRefFromName;
    if (!nodes[name]) return null;
    nodes[name].updateWorldMatrix(true, false);
    return [nodes[''].matrixWorld.toArray(), nodes[name].matrixWorld.toArray()];
}"""

PROJECTION = """() => {
    const page = window.__viserMutable, box = page.canvas.getBoundingClientRect();
    page.camera.updateMatrixWorld();
    return [page.nodeRefFromName[''].matrixWorld, page.camera.matrixWorldInverse, page.camera.projectionMatrix]
        .map(m => m.toArray()).concat([[box.left, box.top, box.width, box.height]]);
}"""

PLOTS = """() => Object.values((window.__viserTestpoints || {}).uplots || {}).map(({chart}) =>
    [chart.series.slice(1).map(s => s.label), chart.data.map(column => Array.from(column))])"""


def chromium() -> str | None:
    """Where the browser lies; None if there is none."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def headless() -> Iterator[Browser]:
    """A headless Chromium that draws WebGL without a graphics card."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


def until(true: Callable[[], Any], what: str, seconds: float = SECONDS) -> Any:
    """What `true` returns as soon as that counts as true; fails with `what` when it does not in time."""
    end = time.monotonic() + seconds
    while not (value := true()):
        assert time.monotonic() < end, f"not within {seconds:g} s: {what}"
        time.sleep(0.03)
    return value


def act(gesture: Callable[[], object], done: Callable[[], Any], what: str, patience_s: float = 5.0) -> Any:
    """Repeat a gesture until `done` returns a true value, which is returned: a panel that moves or is replaced while a
    person points at it takes no notice.

    Args:
        gesture: What a person does.
        done: As `true` of `until`.
        what: As there.
        patience_s: Time in seconds after which a gesture that nothing followed is repeated.
    """

    def tried() -> Any:
        gesture()
        end = time.monotonic() + patience_s
        while not (value := done()) and time.monotonic() < end:
            time.sleep(0.03)
        return value

    return until(tried, what)


def matrix(numbers: Sequence[float]) -> np.ndarray:
    """A matrix of three.js, which stores columns."""
    return np.array(numbers, dtype=float).reshape(4, 4).T


class ViserPage:
    """One page, live or of a file, with the errors of its console."""

    def __init__(self, browser: Browser, size: tuple[int, int] = VIEWPORT):
        context = browser.new_context(viewport={"width": size[0], "height": size[1]}, accept_downloads=True)
        self.page: Page = context.new_page()
        self.errors: list[str] = []
        """What went wrong in the page: errors of the console and exceptions that nothing caught."""
        self.requests: list[str] = []
        """Every address that the page asked for."""
        self.page.on("console", self._listen)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def _listen(self, message: ConsoleMessage) -> None:
        if message.type == "error" and not message.text.startswith(NOISE):
            self.errors.append(message.text)

    def close(self) -> None:
        """Close the page and forget its session."""
        self.page.context.close()

    def open(self, address: str, query: str = "") -> None:
        """Load an address and wait until its scene exists; viser's remark on slow graphics is closed."""
        self.page.goto(f"{address}{'&' if '?' in address else '?'}{query}&fixedDpr={DETAIL:g}")
        ready = "() => window.__viserMutable && window.__viserMutable.nodeRefFromName['']"
        self.page.wait_for_function(ready, timeout=1000 * SECONDS)
        self.close_notifications()

    def reload(self) -> None:
        """Load the page again, in the same window."""
        self.open(self.page.url.split("?")[0])

    # What is drawn.

    def canvas_box(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the 3D scene in the window."""
        left, top, width, height = self.page.evaluate(PROJECTION)[3]
        return left, top, width, height

    def scene_size(self) -> tuple[float, float]:
        """Width and height of the place of the 3D scene in the window, which the canvas takes when viser measures."""
        box = "window.__viserMutable.canvas.parentElement.getBoundingClientRect()"
        width, height = self.page.evaluate(f"() => [{box}.width, {box}.height]")
        return width, height

    def picture(self) -> np.ndarray:
        """The pixels of the 3D scene as drawn, on white, (height, width, 3) uint8: what lies above it is left out."""
        # A screenshot of the page would wait until the browser has nothing else to draw.
        address = self.page.evaluate("() => window.__viserMutable.canvas.toDataURL('image/png')")
        drawn = Image.open(BytesIO(b64decode(address.split(",")[1]))).convert("RGBA")
        white = Image.new("RGBA", drawn.size, "white")
        _, _, width, height = self.canvas_box()
        size = round(width), round(height)
        return np.asarray(Image.alpha_composite(white, drawn).convert("RGB").resize(size, Image.Resampling.NEAREST))

    def wait_for_scene(self) -> np.ndarray:
        """The picture, as soon as more than 1 % of its pixels differ from the white background."""

        def drawn() -> np.ndarray | None:
            picture = self.picture()
            return picture if (picture < 235).all(axis=-1).mean() > 0.01 else None

        end = time.monotonic() + SECONDS
        while (picture := drawn()) is None:
            assert time.monotonic() < end, f"nothing was drawn within {SECONDS:g} s"
        return picture

    # The scene.

    def nodes(self) -> set[str]:
        """The names of all nodes that exist in three.js, hidden ones too."""
        return set(self.page.evaluate("() => Object.keys(window.__viserMutable.nodeRefFromName)"))

    def wait_for_node(self, name: str) -> None:
        """Wait until a node exists."""
        until(lambda: name in self.nodes(), f"node {name}")

    def pose(self, name: str) -> np.ndarray:
        """T_world_node (4, 4) as drawn."""
        matrices = self.page.evaluate(POSE, name)
        assert matrices is not None, f"no node {name}; there are {sorted(self.nodes())}"
        T_three_world, T_three_node = map(matrix, matrices)
        return np.linalg.solve(T_three_world, T_three_node)

    def visible(self, name: str) -> bool:
        """Whether a node and all above it are shown."""
        state = self.page.evaluate("name => window.__viserSceneTree.getState()[name]?.effectiveVisibility", name)
        assert state is not None, f"no node {name}; there are {sorted(self.nodes())}"
        return bool(state)

    def camera(self) -> np.ndarray:
        """T_world_camera (4, 4) of three.js: x right, y up, looking along -z."""
        T_three_world, T_camera_three = map(matrix, self.page.evaluate(PROJECTION)[:2])
        return np.linalg.inv(T_camera_three @ T_three_world)

    def resting_camera(self) -> np.ndarray:
        """`camera`, once it rests: it glides, and a busy page draws seldom."""
        now = self.camera()
        while True:
            before = now
            self.page.wait_for_timeout(500)
            self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            now = self.camera()
            if np.allclose(now, before, atol=1e-4):
                return now

    def pixel(self, point: Sequence[float] | np.ndarray) -> tuple[float, float]:
        """Where the window shows a point of the world."""
        T_three_world, T_camera_three, projection = map(matrix, self.page.evaluate(PROJECTION)[:3])
        left, top, width, height = self.canvas_box()
        x, y, _, w = projection @ T_camera_three @ T_three_world @ np.append(point, 1.0)
        assert w > 0.0, f"{point} is behind the camera"
        return left + (1.0 + x / w) / 2.0 * width, top + (1.0 - y / w) / 2.0 * height

    def click_point(self, point: Sequence[float] | np.ndarray) -> None:
        """Click where the window shows a point of the world."""
        x, y = self.pixel(point)
        self.page.mouse.move(x, y)  # viser finds what lies under the pointer when it moves
        self.page.mouse.click(x, y)

    # The widgets. viser sends one message in 50 ms and forgets all but the last in between, of whichever widget.

    def let_it_send(self) -> None:
        """Wait for viser's next message."""
        self.page.wait_for_timeout(60)

    def row(self, label: str) -> Locator:
        """The row of a widget, by its label; the first if several are shown."""
        text = f"label[normalize-space()={quoted(label)}]"
        rows = self.page.locator(f"xpath=//{text}/ancestor::div[contains(@class, 'mantine-Flex-root')][1]")
        return rows.locator("visible=true").first

    def button(self, label: str) -> Locator:
        """A button, by its words."""
        return self.page.get_by_role("button", name=label, exact=True).first

    def click(self, label: str) -> None:
        """Click a button as soon as it is there and enabled."""
        self.button(label).click(timeout=1000 * SECONDS)
        self.let_it_send()

    def tab(self, label: str) -> None:
        """Bring a tab to the front."""
        tab = self.page.get_by_role("tab", name=label, exact=True)
        tab.click(timeout=1000 * SECONDS)
        until(lambda: tab.get_attribute("aria-selected") == "true", f"tab {label} in front")

    def folder(self, label: str) -> None:
        """Open or close a folder."""
        self.page.locator(
            f"xpath=//div[contains(@class, 'mantine-Paper-root') and normalize-space()={quoted(label)}]"
        ).first.click()

    def value(self, label: str) -> str:
        """What a slider, a number, a text, or a choice shows."""
        return self.row(label).locator("input:not([type=hidden])").last.input_value(timeout=1000 * SECONDS)

    def enter(self, label: str, value: float | str) -> None:
        """Type a value into a slider's box, a number or a text."""
        box = self.row(label).locator("input:not([type=hidden])").last
        box.fill(str(value), timeout=1000 * SECONDS)
        box.blur()
        self.let_it_send()

    def drag_slider(self, label: str, *shares: float, steps: int = 8) -> None:
        """Hold a slider and move it through `shares` of its way, 0 left, 1 right, in `steps` each."""
        box = self.row(label).locator(".mantine-Slider-track").bounding_box(timeout=1000 * SECONDS)
        assert box is not None, f"slider {label} is not shown"
        places = [(box["x"] + share * box["width"], box["y"] + box["height"] / 2.0) for share in shares]
        self.page.mouse.move(*places[0])
        self.page.mouse.down()
        for place in places[1:]:
            self.page.mouse.move(*place, steps=steps)
        self.page.mouse.up()
        self.let_it_send()

    def upload(self, label: str, file: Path) -> None:
        """Give a file to an upload button."""
        with self.page.expect_file_chooser(timeout=1000 * SECONDS) as chosen:
            self.click(label)
        chosen.value.set_files(file)

    # What is said.

    def wait_for_text(self, words: str) -> None:
        """Wait until the page shows some words, in a panel or a notification."""
        until(lambda: words in self.page.locator("body").inner_text(), f"the words {words!r}")

    def close_notifications(self) -> None:
        """Close every notification: they hide part of the scene."""
        self.page.evaluate(
            "() => document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
        )
        shown = self.page.locator(".mantine-Notification-root")
        until(lambda: not shown.count(), "all notifications closed")

    def plots(self) -> list[dict[str, np.ndarray]]:
        """The charts that are shown: name of a line -> heights (n,), gaps are NaN; "": places along the x axis."""
        return [
            {name: np.array(line, dtype=float) for name, line in zip(["", *names], columns, strict=True)}
            for names, columns in self.page.evaluate(PLOTS)
        ]


def quoted(text: str) -> str:
    """A string of XPath, which knows no escapes."""
    assert '"' not in text, "labels hold no double quotes"
    return f'"{text}"'
