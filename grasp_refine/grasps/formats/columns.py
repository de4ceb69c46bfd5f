"""Columns of a table: CSV, Parquet, HDF5, JSON, or a LeRobot data set; of bounded size.

A LeRobot data set (version 2 or 3) is a folder with `meta/info.json` and Parquet files below `data`. Its vectors have
named entries there; a column of each, `observation.state.NAME`, stands beside `observation.state`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_file, is_folder
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.folders import natural
from grasp_refine.grasps.formats.source import MAX_NUMBERS

MAX_TEXT_BYTES = 2**26
"""Largest size of a CSV file in bytes; its values take about ten times as much."""
MAX_FILES = 1000
"""Most Parquet files of a LeRobot data set."""
MAX_CHARACTERS = 1000
"""Most characters of a text in a table."""
INSTALL = "it takes pyarrow to read it: pip install 'grasp-refine[parquet]'"
INFO = "meta/info.json"
"""Description of a LeRobot data set, in its folder."""

Columns = dict[str, np.ndarray]
"""Name -> entries (N, ...), numbers or texts."""


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
        return _parquet([path], wanted)
    flat = dict(_flat(load_content(path)))
    return {name: _entries(path, name, flat[name]) for name in wanted if name in flat}


def column_names(path: Path) -> list[str]:
    """Names of the columns of a table, as far as they are cheap to list, for messages."""
    try:
        if path.suffix.lower() == ".csv":
            with path.open(newline="", encoding="utf-8-sig") as file:
                return next(csv.reader([file.readline(MAX_TEXT_BYTES)]), [])
        if path.suffix.lower() == ".parquet" or is_folder(path):
            import pyarrow.parquet as pq

            return list(pq.read_schema(_data_files(path)[0] if is_folder(path) else path).names)
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


def _parquet(paths: list[Path], wanted: Collection[str]) -> Columns:
    if find_spec("pyarrow") is None:
        raise GraspFileError(f"{paths[0]}: is Parquet, and {INSTALL}")
    import pyarrow as pa
    import pyarrow.parquet as pq

    parts: list[Columns] = []
    left = MAX_NUMBERS
    for path in paths:
        if not is_file(path):
            raise GraspFileError(f"{path}: no such table")
        try:
            with pq.ParquetFile(path) as file:
                schema = file.schema_arrow
                texts = [field.name for field in schema if pa.types.is_string(field.type)]
                names = [name for name in wanted if name in schema.names]
                about = file.metadata
                # Numbers may be packed to almost nothing: only their count bounds what they become.
                left -= sum(
                    column.num_values
                    for group in map(about.row_group, range(about.num_row_groups))
                    for column in map(group.column, range(group.num_columns))
                    if column.path_in_schema.split(".")[0] in {name.split(".")[0] for name in names}
                )
                if left < 0:
                    raise GraspFileError(f"{path}: has more than {MAX_NUMBERS} numbers in the columns that are read")
            table = pq.read_table(path, columns=names, read_dictionary=[name for name in names if name in texts])
            parts.append({name: _of_arrow(path, name, table.column(name)) for name in names})
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            raise GraspFileError(f"{path}: is no readable Parquet file ({' '.join(str(error).split())[:80]})") from None
    common = [name for name in parts[0] if all(name in part for part in parts)]
    try:
        return {name: np.concatenate([part[name] for part in parts]) for name in common}
    except ValueError:
        raise GraspFileError(f"{paths[0].parent}: its files have columns of several shapes") from None


def _of_arrow(path: Path, name: str, column: Any) -> np.ndarray:
    """Entries of a column of Arrow: numbers, texts, or lists of one length."""
    import pyarrow as pa

    chunks = column.combine_chunks()
    chunk = pa.concat_arrays(chunks.chunks) if isinstance(chunks, pa.ChunkedArray) else chunks
    shape = [len(chunk)]
    if isinstance(chunk, pa.DictionaryArray):
        values = chunk.dictionary.to_pylist()
        if any(value is None or len(value) > MAX_CHARACTERS for value in values):
            raise GraspFileError(f"{path}: column {name} has a text of more than {MAX_CHARACTERS} characters")
        codes = chunk.indices.to_numpy(zero_copy_only=False)
        return np.array([*values, ""])[np.where(np.isfinite(codes), codes, len(values)).astype(int)]
    while pa.types.is_list(chunk.type) or pa.types.is_large_list(chunk.type) or pa.types.is_fixed_size_list(chunk.type):
        if chunk.null_count:
            raise GraspFileError(f"{path}: column {name} has rows without a list")
        flat = chunk.flatten()
        lengths = {len(chunk) and len(flat) // len(chunk)} | set(
            chunk.value_lengths().unique().to_pylist() if not pa.types.is_fixed_size_list(chunk.type) else ()
        )
        if len(lengths) > 1:
            raise GraspFileError(f"{path}: column {name} has lists of several lengths")
        shape, chunk = [*shape, *lengths], flat
    return np.asarray(chunk.to_numpy(zero_copy_only=False)).reshape(shape)


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
    columns = _parquet(files, list(dict.fromkeys(entries.get(name, (name, 0))[0] for name in wanted)))
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
