"""Widgets that users and states change at the same time, and buttons in a row."""

from __future__ import annotations

from asyncio import TimerHandle
from collections.abc import Callable, Sequence
from threading import Lock
from time import monotonic
from typing import Any

import viser

from grasp_refine_apps.viewer.server.viser_private import event_loop, is_removed, send_value, widget_id

HOLD_S = 0.5
"""Seconds after a user's last movement during which states do not move the widget: they may be older."""


# viser runs other functions in threads, where Start could overtake a choice that was made just before. Functions that
# are asynchronous run one after the other, as a user's changes come; none may wait for anything.


def on_click(button: Any, act: Callable[[], object]) -> None:
    """Call `act`, which must return at once, when a button is clicked; after all that a user changed before."""

    async def clicked(event: viser.GuiEvent[Any]) -> None:
        act()

    button.on_click(clicked)


def on_choice(buttons: Any, act: Callable[[str], object]) -> None:
    """Call `act`, which must return at once, with the label of the button of a group that is clicked, in turn."""

    async def clicked(event: viser.GuiEvent[Any]) -> None:
        act(event.target.value)

    buttons.on_click(clicked)


def on_change(widget: Any, act: Callable[[Any], object]) -> None:
    """Call `act`, which must return at once, with the value of a widget that a user changed, in turn.

    Values that the program sets come without a client.
    """

    async def changed(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            act(event.target.value)

    widget.on_update(changed)


class LiveInput:
    """Slider or other input that shows values and sends a user's changes; late states do not move it back.

    The widget is moved in viser's own thread, where movements of users arrive, too: none is lost between reading and
    setting the widget.
    """

    def __init__(self, handle: Any, send: Callable[[Any], None]) -> None:
        """Listen to a widget.

        Args:
            handle: The widget.
            send: Called with its value when a user moved it; must return at once.
        """
        self.handle, self._send = handle, send
        self._loop = event_loop(handle)
        self._sending = Lock()
        self._known = self._shown = handle.value
        self._unsent: Any = None
        """Value of a user that was not sent yet; None: there is none."""
        self._unsettled = False
        """Whether a user has moved the widget since its value was last sent to pages."""
        self._until = float("-inf")
        self._timer: TimerHandle | None = None
        self._closed = False
        on_change(handle, lambda value: self._moved())

    def show(self, value: Any) -> None:
        """Show a value soon or, if a user is moving the widget, soon after that; the newest counts."""
        self._shown = value
        if self.handle.value != value:
            self._loop.call_soon_threadsafe(self._settle)

    def close(self) -> None:
        """Stop showing values: the widget will be removed."""
        self._closed = True

    def _settle(self) -> None:
        """Move the widget, or wait until no user does; in viser's thread."""
        if self._closed or is_removed(self.handle):
            return
        if self.handle.value != self._known:
            # A user moved it just now; `_moved` was not called yet.
            self._touched()
        wait = self._until - monotonic()
        if wait <= 0:
            if self.handle.value != self._shown:
                self.handle.value = self._shown
            elif self._unsettled:
                # A page that has crossed a late state with its user's last movement shows that state.
                send_value(self.handle)
            self._known, self._unsettled = self.handle.value, False
        elif self._timer is None:
            self._timer = self._loop.call_later(wait, self._late)

    def _late(self) -> None:
        self._timer = None
        self._settle()

    def _moved(self) -> None:
        """Send a user's change; viser calls this in any of its threads, and not always in order."""
        with self._sending:
            if self._unsent is None or self.handle.value != self._known:
                self._touched()
            # The user's last value, even where a late state has meanwhile moved the widget.
            value, self._unsent = self._unsent, None
            self._send(value)
        self._unsettled = True
        self._loop.call_soon_threadsafe(self._settle)

    def _touched(self) -> None:
        # In this order: `_settle`, in another thread, must not take a value for known that it may still overwrite.
        self._until = monotonic() + HOLD_S
        self._known = self._unsent = self.handle.value


def in_a_row(gui: viser.GuiApi, buttons: Sequence[viser.GuiButtonHandle]) -> None:
    """Put buttons that follow each other on one line, equally wide.

    viser 1.1 has no such layout, but gives each button the id of its handle, which a style sheet can name. Should
    that ever change, buttons are below each other again.
    """
    width = f"calc((100% - 1.25rem) / {len(buttons)})"
    rules = []
    for i, button in enumerate(buttons):
        left, right = ("0.625rem" if i == end else "0" for end in (0, len(buttons) - 1))
        rules.append(
            f'div:has(> button[id="{widget_id(button)}"]) {{ display: inline-block; width: {width}; '
            f"margin-inline: {left} {right} !important; padding-left: {'0' if i == 0 else '0.3em'} }}"
        )
    gui.add_html(f"<style>{' '.join(rules)}</style>")
