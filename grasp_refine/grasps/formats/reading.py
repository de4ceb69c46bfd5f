"""Grasps from a file or a folder of any format, recognised by content."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.arguments import check_kind, describe_value
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_folder
from grasp_refine.core.npz_files import ZIP_ERRORS, is_zip
from grasp_refine.grasps.formats.archives import ARCHIVE_SUFFIXES, in_archive, members
from grasp_refine.grasps.formats.content import ARRAY_SUFFIXES, SUFFIXES, content_of, load_content, load_pickled_npz
from grasp_refine.grasps.formats.folders import natural
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.listing import FOREIGN, FORMATS, OURS
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.formats.torch_files import is_torch_archive
from grasp_refine.grasps.grasp_set import OTHER_STAGES, GraspSet
from grasp_refine.hands.hand import Hand

MAX_LISTED_ROWS = 10
"""Most rows that a note lists."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Grasps that were read, with their format and notes."""

    grasps: GraspSet
    """All grasps, in the order of the files."""
    format: Format
    """The format of all files."""
    files: tuple[Path, ...]
    """The files."""
    notes: tuple[str, ...]
    """Remarks for the user."""


def reading(
    path: str | Path,
    *,
    format: str | None = None,
    hand: Hand | None = None,
    on_file: Callable[[int, int], None] | None = None,
    within: Path | None = None,
) -> Reading:
    """The grasps of a file or a folder, with their format and notes.

    Args:
        path: A file, or a folder whose files, all of one format, are read. YAML, JSON and torch files in it that are
            of no format are left out, as such files lie beside grasps as well.
        format: Its format; None: recognised by its contents.
        hand: The hand that the grasps are for; needed where a file has no joint names and fits several.
        on_file: Called with the number of files read, and of all files.
        within: Folder that limits reading; a file may name another that describes its scene.

    Raises:
        GraspFileError: no such file, none in a folder, of no format or of several, or something in it is invalid.
    """
    check_kind("path", path, str | Path)
    path = Path(path)
    wanted = None if format is None else FORMATS[format]
    files, notes = _files(path, wanted)
    sets: list[GraspSet] = []
    found: Format | None = None
    paths: list[Path] = []
    for number, file in enumerate(files):
        for place, content in _contents(file, wanted):
            known = wanted or _recognise(place, content)
            mismatch = "it is an .npz file" if content is None and known != OURS else _mismatch(known, content)
            if mismatch:
                raise GraspFileError(f"{place}: is not a file of the format {known.name}: {mismatch}")
            if found is not None and known != found:
                raise GraspFileError(
                    f"{path}: holds files of several formats: {paths[0]} is {found.name}, {place} is {known.name}; "
                    "give one of its folders, or files one by one"
                )
            found = known
            grasps, more = _read(known, Source(place, content, within), hand)
            sets.append(grasps)
            paths.append(place)
            notes += more
        if on_file is not None:
            on_file(number + 1, len(files))
    assert found is not None
    joined, more = _join(paths, sets)
    if found != OURS:
        joined, empty = _without_empty_stages(joined)
        more += empty
    more += [*_label_notes(joined), *_not_finite(joined)]
    return Reading(joined, found, tuple(files), tuple(dict.fromkeys([*notes, *more])))


def may_be_other(file: Path) -> bool:
    """Return True for a file that may be something other than grasps, by its ending."""
    return file.suffix.lower() not in ARRAY_SUFFIXES


def is_other(file: Path) -> bool:
    """Return True if a file is of no format.

    Raises:
        GraspFileError: it cannot be read.
    """
    return not any(_is_of(content, FORMATS) for _, content in _contents(file, None))


def holds_grasps(file: Path) -> bool:
    """Return True if a file can be read and is of a format."""
    try:
        return not is_other(file)
    except GraspFileError:
        return False


