"""Grasps in our own format, and what else reads .npz files: results of batches, recordings."""

from __future__ import annotations

import io
import json
import struct
import warnings
import zipfile
from collections.abc import Hashable
from pathlib import Path
from random import Random

import numpy as np

from fuzz.mutations import LARGEST_INPUT, changed_value
from fuzz.reader import Reader, plain
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine_apps.batch.record import is_result
from grasp_refine_apps.batch.rows import NEEDED, read_rows
from grasp_refine_apps.batch.shard import Shard

WORDS = (b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06", b"PK\x06\x06", b"PK\x06\x07", b"\x93NUMPY", b"'descr': '|O'")
WORDS += (b"'shape': (1000000000000,)", b"'fortran_order': True", b"<U9", b"<f8", b"hand_pose.npy", b"../x.npy")
TYPES = ("<f4", ">f8", "<i8", "|b1", "<U3", "|S4", "<c16", "<M8[s]", "<f2", "<u8", "|V3", "<U0")
SHAPES = ((), (0,), (0, 7), (1,), (3,), (3, 7, 1), (7,), (1000000000000,), (2, 3))
PROVENANCE = {
    "urdf": {"sha256": "0" * 64},
    "batch": {"stamp": "s", "job": "j", "look": ["a"]},
    "row": [0],
    "source": {"path": "a.npz"},
}


def arrays() -> dict[str, np.ndarray]:
    """Three grasps with everything that a file can hold."""
    pose = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (3, 1))
    return {
        # What results of a batch have besides.
        **{name: np.full(3, 0.5) for name in NEEDED},
        "schema": np.array(1),
        "hand": np.array("claw"),
        "base_link": np.array("palm"),
        "joint_names": np.array(["close", "slide"]),
        "object": np.array(["mug", "mug", "box:1,1,1"]),
        "scale": np.array(0.5),
        "hand_pose": pose,
        "q": np.arange(6.0).reshape(3, 2),
        "target_link": np.array(["left"]),
        "target_point_link": np.zeros((3, 1, 3)),
        "target_point_object": np.zeros((3, 1, 3)),
        "pregrasp_pose": pose,
        "pregrasp_q": np.zeros((3, 2)),
        "squeeze_pose": pose,
        "squeeze_q": np.zeros((3, 2)),
        "provenance": np.array(json.dumps(PROVENANCE)),
        "status": np.array(["converged", "stalled", "converged"]),
    }


def archive(members: dict[str, bytes], *, packed: bool = False) -> bytes:
    """A zip of some files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return stream.getvalue()


def member(array: np.ndarray) -> bytes:
    """An array file."""
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def seeds() -> list[tuple[str, bytes]]:
    """One stored, one packed."""
    members = {f"{key}.npy": member(value) for key, value in arrays().items()}
    small = {key: value for key, value in members.items() if not key.startswith(("target", "squeeze", "pregrasp"))}
    return [("grasps.npz", archive(members)), ("packed.npz", archive(small, packed=True))]


def change(random: Random, name: str, content: bytes) -> bytes:
    """Arrays of other shapes, types and values, headers that lie, members of other names."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = {entry.filename: file.read(entry) for entry in file.infolist() if entry.file_size < 2**16}
    except Exception:  # whatever a damaged archive raises
        return content
    for _ in range(random.choice((1, 1, 2, 3))):
        if not members:
            break
        key = (
            "provenance.npy" if "provenance.npy" in members and random.random() < 0.2 else random.choice(list(members))
        )
        kind = random.randrange(8)
        if kind < 3:
            members[key] = member(_changed(random, members[key]))
        elif kind == 3:
            del members[key]
        elif kind == 4:
            members[random.choice(("../x.npy", "/x.npy", "q", "a\nb.npy", "\x1b.npy", "x.npy.npy", "x"))] = members[key]
        elif kind == 5:
            members[key] = header(random) + members[key][random.choice((0, 64, 128)) :]
        elif kind == 6:
            members[key] = random.choice((b"", b"\x93NUMPY", b"not an array", members[key][: random.randrange(200)]))
        else:
            members[key] = members[random.choice(list(members))]
    data = archive(members, packed=random.random() < 0.3)
    if random.random() < 0.1:
        # What the directory says of sizes is not what follows.
        at = data.rfind(b"PK\x01\x02")
        where = at + random.choice((16, 20, 24, 42))
        data = data[:where] + struct.pack("<I", random.choice((0, 1, 2**20, 2**31, 2**32 - 1))) + data[where + 4 :]
    return data


