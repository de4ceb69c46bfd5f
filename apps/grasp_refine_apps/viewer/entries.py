"""Form entries of a dataclass: labels from names, hints from docstrings, widgets by types.

The command line makes options of the same dataclasses, so that both have the same texts.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from docstring_parser import parse_from_object
from tyro.conf import Suppress
from tyro.constructors import PrimitiveConstructorSpec

_SUPPRESSED = get_args(Suppress[int])[1]
_NONE = type(None)
_OPTION = re.compile(r"--([a-z][a-z0-9-]*)(?:\.([a-z][a-z0-9-]*))?")


@dataclass(frozen=True)
class Entry:
    """Display and parsing of one field."""

    name: str
    """Name of the field, after those of its parent dataclasses: `weights.contact`."""
    label: str
    """Label before the widget."""
    hint: str
    """Tooltip."""
    widget: Literal["choice", "tick", "number", "text"]
    """Kind of the widget."""
    read: Callable[[Any], Any]
    """Conversion from the widget's value to the field's.

    Raises:
        ValueError: the value is invalid; the message names what is needed.
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


def parts_of(kind: type, prefix: str = "", about: str = "") -> tuple[Entry | Section, ...]:
    """Return the entries of the fields of a dataclass in order, without those that tyro suppresses.

    Args:
        kind: The dataclass.
        prefix: Prefix of the names of its fields.
        about: Text before the hint of each field.

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
        if _SUPPRESSED in extras:
            continue
        name, label, doc = f"{prefix}{one.name}", label_of(one.name), docs_of(kind).get(one.name, "")
        if isinstance(inner, type) and is_dataclass(inner):
            choice = one.name.replace("_", "-")
            chosen_by = choosers.get(choice, "")
            inside = parts_of(inner, f"{name}.", "" if chosen_by else doc)
            if inside:
                parts.append(Section(name, label, inside, chosen_by, choice if chosen_by else ""))
        else:
            hint = " ".join(filter(None, (about, doc, _default_words(one, extras))))
            if _may_be_none(inner):
                hint = hint.replace("None", "empty")
            parts.append(Entry(name, label, plain(hint), *_widget(name, inner, extras)))
    return tuple(parts)


@cache
def docs_of(kind: type) -> dict[str, str]:
    """The docstring of each field of a dataclass, its bases' too, each in one line."""
    found = {
        param.arg_name: " ".join((param.description or "").split())
        for base in reversed(kind.__mro__)
        if is_dataclass(base)
        for param in parse_from_object(base).params
    }
    return {name: text for name, text in found.items() if text}


def label_of(name: str) -> str:
    """Label of a field: `max_move` is "Max move"."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


def plain(text: str) -> str:
    """Return a text with options named as in a form: `--weights.stay-near` is "weights: stay near"."""
    return _OPTION.sub(lambda found: ": ".join(filter(None, found.groups())).replace("-", " "), text)


def value_of(whole: Any, name: str) -> Any:
    """Return the value of the field `name` of a dataclass, such as `weights.contact`."""
    for step in name.split("."):
        whole = getattr(whole, step)
    return whole


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


def _may_be_none(kind: Any) -> bool:
    """Return whether a type is the union of one type and None."""
    return get_origin(kind) in (Union, types.UnionType) and _NONE in get_args(kind) and len(get_args(kind)) == 2


def _default_words(one: Field[Any], extras: Sequence[Any]) -> str:
    """Text of the default value of a field; that of the command line where it has one."""
    for extra in extras:
        if isinstance(text := getattr(extra, "help_behavior_hint", None), str):
            return text
    default = one.default if one.default_factory is MISSING else one.default_factory()
    return "" if default is MISSING or isinstance(default, bool) else f"(default: {as_text(default) or 'empty'})"


def _widget(name: str, kind: Any, extras: Sequence[Any]) -> tuple[Any, ...]:
    """The widget of a type, how it is read and written, and its choices.

    Raises:
        TypeError: there is none for such a type.
    """
    for extra in extras:
        if isinstance(extra, PrimitiveConstructorSpec):
            return "text", _optional(_words_reader(extra)), as_text
    if get_origin(kind) is Literal:
        choices = {str(choice): choice for choice in get_args(kind)}
        return "choice", choices.__getitem__, str, tuple(choices)
    if kind is bool:
        return "tick", bool, bool
    if kind is int:
        return "number", int, int
    if _may_be_none(kind):
        (inner,) = (one for one in get_args(kind) if one is not _NONE)
        return "text", _optional(_reader(name, inner)), as_text
    return "text", _reader(name, kind), as_text


def _reader(name: str, kind: Any) -> Callable[[str], Any]:
    """Return the parser of a type from text.

    Raises:
        TypeError: there is none.
    """
    if kind is str:
        return str.strip
    if kind is int:
        return lambda text: _number(int, "an integer", text)
    if kind is float:
        return lambda text: _number(float, "a number", text)
    if get_origin(kind) is tuple:
        inner = dict.fromkeys(one for one in get_args(kind) if one is not Ellipsis)
        if len(inner) == 1:
            read = _reader(name, *inner)
            return lambda text: tuple(read(word) for word in text.replace(",", " ").split())
    raise TypeError(f"no widget for {name}: {kind}")


def _words_reader(how: PrimitiveConstructorSpec) -> Callable[[str], Any]:
    """Return the parser of tyro, for a text of words."""
    return lambda text: how.instance_from_str(text.split())


def _number(kind: type, called: str, text: str) -> Any:
    """Parse a number.

    Raises:
        ValueError: the text is none.
    """
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"needs {called}, got {text.strip()!r}") from None


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return the parser extended to empty text, which means None."""
    return lambda text: read(text) if text.strip() else None


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