def load_grasps(path: str | Path, *, format: str | None = None, hand: Hand | None = None) -> GraspSet:
    """Return the grasps of a file, or of a folder of files, of any format.

    What a file of another program does not say, or says twice, is warned about.

    Args:
        path: A file, or a folder whose files are all of one format.
        format: Name of the format, such as "dexgraspbench"; None: recognised by content.
        hand: The hand of the grasps; needed where a file has no joint names and fits several hands.

    Returns:
        Poses (N, 7) of the hand's base link in the object's frame, metres, joint values (N, n) by name, and object,
        scale, stages and labels as far as the file has them. Rows that are not finite are kept as NaN.

    Raises:
        GraspFileError: no such file, of no format or of several, or something in it is invalid.
    """
    check_kind("hand", hand, Hand | None)
    check_kind("format", format, str | None)
    found = reading(path, format=format, hand=hand)
    for note in () if found.format == OURS else found.notes:
        warnings.warn(f"{path}: {note}", stacklevel=2)
    return found.grasps


def _mismatch(known: Format, content: Any) -> str:
    """Reason why contents are not of a format.

    Raises:
        GraspFileError: the format gives no text.
    """
    reason = known.mismatch(content)
    if not isinstance(reason, str):
        raise GraspFileError(f"format {known.name}: mismatch must return a text, empty for a match, got {reason!r}")
    return reason


