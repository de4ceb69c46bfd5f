"""Points in PCD files of the Point Cloud Library, versions 0.6 and 0.7: ascii, binary and binary_compressed.

Source: pointclouds.org, "The PCD (Point Cloud Data) file format"; the compression is LZF, by fields.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.scans.cloud import AXES, NORMAL_AXES, Cloud, check_point_count, cloud_of_columns, every, text_columns

MAX_HEADER_LINES, MAX_LINE_BYTES = 64, 4096
"""Most lines of a header, and most bytes of one."""

MAX_UNPACKED_BYTES = 2**28
"""Most bytes of compressed points when unpacked: 256 MiB."""

MAX_RUNS = 2**24
"""Most runs that compressed points are cut into: ten seconds."""

KINDS = {"F": "f", "I": "i", "U": "u"}
"""Type of a field -> NumPy's."""


def read_pcd(path: Path) -> Cloud:
    """Return the points of a PCD file; a VIEWPOINT other than the origin is the position of the sensor.

    Raises:
        MeshError: it is damaged, or has too many points.
    """
    with path.open("rb") as file:
        header: dict[str, list[str]] = {}
        for _ in range(MAX_HEADER_LINES):
            words = file.readline(MAX_LINE_BYTES).decode("ascii", errors="replace").split()
            if words and not words[0].startswith("#"):
                header[words[0].upper()] = words[1:]
                if words[0].upper() == "DATA":
                    break
        try:
            names, (data,) = header["FIELDS"], header["DATA"]
            counts = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
            kinds = [
                np.dtype(f"<{KINDS[kind]}{int(size)}")
                for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)
            ]
            points = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0])
            viewpoint = np.array([float(word) for word in header.get("VIEWPOINT", ["0"] * 7)][:3])
            if not (len(names) == len(counts) == len(kinds) and points >= 0 and all(0 < n <= 4096 for n in counts)):
                raise ValueError("fields do not fit each other")
            if viewpoint.shape != (3,) or not np.isfinite(viewpoint).all():
                raise ValueError("VIEWPOINT is no pose")
        except (LookupError, ValueError, TypeError) as error:
            raise MeshError(f"{path}: no PCD file, its header is damaged ({error})") from None
        check_point_count(points, path)
        # Fields without a name, "_", are padding.
        fields = {name: at for at, name in enumerate(names) if counts[at] == 1}
        wanted = [name for name in (*AXES, *NORMAL_AXES[1]) if name in fields]
        more = {"origins": viewpoint[None]} if viewpoint.any() else {}
        step = every(points) if points else 1
        columns: dict[str, np.ndarray]
        if data == "ascii":
            first = np.cumsum([0, *counts])
            values = text_columns(file, points, [int(first[fields[name]]) for name in wanted], path)
            _check_complete(len(values), points, path)
            columns = dict(zip(wanted, values[::step].T, strict=True))
        elif data == "binary":
            row = np.dtype([(f"{at}", kind, (n,)) for at, (kind, n) in enumerate(zip(kinds, counts, strict=True))])
            start = file.tell()
            _check_complete((path.stat().st_size - start) // row.itemsize, points, path)
            rows = np.memmap(file, row, "r", offset=start, shape=(points,))[::step] if points else np.zeros(0, row)
            columns = {name: rows[f"{fields[name]}"][:, 0] for name in wanted}
        elif data == "binary_compressed":
            packed, size = (int(number) for number in np.frombuffer(file.read(8).ljust(8, b"\0"), "<u4"))
            if size > MAX_UNPACKED_BYTES:
                raise MeshError(
                    f"{path}: would unpack to {size / 2**20:.0f} MiB; at most {MAX_UNPACKED_BYTES // 2**20} are read"
                )
            sizes = [kind.itemsize * n * points for kind, n in zip(kinds, counts, strict=True)]
            content = file.read(packed)
            if sum(sizes) > size or len(content) < packed:
                raise MeshError(f"{path}: cut off: its header promises {points} points")
            content, begin = _unpacked(content, size, path), np.cumsum([0, *sizes])
            columns = {
                name: np.frombuffer(content, kinds[fields[name]], points, int(begin[fields[name]]))[::step]
                for name in wanted
            }
        else:
            raise MeshError(f"{path}: its points are '{data}'; ascii, binary and binary_compressed are read")
        return cloud_of_columns(columns, points, path, **more)


def _check_complete(found: int, count: int, path: Path) -> None:
    if found < count:
        raise MeshError(f"{path}: cut off: its header promises {count} points, it has {found}")


def _unpacked(packed: bytes, size: int, path: Path) -> bytes:
    """Return bytes that LZF compressed: runs of at most 32 bytes as they are, or copies of earlier bytes."""
    out, at, runs = bytearray(), 0, 0
    try:
        while at < len(packed):
            runs += 1
            if runs > MAX_RUNS:
                raise MeshError(f"{path}: its compressed points are cut into more than {MAX_RUNS} runs")
            control = packed[at]
            at += 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            back = ((control & 31) << 8) + packed[at] + 1
            at += 1
            length += 2
            start = len(out) - back
            if start < 0 or len(out) + length > size:
                raise IndexError
            # A copy may reach into itself: then what lies between repeats.
            piece = out[start : start + length]
            out += (piece * (length // len(piece) + 1))[:length]
    except IndexError:
        raise MeshError(f"{path}: its compressed points are damaged") from None
    if len(out) != size:
        raise MeshError(f"{path}: its compressed points are damaged: {len(out)} bytes of {size}")
    return bytes(out)
