"""User marks of grasps, good or bad, kept in a small table beside the grasp file."""

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
"""Mark of a grasp; empty: none."""
MARKS: tuple[Mark, ...] = tuple(mark for mark in get_args(Mark) if mark)
"""Marks that can be given."""
MARKS_SUFFIX = ".marks.csv"
"""Suffix added to the name of a grasp file for the file of its marks."""
HEADER = ("row", "object", "index", "mark", "time")
"""Columns of a file of marks: row in the grasp file, name of the object, number of the grasp within the object,
mark, and when it was given, in UTC."""
MAX_FILE_BYTES = 2**26
"""Maximum bytes of a file of marks: 64 MiB, or a million marks."""


@dataclass(frozen=True)
class MarkedGrasp:
    """Mark of one grasp."""

    object: str
    """Name of the grasp's object."""
    index: int
    """Number of the grasp within the object."""
    mark: Mark
    """Mark of the grasp."""
    time: str
    """Time of the mark in UTC, as in ISO 8601."""


@dataclass(frozen=True)
class Marks:
    """Marks of one grasp file."""

    path: Path | None
    """File of the marks; None: not saved, since the grasps have no file."""
    by_row: Mapping[int, MarkedGrasp] = field(default_factory=dict)
    """Row in the grasp file -> its mark."""

    @staticmethod
    def read(path: Path) -> Marks:
        """Read the marks of a file; none if there is no such file.

        Raises:
            GraspFileError: it is no file of marks.
        """
        if not path.exists():
            return Marks(path)
        try:
            if path.stat().st_size > MAX_FILE_BYTES:
                raise _damaged(path, f"it is larger than {MAX_FILE_BYTES // 2**20} MiB")
            with path.open(encoding="utf-8", newline="") as stream:
                lines = list(csv.reader(stream))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise _damaged(path, str(error)) from None
        if not lines or tuple(lines[0]) != HEADER:
            raise _damaged(path, f"it must begin with the line {','.join(HEADER)}")
        return Marks(path, dict(_parse_line(path, at, line) for at, line in enumerate(lines[1:], 2) if line))

    def of(self, row: int) -> Mark:
        """Mark of a row of the grasp file."""
        return self.by_row[row].mark if row in self.by_row else ""

    def with_mark(self, row: int, mark: Mark, *, object: str, index: int) -> Marks:
        """Return the marks with another mark of a row; an empty one deletes it."""
        others = {key: value for key, value in self.by_row.items() if key != row}
        if mark:
            time = datetime.now(UTC).isoformat(timespec="seconds")
            others[row] = MarkedGrasp(object, index, mark, time)
        return replace(self, by_row=dict(sorted(others.items())))

    @property
    def text(self) -> str:
        """Content of the file: a table of comma-separated values."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows((row, to_cell(m.object), m.index, m.mark, m.time) for row, m in self.by_row.items())
        return stream.getvalue()

    def save(self) -> None:
        """Write the marks, whole or not at all.

        Raises:
            GraspFileError: they cannot be written there; they stay in memory.
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
    """Path of the marks of a grasp file, or of a folder of them: beside it, with `MARKS_SUFFIX` added to its name.

    Marks of embedded grasps are kept in the current folder.
    """
    folder = path.resolve().parent
    if folder.is_relative_to(resource_dir("robots").resolve()):
        folder = Path.cwd()
    return folder / f"{path.resolve().name}{MARKS_SUFFIX}"


def _parse_line(path: Path, at: int, line: list[str]) -> tuple[int, MarkedGrasp]:
    """Parse row and mark of a line."""
    if len(line) != len(HEADER):
        raise _damaged(path, f"line {at} has {len(line)} values instead of {len(HEADER)}")
    row, name, index, mark, time = line
    if not all(text.isascii() and text.isdigit() and len(text) < 16 for text in (row, index)):
        raise _damaged(path, f"row and index in line {at} must be integers")
    if mark not in MARKS:
        raise _damaged(path, f"the mark in line {at} must be {' or '.join(MARKS)}")
    return int(row), MarkedGrasp(from_cell(name), int(index), mark, time)


def _damaged(path: Path, reason: str) -> GraspFileError:
    return GraspFileError(f"{path}: not a file of marks, {reason}; fix it or move it away")
