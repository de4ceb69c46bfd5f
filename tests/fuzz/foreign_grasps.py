"""Grasps of other programs: array files and pickles of every format, and pickles of anything else."""

from __future__ import annotations

import io
import os
import pickle
import pickletools
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from fuzz.mutations import VALUES, changed_value
from fuzz.npz_files import header
from fuzz.reader import Reader, plain, written
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.dexgraspnet import JOINTS
from grasp_refine.grasps.formats.reading import reading

OPCODES = tuple(opcode.code.encode("latin-1") for opcode in pickletools.opcodes)
WORDS = (b"cos\nsystem\n", b"cbuiltins\neval\n", b"cnumpy\ndtype\n", b"cnumpy.core.multiarray\n_reconstruct\n")
WORDS += (b"cnumpy\nndarray\n", b"c_codecs\nencode\n", b"X\x05\x00\x00\x00hello", b"I01\n", b"L999999999999L\n")
WORDS += (b"\x93NUMPY", *OPCODES)
POSE = np.array([0.1, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0])
ARRAYS = (np.zeros(0), np.zeros((3, 7)), np.full(7, np.nan), np.float32(1), np.int64(2), np.array("x"), np.array(None))
ARRAYS += (np.array([1, "a", None], dtype=object), np.zeros((0, 3)), np.arange(29.0), np.bool_(True), np.array(1 + 2j))


class Touch:
    """Makes a file when Python unpickles it."""

    def __reduce__(self) -> Any:
        return os.system, ("touch ../outside/ran",)


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """A file of each format."""
    row = np.concatenate([POSE, np.linspace(0, 0.5, 22)])
    stages = {f"{name}_qpos": row for name in ("pregrasp", "grasp", "squeeze")}
    scene = {"scene": {"mug": {"pose": POSE, "scale": np.full(3, 0.1), "file_path": "a/b.obj"}}}
    bench = {"obj_pose": POSE, "obj_scale": 0.06, "obj_path": "assets/object/mug", **stages}
    named = {
        "qpos": {**dict.fromkeys(JOINTS, 0.1), **dict.fromkeys([f"WRJT{a}" for a in "xyz"], 0.0)},
        "scale": 0.1,
    }
    named["qpos"] |= dict.fromkeys([f"WRJR{a}" for a in "xyz"], 0.2)
    bodex = {"robot_pose": np.tile(row, (1, 2, 3, 1)), "obj_pose": POSE[None], "obj_scale": np.array([0.1])}
    bodex |= {"obj_path": ["assets/object/mug/mesh/simplified.obj"], "joint_names": [f"joint_{i}" for i in range(22)]}
    dexonomy = {key: value[None] for key, value in stages.items()} | {"n_evo": np.zeros(1), "hand_name": "shadow"}
    contents = {
        "bench": bench,
        "bodex": {key: value for key, value in bodex.items() if key != "joint_names"},
        "dexonomy": dexonomy | {"scene_cfg": scene | {"task": {"obj_name": "mug"}}},
        "floating": dexonomy | {"scene_path": "assets/mug/floating/scale010.npy"},
        "beside": dexonomy | {"scene_path": "../outside/scene.npy"},
        "dexgraspnet": [named, named],
        "leap_s10": np.tile(np.r_[np.zeros(16), 0, 0, 0.5, 0, 0, 0, 1].astype(np.float32), (3, 1)),
    }
    seqs = np.tile(np.linspace(0.0, 0.4, 12), (2, 9, 1))
    seqs[:, 5:, 2] += 0.01 * np.arange(4)
    contents["tray"] = {
        "grasp_seqs": seqs,
        "obj_rotmat": np.tile(np.eye(3), (2, 1, 1)),
        "obj_scale": np.array([0.1, 0.2]),
    }
    found = [(f"{name}.npy", stored(content)) for name, content in contents.items()]
    return (*found, *((f"{name}.pkl", pickle.dumps(contents[name], protocol=2)) for name in ("bench", "dexgraspnet")))


def stored(content: Any) -> bytes:
    """An array file."""
    stream = io.BytesIO()
    np.save(stream, content if isinstance(content, np.ndarray) else np.array(content, dtype=object))
    return stream.getvalue()


def change(random: Random, name: str, content: bytes) -> bytes:
    """Other values in the same form, pickled anew; a header that lies; opcodes in a row."""
    kind = random.random()
    if kind < 0.1:
        return header(random) + content[random.choice((80, 128)) :]
    if kind < 0.2:
        return bytes([128, random.randrange(6)]) + b"".join(random.choices((*WORDS, b"\x00", b"\x01\x00"), k=40)) + b"."
    value = _held(content)
    if value is None:
        return content
    value = changed_value(random, value, (*VALUES, *ARRAYS, *ARRAYS, None, b"bytes", (), Touch()))
    if random.random() < 0.1:
        for _ in range(random.choice((20, 40, 2000))):
            value = [value]
    try:
        if name.endswith(".npy") and random.random() < 0.7:
            return stored(value)
        return pickle.dumps(value, protocol=random.randrange(6))
    except (RecursionError, ValueError, TypeError, OverflowError, pickle.PicklingError):
        return content


def _held(content: bytes) -> Any:
    """What a sound file holds; files that were changed are not unpickled."""
    known = {data: name for name, data in seeds()}
    if content not in known:
        return None
    stream = io.BytesIO(content)
    array = np.load(stream, allow_pickle=True)
    if not isinstance(array, np.ndarray):
        return array
    # Of an array of one object the object, of one of several a list.
    return array.tolist() if array.dtype.hasobject else array


def read(path: Path) -> Hashable:
    """The grasps of one file, of whichever format."""
    load_content(path)
    return read_any(path)


def read_any(path: Path) -> Hashable:
    """The grasps of a file or an archive, of whichever format."""
    found = reading(path)
    grasps, n = found.grasps, len(found.grasps)
    assert n and grasps.q.shape == (n, len(grasps.joint_names)) and not np.isinf(grasps.q).any()
    assert (grasps.scale > 0).all() and np.isfinite(grasps.scale).all() and not np.isinf(grasps.hand_pose).any()
    np.testing.assert_allclose(np.linalg.norm(grasps.hand_pose[grasps.finite, 3:], axis=1), 1, atol=1e-9)
    for text in (grasps.hand, *grasps.joint_names, *grasps.object.tolist(), *found.notes):
        plain(text)
    return found.format.name, n, len(found.notes), grasps.pregrasp is None


def prepare(folder: Path) -> None:
    """The mesh of the object of the trajectories."""
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    written(folder, {"meshdata/tray/coacd/decomposed.obj": corners})


READER = Reader("foreign", seeds, read, change, WORDS, prepare)
