"""Points in PLY files: the element `vertex`, ascii or binary; headers are checked against the size of the file."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.scans.cloud import AXES, NORMAL_AXES, Cloud, check_point_count, cloud_of_columns, every, text_columns

MAX_HEADER_BYTES = 2**16
"""Most bytes of a header."""

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
"""Type of a property -> NumPy's."""

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
"""Format -> NumPy's sign of the order of bytes."""


def is_cloud(path: Path) -> bool:
    """Return whether a PLY file has points and no faces; others are for readers of meshes."""
    with path.open("rb") as file:
        return _points(file) is not None


def read_ply(path: Path) -> Cloud:
    """Return the points of a PLY file that `is_cloud`.

    Raises:
        MeshError: it is damaged, or has too many points.
    """
    with path.open("rb") as file:
        found = _points(file)
        if found is None:
            raise MeshError(f"{path}: has no points without faces")
        order, count, properties = found
        check_point_count(count, path)
        names = [name for name, _ in properties]
        if len(set(names)) < len(names):
            raise MeshError(f"{path}: a property of its points is there twice")
        wanted = [name for name in (*AXES, *NORMAL_AXES[0]) if name in names]
        if order == "":
            values = text_columns(file, count, [names.index(name) for name in wanted], path)
            _check_complete(len(values), count, path)
            values = values[:: every(count)] if count else values
            return cloud_of_columns(dict(zip(wanted, values.T, strict=True)), count, path)
        kind = np.dtype([(name, f"{order}{kind}") for name, kind in properties])
        start = file.tell()
        _check_complete((path.stat().st_size - start) // max(kind.itemsize, 1), count, path)
        if count == 0:
            return cloud_of_columns({name: np.zeros(0) for name in wanted}, 0, path)
        rows = np.memmap(file, kind, "r", offset=start, shape=(count,))[:: every(count)]
        return cloud_of_columns({name: rows[name] for name in wanted}, count, path)


def _points(file: BinaryIO) -> tuple[str, int, list[tuple[str, str]]] | None:
    """Return the order of bytes, number and properties of the points after a header; None: there are faces, or none."""
    order, elements = _header(file)
    if order is None or not elements or elements[0][0] != "vertex":
        return None
    if any(name == "face" and count for name, count, _ in elements):
        return None
    _, count, properties = elements[0]
    kinds = [(name, kind) for name, kind in properties if kind is not None]
    return (order, count, kinds) if len(kinds) == len(properties) else None


def _header(file: BinaryIO) -> tuple[str | None, list[tuple[str, int, list[tuple[str, str | None]]]]]:
    """Return the order of bytes, None for an unknown format, and elements with count and properties.

    The type of a property is None where it is a list.
    """
    order: str | None = None
    elements: list[tuple[str, int, list[tuple[str, str | None]]]] = []
    if file.readline(8).strip() != b"ply":
        return None, []
    while file.tell() < MAX_HEADER_BYTES:
        line = file.readline(MAX_HEADER_BYTES)
        if not line:
            break
        words = line.decode("ascii", errors="replace").split()
        if words[:1] == ["end_header"]:
            return order, elements
        try:
            if words[:1] == ["format"]:
                order = ORDERS.get(words[1])
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
                if elements[-1][1] < 0:
                    break
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[-1], None if words[1] == "list" else TYPES[words[1]]))
        except (LookupError, ValueError):
            break
    return None, []


def _check_complete(found: int, count: int, path: Path) -> None:
    if found < count:
        raise MeshError(f"{path}: cut off: its header promises {count} points, it has {found}")
