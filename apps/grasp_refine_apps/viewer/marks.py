"""What people thought of grasps: good or bad, kept in a small table beside the grasp file."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, get_args

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import from_cell, to_cell

Mark = Literal["", "good", "bad"]
"""What somebody thought of a grasp; empty: nothing."""
MARKS: tuple[Mark, ...] = tuple(mark for mark in get_args(Mark) if mark)
"""Marks that can be given."""
ENDING = ".marks.csv"
"""What is added to the name of a grasp file for the file of its marks."""
HEADER = ("row", "object", "index", "mark", "time")
"""Columns of a file of marks: row in the grasp file, name of the object, number of the grasp among those of the object,
mark, and when it was given, in UTC."""
LARGEST = 2**26
"""How many bytes a file of marks may have: 64 MiB, or a million marks."""


@dataclass(frozen=True)
class Marked:
    """One mark."""

    object: str
    """Name of the grasp's object."""
    index: int
    """Its number among the grasps of the object."""
    mark: Mark
    """What somebody thought of it."""
    time: str
    """When, in UTC, as ISO 8601 writes it."""


@dataclass(frozen=True)
class Marks:
    """The marks of one grasp file."""

    path: Path | None
    """Where they are kept; None: nowhere, the grasps lie in no file."""
    by_row: Mapping[int, Marked] = field(default_factory=dict)
    """Row in the grasp file -> its mark."""

    @staticmethod
    def read(path: Path) -> Marks:
        """The marks in a file; none if there is no such file.

        Raises:
            GraspFileError: it cannot be read as such.
        """
        if not path.exists():
            return Marks(path)
        try:
            if path.stat().st_size > LARGEST:
                raise _damaged(path, f"it is larger than {LARGEST // 2**20} MiB")
            with path.open(encoding="utf-8", newline="") as stream:
                lines = list(csv.reader(stream))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise _damaged(path, str(error)) from None
        if not lines or tuple(lines[0]) != HEADER:
            raise _damaged(path, f"it must begin with the line {','.join(HEADER)}")
        return Marks(path, dict(_marked(path, at, line) for at, line in enumerate(lines[1:], 2) if line))

    def of(self, row: int) -> Mark:
        """The mark of a row of the grasp file."""
        return self.by_row[row].mark if row in self.by_row else ""

    def marked(self, row: int, mark: Mark, *, object: str, index: int) -> Marks:
        """The same with another mark of a row; an empty one takes it away."""
        others = {key: value for key, value in self.by_row.items() if key != row}
        if mark:
            time = datetime.now(UTC).isoformat(timespec="seconds")
            others[row] = Marked(object, index, mark, time)
        return replace(self, by_row=dict(sorted(others.items())))

    @property
    def text(self) -> str:
        """What is written: a table of comma-separated values."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows((row, to_cell(m.object), m.index, m.mark, m.time) for row, m in self.by_row.items())
        return stream.getvalue()

    def save(self) -> None:
        """Write them, whole or not at all.

        Raises:
            GraspFileError: they cannot be written there; they are still here.
        """
        if self.path is None:
            raise GraspFileError(
                "marks are kept beside grasp files, and these grasps lie in none: save them to a file and open it, or "
                "download the marks"
            )
        try:
            with written_whole(self.path, GraspFileError) as partial:
                partial.write_text(self.text, encoding="utf-8")
        except GraspFileError as error:
            raise GraspFileError(f"{error}: make the folder writable and mark again, or download the marks") from error


def marks_path(path: Path) -> Path:
    """Where the marks of a grasp file, or of a folder of them, are kept: beside it, with `ENDING` added to its name.

    Those of grasps that come with the program are kept in the current folder.
    """
    folder = path.resolve().parent
    if folder.is_relative_to(resource_dir("robots").resolve()):
        folder = Path.cwd()
    return folder / f"{path.resolve().name}{ENDING}"


def _marked(path: Path, at: int, line: list[str]) -> tuple[int, Marked]:
    """Row and mark that a line says."""
    if len(line) != len(HEADER):
        raise _damaged(path, f"line {at} has {len(line)} values instead of {len(HEADER)}")
    row, name, index, mark, time = line
    if not all(text.isascii() and text.isdigit() and len(text) < 16 for text in (row, index)):
        raise _damaged(path, f"row and index in line {at} must be whole numbers")
    if mark not in MARKS:
        raise _damaged(path, f"the mark in line {at} must be {' or '.join(MARKS)}")
    return int(row), Marked(from_cell(name), int(index), mark, time)


def _damaged(path: Path, reason: str) -> GraspFileError:
    return GraspFileError(f"{path}: not a file of marks, {reason}; mend it or move it away")
