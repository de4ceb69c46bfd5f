"""Interface of a format of grasp files: recognising, reading and writing them."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Protocol, runtime_checkable

import numpy as np

from grasp_refine.core.arguments import describe_value
from grasp_refine.core.array_types import Int
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

SUCCESS, CONFIDENCE, ENERGY, FALL_TIME = "success", "confidence", "energy", "fall_time"
"""Labels that formats have a place for: result of a trial, 1 or 0; a score from 0 to 1; lower is better; seconds."""

SINGLE_PRECISION = "numbers are written in single precision, as its own are"
"""Note of formats of such numbers."""

Load = Callable[[str], Hand]
"""Loader of the hand below one of its links."""


@dataclass(frozen=True, eq=False)
class Part:
    """One file to be written."""

    path: str
    """Path in the folder, with / between folders; a part that may be a single file has no other beside it."""
    rows: Int[np.ndarray, " rows"]
    """The grasps in it, in its order."""
    content: Any
    """Contents: a GraspSet for our own format, else anything that an array file can hold."""


@runtime_checkable
class Format(Protocol):
    """One format: its name, its description in one line, and how its files are recognised, read and written.

    A subclass gives `name`, `what`, `mismatch` and `read`; without its own `write` it is read only.
    """

    @property
    def name(self) -> str:
        """Name on the command line."""
        ...

    @property
    def what(self) -> str:
        """Description in one line."""
        ...

    @property
    def named_by_path(self) -> bool:
        """Whether the name of a file has a meaning, so that it is always one in a folder."""
        return False

    @abstractmethod
    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        ...

    @abstractmethod
    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of one file, and notes for the user.

        Raises:
            GraspFileError: the file is of this format, but something in it is invalid.
        """
        ...

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """The files of some grasps, and notes on data without a place in them; `load` returns the hand below a link.

        Raises:
            GraspFileError: grasps that this format cannot hold at all, or it is read only.
        """
        raise GraspFileError(f"format {self.name} is read only")


MEMBERS = ("name", "what", "named_by_path", "mismatch", "read", "write")


def check_format(value: Format) -> None:
    """Refuse other objects than formats.

    Raises:
        GraspRefineError: names the missing or mistyped attribute.
    """
    if isinstance(value, type):
        raise GraspRefineError(f"a format is needed, got the class {value.__name__} itself: {value.__name__}()")
    lacking = [member for member in MEMBERS if not hasattr(value, member)]
    if lacking:
        raise GraspRefineError(f"{describe_value(value)} is no format: it lacks {', '.join(lacking)}; see Format")
    for member in ("name", "what"):
        text = getattr(value, member)
        if not (isinstance(text, str) and text.isprintable() and text):
            raise GraspRefineError(f"{member} of format {type(value).__name__} must be a text, got {text!r}")
    for member in ("mismatch", "read", "write"):
        if not callable(getattr(value, member)):
            raise GraspRefineError(f"{member} of format {value.name} must be a method")


def omission_notes(
    grasps: GraspSet, joints: Collection[str], *, stages: bool = True, labels: Collection[str] = (), size: str = ""
) -> list[str]:
    """Notes on what a format omits: it has a place for these joints and labels, maybe for stages, none for targets.

    `size` is the reason of a format without a place for scales.
    """
    others = [] if stages else [*grasps.other_stages]
    notes = [f"scale has no place in this format: its {size}"] if size and (grasps.scale != 1.0).any() else []
    notes += [f"{' and '.join(others)} have no place in this format and are left out"] if others else []
    if grasps.targets is not None:
        notes.append("targets have no place in this format and are left out")
    without_place = [name for name in grasps.labels if name not in labels]
    if without_place:
        notes.append(f"the labels {', '.join(without_place)} have no place in this format and are left out")
    above = [name for name in grasps.joint_names if name not in joints]
    if above:
        notes.append(f"{', '.join(above)} have no place in this format: the pose of the hand is that behind them")
    return notes


def check_file_names(grasps: GraspSet, format_name: str) -> None:
    """Refuse objects whose names cannot be file names.

    Raises:
        GraspFileError: there is one.
    """
    for name in np.unique(grasps.object).tolist():
        if not name or PurePosixPath(name).name != name or name.startswith(".") or "\0" in name:
            raise GraspFileError(f"format {format_name} names its files after objects, which {name!r} cannot be")


def single_grasps(grasps: GraspSet, folder: Callable[[str, float], str]) -> Iterator[tuple[int, str, float, str]]:
    """Row, object, scale and FOLDER/NUMBER of each grasp; `folder` is for an object and scale, numbers begin at 0."""
    numbers: Counter[str] = Counter()
    for row, (name, scale) in enumerate(zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)):
        place = folder(name, scale)
        yield row, name, scale, f"{place}/{numbers[place]}"
        numbers[place] += 1


def rows_by_object(grasps: GraspSet) -> dict[tuple[str, float], np.ndarray]:
    """Object and scale -> rows, in the order of the first of each."""
    groups: dict[tuple[str, float], list[int]] = {}
    for row, (name, scale) in enumerate(zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)):
        groups.setdefault((name, scale), []).append(row)
    return {key: np.array(rows) for key, rows in groups.items()}
