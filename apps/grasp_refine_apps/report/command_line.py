"""Command line that repeats a run."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

WRITTEN = ("json", "html", "overwrite")
"""Options for output files."""

POSITIONAL = ("jobs",)
"""Options without a name on the command line."""


def flag(name: str, prefix: str = "--") -> str:
    """Name of the option of a field."""
    return prefix + name.replace("_", "-")


def invocation(command: str, options: Any) -> str:
    """Return the command line of some options, without the output files.

    Args:
        command: Words of the command, such as "bench align".
        options: Dataclass of the command; the options of nested dataclasses have no prefix.
    """
    return shlex.join(["refine-grasp", *command.split(), *words(options)])


def words(options: Any) -> Iterator[str]:
    """Yield the options that differ from their defaults."""
    for option in fields(options):
        value = getattr(options, option.name)
        if is_dataclass(value):
            yield from words(value)
        elif value == option.default or option.name in WRITTEN:
            continue
        elif option.name in POSITIONAL:
            yield from map(str, value)
        elif isinstance(value, bool):
            yield flag(option.name, "--" if value else "--no-")
        else:
            yield from (flag(option.name), *map(str, value if isinstance(value, tuple) else (value,)))
