"""Columns of a table: CSV, Parquet, HDF5, JSON, or a LeRobot data set; of bounded size.

A LeRobot data set (version 2 or 3) is a folder with `meta/info.json` and Parquet files below `data`. Its vectors have
named entries there; a column of each, `observation.state.NAME`, stands beside `observation.state`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_file, is_folder
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.folders import natural
from grasp_refine.grasps.formats.parquet_files import MAX_CHARACTERS, Columns, load_parquet

MAX_TEXT_BYTES = 2**26
"""Largest size of a CSV file in bytes; its values take about ten times as much."""
MAX_FILES = 1000
"""Most Parquet files of a LeRobot data set."""
INFO = "meta/info.json"
"""Description of a LeRobot data set, in its folder."""


def load_columns(path: Path, wanted: Collection[str]) -> Columns:
    """Return the columns of a table that are wanted, as far as it has them.

    Raises:
        GraspFileError: it is missing, damaged or too large, or pyarrow or h5py is.
    """
    if is_folder(path):
        return _lerobot(path, wanted)
    if path.suffix.lower() == ".csv":
        return _csv(path, wanted)
    if path.suffix.lower() == ".parquet":
        return load_parquet([path], wanted)[0]
    flat = dict(_flat(load_content(path)))
    return {name: _entries(path, name, flat[name]) for name in wanted if name in flat}


def column_names(path: Path) -> list[str]:
    """Names of the columns of a table, as far as they are cheap to list, for messages."""
    try:
        if path.suffix.lower() == ".csv":
            with path.open(newline="", encoding="utf-8-sig") as file:
                return next(csv.reader([file.readline(MAX_TEXT_BYTES)]), [])
        if path.suffix.lower() == ".parquet" or is_folder(path):
            return load_parquet(_data_files(path)[:1] if is_folder(path) else [path], [])[1]
        return [name for name, _ in _flat(load_content(path))]
    except Exception:  # only for a message about something else
        return []


def _csv(path: Path, wanted: Collection[str]) -> Columns:
    if not is_file(path):
        raise GraspFileError(f"{path}: no such table")
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise GraspFileError(f"{path}: has more than {MAX_TEXT_BYTES / 2**20:.0f} MiB; split it, or use Parquet")
    try:
        text = path.read_bytes()[: MAX_TEXT_BYTES + 1].decode("utf-8-sig")
        rows = csv.reader(io.StringIO(text, newline=""), strict=True)
        names = next(rows, [])
        places = {name: names.index(name) for name in wanted if name in names}
        cells: dict[str, list[str]] = {name: [] for name in places}
        for number, row in enumerate(rows, 2):
            if not row:
                continue
            if len(row) != len(names):
                raise GraspFileError(f"{path}: line {number} has {len(row)} cells; its header has {len(names)}")
            for name, place in places.items():
                cells[name].append(row[place])
    except (UnicodeDecodeError, csv.Error) as error:
        raise GraspFileError(f"{path}: is no valid CSV file ({error})") from None
    return {name: _parsed(values) for name, values in cells.items()}


def _parsed(cells: list[str]) -> np.ndarray:
    """Cells as numbers, NaN where they are empty, or as texts where one of them is no number."""
    try:
        return np.array([float(cell) if cell.strip() else np.nan for cell in cells])
    except ValueError:
        return np.array([cell[:MAX_CHARACTERS] for cell in cells])


def _data_files(folder: Path) -> list[Path]:
    found = [path for path in (folder / "data").rglob("*.parquet") if path.is_file()]
    return sorted(found, key=lambda path: natural(path.relative_to(folder).as_posix()))


def _lerobot(folder: Path, wanted: Collection[str]) -> Columns:
    info = load_content(folder / INFO) if is_file(folder / INFO) else None
    if not isinstance(info, Mapping) or not isinstance(info.get("features"), Mapping):
        raise GraspFileError(f"{folder}: is no LeRobot data set: it lacks {INFO} with features")
    files = _data_files(folder)
    if not 0 < len(files) <= MAX_FILES:
        raise GraspFileError(f"{folder}: has {len(files)} Parquet files below data; 1 to {MAX_FILES} are read")
    entries = {
        f"{name}.{entry}": (name, at)
        for name, feature in info["features"].items()
        for at, entry in enumerate(_entry_names(feature))
    }
    columns, _ = load_parquet(files, list(dict.fromkeys(entries.get(name, (name, 0))[0] for name in wanted)))
    for name in wanted:
        vector, at = entries.get(name, ("", 0))
        if vector in columns:
            if columns[vector].ndim != 2 or columns[vector].shape[1] <= at:
                raise GraspFileError(f"{folder}: {vector} has fewer entries than {INFO} names")
            columns[name] = columns[vector][:, at]
    return columns


def _entry_names(feature: Any) -> list[str]:
    """Names of the entries of a vector: a list, or a dict with one list; none where there are none."""
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping) and len(names) == 1:
        names = next(iter(names.values()))
    return [str(name) for name in names] if isinstance(names, list) else []


def _flat(content: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Name and value of each entry of nested dicts, with / between their keys."""
    for key, value in content.items() if isinstance(content, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}/")
        else:
            yield f"{above}{key}", value


def _entries(path: Path, name: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value)
    except ValueError:
        raise GraspFileError(f"{path}: the rows of {name} differ in length") from None
