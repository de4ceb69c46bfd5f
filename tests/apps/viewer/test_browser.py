"""The viewer in a real browser: one page serves all tests; what it shows is compared with the state of its server."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

from browser import ViserPage, act, until
from grasp_refine.core.se3 import transform_points
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses
from grasp_refine_apps.viewer.model.columns import STATUS
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.panels.app import Viewer
from grasp_refine_apps.viewer.panels.session import Session
from grasp_refine_apps.viewer.server.page import open_server
from open_viewer import controller, example, settled

if TYPE_CHECKING:
    from playwright.sync_api import Browser

THUMB, THUMB_LINK = "/grasp/hand/20", "link_15.0_tip"
"""The last link of the embedded hand's thumb, which should touch and lies before the mug on the right."""

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


@pytest.fixture(scope="module")
def viewer(problem: Problem, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewer]:
    """The embedded example, in a folder of its own for the marks, and measured."""
    path = tmp_path_factory.mktemp("example") / "mug.npz"
    path.write_bytes(problem.files[0].read_bytes())
    with Viewer(open_server("127.0.0.1", 0), controller(example(grasps=path))) as opened:
        opened.controller.background.measure()
        settled(opened.controller)
        yield opened


@pytest.fixture(scope="module")
def opened(viewer: Viewer, browser: Browser) -> Iterator[ViserPage]:
    page = ViserPage(browser)
    page.open(viewer.address)
    page.wait_for_node(THUMB)
    yield page
    page.close()


@pytest.fixture
def page(viewer: Viewer, opened: ViserPage) -> Iterator[ViserPage]:
    """The page with the first grasp as in its file."""
    made = viewer.controller
    made.grasps.show(0)
    made.become(replace(made.state, works={0: made.state.collection.work(0)}, listing=Listing()))
    opened.tab("Refine")
    opened.close_notifications()
    yield opened
    assert opened.errors == []


def wait_for_pose(viewer: Viewer, page: ViserPage, pose: Pose) -> None:
    """Wait until the thumb is drawn where kinematics has it in a pose of the hand."""
    T = LinkPoses.of(viewer.controller.state.scene.hand)(pose.T_object_root, pose.q)[THUMB_LINK]
    until(lambda: np.allclose(page.pose(THUMB), T, atol=1e-5), "the thumb where kinematics has it")


def shown(viewer: Viewer) -> Session:
    """The first page."""
    return next(session for session in viewer.sessions.values() if session.controller is viewer.controller)


def press(page: ViserPage, key: str) -> None:
    """Press a key somewhere in the scene."""
    page.page.evaluate("() => document.activeElement.blur()")
    page.page.keyboard.press(key)
    page.let_it_send()


