"""Form for any dataclass: widgets that show and change it, with the texts of the command line."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from threading import RLock, Timer
from typing import Any

import viser

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.entries import Entry, Section, parts_of, plain, value_of, with_value

REFUSAL_DELAY_S = 1.5
"""Seconds after the last key until invalid text is refused: until then it may be half typed."""


@dataclass(eq=False)
class Form:
    """Widgets that show a dataclass and change it, made in the container of `gui` that is open."""

    gui: viser.GuiApi
    value: Any
    """Dataclass with the values of the widgets, unused fields at their defaults."""
    on_change: Callable[[Any], None]
    """Called with the new dataclass when a user changed something."""
    on_error: Callable[[str], None]
    """Called with a message when a typed value is invalid; the widget is then restored."""
    check: Callable[[Any], None] = lambda value: None
    """Check of a dataclass; raises a GraspRefineError if it is invalid."""
    unused: Callable[[Any], Collection[str]] = lambda value: ()
    """Names of the fields without effect given the others: they are hidden, and at their defaults."""
    first: Sequence[str] = ()
    """Names of the fields that come first, in this order; the others are in a folder."""
    left_out: Collection[str] = ()
    """Names of fields without a widget."""
    patience: float = REFUSAL_DELAY_S
    """Seconds until invalid text is refused."""

    _handles: dict[str, Any] = field(init=False, default_factory=dict)
    _entries: dict[str, Entry] = field(init=False, default_factory=dict)
    _sections: dict[str, Section] = field(init=False, default_factory=dict)
    _waiting: dict[str, Timer] = field(init=False, default_factory=dict)
    _sent: list[Any] = field(init=False, default_factory=list)
    _lock: RLock = field(init=False, default_factory=RLock)

    def __post_init__(self) -> None:
        """Make the widgets."""
        self._wanted = self._shown = self.value
        self._defaults = type(self.value)()
        parts = {part.name: part for part in parts_of(type(self.value)) if part.name not in self.left_out}
        self._make(parts[name] for name in self.first)
        rest = [part for name, part in parts.items() if name not in self.first]
        if rest:
            with self.gui.add_folder("More options", expand_by_default=False):
                self._make(rest)
        self._set_visible(self._without_unused(self.value)[1])

    def show(self, value: Any) -> None:
        """Show a dataclass, without calling `on_change`.

        Values that this form sent itself are shown already, also when states come back later than a user types.
        """
        with self._lock:
            if value is self._shown:
                return
            shown, self._shown = self._shown, value
            if value in self._sent:
                del self._sent[: self._sent.index(value) + 1]
                return
            if value == shown:
                return
            self._sent.clear()
            self._wanted = self.value = value
            for name, entry in self._entries.items():
                self._cancel_refusal(name)
                self._handles[name].value = entry.write(value_of(value, name))
            self._set_visible(self._without_unused(value)[1])

    def _make(self, parts: Iterator[Entry | Section] | Sequence[Entry | Section]) -> None:
        """Make widgets and folders, in the container that is open."""
        for part in parts:
            if isinstance(part, Section):
                self._sections[part.name] = part
                self._handles[part.name] = self.gui.add_folder(part.label, expand_by_default=False)
                with self._handles[part.name]:
                    self._make(part.parts)
            else:
                self._entries[part.name] = part
                self._handles[part.name] = self._make_widget(part)

    def _make_widget(self, entry: Entry) -> Any:
        """Make the widget of a field."""
        shown = entry.write(value_of(self.value, entry.name))
        handle: Any
        if entry.widget == "choice":
            handle = self.gui.add_dropdown(entry.label, entry.choices, initial_value=shown, hint=entry.hint)
        elif entry.widget == "tick":
            handle = self.gui.add_checkbox(entry.label, shown, hint=entry.hint)
        elif entry.widget == "number":
            handle = self.gui.add_number(entry.label, shown, step=1, hint=entry.hint)
        else:
            handle = self.gui.add_text(entry.label, shown, hint=entry.hint)
        handle.on_update(lambda event: self._changed(entry) if event.client is not None else None)
        return handle

    def _changed(self, entry: Entry) -> None:
        """Call `on_change` after a user changed a widget, or refuse an invalid value."""
        with self._lock:
            self._cancel_refusal(entry.name)
            try:
                wanted = with_value(self._wanted, entry.name, entry.read(self._handles[entry.name].value))
                value, hidden = self._without_unused(wanted)
                self.check(value)
            except (GraspRefineError, ValueError) as error:
                self._refuse_later(
                    entry, plain(str(error)) if isinstance(error, GraspRefineError) else f"{entry.label} {error}"
                )
                return
            self._wanted = wanted
            if value == self.value:
                return
            self.value = value
            self._sent.append(value)
            self._set_visible(hidden)
            self.on_change(value)

    def _without_unused(self, wanted: Any) -> tuple[Any, set[str]]:
        """Return the dataclass with unused fields at their defaults, and the names of these."""
        value = wanted
        hidden: set[str] = set()
        while more := self._hidden(value, hidden) - hidden:
            hidden |= more
            for name in more:
                value = with_value(value, name, value_of(self._defaults, name))
        return value, hidden

    def _hidden(self, value: Any, hidden: Collection[str]) -> set[str]:
        """Names of the fields without effect given the others, some of which are hidden already."""
        others = {
            name
            for name, section in self._sections.items()
            if section.chosen_by
            and (section.chosen_by in hidden or value_of(value, section.chosen_by) != section.choice)
        }
        return others | {name for name in self.unused(value) if name in self._handles}

    def _set_visible(self, hidden: Collection[str]) -> None:
        """Hide the widgets of these fields, show all others."""
        for name, handle in self._handles.items():
            handle.visible = name not in hidden

    def _refuse_later(self, entry: Entry, words: str) -> None:
        """Refuse typed text unless typing continues; a choice, at once."""
        seconds = self.patience if entry.widget in ("text", "number") else 0.0
        timer = Timer(seconds, lambda: self._refuse(entry, timer, words))
        timer.daemon = True
        self._waiting[entry.name] = timer
        timer.start()

    def _refuse(self, entry: Entry, timer: Timer, words: str) -> None:
        """Restore the previous value, and report the reason."""
        with self._lock:
            if self._waiting.get(entry.name) is not timer:
                return
            del self._waiting[entry.name]
            self._handles[entry.name].value = entry.write(value_of(self._wanted, entry.name))
        self.on_error(words)

    def _cancel_refusal(self, name: str) -> None:
        """Cancel a pending refusal."""
        if timer := self._waiting.pop(name, None):
            timer.cancel()
