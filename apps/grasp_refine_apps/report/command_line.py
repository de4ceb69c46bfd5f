"""Fields as options of the command line: their names in messages, and the command line that repeats a run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_type_hints

from grasp_refine.problem.spec import ProblemSpec

WRITTEN = ("json", "html", "markdown", "overwrite")
"""Options for output files."""

POSITIONAL = ("jobs", "files")
"""Options without a name on the command line."""


_FIELD = re.compile(r"`([a-z][a-z0-9_]*)(?:=('?)([^`]*?)\2)?`")
"""Field as messages of the library name it: `scale`, or with a value, `unit='mm'`."""


def in_options(text: str) -> str:
    """Return a message of the library with options for fields: `scale` -> --scale, `unit='mm'` -> --unit mm."""
    return _FIELD.sub(lambda found: " ".join(filter(None, (flag(found[1]), found[3]))), text)


def flag(name: str, prefix: str = "--") -> str:
    """Name of the option of a field."""
    return prefix + name.replace("_", "-")


def invocation(command: str, options: Any) -> str:
    """Return the command line of some options, without the output files.

    Args:
        command: Words of the command, such as "bench align".
        options: Dataclass of the command.
    """
    return shlex.join(["refine-grasp", *command.split(), *words(options)])


def words(options: Any, group: str = "") -> Iterator[str]:
    """Yield the options that differ from their defaults; fields of a nested dataclass follow its name and a dot.

    Args:
        options: Dataclass.
        group: Prefix of the names of its options, such as "weights."; a field that tyro gives no name adds none.
    """
    hints = get_type_hints(type(options), include_extras=True)
    for option in fields(options):
        value, name = getattr(options, option.name), group + option.name
        if is_dataclass(value):
            yield from words(value, group if is_nameless(hints[option.name]) else f"{name}.")
        elif value == option.default or option.name in WRITTEN:
            continue
        elif option.name in POSITIONAL:
            yield from map(str, value)
        elif isinstance(value, bool):
            yield flag(name, "--" if value else "--no-")
        else:
            yield from (flag(name), *map(str, value if isinstance(value, tuple) else (value,)))


def view_options(inputs: ProblemSpec) -> tuple[str, ...]:
    """Return the options of `refine-grasp view` to show a result, transferred and scaled already."""
    other = ("grasps", "targets", "scale", "unit", "format", "object_name", "index", "other_object", "transfer_from")
    return tuple(words(replace(inputs, **{name: getattr(ProblemSpec, name) for name in other})))


def is_nameless(hint: Any) -> bool:
    """Return whether `arg(name="")` annotates a field."""
    return any(getattr(note, "name", None) == "" for note in getattr(hint, "__metadata__", ()))
