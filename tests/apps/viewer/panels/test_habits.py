"""Links, keys and marks as pages send them, the tab that ends a replay, badges, and the viewer in a notebook."""

from collections.abc import Iterator
from contextlib import nullcontext
from html import escape
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.drawing.view import ASPECT_RATIO
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.panels.app import Viewer
from grasp_refine_apps.viewer.panels.habits import title
from grasp_refine_apps.viewer.panels.session import Session, badge
from grasp_refine_apps.viewer.server.page import open_server
from open_viewer import controller

NOBODY = SimpleNamespace(client_id=7)


@pytest.fixture
def viewer(problem: Problem, server: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.chdir(tmp_path)  # where marks of the example are kept
    made = controller(problem)
    opened = Session(server, made)
    opened.complete()
    yield opened
    opened.close()
    made.close()


def test_messages_of_pages_are_done_and_garbage_is_not(viewer: Session):
    habits, state = viewer.habits, viewer.controller
    for text, number in (("open 2 0.1", 2), ("next 0.2", 3), ("next 0.3", 0), ("previous 0.4", 3)):
        habits.receive(text, NOBODY)
        assert state.state.number == number
    opens = ("", " ", "open", "open x", "open -1", "open 99999999999999", "fit x", "ready nan", "ready -3", "é 🙂")
    brushes = ("brush", "brush quality_after", "brush quality_after a b", "brush quality_after nan 1", "brush x 0 1")
    for text in (*opens, *brushes):
        habits.receive(text, NOBODY)
    assert state.state.number == 3 and len(state.state.listing.numbers(state.state.collection)) == 4
    for text, mark in (("good 1", "good"), ("bad 2", "bad"), ("bad 3", "")):
        habits.receive(text, NOBODY)
        assert state.state.collection.mark(3) == mark
    state.editor.set_joint(2, 0.3)
    habits.receive("undo 3", NOBODY)
    assert state.state.undo_steps == ()
    habits.receive("redo 4", NOBODY)
    assert len(state.state.undo_steps) == 1


def test_only_tabs_of_the_grasp_end_a_replay(viewer: Session):
    state, pose = viewer.controller, viewer.controller.state.pose
    still = {"T_root": pose.T_object_root[None], "q": pose.q[None], "time": np.zeros(1), "texts": ("still",)}
    for tab, ends in (("files", False), ("view", False), ("validate", False), ("browse", True), ("edit", True)):
        state.player.show(Recording(title="replay", **still))
        viewer.habits.receive(f"tab {tab}", NOBODY)
        assert (state.state.motion is None) == ends, tab


def test_the_first_camera_of_a_page_is_fitted_only_to_an_unusual_picture(viewer: Session):
    usual, wide, low = f"{ASPECT_RATIO * 1.03}", "0.5", "0.05"
    for text, fits in (
        (f"ready {usual}", False), (f"fit {low}", False), ("fit 11", False), (f"ready {wide}", True),
        (f"ready {usual}", True), (f"fit {usual}", True),
    ):  # fmt: skip
        camera = SimpleNamespace(position=np.ones(3), look_at=np.zeros(3))
        viewer.habits.receive(text, SimpleNamespace(client_id=7, camera=camera, atomic=nullcontext))
        assert hasattr(camera, "fov") == fits, text


def test_a_hand_of_ours_has_a_badge_that_names_the_makers(viewer: Session):
    collection = viewer.controller.state.collection
    assert "hands/allegro" in badge(collection.hand) and title(collection).startswith("example_mug.npz")
    assert badge(load_hand(Path(__file__).parents[3] / "two_jaws.urdf", candidates=16)) == ""


def test_a_notebook_shows_the_page(problem: Problem):
    with Viewer(open_server("127.0.0.1", 0), controller(problem)) as viewer:
        assert f'<iframe src="{escape(viewer.page.frame_address)}"' in viewer._repr_html_()
        for encoding in ("identity", "gzip"):
            with urlopen(Request(viewer.address, headers={"Accept-Encoding": encoding})) as answer:
                body = answer.read()
                assert int(answer.headers["Content-Length"]) == len(body)
                assert encoding == "gzip" or (b"gr-page" in body and b"<head><style>" in body)
