"""Keys, links, the tab's title, the system's colours, hints and small windows, in a real browser."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from browser import ViserPage, until
from viewer_process import Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

CONTRASTS = """() => {
    // Contrast of each text that is shown with what lies behind it, by the formula of WCAG 2.
    const parse = text => {
        const found = text.match(/rgba?\\(([^)]*)\\)/);
        const [r, g, b, a = 1] = found ? found[1].split(/[ ,/]+/).map(Number) : [0, 0, 0, 0];
        return {rgb: [r, g, b], a};
    };
    const over = (top, below) => top.rgb.map((c, k) => top.a * c + (1 - top.a) * below[k]);
    const luminance = rgb => rgb.map(c => c / 255).map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
        .reduce((sum, c, k) => sum + c * [0.2126, 0.7152, 0.0722][k], 0);
    const dark = document.documentElement.dataset.mantineColorScheme === "dark";
    const found = [], exempt = "[data-disabled],:disabled,[aria-disabled=true],script,style,canvas";
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
        const element = walker.currentNode.parentElement, text = walker.currentNode.nodeValue.trim();
        if (!text || !element || element.closest(exempt)) continue;
        const box = element.getBoundingClientRect();
        if (!box.width || !box.height || !element.checkVisibility({opacityProperty: true, visibilityProperty: true}))
            continue;
        const layers = [];
        let opacity = 1;
        for (let each = element; each; each = each.parentElement) {
            layers.unshift(parse(getComputedStyle(each).backgroundColor));
            opacity *= Number(getComputedStyle(each).opacity);
        }
        const back = layers.reduce((below, layer) => over(layer, below), dark ? [20, 20, 20] : [255, 255, 255]);
        const color = parse(getComputedStyle(element).color);
        const front = over({rgb: color.rgb, a: color.a * opacity}, back);
        const [low, high] = [luminance(front), luminance(back)].sort((a, b) => a - b);
        found.push([text.slice(0, 40), (high + 0.05) / (low + 0.05)]);
    }
    return found;
}"""

OVERLAPS = """() => {
    // Pairs of widgets that cover each other, and those that reach out of the window.
    const found = [], boxes = [...document.querySelectorAll("button,input:not([type=hidden]),label,[role=tab]")]
        .filter(e => e.checkVisibility() && e.getBoundingClientRect().width > 2)
        .map(e => [e, e.getBoundingClientRect()]);
    for (const [k, [one, a]] of boxes.entries()) {
        if (a.left < -1 || a.right > innerWidth + 1) found.push([one.outerHTML.slice(0, 90), "outside"]);
        for (const [other, b] of boxes.slice(k + 1)) {
            if (one.contains(other) || other.contains(one)) continue;
            const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
            const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
            const field = ".mantine-InputWrapper-root,.mantine-Input-wrapper", same = one.closest(field);
            if (wide > 3 && high > 3 && !(same && same === other.closest(field)))
                found.push([one.outerHTML.slice(0, 90), other.outerHTML.slice(0, 90)]);
        }
    }
    return found;
}"""


@pytest.fixture(scope="module")
def viewer(start_viewer: Callable[..., Viewer]) -> Viewer:
    """The embedded example."""
    return start_viewer()


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[ViserPage]:
    opened = ViserPage(browser)
    opened.open(viewer.address)
    until(lambda: shown(opened) is not None, "an address that follows")
    yield opened
    opened.close()


def shown(page: ViserPage) -> str | None:
    """The number of the shown grasp, by the address."""
    return page.page.evaluate("() => new URLSearchParams(location.search).get('grasp')")


def press(page: ViserPage, key: str) -> None:
    """Press a key somewhere in the scene."""
    page.page.evaluate("() => document.activeElement.blur()")
    page.page.keyboard.press(key)
    page._let_it_send()


def test_keys_step_and_mark_and_the_camera_stays(page: ViserPage):
    page.tab("Browse")
    page.page.evaluate("() => document.activeElement.blur()")
    camera = page.camera()
    press(page, "ArrowRight")
    until(lambda: shown(page) == "1", "the next grasp")
    np.testing.assert_allclose(page.camera(), camera)
    press(page, "g")
    page.wait_for_text("marked good")
    press(page, "b")
    page.wait_for_text("marked bad")
    press(page, "b")
    until(lambda: "marked" not in page.text(), "the mark taken back")
    press(page, "ArrowLeft")
    until(lambda: shown(page) == "0", "the one before")


def test_typing_is_no_command(page: ViserPage):
    page.tab("Refine")
    number = shown(page)
    box = page.row("Iterations").locator("input")
    assert box.get_attribute("placeholder"), "the default of an empty field is not shown"
    box.focus()
    page.page.keyboard.type("g b f ")
    page.page.keyboard.press("ArrowRight")
    box.fill("")
    box.blur()
    page.tab("Browse")
    assert shown(page) == number and "marked" not in page.text()


def test_f_fits_the_camera_of_one_page(page: ViserPage):
    moved = page.camera()
    page.page.mouse.move(400, 400)
    for _ in range(3):
        page.page.mouse.wheel(0, 400)
    until(lambda: not np.allclose(page.camera(), moved, atol=0.02), "a camera that steps back")
    press(page, "f")
    until(lambda: np.allclose(page.camera()[:3, 3], moved[:3, 3], atol=0.08), "the camera back at hand and object")


def test_a_link_opens_grasp_and_tab(viewer: Viewer, page: ViserPage, browser: Browser):
    other = ViserPage(browser)
    other.page.goto(f"{viewer.address}/?grasp=2&tab=prove&fixedDpr=0.2")
    tab = other.page.get_by_role("tab", name="Validate", exact=True)
    until(lambda: tab.count() and tab.get_attribute("aria-selected") == "true", "the tab of the link")
    until(lambda: shown(page) == "2", "the grasp of the link")
    until(lambda: "tab=validate" in other.page.evaluate("() => location.search"), "the tab in the address")
    until(lambda: other.page.title().startswith("example_mug.npz"), "the file in the title")
    other.close()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_the_contrast_of_wcag_aa(viewer: Viewer, browser: Browser, scheme: str):
    opened = ViserPage(browser)
    opened.page.emulate_media(color_scheme=scheme)
    opened.open(viewer.address)
    attribute = "() => document.documentElement.dataset.mantineColorScheme"
    until(lambda: opened.page.evaluate(attribute) == scheme, f"a {scheme} page")
    opened.page.wait_for_timeout(300)  # colours of buttons change slowly
    for tab in ("Refine", "Edit", "Validate", "Browse", "Files", "View"):
        opened.tab(tab)
        opened.page.mouse.move(300, 600)
        opened.page.wait_for_timeout(300)
        weak = [(text, ratio) for text, ratio in opened.page.evaluate(CONTRASTS) if ratio < 4.5]
        assert not weak, f"{tab}: {weak}"
    # The system changes its mind.
    opened.page.emulate_media(color_scheme="dark" if scheme == "light" else "light")
    until(lambda: opened.page.evaluate(attribute) != scheme, "the other colours")
    opened.close()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 720), (800, 900)])
def test_small_windows_have_no_overlap_and_the_whole_grasp(
    viewer: Viewer, open_page: Callable[..., ViserPage], size: tuple[int, int]
):
    page = open_page(viewer.address, size)
    page.wait_for_node("/grasp/hand/20")
    for tab in ("Refine", "Browse", "Files"):
        page.tab(tab)
        assert page.page.evaluate(OVERLAPS) == [], tab
    left, _, width, _ = page.canvas_box()

    def whole() -> bool:
        tips = [page.pixel(page.pose(name)[:3, 3])[0] for name in ("/grasp/hand/20", "/grasp/hand/0")]
        return all(left < x < left + page.scene_size()[0] for x in tips)

    until(whole, "all of the hand within the scene")


def test_hints_stand_beside_the_panel(page: ViserPage):
    page.tab("Refine")
    row = page.row("Margin, mm")
    panel = page.page.locator("[role=tablist]").bounding_box()
    row.locator("input").hover()
    hint = page.page.locator(".mantine-Tooltip-tooltip")
    hint.wait_for(state="visible")
    until(
        lambda: (box := hint.bounding_box()) is not None and box["x"] + box["width"] <= panel["x"] + 1, "a hint aside"
    )
    page.page.mouse.move(100, 600)


def test_a_brush_over_a_histogram_filters_the_list_and_a_click_lists_all(page: ViserPage):
    page.tab("Browse")
    page.folder("Sort and filter")
    chart = page.page.locator("svg[data-brush]")
    chart.wait_for(state="visible")
    chart.scroll_into_view_if_needed()

    # The chart moves while grasps are measured, so that a gesture may miss it; none does more when repeated.
    def brushed() -> bool:
        box = chart.bounding_box()
        y = box["y"] + box["height"] / 2
        page.page.mouse.move(box["x"] + 0.5 * box["width"], y)
        page.page.mouse.down()
        page.page.mouse.move(box["x"] + box["width"], y, steps=4)
        page.page.mouse.up()
        page.page.wait_for_timeout(1000)
        return "listed, 4 in all" in page.text()

    def clicked() -> bool:
        # The server may replace the histogram between both halves of a click.
        chart.hover()
        page.page.mouse.down()
        chart.evaluate("svg => svg.replaceWith(svg.cloneNode(true))")
        page.page.mouse.up()
        page.page.wait_for_timeout(1000)
        return "1 to 4 of 4" in page.text()

    until(brushed, "a range of the measure")
    until(clicked, "all of them")
    page.folder("Sort and filter")


@pytest.mark.slow
def test_a_gif_is_recorded_from_the_camera_of_the_page(page: ViserPage, tmp_path: Path):
    page.tab("Refine")
    page.click("Start")
    page.wait_for_text("Converged")
    page.close_notifications()
    page.tab("Files")
    file = page.download("Animation (GIF)", tmp_path)
    width, height = page.scene_size()
    with Image.open(file) as picture:
        assert file.suffix == ".gif" and picture.n_frames > 3
        assert picture.width / picture.height == pytest.approx(width / height, rel=0.03)
        first = np.asarray(picture.convert("RGB"), dtype=int)
        picture.seek(picture.n_frames - 1)
        assert np.abs(np.asarray(picture.convert("RGB"), dtype=int) - first).max() > 100, "nothing moves"
    page.tab("Refine")
    page.click("Reset")
    assert page.errors == []
