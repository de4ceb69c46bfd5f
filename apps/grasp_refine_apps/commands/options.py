"""Parsing of the command line into the dataclass of a command, and checks of the numbers in it."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import tyro

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.commands.option_rules import OptionRules
from grasp_refine_apps.report.command_line import flag, is_nameless

Command = TypeVar("Command")

Overwrite = Annotated[
    bool, tyro.conf.arg(help="Replace existing files; without it they are kept.", help_behavior_hint="")
]
"""The option `--overwrite` of commands that write files."""

OptionalFile = Annotated[
    tyro.conf.DisallowNone[Path | None], tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")
]
"""An option such as `--json`, a file that is written if it is given."""


def default(text: str, metavar: str | None = None) -> Any:
    """Return the annotation of an option whose default the help describes in words."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {text})")


NOTHING_USABLE = 1
"""Exit code when there are no usable results."""

LARGEST_SEED = 2**32 - 1

MAY_BE_ZERO = ("seed", "restarts", "noise")
"""Numbers that may be 0."""

MAY_BE_INFINITE = ("max_move",)
"""Limits that may be infinite."""


_FRAME, _RULE = "│| \n", "│╭╮╰╯─|+- "
"""Characters of tyro's boxes, also of its ASCII ones."""
_ANSI = re.compile(r"\x1b\[[0-9;]*m")
_PUNCTUATION = re.compile(r"[.;:?]$")
_CHOICES = re.compile(r"(?<=one of )\('[^()]*'\)")
_UNRECOGNIZED = "unrecognized options: "


def parse(command: type[Command], program: str, arguments: Sequence[str]) -> Command:
    """Parse the options of a command.

    Raises:
        GraspRefineError: options that do not exist, have no value or a wrong one.
        SystemExit: with code 0, after `--help` was printed.
    """
    stderr, rules = io.StringIO(), OptionRules(arguments)
    try:
        with contextlib.redirect_stderr(stderr):
            parsed = tyro.cli(command, prog=program, args=arguments, registry=rules)
    except GraspRefineError as error:
        raise GraspRefineError(rules.with_option(str(error))) from None
    except SystemExit as end:
        if not end.code:
            raise
        complaint = _one_line(stderr.getvalue())
        raise GraspRefineError(f"{complaint}{_grasps_hint(complaint, command)}; see {program} --help") from None
    sys.stderr.write(stderr.getvalue())
    return parsed


def _one_line(box: str) -> str:
    """Extract the error from tyro's box of several paragraphs, and the options that may have been meant."""
    paragraphs: list[list[str]] = [[]]
    for line in _ANSI.sub("", box).splitlines()[1:]:
        text = line.strip(_FRAME)
        if text.strip(_RULE):
            paragraphs[-1].append(text)
        else:
            paragraphs.append([])
    complaint = " ".join(next(filter(None, paragraphs), box.split()))
    complaint = complaint[:1].lower() + complaint[1:]
    meant = [
        text.split()[0].rstrip(",")
        for paragraph in paragraphs
        if paragraph and paragraph[0].startswith("Perhaps")
        for text in paragraph[1:]
        if text.startswith("--")
    ]
    guess = f"; perhaps {' or '.join(dict.fromkeys(meant))}" if meant else ""
    return _PUNCTUATION.sub("", _CHOICES.sub(_sorted_choices, complaint)) + guess


def _sorted_choices(found: re.Match[str]) -> str:
    """Sort the choices that tyro lists: it has them in the order of a set, with the None of an absent option."""
    return ", ".join(sorted(set(re.findall(r"'([^']*)'", found[0])) - {"None"}))


def _grasps_hint(complaint: str, command: type[Any]) -> str:
    """Return a hint how a grasp file is given, if a word without an option looks like one."""
    word = complaint.removeprefix(_UNRECOGNIZED).split()[0].rstrip(",") if complaint.startswith(_UNRECOGNIZED) else "-"
    return "" if word.startswith("-") or not _has_option(command, "grasps") else f"; perhaps --grasps {word}"


def _has_option(command: Any, name: str) -> bool:
    """Return True if a dataclass of options, or one nested in it, has a field of this name."""
    types = get_type_hints(command)
    return name in types or any(_has_option(kind, name) for kind in types.values() if is_dataclass(kind))


def check_numbers(options: Any, prefix: str = "--") -> None:
    """Refuse numbers out of range in a dataclass, and in those nested in it under a name.

    Floats must be finite and not negative, integers at least 1, some of them at least 0.

    Raises:
        GraspRefineError: names the option, its value and its range.
    """
    hints = get_type_hints(type(options), include_extras=True)
    for field in fields(options):
        value = getattr(options, field.name)
        option = flag(field.name, prefix)
        if is_dataclass(value):
            if not is_nameless(hints[field.name]):
                check_numbers(value, f"{option}.")
            continue
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float):
                limit = field.name in MAY_BE_INFINITE
                if not (number >= 0 and (limit or isfinite(number))):
                    words = "at least 0" if limit else "finite and not negative"
                    raise GraspRefineError(f"{option} must be {words}, got {number:g}")
            if type(number) is not int:
                continue
            if field.name == "seed" and not 0 <= number <= LARGEST_SEED:
                raise GraspRefineError(f"{option} must be 0 to {LARGEST_SEED}, got {number}")
            least = 0 if field.name in MAY_BE_ZERO else 1
            if number < least:
                raise GraspRefineError(f"{option} must be at least {least}, got {number}")


def check_device(device: str, dtype: str) -> None:
    """Refuse a device on which torch cannot hold numbers of a type.

    Raises:
        GraspRefineError: names the device and the type.
    """
    if device == "cpu":
        return
    import torch

    try:
        torch.zeros(1, dtype=getattr(torch, dtype), device=device).item()
    except (RuntimeError, AssertionError, TypeError, NotImplementedError) as error:
        reason = str(error).strip().splitlines()[0]
        raise GraspRefineError(
            f"--device {device} with --dtype {dtype} does not work here ({reason}); "
            "`refine-grasp doctor` lists the devices"
        ) from None
