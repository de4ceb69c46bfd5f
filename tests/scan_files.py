"""Point clouds in the formats of scanners, written by their specifications."""

from __future__ import annotations

import io
import struct

import numpy as np

RADIUS_M = 0.05


def dome(count: int = 800) -> np.ndarray:
    """Points (count, 3) on the upper half of a sphere, exact in float32."""
    way = np.random.default_rng(0).standard_normal((count, 3))
    way[:, 2] = np.abs(way[:, 2])
    return (RADIUS_M * way / np.linalg.norm(way, axis=1, keepdims=True)).astype(np.float32).astype(float)


def ply(points: np.ndarray, kind: str, *, normals: bool = False, count: int | None = None, more: str = "") -> bytes:
    """A PLY file with colours between coordinates and normals."""
    props = ["float x", "float y", "float z", "uchar red"] + ["double nx", "double ny", "double nz"] * normals
    count = len(points) if count is None else count
    head = f"ply\nformat {kind} 1.0\ncomment made\nelement vertex {count}\n"
    head += "".join(f"property {prop}\n" for prop in props) + more + "end_header\n"
    rows = [(*p, 7, *(p / RADIUS_M if normals else ())) for p in points]
    if kind == "ascii":
        return (head + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows)).encode()
    sign = "<" if "little" in kind else ">"
    return head.encode() + b"".join(struct.pack(f"{sign}fffB{'ddd' * normals}", *row) for row in rows)


def lzf(data: bytes) -> bytes:
    """Compressed bytes: copies of earlier ones where four repeat, else as they are."""
    out, waiting, at, seen = bytearray(), bytearray(), 0, {}

    def flush() -> None:
        for start in range(0, len(waiting), 32):
            part = waiting[start : start + 32]
            out.extend([len(part) - 1, *part])
        waiting.clear()

    while at < len(data):
        back = at - seen.get(data[at : at + 4], -(2**20))
        seen[data[at : at + 4]] = at
        if 0 < back <= 8192 and at + 4 <= len(data):
            length = 4
            while at + length < len(data) and length < 264 and data[at + length - back] == data[at + length]:
                length += 1
            flush()
            code, far = length - 2, back - 1
            out.extend([(min(code, 7) << 5) | far >> 8, *([code - 7] if code >= 7 else []), far & 255])
            at += length
        else:
            waiting.append(data[at])
            at += 1
    flush()
    return bytes(out)


def pcd(points: np.ndarray, data: str, *, normals: bool = False, count: int | None = None, viewpoint="0 0 0") -> bytes:
    """A PCD file with a field of three numbers between coordinates and normals."""
    names = ["x", "y", "z", "_"] + ["normal_x", "normal_y", "normal_z"] * normals
    count = len(points) if count is None else count
    head = (
        "# .PCD v0.7\nVERSION 0.7\n"
        f"FIELDS {' '.join(names)}\nSIZE {' '.join('1' if n == '_' else '4' for n in names)}\n"
        f"TYPE {' '.join('U' if n == '_' else 'F' for n in names)}\n"
        f"COUNT {' '.join('3' if n == '_' else '1' for n in names)}\n"
        f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT {viewpoint} 1 0 0 0\nPOINTS {count}\nDATA {data}\n"
    )
    rows = [(*p, 1, 2, 3, *(p / RADIUS_M if normals else ())) for p in points]
    if data == "ascii":
        return (head + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows)).encode()
    if data == "binary":
        return head.encode() + b"".join(struct.pack(f"<fffBBB{'fff' * normals}", *row) for row in rows)
    columns = list(zip(*rows, strict=True))
    content = b"".join(
        [
            *(np.array(column, "<f4").tobytes() for column in columns[:3]),
            np.array(columns[3:6], "u1").T.tobytes(),
            *(np.array(column, "<f4").tobytes() for column in columns[6:]),
        ]
    )
    packed = lzf(content)
    assert len(packed) < len(content)
    return head.encode() + struct.pack("<II", len(packed), len(content)) + packed


def npz(points: np.ndarray, normals: bool) -> bytes:
    out = io.BytesIO()
    np.savez(out, points=points, **({"normals": points / RADIUS_M} if normals else {}))
    return out.getvalue()


def text(points: np.ndarray, between: str, normals: bool) -> bytes:
    rows = np.hstack([points, points / RADIUS_M]) if normals else points
    return ("# made\n" + "".join(between.join(f"{v:.9g}" for v in row) + "\n" for row in rows)).encode()


FILES = {
    "ascii.ply": lambda p, n: ply(p, "ascii", normals=n),
    "little.ply": lambda p, n: ply(p, "binary_little_endian", normals=n),
    "big.ply": lambda p, n: ply(p, "binary_big_endian", normals=n),
    "ascii.pcd": lambda p, n: pcd(p, "ascii", normals=n),
    "binary.pcd": lambda p, n: pcd(p, "binary", normals=n),
    "packed.pcd": lambda p, n: pcd(p, "binary_compressed", normals=n),
    "plain.xyz": lambda p, n: text(p, " ", n),
    "commas.xyz": lambda p, n: text(p, ",", n),
    "arrays.npz": npz,
}
"""Name -> function of points, and of whether there are normals, that returns the content."""