def header(random: Random) -> bytes:
    """The head of an array file that may say anything."""
    shapes = ("(1000000000000,)", "(-1,)", "(2**40,)", "(1, 2, 'x')", "[]", "(" * 300, "(3, 7)", "(3L, 7L)")
    dtype = random.choice(("'<f8'", "'|O'", "'<U1000000000'", "[('a', '<f8')]", "'V'", "'<f99'", "None", "'<M8[7D]'"))
    order, shape = random.choice(("False", "True", "3")), random.choice(shapes)
    text = f"{{'descr': {dtype}, 'fortran_order': {order}, 'shape': {shape}, }}"
    text += random.choice(("", " " * 60, "\n", "\0", "'x': 1}"))
    version = random.choice(((1, 0), (1, 0), (2, 0), (3, 0), (4, 0)))
    size = random.choice((len(text), len(text), len(text), 0, 2**16 - 1))
    return b"\x93NUMPY" + bytes(version) + struct.pack("<H" if version[0] == 1 else "<I", size) + text.encode()


def _changed(random: Random, data: bytes) -> np.ndarray:
    """Another array."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # whatever a damaged array raises
        array = np.zeros(3)
    if array.nbytes > LARGEST_INPUT or array.dtype.itemsize > LARGEST_INPUT:
        # Packed files of zeros may hold arrays that double without end.
        array = np.zeros(3)
    if array.dtype.kind == "U" and array.shape == () and str(array).startswith("{") and random.random() < 0.8:
        try:
            return np.array(json.dumps(changed_value(random, json.loads(str(array)))))
        except (ValueError, RecursionError):
            return array
    kind = random.randrange(7)
    if kind == 0:
        return np.zeros(random.choice([shape for shape in SHAPES if np.prod(shape) < 1e6]), array.dtype)
    if kind == 1:
        return np.zeros(array.shape, random.choice(TYPES))
    if kind == 2:
        texts = ("\x1b[2J", "", "a" * 5000, "../outside/secret", "{}", "[" * 9000, "a\nb", "\x9b")
        return np.array(random.choice(texts))
    if kind == 3 and array.size and array.dtype.kind == "f":
        array = array.copy()
        at = tuple(random.randrange(length) for length in array.shape)
        array[at] = random.choice((np.nan, np.inf, -1e308, 1e308, 5e-324, 0.0, -1.0))
        return array
    if kind == 4:
        return np.asfortranarray(array[..., ::-1] if array.ndim else array).astype(array.dtype.newbyteorder())
    if kind == 5:
        return np.array([None, {"a": 1}], dtype=object)
    return np.concatenate([array, array]) if array.ndim else np.array([array.item()] * 2)


def read(path: Path) -> Hashable:
    """The grasps as any command reads them; what a batch and a proof look up first."""
    is_result(path)
    try:
        known = str(read_provenance(path))
    except GraspFileError:
        known = "refused"
    try:
        read_rows(Shard(0, "", "claw", 3, path, "s", None), path.parent)
    except GraspRefineError as error:
        plain(str(error))
    grasps = reading(path).grasps
    n = len(grasps)
    assert n and grasps.q.shape == (n, len(grasps.joint_names)) and grasps.finite.shape == (n,)
    assert (grasps.scale > 0).all() and np.isfinite(grasps.scale).all()
    stages = (stage.pose for stage in (grasps.pregrasp, grasps.squeeze) if stage is not None)
    for pose in (grasps.hand_pose, *stages):
        poses = pose[grasps.finite]
        np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1, atol=1e-9)
    for text in (grasps.hand, grasps.base_link, *grasps.joint_names, *grasps.object.tolist()):
        plain(text)
    return n, known, grasps.targets is None, grasps.pregrasp is None, grasps.squeeze is None


READER = Reader("npz", seeds, read, change, WORDS)