def test_a_grasp_is_seen_refined_scrubbed_and_reloaded(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    red, _, blue = page.wait_for_scene().astype(int).transpose(2, 0, 1)
    # Links that should touch are orange, the object is blue.
    assert (red > blue + 50).sum() > 3000 and (blue > red + 15).sum() > 3000
    came = made.state.pose
    wait_for_pose(viewer, page, came)
    assert page.visible("/grasp/object/mesh/0") and "/grasp/ghost/20" not in page.nodes(), "it is as in its file"
    page.click("Start")
    until(lambda: made.state.outcome is not None, "a result")
    settled(made)
    trace, refined = made.state.trace, made.state.pose
    wait_for_pose(viewer, page, refined)
    page.wait_for_text(f"contact error {1e3 * made.state.outcome['contact_error_m'][0, 1]:.2f} mm")
    # Without a graphics card, the input hand and the ground are not even sent.
    assert not {"/grasp/ghost/20", "/ground/grid"} & page.nodes()
    until(lambda: page.value("Iteration") == str(len(trace) - 1), "the timeline at the end")
    act(lambda: page.drag_slider("Iteration", 0.98, 0.5, 0.0), lambda: made.state.frame == 0, "the first iteration")
    wait_for_pose(viewer, page, came)
    page.wait_for_text(f"contact error {1e3 * made.state.outcome['contact_error_m'][0, 0]:.2f} mm")
    page.enter("Iteration", 3)
    wait_for_pose(viewer, page, trace.pose(3))

    def chart() -> dict[str, np.ndarray]:
        return next(iter(page.plots()), {"": np.zeros(0), "shown now": np.zeros(0)})

    for again in (False, True):
        if again:
            page.reload()
            page.wait_for_node(THUMB)
            wait_for_pose(viewer, page, trace.pose(3))
            until(lambda: page.value("Iteration") == "3", "the timeline where it was")
        page.wait_for_text(f"remaining gap {1e3 * trace.remaining[3]:.2f} mm")
        until(lambda: 3 in chart()[""][np.isfinite(chart()["shown now"])], "the line in the chart")
        x, gaps = chart()[""].astype(int), chart()["remaining gap"]
        np.testing.assert_allclose(gaps, np.maximum(1e3 * trace.remaining[x], 1e-3), rtol=1e-6)


@pytest.mark.slow
def test_fifty_clicks_on_start_and_stop_leave_a_page_that_refines(viewer: Viewer, page: ViserPage) -> None:
    start, stop = page.button("Start"), page.button("Stop")
    for k in range(50):
        (start, stop)[k % 2].dispatch_event("click")
    until(lambda: page.button("Start").is_enabled(), "nothing is being refined")
    if page.button("Reset").is_enabled():
        page.click("Reset")
    until(lambda: viewer.controller.state.pose.same(viewer.controller.state.initial), "the input grasp")
    page.click("Start")
    until(lambda: viewer.controller.state.outcome is not None, "a result")


def test_a_link_opens_grasp_and_tab_of_its_own_page_and_both_share_their_work(
    viewer: Viewer, page: ViserPage, open_page: Callable[..., ViserPage]
) -> None:
    made, camera = viewer.controller, page.camera()
    other = open_page(viewer.address, (700, 500), query="grasp=2&tab=prove&drawing=full")
    tab = other.page.get_by_role("tab", name="Validate", exact=True)
    until(lambda: tab.count() and tab.get_attribute("aria-selected") == "true", "the tab of the link")
    (its,) = (session.controller for session in viewer.sessions.values() if session.controller is not made)
    until(lambda: its.state.number == 2, "the grasp of the link")
    until(lambda: "tab=validate" in other.page.evaluate("() => location.search"), "the tab in the address")
    until(lambda: other.page.title().startswith("mug.npz"), "the file in the title")
    # A small window has scene and panel, and the whole hand in the scene.
    until(lambda: other.scene_size() == (312.0, 500.0), "a scene beside the panel")
    other.wait_for_node(THUMB)
    tips = ("/grasp/hand/0", THUMB)
    until(lambda: all(0 < other.pixel(other.pose(name)[:3, 3])[0] < 312 for name in tips), "the whole hand")
    # The first page stays at its grasp, where its camera was.
    assert made.state.number == 0 and "grasp=mug+0" in page.page.evaluate("() => location.search")
    assert page.page.get_by_role("tab", name="Refine", exact=True).get_attribute("aria-selected") == "true"
    its.editor.set_joint(15, 0.5)
    its.grasps.mark(2, "good")
    wait_for_pose(viewer, other, its.state.pose)
    until(lambda: {"/grasp/ghost/20", "/ground/grid"} <= other.nodes(), "the input hand and the ground")
    wait_for_pose(viewer, page, made.state.pose)
    np.testing.assert_allclose(page.camera(), camera, atol=1e-6)
    press(page, "ArrowRight")
    press(page, "ArrowRight")
    until(lambda: made.state.number == 2, "the same grasp")
    assert made.state.collection.mark(2) == "good" and made.state.pose is its.state.pose
    wait_for_pose(viewer, page, its.state.pose)
    made.editor.set_joint(15, 0.7)
    wait_for_pose(viewer, other, made.state.pose)
    its.grasps.mark(2, "")


def test_keys_step_and_mark_and_typing_is_no_command(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    page.folder("More settings")
    box = page.row("Iterations").locator("input")
    assert box.get_attribute("placeholder"), "the default of an empty field is not shown"
    box.focus()
    page.page.keyboard.type("g b f ")
    page.page.keyboard.press("ArrowRight")
    box.fill("")
    box.blur()
    page.folder("More settings")
    assert made.state.number == 0 and made.state.collection.mark(0) == ""
    for key, number, mark in (
        ("ArrowRight", 1, ""), ("g", 1, "good"), ("b", 1, "bad"), ("b", 1, ""), ("ArrowLeft", 0, ""),
    ):  # fmt: skip
        press(page, key)
        until(lambda n=number, m=mark: (made.state.number, made.state.collection.mark(n)) == (n, m), f"key {key}")
    camera = page.resting_camera()
    # The camera follows the grasp until it is moved; F fits the camera of this page.
    page.page.mouse.move(400, 400)
    act(
        lambda: [page.page.mouse.wheel(0, 400) for _ in range(3)],
        lambda: not np.allclose(page.camera(), camera, atol=0.02),
        "a camera that steps back",
    )
    until(lambda: shown(viewer).view._moved, "the server knows")
    away = page.resting_camera()
    press(page, "ArrowRight")
    until(lambda: made.state.number == 1, "the next grasp")
    wait_for_pose(viewer, page, made.state.pose)
    np.testing.assert_allclose(page.camera()[:3, 3], away[:3, 3], atol=0.02)
    back = "the camera back at hand and object"
    act(lambda: press(page, "f"), lambda: not np.allclose(page.camera()[:3, 3], away[:3, 3], atol=0.08), back)


def test_clicks_on_the_table_sort_and_open(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    page.tab("Browse")
    quality = made.state.collection.columns["quality_after"].values
    for descending in (True, False):
        head = page.page.locator(".gr-table th", has_text="Quality")
        act(head.click, lambda d=descending: made.state.listing == Listing("quality_after", d), "a sorted list")
    order = np.argsort(quality, kind="stable").tolist()
    rows = page.page.locator(".gr-table tbody tr")
    first = page.page.locator(".gr-table tbody tr td:first-child")
    until(lambda: first.all_text_contents() == [str(row) for row in order], "rows in this order")
    for _ in range(2):
        # A row is opened again after another way of leaving it.
        act(rows.nth(3).click, lambda: made.state.number == order[3], "the grasp of the row")
        made.grasps.show(order[1])
        until(lambda: page.page.locator(".gr-open td").first.inner_text() == str(order[1]), "its row is marked")


def test_a_brush_over_a_histogram_filters_the_list_and_a_click_lists_all(viewer: Viewer, page: ViserPage) -> None:
    page.tab("Browse")
    page.folder("Sort and filter")
    chart = page.page.locator("svg[data-brush]")

    def brush() -> None:
        chart.scroll_into_view_if_needed()
        box = chart.bounding_box()
        y = box["y"] + box["height"] / 2
        page.page.mouse.move(box["x"] + 0.5 * box["width"], y)
        page.page.mouse.down()
        page.page.mouse.move(box["x"] + box["width"], y, steps=4)
        page.page.mouse.up()

    ((key, low, high),) = act(brush, lambda: viewer.controller.state.listing.ranges, "a range of the measure")
    values = viewer.controller.state.collection.columns[key].values
    middle = (np.nanmin(values) + np.nanmax(values)) / 2
    assert low == pytest.approx(middle, abs=0.02 * np.ptp(values)) and high == pytest.approx(np.nanmax(values))

    def click() -> None:
        chart.hover()
        page.page.mouse.down()
        # The server may replace the histogram between both halves of a click, and while it does there is none.
        chart.evaluate("svg => svg.replaceWith(svg.cloneNode(true))")
        page.page.mouse.up()

    act(click, lambda: not viewer.controller.state.listing.ranges, "all of them")
    page.folder("Sort and filter")


def test_hints_stand_beside_the_panel(page: ViserPage) -> None:
    panel = page.page.locator("[role=tablist]").bounding_box()
    page.row("Freeze").locator("input").hover()
    hint = page.page.locator(".mantine-Tooltip-tooltip")
    hint.wait_for(state="visible")
    until(lambda: (box := hint.bounding_box()) and box["x"] + box["width"] <= panel["x"] + 1, "a hint aside")
    page.page.mouse.move(100, 600)


def test_a_fingertip_that_is_dragged_takes_its_finger_along(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    page.tab("Edit")
    act(lambda: page.row("Fingers").locator("input").check(), lambda: made.state.gizmo == "fingers", "the choice")
    before, camera = made.state.pose, page.camera()
    middle = shown(viewer).view.nodes.shapes[20].vertices.astype(float).mean(axis=0)
    x, y = page.pixel(transform_points(page.pose(THUMB), middle))

    def drag() -> None:
        page.page.mouse.move(x, y)
        page.page.mouse.down()
        page.page.mouse.move(x + 40, y + 20, steps=5)
        page.page.mouse.up()

    act(drag, lambda: made.state.undo_steps, "a finger that follows")
    page.let_it_send()
    until(lambda: not np.array_equal(made.state.pose.q[12:], before.q[12:]), "another thumb")
    assert np.array_equal(made.state.pose.q[:12], before.q[:12])
    wait_for_pose(viewer, page, made.state.pose)
    np.testing.assert_allclose(page.camera(), camera, atol=1e-9)
    made.set(gizmo="none")


def test_an_object_is_pulled_with_the_mouse_while_it_is_simulated(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    made.grasps.show(1)
    page.tab("Validate")
    page.click("Pull live")
    page.wait_for_text("held so far")
    x, y = page.pixel((0.0, 0.0, 0.02))
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x - 60, y + 40, steps=5)
    until(lambda: made.state.motion.is_pushed(0), "a force")
    page.page.mouse.up()
    until(lambda: not made.state.motion.is_pushed(0), "no force after the mouse")
    page.enter("Pull, N", 30)
    page.wait_for_text("lost (")
    until(lambda: made.state.job is None, "the end")
    until(lambda: page.button("Pull live").is_enabled(), "another trial can begin")
    page.tab("Refine")
    until(lambda: made.state.motion is None, "the grasp")


@pytest.mark.slow
def test_a_link_ends_where_two_clicks_in_the_scene_said(viewer: Viewer, page: ViserPage) -> None:
    made = viewer.controller
    made.refinement.start()
    settled(made)
    wait_for_pose(viewer, page, made.state.pose)
    made.targets.set_picking(True)
    # A place on the thumb that the camera sees and that can touch, and one on the mug above it, both clear of edges.
    side = page.pose("/grasp/contacts/link/3")[:3, 3] + (0.0015, 0.0067, 0.0097)
    wanted = page.pose("/grasp/contacts/object/3")[:3, 3] + (-0.0062, 0.0007, 0.0182)
    act(lambda: page.click_point(side), lambda: made.state.picked, "a click on the thumb")
    assert made.state.picked[0] == THUMB_LINK
    act(lambda: page.click_point(wanted), lambda: made.state.targets, "a click on the mug")
    (target,) = made.state.targets
    assert np.linalg.norm(target.point_object - wanted) < 0.003
    made.targets.set_picking(False)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_the_contrast_of_wcag_aa(viewer: Viewer, browser: Browser, scheme: str) -> None:
    opened = ViserPage(browser)

    def weak() -> list[tuple[str, float]]:
        return [(text, ratio) for text, ratio in opened.page.evaluate(CONTRASTS) if ratio < 4.5]

    opened.page.emulate_media(color_scheme=scheme)
    opened.open(viewer.address)
    attribute = "() => document.documentElement.dataset.mantineColorScheme"
    until(lambda: opened.page.evaluate(attribute) == scheme, f"a {scheme} page")
    for tab in ("Refine", "Edit", "Validate", "Browse", "Files", "View"):
        opened.tab(tab)
        opened.page.mouse.move(300, 600)
        # Colours of buttons change slowly.
        with contextlib.suppress(AssertionError):
            until(lambda: not weak(), "strong contrasts", 20.0)
        assert not weak(), f"{tab}: {weak()}"
    # The system changes its mind.
    opened.page.emulate_media(color_scheme="dark" if scheme == "light" else "light")
    until(lambda: opened.page.evaluate(attribute) != scheme, "the other colours")
    opened.close()


@pytest.mark.slow
def test_a_mesh_is_uploaded_and_names_in_files_run_no_scripts(viewer: Viewer, page: ViserPage, tmp_path: Path) -> None:
    """The last test: other grasps are open at its end."""
    made, upload = viewer.controller, "Upload mesh, hand or grasps"
    (tmp_path / "text.obj").write_text("this is no mesh\n", encoding="utf-8")
    trimesh.creation.icosphere(2, 0.04).export(tmp_path / "ball.obj")
    page.tab("Files")
    page.upload(upload, tmp_path / "text.obj")
    page.wait_for_text("text.obj")
    until(lambda: made.state.notice is not None and made.state.notice.bad, "a refusal")

    ball = tmp_path / "ball.obj"
    act(lambda: page.upload(upload, ball), lambda: made.state.scene.object.name == "ball", "the ball", 30.0)
    made.grasps.reopen(0)
    evil = '<img src=x onerror="window.evil=1">"\'><script>window.evil=1</script>{window.evil=1}'
    collection = made.state.collection
    (group,) = collection.problem.groups
    problem = replace(collection.problem, groups=(replace(group, object=evil),))
    made.grasps.open(replace(collection, problem=problem).with_columns(STATUS.with_values(np.full(4, evil))), 1)
    page.tab("Browse")
    page.wait_for_text(f"{evil} 1")
    assert page.page.evaluate("() => window.evil") is None
