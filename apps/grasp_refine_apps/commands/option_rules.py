"""Rules by which tyro makes options of the dataclasses of the library: in groups, and some on demand."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro.conf
from tyro.conf import arg
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from grasp_refine_apps.report.command_line import flag, in_options
from grasp_refine_apps.report.fields import Without, docs_of

MARKERS: Any = tyro.conf
"""Markers of tyro, here for types that are known at run time only."""


@dataclass(frozen=True)
class OptionGroup:
    """Options that the help shows in one box, "TITLE options"."""

    title: str
    """Words before "options"."""
    about: str = ""
    """Line above the options; empty: the docstring of the dataclass."""
    names: tuple[str, ...] = ()
    """Fields of the dataclass; empty: all."""
    on_demand: str = ""
    """Option with which the group is shown; empty: always."""


def _indices(words: list[str]) -> tuple[int, ...]:
    """Parse integers separated by spaces or commas.

    Raises:
        ValueError: a word is no integer.
    """
    return tuple(int(word) for word in ",".join(words).split(",") if word)


INDICES = PrimitiveConstructorSpec(
    nargs="*",
    metavar="I [I ...]",
    instance_from_str=_indices,
    is_instance=lambda value: isinstance(value, tuple),
    str_from_instance=lambda value: [str(number) for number in value],
)
"""Constructor of an option that takes integers, as in 0 3 7 or 0,3,7."""


class OptionRules(ConstructorRegistry):
    """Rules for dataclasses that list their fields in a class variable `groups`, from which options are made.

    The help of an option is the docstring of its field. A field that may be None takes only values; a tuple of texts is
    an option that may be given several times. Placeholders of values stand in a class variable `metavars`.

    Groups `on_demand`, and fields that are dataclasses in no group, such as the options of a solver, exist where a
    command line names them: `--solver adam` has the options of Adam, in its help, too.
    """

    def __init__(self, arguments: Sequence[str], *, everything: bool = False) -> None:
        """Take the words of the command line; `everything`: options on demand are there in any case."""
        super().__init__()
        self._everything = everything
        self._words = {word.partition("=")[0] for word in arguments} | {word.partition("=")[2] for word in arguments}
        self._boxes: dict[type, StructConstructorSpec] = {}
        self._nested: dict[type, tuple[str, ...]] = {}
        self._option: dict[str, str] = {}
        self.struct_rule(self._of_dataclass)

    def with_option(self, message: str) -> str:
        """Return a message of the library with an option for its "Class: field", as in "Weights: contact"."""
        return re.sub(
            r"^([\w-]+): (\w+)",
            lambda found: flag(found[2], f"{self._option[found[1]]}.") if found[1] in self._option else found[0],
            message,
        )

    def _of_dataclass(self, info: StructTypeInfo) -> StructConstructorSpec | None:
        kind = info.type
        if kind in self._boxes:
            return self._boxes[kind]
        if kind in self._nested:
            return StructConstructorSpec(
                kind, tuple(self._spec(kind, name, info.default) for name in self._nested[kind])
            )
        groups: tuple[OptionGroup, ...] = getattr(kind, "groups", ())
        if not groups or not is_dataclass(kind):
            return None
        default = info.default if isinstance(info.default, kind) else kind()
        inner = {name: _split(hint)[0] for name, hint in _hints(kind).items()}
        boxes, nested, grouped = [], [], set()
        for group in groups:
            names = group.names or tuple(one.name for one in fields(kind))
            always = not group.on_demand or group.on_demand in self._words
            shown = [name for name in names if always or self._typed(name)]
            flat = tuple(self._spec(kind, name, default) for name in shown if not is_dataclass(inner[name]))
            boxes += [self._box(group.title, group.about or kind.__doc__, flat)] if flat else []
            nested += [name for name in shown if is_dataclass(inner[name])]
            grouped |= set(names)
        methods = [name for name in inner if is_dataclass(inner[name]) and name not in grouped]
        nested += [name for name in methods if self._typed(name) or flag(name, "") in self._words]
        specs = [self._nested_spec(kind, name, default) for name in nested]
        titles = {box.name for box in boxes}

        def build(**values: Any) -> Any:
            flat = {name: value for title in titles for name, value in values.pop(title).items()}
            return kind(**flat, **values)

        build.__doc__ = kind.__doc__
        return StructConstructorSpec(build, (*boxes, *filter(None, specs)))

    def _typed(self, name: str) -> bool:
        """Return whether the command line has the option of a field, or one of its own."""
        option, off = flag(name), flag(name, "--no-")
        return self._everything or any(word in (option, off) or word.startswith(f"{option}.") for word in self._words)

    def _box(self, title: str, about: str | None, specs: tuple[StructFieldSpec, ...]) -> StructFieldSpec:
        """Return a group as a nested dataclass whose name is no prefix."""
        box = type("Box", (), {})
        self._boxes[box] = StructConstructorSpec(dict, specs)
        named: Any = Annotated[box, arg(name=title)]
        return StructFieldSpec(title, MARKERS.OmitArgPrefixes[named], box(), about)

    def _nested_spec(self, kind: type, name: str, default: Any) -> StructFieldSpec | None:
        """Return a field that is a dataclass, with its fields that are options; None: there are none."""
        inner, extras = _split(_hints(kind)[name])
        without = {left for extra in extras if isinstance(extra, Without) for left in extra.names}
        self._nested[inner] = tuple(one.name for one in fields(inner) if one.name not in without)
        self._option |= dict.fromkeys((inner.__name__, flag(name, "")), flag(name))
        return self._spec(kind, name, default) if self._nested[inner] else None

    def _spec(self, kind: type, name: str, default: Any) -> StructFieldSpec:
        """Return the option of a field, or a field that is a dataclass itself."""
        hint: Any = _hints(kind)[name]
        value = getattr(default, name)
        inner, extras = _split(hint)
        if not extras and hasattr(kind, "groups") and not is_dataclass(inner):
            hint = self._annotated(inner, value, getattr(kind, "metavars", {}).get(name))
        # Docstrings are read when the help is shown.
        return StructFieldSpec(name, hint, value, lambda: in_options(docs_of(kind).get(name, "")))

    def _annotated(self, kind: Any, value: Any, metavar: str | None) -> Any:
        """Return the annotation of an option for a type of the library."""
        # The docstring says what happens without the option.
        unset = value is None or value is False or value == ()
        annotation: Any = Annotated[kind, arg(metavar=metavar, help_behavior_hint="" if unset else None)]
        if kind == tuple[int, ...]:
            return Annotated[annotation, INDICES]
        if kind == tuple[str, ...]:
            return MARKERS.UseAppendAction[annotation]
        return MARKERS.DisallowNone[annotation] if NoneType in get_args(kind) else annotation


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _split(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """Split a type from the metadata that `Annotated` adds."""
    return (get_args(hint)[0], hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())