def _read(known: Format, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
    """The grasps of a file and notes.

    Raises:
        GraspFileError: the format gives something else, or the file is invalid.
    """
    found = known.read(source, hand)
    if not (isinstance(found, tuple) and len(found) == 2 and isinstance(found[0], GraspSet)):
        raise GraspFileError(f"format {known.name}: read must return a GraspSet and notes, got {describe_value(found)}")
    return found


def _is_of(content: Any, formats: Iterable[Format]) -> bool:
    return any(not _mismatch(known, content) for known in formats)


def _files(path: Path, wanted: Format | None) -> tuple[list[Path], list[str]]:
    """The files to be read, and notes on files that may hold grasps but cannot be read."""
    if not is_folder(path):
        return [path], []
    found = [file for file in path.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file()]
    files, notes, reason = [], [], ""
    for file in sorted(found, key=lambda file: natural(file.relative_to(path).as_posix())):
        if not may_be_other(file):
            files.append(file)
            continue
        try:
            place, content = next(_contents(file, wanted))
        except GraspFileError as error:
            notes.append(f"left out: {error}")
            continue
        if _is_of(content, (wanted,) if wanted else FORMATS):
            files.append(file)
        elif not reason:
            reason = f"; {_no_format(place, content)}"
    if not files:
        why = notes[0].removeprefix("left out: ") if notes else ""
        reason = f"; {why}" if why else reason
        raise GraspFileError(
            f"{path}: no grasp files in this folder or below it; they end with {', '.join(SUFFIXES)}{reason}"
        )
    return files, notes


def _contents(file: Path, wanted: Format | None) -> Iterator[tuple[Path, Any]]:
    """Path and contents of a file; of an archive, those of each file in it that is of a format, or must be."""
    found = in_archive(file)
    if found is None:
        yield file, _content(file)
        return
    archive, below = found
    none, other = True, None
    for place, data in members(archive, below, tuple(suffix for suffix in SUFFIXES if suffix not in ARCHIVE_SUFFIXES)):
        try:
            content = content_of(data, place)
        except GraspFileError:
            if may_be_other(place):
                continue
            raise
        if may_be_other(place) and not _is_of(content, (wanted,) if wanted else FORMATS):
            other = other or (place, content)
            continue
        none = False
        yield place, content
    if none and other is None:
        raise GraspFileError(f"{file}: has no files of grasps that can be read")
    if none and other is not None:
        yield other


def _content(file: Path) -> Any:
    """Contents of a file; None for an .npz, which our own format reads, unless it is of another one."""
    if not is_zip(file) or _is_torch(file):
        return None if file.suffix.lower() == ".npz" else load_content(file)
    content = load_pickled_npz(file)
    return content if _is_of(content, FOREIGN) else None


def _is_torch(file: Path) -> bool:
    """Return True for a zip that `torch.save` wrote."""
    try:
        with zipfile.ZipFile(file) as archive:
            return is_torch_archive(archive)
    except ZIP_ERRORS:
        return False


def _recognise(file: Path, content: Any) -> Format:
    """The one format that contents fit."""
    if content is None:
        return OURS
    fits = [known for known in FOREIGN if not _mismatch(known, content)]
    if len(fits) == 1:
        return fits[0]
    if fits:
        raise GraspFileError(
            f"{file}: fits the formats {' and '.join(known.name for known in fits)}: choose one with `format`"
        )
    raise GraspFileError(f"{_no_format(file, content)}; `format` chooses one")


def _no_format(file: Path, content: Any) -> str:
    reasons = "; ".join(f"{known.name}: {_mismatch(known, content)}" for known in FORMATS)
    return f"{file}: is of no known format ({reasons})"


def _join(files: Sequence[Path], sets: Sequence[GraspSet]) -> tuple[GraspSet, list[str]]:
    """All grasps as one set, and notes on lost data."""
    first = sets[0]
    if len(sets) == 1:
        return first, []
    for file, grasps in zip(files, sets, strict=True):
        same = grasps.base_link == first.base_link and set(grasps.joint_names) == set(first.joint_names)
        if not (same and grasps.hand == first.hand):
            raise GraspFileError(
                f"{file}: is for hand '{grasps.hand}' from link '{grasps.base_link}' on, with the joints "
                f"{', '.join(grasps.joint_names)}; {files[0]} is for '{first.hand}' from '{first.base_link}' on, with "
                f"{', '.join(first.joint_names)}: give them one by one"
            )
    lost = [name for name in OTHER_STAGES if len({name in grasps.other_stages for grasps in sets}) > 1]
    notes = [f"only some files have a {name}: it is left out" for name in lost]
    if any(grasps.targets is not None for grasps in sets):
        notes.append("targets are read from single files only, not from folders: they are left out")
    without: dict[str, Any] = dict.fromkeys(("targets", *lost))
    return GraspSet.join(replace(grasps, **without) for grasps in sets), notes


def _without_empty_stages(grasps: GraspSet) -> tuple[GraspSet, list[str]]:
    """The grasps without stages that equal the grasps themselves, and notes on these.

    Formats that need every stage repeat the grasp for missing ones; a squeeze that presses nothing is none.
    """
    notes = []
    for name, stage in grasps.other_stages.items():
        known = grasps.finite
        if not ((stage.pose != grasps.hand_pose)[known].any() or (stage.q != grasps.q)[known].any()):
            without: dict[str, Any] = {name: None}
            grasps = replace(grasps, **without)
            notes.append(f"the {name} is the grasp itself in all {len(grasps)}, so that there is none")
    return grasps, notes


def _label_notes(grasps: GraspSet) -> list[str]:
    """Note on the labels that distinguish grasps."""
    said = []
    for name, values in grasps.labels.items():
        known = values[np.isfinite(values)]
        if not len(known) or np.ptp(known) == 0:
            continue
        if np.isin(known, (0, 1)).all():
            said.append(f"{name} (1 of {int(known.sum())}, 0 of {int((known == 0).sum())})")
        else:
            said.append(f"{name} ({known.min():.4g} to {known.max():.4g})")
    return [f"labels of the grasps are kept: {', '.join(said)}"] if said else []


def _not_finite(grasps: GraspSet) -> list[str]:
    """Note on grasps that are not finite."""
    rows = np.flatnonzero(~grasps.finite)
    if not len(rows):
        return []
    are, what = ("is", "row") if len(rows) == 1 else ("are", "rows")
    listed = ", ".join(map(str, rows[:MAX_LISTED_ROWS])) + (", ..." if len(rows) > MAX_LISTED_ROWS else "")
    return [
        f"{len(rows)} of {len(grasps)} grasps {are} not finite: NaN, infinite, or a quaternion of length 0 "
        f"({what} {listed})"
    ]
