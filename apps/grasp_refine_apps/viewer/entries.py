"""How the fields of a dataclass are shown: labels from names, hints from docstrings, widgets by types.

The command line makes options of the same dataclasses, so that both have the same words.
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
    """How one field is shown and read."""

    name: str
    """Its name, those of the dataclasses around it before it: `weights.contact`."""
    label: str
    """What stands before the widget."""
    hint: str
    """What is said when the mouse rests on it."""
    widget: Literal["choice", "tick", "number", "text"]
    """What kind it is."""
    read: Callable[[Any], Any]
    """The field's value from the widget's.

    Raises:
        ValueError: it is none; the message says what is needed.
    """
    write: Callable[[Any], Any]
    """The widget's value from the field's."""
    choices: tuple[str, ...] = ()
    """What can be chosen."""


@dataclass(frozen=True)
class Section:
    """A field that is a dataclass itself: a folder."""

    name: str
    label: str
    """The folder's title."""
    parts: tuple[Entry | Section, ...]
    """What is in it."""
    chosen_by: str = ""
    """Name of the field that chooses this one among others; empty: none does."""
    choice: str = ""
    """What that field is when it chooses this one."""


def parts_of(kind: type, prefix: str = "", about: str = "") -> tuple[Entry | Section, ...]:
    """How the fields of a dataclass are shown, in their order; those that tyro leaves out are left out.

    Args:
        kind: The dataclass.
        prefix: What stands before the names of its fields.
        about: Words before the hint of each field.

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
    """What people call a field: `max_move` is "Max move"."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


def plain(text: str) -> str:
    """Words about options as they are called in a form: `--weights.stay-near` is "weights: stay near"."""
    return _OPTION.sub(lambda found: ": ".join(filter(None, found.groups())).replace("-", " "), text)


def value_of(whole: Any, name: str) -> Any:
    """The field of a dataclass that is called `name`, such as `weights.contact`."""
    for step in name.split("."):
        whole = getattr(whole, step)
    return whole


def with_value(whole: Any, name: str, value: Any) -> Any:
    """The dataclass with another value in the field that is called `name`.

    Raises:
        GraspRefineError: a dataclass refuses the value.
    """
    first, _, rest = name.partition(".")
    return replace(whole, **{first: with_value(getattr(whole, first), rest, value) if rest else value})


def _unwrapped(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without, and its annotations with, what `Annotated` adds."""
    return (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())


def _may_be_none(kind: Any) -> bool:
    """Whether a type is another one or None."""
    return get_origin(kind) in (Union, types.UnionType) and _NONE in get_args(kind) and len(get_args(kind)) == 2


def _default_words(one: Field[Any], extras: Sequence[Any]) -> str:
    """What a field is when nobody says: in the words of the command line, where it has some."""
    for extra in extras:
        if isinstance(said := getattr(extra, "help_behavior_hint", None), str):
            return said
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
    """What makes a value of a type from text.

    Raises:
        TypeError: nothing can.
    """
    if kind is str:
        return str.strip
    if kind is int:
        return lambda text: _number(int, "a whole number", text)
    if kind is float:
        return lambda text: _number(float, "a number", text)
    if get_origin(kind) is tuple:
        inner = dict.fromkeys(one for one in get_args(kind) if one is not Ellipsis)
        if len(inner) == 1:
            read = _reader(name, *inner)
            return lambda text: tuple(read(word) for word in text.replace(",", " ").split())
    raise TypeError(f"no widget for {name}: {kind}")


def _words_reader(how: PrimitiveConstructorSpec) -> Callable[[str], Any]:
    """What makes a value from words as tyro does."""
    return lambda text: how.instance_from_str(text.split())


def _number(kind: type, called: str, text: str) -> Any:
    """The number that a text says.

    Raises:
        ValueError: it says none.
    """
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"needs {called}, got {text.strip()!r}") from None


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    """The same, where text that is empty means None."""
    return lambda text: read(text) if text.strip() else None


def as_text(value: Any) -> str:
    """A value as it can be typed: the shortest number that is read back as the same."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return ", ".join(map(as_text, value))
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return str(value)
