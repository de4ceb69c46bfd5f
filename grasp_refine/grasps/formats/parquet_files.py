"""Columns of Parquet files, of bounded size; needs pyarrow.

Its library ends the process on some damaged files. So it reads in a process of its own:
`python -m grasp_refine.grasps.formats.parquet_files COLUMNS FILE ...`, where COLUMNS is a list in JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_file
from grasp_refine.grasps.formats.pickled import Refused
from grasp_refine.grasps.formats.reading_apart import answer, read_apart
from grasp_refine.grasps.formats.source import MAX_NUMBERS

MAX_CHARACTERS = 1000
"""Most characters of a text in a table."""
INSTALL = "it takes pyarrow to read it: pip install 'grasp-refine[parquet]'"

Columns = dict[str, np.ndarray]
"""Name -> entries (N, ...), numbers or texts."""


def load_parquet(paths: Sequence[Path], wanted: Collection[str]) -> tuple[Columns, list[str]]:
    """Return columns of some files, one after the other, as far as all have them, and the names of all columns.

    Raises:
        GraspFileError: one is missing, damaged or too large, or pyarrow is missing.
    """
    if find_spec("pyarrow") is None:
        raise GraspFileError(f"{paths[0]}: is Parquet, and {INSTALL}")
    module, damaged = "grasp_refine.grasps.formats.parquet_files", f"{paths[0]}: is a damaged Parquet file"
    try:
        columns, names = read_apart(module, json.dumps(list(wanted)), *map(str, paths), damaged=damaged)
    except Refused as error:
        raise GraspFileError(str(error)) from None
    return columns, names


def parse_parquet(paths: Sequence[Path], wanted: Collection[str]) -> tuple[Columns, list[str]]:
    """Return columns as `load_parquet`, read in this process, which a damaged file may end.

    Raises:
        GraspFileError: as in `load_parquet`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    parts: list[Columns] = []
    known: list[str] = []
    left = MAX_NUMBERS
    for path in paths:
        if not is_file(path):
            raise GraspFileError(f"{path}: no such table")
        try:
            with pq.ParquetFile(path) as file:
                schema = file.schema_arrow
                known = known or list(schema.names)
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
        return {name: np.concatenate([part[name] for part in parts]) for name in common}, known
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


if __name__ == "__main__":
    sys.exit(answer(lambda: parse_parquet([Path(name) for name in sys.argv[2:]], json.loads(sys.argv[1]))))
