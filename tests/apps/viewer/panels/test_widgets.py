"""A widget that a user and states move at the same time."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from grasp_refine_apps.viewer.panels import widgets
from grasp_refine_apps.viewer.panels.widgets import LiveInput, on_change, on_click
from websocket_page import Page, until


@pytest.fixture
def page(server: Any) -> Iterator[Page]:
    page = Page(server)
    yield page
    page.close()


def test_what_a_user_does_is_sent_and_what_states_do_is_not(server: Any, page: Page):
    sent: list[float] = []
    slider = LiveInput(server.gui.add_slider("x", 0.0, 10.0, 0.5, 0.0), sent.append)
    slider.show(3.0)
    until(lambda: slider.handle.value == 3.0)
    assert sent == []
    page.change(slider.handle, 4)
    assert until(lambda: sent) == [4.0]
    assert isinstance(sent[0], float)


def test_late_states_do_not_push_a_slider_back(server: Any, page: Page, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(widgets, "HOLD_S", 600.0)  # longer than a busy machine takes for eight changes
    sent: list[float] = []
    slider = LiveInput(server.gui.add_slider("x", 0.0, 10.0, 0.5, 0.0), sent.append)
    for value in range(1, 9):
        page.change(slider.handle, value)
        until(lambda value=value: slider.handle.value == value)
        slider.show(value - 1.0)  # what was drawn of the state before
    until(lambda: sent and sent[-1] == 8.0)
    assert sent == sorted(sent) and slider.handle.value == 8.0 and page.told(slider.handle) == []
    slider.close()


def test_a_late_state_does_not_replace_what_a_user_sends(server: Any, page: Page, monkeypatch: pytest.MonkeyPatch):
    """A busy machine calls back so late that a state of before has moved the widget already."""
    late: list[Callable[[Any], None]] = []
    monkeypatch.setattr(widgets, "on_change", lambda handle, act: late.append(act))
    monkeypatch.setattr(widgets, "HOLD_S", 0.1)
    sent: list[float] = []
    slider = LiveInput(server.gui.add_slider("x", 0.0, 10.0, 0.5, 0.0), sent.append)
    page.change(slider.handle, 3)
    until(lambda: slider.handle.value == 3.0)
    slider.show(8.0)
    until(lambda: slider.handle.value == 8.0)
    late[0](8.0)
    assert sent == [3.0]
    slider.close()


def test_a_page_hears_at_last_what_its_user_did(server: Any, page: Page, monkeypatch: pytest.MonkeyPatch):
    """A late state that crossed the last movement was shown for ever by the page that had sent it."""
    monkeypatch.setattr(widgets, "HOLD_S", 0.1)
    slider = LiveInput(server.gui.add_slider("x", 0.0, 10.0, 0.5, 0.0), lambda value: slider.show(value))
    page.change(slider.handle, 3)
    until(lambda: page.told(slider.handle)[-1:] == [3.0])
    slider.close()


def test_soon_after_the_newest_state_counts_again(server: Any, page: Page, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(widgets, "HOLD_S", 0.5)
    slider = LiveInput(server.gui.add_slider("x", 0.0, 10.0, 0.5, 0.0), lambda value: None)
    page.change(slider.handle, 8)
    until(lambda: slider.handle.value == 8.0)
    slider.show(0.0)
    until(lambda: page.told(slider.handle)[-1:] == [0.0])
    slider.close()


def test_a_click_waits_for_the_change_before_it(server: Any):
    """Start overtook a choice that was made just before: viser calls functions in threads."""
    box, button = server.gui.add_checkbox("box", False), server.gui.add_button("button")
    done: list[Any] = []

    def change(value: bool) -> None:
        time.sleep(0.1)
        done.append(value)

    on_change(box, change)
    on_click(button, lambda: done.append("clicked"))
    page = Page(server)
    for value in (True, False):
        page.change(box, value)
        page.change(button, True)
    until(lambda: len(done) == 4)
    page.close()
    assert done == [True, "clicked", False, "clicked"]
