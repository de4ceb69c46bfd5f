"""The page of an alignment task, on a real server: what is scrubbed is where the bodies are."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator

import numpy as np
import pytest

from shapes_for_tests import cluster_body, convex_body

pytest.importorskip("viser", reason="the viewer comes with the extra 'viewer'")

import viser

from grasp_refine.core.se3 import matrix_from_quaternion, transform_points
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.record import record_task, shown_task
from grasp_refine_apps.bench.align.saved import AlignmentTask
from grasp_refine_apps.bench.align.tasks import draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.viewer.alignment import AlignmentPage
from grasp_refine_apps.viewer.alignment_chart import MIN_ERROR_MM, Chart, best_so_far
from grasp_refine_apps.viewer.alignment_words import mm, where
from grasp_refine_apps.viewer.colors import distance_colors
from grasp_refine_apps.viewer.page import open_server
from websocket_page import Page, until

PAIR = BodyPair("two", "concave", normalised(convex_body(1, 24), 0.06), normalised(cluster_body(3, 4), 0.09))
VARIANTS = (Variant(budget=60), Variant("rigid", optimise="T1T2", budget=20), Variant.least_squares(budget=50))
DISTANCE, RIGID, LEAST_SQUARES = range(3)


@pytest.fixture(scope="module")
def task() -> AlignmentTask:
    return record_task(PAIR, shown_task(draw_tasks(PAIR, ("face-vertex",), 4, 0)), VARIANTS, seed=0)


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    opened = open_server("127.0.0.1", 0)
    yield opened
    opened.stop()


@pytest.fixture
def shown(server: viser.ViserServer, task: AlignmentTask) -> Iterator[AlignmentPage]:
    server.gui.reset()
    server.scene.reset()
    page = AlignmentPage(server, task)
    yield page
    page.close()


@pytest.fixture
def visitor(server: viser.ViserServer, shown: AlignmentPage) -> Iterator[Page]:
    page = Page(server)
    yield page
    page.close()


def pose(handle: viser.SceneNodeHandle) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrix_from_quaternion(np.asarray(handle.wxyz, dtype=float)), handle.position
    return T


def drawn(page: AlignmentPage, **wanted: object) -> None:
    """Wait until the page shows this."""
    until(lambda: all(getattr(page._drawn, name) == value for name, value in wanted.items()))


def test_it_opens_at_the_start_of_the_method_that_did_best(shown: AlignmentPage, task: AlignmentTask):
    assert (shown.shown.method, shown.shown.iteration, shown.shown.playing) == (LEAST_SQUARES, 0, False)
    for body, T in zip(shown.scene.bodies, task.start, strict=True):
        np.testing.assert_allclose(pose(body), T, atol=1e-6)
    assert shown.method.value == "levenberg-marquardt"
    assert 'class="no"' in shown.where.content and " 0</b>" in shown.where.content


def test_scrubbing_moves_the_bodies_to_the_recorded_poses(shown: AlignmentPage, visitor: Page, task: AlignmentTask):
    for method, iteration in ((DISTANCE, 37), (RIGID, 13), (LEAST_SQUARES, 3)):
        visitor.change(shown.method, shown.method.options[method])
        drawn(shown, method=method)
        visitor.change(shown.slider, iteration)
        drawn(shown, iteration=iteration)
        run = task.trajectories[method]
        for body, T in zip(shown.scene.bodies, run.poses[iteration], strict=True):
            np.testing.assert_allclose(pose(body), T, atol=1e-6)
        for dot, point in zip(shown.scene.dots, run.witness[iteration], strict=True):
            np.testing.assert_allclose(dot.position, point, atol=1e-6)
        goals = transform_points(run.poses[iteration], task.targets)
        between, *misses = shown.scene.lines.points
        np.testing.assert_allclose(between, run.witness[iteration], atol=1e-6)
        np.testing.assert_allclose(misses, np.stack([run.witness[iteration], goals], axis=1), atol=1e-6)
        np.testing.assert_array_equal(shown.scene.lines.colors[0, 0], distance_colors(run.distance[[iteration]])[0])
        assert re.search(rf"\b{iteration}</b>\D+\b{run.iteration[-1]}\b", shown.where.content)


def test_at_the_result_body_b_lies_on_body_a_and_the_camera_sees_it_so(shown: AlignmentPage, task: AlignmentTask):
    run = task.trajectories[LEAST_SQUARES]
    R = matrix_from_quaternion(np.asarray(shown.scene.root.wxyz, dtype=float))
    centers = [
        transform_points(T, body.mesh().bounds.mean(axis=0))
        for T, body in zip(run.poses[run.result], task.bodies, strict=True)
    ]
    up = R @ (centers[1] - centers[0])
    np.testing.assert_allclose(up / np.linalg.norm(up), [0.0, 0.0, 1.0], atol=1e-6)
    view = shown.server.initial_camera
    forward = (view.look_at - view.position) / np.linalg.norm(view.look_at - view.position)
    for T in (task.start, run.poses[run.result]):
        for pose_of, body in zip(T, task.bodies, strict=True):
            away = transform_points(pose_of, body.mesh().vertices) @ R.T - view.position
            # All in front of it, and within the height of the picture.
            depth = away @ forward
            right = np.cross(forward, [0.0, 0.0, 1.0])
            height = away @ np.cross(right / np.linalg.norm(right), forward)
            assert (depth > view.near).all() and (np.abs(height) < depth * np.tan(view.fov / 2)).all()


def test_one_can_go_to_what_the_method_gave_back(shown: AlignmentPage, visitor: Page, task: AlignmentTask):
    visitor.change(shown.method, shown.method.options[DISTANCE])
    run = task.trajectories[DISTANCE]
    for word, frame in (("best", run.result), ("end", len(run) - 1), ("start", 0)):
        visitor.change(shown.jump, word)
        drawn(shown, method=DISTANCE, iteration=run.iteration[frame])
        np.testing.assert_allclose(pose(shown.scene.bodies[1]), run.poses[frame, 1], atol=1e-6)
        assert shown.slider.value == run.iteration[frame]


def test_a_run_is_played_to_its_end_and_again(shown: AlignmentPage, visitor: Page, task: AlignmentTask):
    idle = shown.play.label
    visitor.change(shown.method, shown.method.options[RIGID])
    drawn(shown, method=RIGID)
    # Ten iterations are played for 4 s, so that a busy machine sees it play.
    visitor.change(shown.slider, 10)
    drawn(shown, iteration=10)
    visitor.change(shown.play, True)
    drawn(shown, playing=True)
    assert shown.play.label != idle
    drawn(shown, playing=False, iteration=20)
    assert shown.play.label == idle and shown.slider.value == 20
    visitor.change(shown.play, True)
    drawn(shown, playing=True)
    assert shown._drawn.iteration < 20
    visitor.change(shown.play, True)
    drawn(shown, playing=False)


def test_a_shorter_run_is_shown_at_its_end_until_a_longer_one_comes(shown: AlignmentPage, task: AlignmentTask):
    shown.change(method=DISTANCE, iteration=55)
    drawn(shown, iteration=55)
    shown.change(method=RIGID)
    drawn(shown, method=RIGID)
    assert (shown.slider.value, shown.slider.max) == (20, 20)
    np.testing.assert_allclose(pose(shown.scene.bodies[1]), task.trajectories[RIGID].poses[20, 1], atol=1e-6)
    shown.change(method=DISTANCE)
    drawn(shown, method=DISTANCE)
    assert (shown.slider.value, shown.slider.max) == (55, 60)


def test_what_is_seen_beside_the_bodies_can_be_chosen(shown: AlignmentPage, visitor: Page, task: AlignmentTask):
    scene = shown.scene
    visitor.change(shown.slider, 2)
    drawn(shown, iteration=2)
    assert scene.path.visible and scene.bodies[0].opacity < 1 and not any(ghost.visible for ghost in scene.ghosts)
    targets = transform_points(task.trajectories[LEAST_SQUARES].poses[:3, 1], np.tile(task.targets[1], (3, 1)))
    np.testing.assert_allclose(scene.path.points, np.stack([targets[:-1], targets[1:]], axis=1), atol=1e-6)
    visitor.change(shown.others, True)
    until(lambda: shown._drawn.layers.others)
    assert [ghost.visible for ghost in scene.ghosts] == [True, True, False]
    for ghost, run in zip(scene.ghosts, task.trajectories, strict=True):
        np.testing.assert_allclose(pose(ghost), run.poses[run.result, 1], atol=1e-6)
    for widget in (shown.path, shown.see_through):
        visitor.change(widget, False)
        until(lambda widget=widget: not getattr(shown._drawn.layers, "path" if widget is shown.path else "see_through"))
    assert not scene.path.visible and scene.bodies[0].opacity is None


def test_the_chart_shows_the_errors(shown: AlignmentPage, visitor: Page, task: AlignmentTask):
    visitor.change(shown.method, shown.method.options[DISTANCE])
    drawn(shown, method=DISTANCE)
    visitor.change(shown.slider, 30)
    drawn(shown, iteration=30)
    until(lambda: shown._charted is shown._drawn)
    x, *lines, each, here, solved = shown.plot.data
    run = task.trajectories[DISTANCE]
    at = int(np.flatnonzero(np.isfinite(here))[0])
    assert np.isfinite(here).sum() == 1 and x[at] == 31.0
    expected = 1e3 * np.sqrt(run.error[30])
    assert here[at] == each[at] == pytest.approx(expected)
    assert lines[DISTANCE][at] == pytest.approx(1e3 * np.sqrt(run.error[:31].min()))
    assert (np.diff(lines, axis=1) <= 0).all() and (solved == 1.0).all()
    assert [line[-1] for line in lines] == pytest.approx(
        [max(1e3 * np.sqrt(run.error[run.result]), MIN_ERROR_MM) for run in task.trajectories]
    )
    _, cpu_time = shown.against.options
    visitor.change(shown.against, cpu_time)
    drawn(shown, against=cpu_time)
    assert shown.plot.axes[0]["label"] == f"{cpu_time}, ms"
    assert shown.plot.data[0][-1] == pytest.approx(1e3 * max(run.cpu_s[-1] for run in task.trajectories))


def test_two_visitors_see_the_same(server: viser.ViserServer, shown: AlignmentPage, visitor: Page):
    other = Page(server)
    try:
        visitor.change(shown.method, shown.method.options[DISTANCE])
        drawn(shown, method=DISTANCE)
        visitor.change(shown.slider, 12)
        drawn(shown, iteration=12)
        until(lambda: 12 in other.told(shown.slider))
        assert any(" 12</b>" in text for text in other.told(shown.where, "content"))
    finally:
        other.close()


def test_it_scrubs_quickly(shown: AlignmentPage):
    """Without a browser: what this process does for each iterate is done many times in the 1/15 s that it may take."""
    shown.change(method=DISTANCE)
    drawn(shown, method=DISTANCE)
    began = time.process_time()
    for iteration in range(60):
        shown._draw(type(shown.shown)(DISTANCE, iteration))
    assert time.process_time() - began < 60 / 15


def test_an_iterate_without_witness_points_is_told_and_draws_none(server: viser.ViserServer):
    start = shown_task(draw_tasks(PAIR, ("face-vertex",), 4, 0))
    lost = record_task(PAIR, start, [Variant("rigid", budget=3)], seed=0)
    (run,) = lost.trajectories
    for array in (run.witness, run.distance, run.error):
        array[1:] = np.nan
    server.gui.reset()
    server.scene.reset()
    page = AlignmentPage(server, lost)
    try:
        page.change(iteration=2)
        drawn(page, iteration=2)
        assert " 2</b>" in page.where.content and "<table" not in page.where.content
        assert not page.scene.lines.visible and not any(dot.visible for dot in page.scene.dots)
        page.change(iteration=0)
        drawn(page, iteration=0)
        assert page.scene.lines.visible and all(dot.visible for dot in page.scene.dots)
        assert "<table" in page.where.content
    finally:
        page.close()
    run.error[:] = np.nan
    assert np.isinf(best_so_far(run)).all()
    assert np.isnan(Chart(lost, "iterations").data(0, 1)[1]).all()
    assert "<table" not in where(lost, 0, 0)


@pytest.mark.parametrize(
    ("metres", "words"),
    [(0.1234, "123 mm"), (0.01234, "12.3 mm"), (0.001234, "1.2 mm"), (1.2e-5, "0.012 mm"), (1e-7, "&lt; 0.001 mm")],
)
def test_lengths_are_told_with_as_many_digits_as_they_need(metres: float, words: str):
    assert mm(metres) == words
