"""Point clouds, depth pictures, intrinsics and poses: read as scans."""

from __future__ import annotations

import io
import struct
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
from PIL import Image

from fuzz.mutations import NUMBERS
from fuzz.reader import Reader
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.scans.camera_files import as_intrinsics, as_poses
from grasp_refine.scans.reading import Sensors, is_scan, read_scan
from scan_files import FILES, dome

WORDS = tuple(
    b"ply format ascii binary_little_endian binary_big_endian 1.0 element vertex face property list uchar float double "
    b"end_header FIELDS SIZE TYPE COUNT WIDTH HEIGHT VIEWPOINT POINTS DATA binary binary_compressed x y z normal_x F U "
    b"K: camera_matrix: data: &a *a [*a,*a,*a,*a] intrinsic_matrix fx ppx NUMPY 'descr': 'shape': IHDR IDAT".split()
)
HEAD_BYTES = 400


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """A small cloud in each format, a depth picture, and files of cameras."""
    found = [(name, make(dome(60), True)) for name, make in FILES.items()]
    depth = np.zeros((40, 40))
    depth[8:32, 8:32] = 0.5 + 0.002 * np.hypot(*np.mgrid[-12:12, -12:12])
    for name, values in (("depth.npy", depth), ("pose.npy", np.eye(4))):
        stream = io.BytesIO()
        np.save(stream, values)
        found.append((name, stream.getvalue()))
    for kind in ("png", "tiff"):
        stream = io.BytesIO()
        Image.fromarray(np.round(1e3 * depth).astype(np.uint16)).save(stream, kind)
        found.append((f"depth.{kind}", stream.getvalue()))
    found.append(("lens.yaml", b"k: [100, 0, 20, 0, 100, 20, 0, 0, 1]\n"))
    found.append(("lens.json", b'{"fx": 100, "fy": 100, "ppx": 20, "ppy": 20}'))
    found.append(("lens.txt", b"100 0 20\n0 100 20\n0 0 1\n"))
    return tuple(found)


def change(random: Random, name: str, content: bytes) -> bytes:
    """A header or a line that says something else; or other sizes of compressed points."""
    if name == "packed.pcd" and random.random() < 0.3:
        at = content.index(b"DATA")
        at = content.index(b"\n", at) + 1 + random.choice((0, 4))
        return content[:at] + struct.pack("<I", random.choice((0, 1, 2**16, 2**28, 2**32 - 1))) + content[at + 4 :]
    head, rest = content[:HEAD_BYTES], content[HEAD_BYTES:]
    lines = head.split(b"\n")
    for _ in range(random.choice((1, 1, 2, 5))):
        at = random.randrange(len(lines))
        words = lines[at].split(b" ")
        kind = random.randrange(4)
        if kind < 2:
            words[random.randrange(len(words))] = random.choice((*NUMBERS, *WORDS))
        elif kind == 2:
            words += words[-1:] * random.choice((1, 3, 1000))
        else:
            words = words[:-1]
        lines[at] = b" ".join(words)
    return b"\n".join(lines) + rest


def read(path: Path) -> Hashable:
    """The scan, or the camera."""
    if path.name.startswith("lens"):
        assert np.isfinite(as_intrinsics(path)).all()
        return "intrinsics"
    if path.name.startswith("pose"):
        assert np.isfinite(as_poses(path)).all()
        return "poses"
    if not is_scan(path):
        raise GraspRefineError("a mesh")
    scan, notes = (
        read_scan(path, Sensors(intrinsics="100,100,20,20"), unit="m")
        if path.name.startswith("depth")
        else read_scan(path, Sensors(seen_from="0,0,0.5"), unit="m")
    )
    for values in (scan.points, scan.normals, scan.origins, np.array(scan.noise_m)):
        assert np.isfinite(values).all()
    np.testing.assert_allclose(np.linalg.norm(scan.normals, axis=1), 1.0)
    assert len(scan.points) == len(scan.normals) == len(scan.view)
    assert scan.view.min() >= 0 and scan.view.max() < len(scan.origins)
    return len(scan.points) < 60, len(notes)


READER = Reader("scan", seeds, read, change, WORDS)
