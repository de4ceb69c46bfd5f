"""Form of any dataclass: labels from names, hints from docstrings, widgets by types; they show it and change it.

The command line makes options of the same dataclasses, so that both have the same texts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import partial
from operator import attrgetter
from threading import RLock, Timer
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import viser
from tyro.constructors import PrimitiveConstructorSpec

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.report.command_line import in_options
from grasp_refine_apps.report.fields import Without, docs_of
from grasp_refine_apps.viewer.panels.units import FieldUnit
from grasp_refine_apps.viewer.server.viser_private import widget_id

REFUSAL_DELAY_S = 1.5
"""Seconds after the last key until invalid text is refused: until then it may be half typed."""

_NONE = type(None)
_DEFAULT = re.compile(r"\(default: (.*?)\)")
_OPTION = re.compile(r"--([a-z][a-z0-9-]*)(?:\.([a-z][a-z0-9-]*))?")


@dataclass(frozen=True)
class Entry:
    """Display and parsing of one field."""

    name: str
    """Name of the field, prefixed by its parent dataclasses: `weights.contact`."""
    label: str
    """Label before the widget."""
    hint: str
    """Tooltip."""
    widget: Literal["choice", "tick", "number", "text"]
    """Kind of the widget."""
    read: Callable[[Any], Any]
    """Conversion from the widget's value to the field's.

    Raises:
        ValueError: the value is invalid; the message names the requirement.
    """
    write: Callable[[Any], Any]
    """Conversion from the field's value to the widget's."""
    choices: tuple[str, ...] = ()
    """Choices of a dropdown."""


@dataclass(frozen=True)
class Section:
    """A field that is a dataclass itself: a folder."""

    name: str
    label: str
    """The folder's title."""
    parts: tuple[Entry | Section, ...]
    """Entries and sections in the folder."""
    chosen_by: str = ""
    """Name of the field that selects this section among others; empty: none does."""
    choice: str = ""
    """Value of that field that selects this section."""


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
    units: Mapping[str, FieldUnit] = field(default_factory=dict)
    """Units in which fields are shown and typed; others as they are."""
    rest: str = "More options"
    """Title of the folder of the others; empty: `make_rest` makes them, in the container that is open then."""
    patience: float = REFUSAL_DELAY_S
    """Seconds until invalid text is refused."""

    handles: dict[str, Any] = field(init=False, default_factory=dict)
    """Widgets and folders, by the names of their fields."""
    _entries: dict[str, Entry] = field(init=False, default_factory=dict)
    _sections: dict[str, Section] = field(init=False, default_factory=dict)
    _waiting: dict[str, Timer] = field(init=False, default_factory=dict)
    _sent: list[Any] = field(init=False, default_factory=list)
    _others: list[Entry | Section] = field(init=False, default_factory=list)
    _lock: RLock = field(init=False, default_factory=RLock)

    def __post_init__(self) -> None:
        """Make the widgets."""
        self._wanted = self._shown = self.value
        self._defaults = type(self.value)()
        parts = {part.name: part for part in parts_of(type(self.value)) if part.name not in self.left_out}
        self._make(parts[name] for name in self.first)
        self._others = [part for name, part in parts.items() if name not in self.first]
        if self._others and self.rest:
            with self.gui.add_folder(self.rest, expand_by_default=False):
                self._make(self._others)
        self._set_visible(self._without_unused(self.value)[1])

    def make_rest(self) -> None:
        """Make the widgets of the other fields."""
        self._make(self._others)
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
                self.handles[name].value = entry.write(attrgetter(name)(value))
            self._set_visible(self._without_unused(value)[1])

    def _make(self, parts: Iterable[Entry | Section]) -> None:
        """Make widgets and folders, in the container that is open."""
        for part in parts:
            if isinstance(part, Section):
                self._sections[part.name] = part
                self.handles[part.name] = self.gui.add_folder(part.label, expand_by_default=False)
                with self.handles[part.name]:
                    self._make(part.parts)
            else:
                if part.name in self.units:
                    part = in_unit(part, self.units[part.name], attrgetter(part.name)(self._defaults))
                self._entries[part.name] = part
                self.handles[part.name] = self._make_widget(part)

    def _make_widget(self, entry: Entry) -> Any:
        """Make the widget of a field."""
        shown = entry.write(attrgetter(entry.name)(self.value))
        add: dict[str, Callable[..., Any]] = {
            "choice": partial(self.gui.add_dropdown, options=entry.choices),
            "tick": self.gui.add_checkbox,
            "number": partial(self.gui.add_number, step=1),
            "text": self.gui.add_text,
        }
        handle = add[entry.widget](entry.label, initial_value=shown, hint=entry.hint)

        # Asynchronous, so that a button pressed next does not overtake it, see `panels.widgets`.
        async def changed(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._changed(entry)

        handle.on_update(changed)
        return handle

    def _changed(self, entry: Entry) -> None:
        """Call `on_change` after a user changed a widget, or refuse an invalid value."""
        with self._lock:
            self._cancel_refusal(entry.name)
            try:
                wanted = with_value(self._wanted, entry.name, entry.read(self.handles[entry.name].value))
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
                value = with_value(value, name, attrgetter(name)(self._defaults))
        return value, hidden

    def _hidden(self, value: Any, hidden: Collection[str]) -> set[str]:
        """Names of the fields without effect given the others, some of which are hidden already."""
        others = {
            name
            for name, section in self._sections.items()
            if section.chosen_by
            and (section.chosen_by in hidden or attrgetter(section.chosen_by)(value) != section.choice)
        }
        return others | {name for name in self.unused(value) if name in self.handles}

    def _set_visible(self, hidden: Collection[str]) -> None:
        """Hide the widgets of these fields, show all others."""
        for name, handle in self.handles.items():
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
            self.handles[entry.name].value = entry.write(attrgetter(entry.name)(self._wanted))
        self.on_error(words)

    def placeholders(self) -> dict[str, str]:
        """Return the defaults of empty text fields, by the ids of their widgets."""
        shown = ((name, _DEFAULT.search(entry.hint)) for name, entry in self._entries.items() if entry.widget == "text")
        return {widget_id(self.handles[name]): found[1] for name, found in shown if found}

    def _cancel_refusal(self, name: str) -> None:
        """Cancel a pending refusal."""
        if timer := self._waiting.pop(name, None):
            timer.cancel()


def in_unit(entry: Entry, unit: FieldUnit, default: Any) -> Entry:
    """Return the entry of a field, whose default is in SI units, that is shown and typed in a unit."""
    before, after = (f"(default: {as_text(value)})" for value in (default, unit.shown(default)))
    return replace(
        entry,
        label=f"{entry.label}, {unit.symbol}",
        hint=unit.hint(entry.hint).replace(before, after),
        read=lambda text: unit.si(entry.read(text)),
        write=lambda value: as_text(unit.shown(value)),
    )


def parts_of(
    kind: type, prefix: str = "", about: str = "", left_out: Collection[str] = ()
) -> tuple[Entry | Section, ...]:
    """Return the entries of the fields of a dataclass in order.

    Args:
        kind: The dataclass.
        prefix: Prefix of the names of its fields.
        about: Text before the hint of each field.
        left_out: Names of fields without a widget.

    Raises:
        TypeError: a field is of a type that no widget can show.
    """
    hints = get_type_hints(kind, include_extras=True)
    choosers = {
        choice: f"{prefix}{name}"
        for name, hint in hints.items()
        if get_origin(hint) is Literal
        for choice in get_args(hint)
    }
    parts: list[Entry | Section] = []
    for one in fields(kind):
        inner, extras = _unwrapped(hints[one.name])
        if one.name in left_out:
            continue
        name, label, doc = f"{prefix}{one.name}", label_of(one.name), docs_of(kind).get(one.name, "")
        if isinstance(inner, type) and is_dataclass(inner):
            choice = one.name.replace("_", "-")
            chosen_by = choosers.get(choice, "")
            without = {name for extra in extras if isinstance(extra, Without) for name in extra.names}
            inside = parts_of(inner, f"{name}.", "" if chosen_by else doc, without)
            if inside:
                parts.append(Section(name, label, inside, chosen_by, choice if chosen_by else ""))
        else:
            hint = " ".join(filter(None, (about, doc, _default_words(one, extras))))
            if _NONE in get_args(inner):
                hint = hint.replace("None", "empty")
            parts.append(Entry(name, label, plain(hint), *_widget(name, inner, extras)))
    return tuple(parts)


def label_of(name: str) -> str:
    """Label of a field: `max_move` is "Max move"."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


def plain(text: str) -> str:
    """Return a text with options and fields named as in a form: `--weights.stay-near` is "weights: stay near"."""
    return _OPTION.sub(lambda found: ": ".join(filter(None, found.groups())).replace("-", " "), in_options(text))


def with_value(whole: Any, name: str, value: Any) -> Any:
    """Return the dataclass with another value of the field `name`.

    Raises:
        GraspRefineError: a dataclass refuses the value.
    """
    first, _, rest = name.partition(".")
    return replace(whole, **{first: with_value(getattr(whole, first), rest, value) if rest else value})


def _unwrapped(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Split a type from the metadata that `Annotated` adds."""
    return (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())


def _default_words(one: Field[Any], extras: Sequence[Any]) -> str:
    """Text of the default value of a field; that of the command line where it has one."""
    for extra in extras:
        if isinstance(text := getattr(extra, "help_behavior_hint", None), str):
            return text
    default = one.default if one.default_factory is MISSING else one.default_factory()
    return "" if default is MISSING or isinstance(default, bool) else f"(default: {as_text(default) or 'empty'})"


def _widget(name: str, kind: Any, extras: Sequence[Any]) -> tuple[Any, ...]:
    """The widget of a type, how it is read and written, and its choices; TypeError: there is none."""
    spec = next((extra for extra in extras if isinstance(extra, PrimitiveConstructorSpec)), None)
    if spec is not None:
        return "text", lambda text: spec.instance_from_str(text.split()) if text.strip() else None, as_text
    if get_origin(kind) is Literal:
        choices = {str(choice): choice for choice in get_args(kind)}
        return "choice", choices.__getitem__, str, tuple(choices)
    if kind is bool:
        return "tick", bool, bool
    if kind is int:
        return "number", int, int
    if _NONE in get_args(kind):
        (inner,) = (one for one in get_args(kind) if one is not _NONE)
        read = _reader(name, inner)
        return "text", lambda text: read(text) if text.strip() else None, as_text
    return "text", _reader(name, kind), as_text


def _reader(name: str, kind: Any) -> Callable[[str], Any]:
    """Return the parser of a type from text; TypeError: there is none."""
    if kind is str:
        return str.strip
    if kind in (int, float):
        return lambda text: _number(kind, text)
    if get_origin(kind) is tuple:
        inner = dict.fromkeys(one for one in get_args(kind) if one is not Ellipsis)
        if len(inner) == 1:
            read = _reader(name, *inner)
            return lambda text: tuple(read(word) for word in text.replace(",", " ").split())
    raise TypeError(f"no widget for {name}: {kind}")


def _number(kind: type[int] | type[float], text: str) -> float:
    """Parse a number.

    Raises:
        ValueError: the text is none.
    """
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"needs {'an integer' if kind is int else 'a number'}, got {text.strip()!r}") from None


def as_text(value: Any) -> str:
    """Return a value as text to type: the shortest number that is read back as the same."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return ", ".join(map(as_text, value))
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return str(value)
