"""Index of a batch: one row per grasp, as Parquet or CSV, written while the result files are read."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.names import to_cell
from grasp_refine.results.validation_document import check_table
from grasp_refine_apps.batch.rows import Kind, Rows, column_kinds

if TYPE_CHECKING:
    import pyarrow

IndexKind = Literal["auto", "parquet", "csv"]

ROW_GROUP_SIZE = 2**14
"""Number of rows in one group of a Parquet file; it determines most of the memory that writing takes."""


AddRows = Callable[[Rows], None]
"""Writer of the rows of one result file after the other, at once or buffered."""


def index_path(out: Path, kind: IndexKind) -> Path:
    """Path of the index of the results in `out`.

    Raises:
        GraspRefineError: Parquet is chosen, and pyarrow is not installed.
    """
    if kind == "auto":
        kind = "parquet" if find_spec("pyarrow") is not None else "csv"
    path = out / f"index.{kind}"
    check_table(path)
    return path


@contextmanager
def index_writer(path: Path) -> Iterator[AddRows]:
    """Open an index for writing, CSV or Parquet by its suffix; the file appears only if the block succeeds.

    Raises:
        GraspRefineError: another suffix, Parquet without pyarrow, or the file cannot be written.
    """
    check_table(path)
    writing = _parquet if path.suffix.lower() == ".parquet" else _csv
    with written_whole(path, GraspRefineError) as partial, writing(partial) as add:
        yield add


@contextmanager
def _csv(path: Path) -> Iterator[AddRows]:
    """Write CSV with empty cells for null, true and false for flags, and the shortest exact text of numbers.

    Texts are escaped by `to_cell`, so that no spreadsheet reads them as formulas.
    """
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(column_kinds())
        yield lambda rows: writer.writerows(
            zip(*(_csv_cells(rows[name], kind) for name, kind in column_kinds().items()), strict=True)
        )


def _csv_cells(values: np.ndarray, kind: Kind) -> list[Any]:
    """Format a column for CSV."""
    if kind == "text":
        return [to_cell(text) for text in values.tolist()]
    words: dict[Kind, Callable[[Any], Any]]
    words = {"whole": int, "flag": lambda value: "true" if value else "false", "number": float}
    shown = words[kind]
    return [shown(value) if value == value else "" for value in values.tolist()]


@contextmanager
def _parquet(path: Path) -> Iterator[AddRows]:
    """Write Parquet, rows gathered to groups of a good size."""
    import pyarrow.parquet

    schema = _schema()
    waiting: list[Rows] = []

    def flush() -> None:
        arrays = [
            _parquet_array(np.concatenate([rows[name] for rows in waiting]), kind, schema.field(name).type)
            for name, kind in column_kinds().items()
        ]
        file.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), row_group_size=sum(map(len, waiting)))
        waiting.clear()

    def add(rows: Rows) -> None:
        waiting.append(rows)
        if sum(map(len, waiting)) >= ROW_GROUP_SIZE:
            flush()

    with pyarrow.parquet.ParquetWriter(path, schema, compression="zstd") as file:
        yield add
        if any(map(len, waiting)):
            flush()


def _parquet_array(values: np.ndarray, kind: Kind, type: pyarrow.DataType) -> pyarrow.Array:
    """Convert a column for Parquet."""
    import pyarrow

    if kind == "text":
        names, at = np.unique(values, return_inverse=True)
        return pyarrow.DictionaryArray.from_arrays(
            pyarrow.array(at.astype(np.int32), mask=values == ""), pyarrow.array(names.tolist(), pyarrow.string())
        )
    none = np.isnan(values)
    plain = {"whole": np.int64, "flag": bool, "number": float}[kind]
    return pyarrow.array(np.where(none, 0.0, values).astype(plain), type, mask=none)


def _schema() -> pyarrow.Schema:
    """Names and types of all columns; texts, which repeat, are stored once as a dictionary."""
    import pyarrow

    types = {
        "text": pyarrow.dictionary(pyarrow.int32(), pyarrow.string()),
        "whole": pyarrow.int64(),
        "flag": pyarrow.bool_(),
        "number": pyarrow.float64(),
    }
    return pyarrow.schema([(name, types[kind]) for name, kind in column_kinds().items()])
