"""Links, keys and marks as pages send them, the badge of simplified hands, and the viewer in a notebook."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from grasp_refine.hands.hand import load_hand
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.panels.app import Viewer, badge  # noqa: E402
from grasp_refine_apps.viewer.panels.habits import Habits, title  # noqa: E402
from grasp_refine_apps.viewer.server.page import close_server, open_server  # noqa: E402
from open_viewer import controller


@pytest.fixture
def viewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    monkeypatch.chdir(tmp_path)  # where marks of the example are kept
    with Viewer(open_server("127.0.0.1", 0), controller()) as opened:
        yield opened


def test_what_pages_send_is_done_and_garbage_is_not(viewer: Viewer):
    habits: Habits = viewer.habits
    state: Controller = viewer.controller
    nobody = SimpleNamespace(client_id=7)
    for text, number in (("open 2 0.1", 2), ("next 0.2", 3), ("next 0.3", 0), ("previous 0.4", 3)):
        habits.receive(text, nobody)
        assert state.state.number == number
    opens = ("", " ", "open", "open x", "open -1", "open 99999999999999", "fit x", "ready nan", "ready -3", "é 🙂")
    brushes = ("brush", "brush quality_after", "brush quality_after a b", "brush quality_after nan 1", "brush x 0 1")
    for text in (*opens, *brushes):
        habits.receive(text, nobody)
    assert state.state.number == 3 and len(state.state.listing.numbers(state.state.collection)) == 4
    habits.receive("good 1", nobody)
    assert state.state.collection.mark(3) == "good"
    habits.receive("good 2", nobody)
    assert state.state.collection.mark(3) == ""
    state.editor.set_joint(2, 0.3)
    habits.receive("undo 3", nobody)
    assert state.state.undo_steps == ()
    habits.receive("redo 4", nobody)
    assert len(state.state.undo_steps) == 1


def test_a_hand_of_ours_has_a_badge_that_names_the_makers(viewer: Viewer):
    collection = viewer.controller.state.collection
    assert "hands/allegro" in badge(collection.hand) and title(collection).startswith("example_mug.npz")
    other = load_hand(Path(__file__).parents[3] / "two_jaws.urdf", candidates=16)
    assert badge(other) == ""


def test_a_notebook_shows_the_page(viewer: Viewer):
    assert f'<iframe src="{viewer.address}"' in viewer._repr_html_()


def test_the_page_has_our_script_and_others_files_do_not():
    from urllib.request import Request, urlopen

    page = open_server("127.0.0.1", 0)
    try:
        for encoding in ("identity", "gzip"):
            with urlopen(Request(page.address, headers={"Accept-Encoding": encoding})) as answer:
                body = answer.read()
                assert int(answer.headers["Content-Length"]) == len(body)
                if encoding == "identity":
                    assert b"gr-page" in body and b"<head><style>" in body
    finally:
        close_server(page.server)
