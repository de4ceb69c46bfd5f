"""Uploads to the viewer: zips of hands and grasps, meshes and URDFs from anyone, and what comes of them."""

from __future__ import annotations

import io
import shutil
import stat
import struct
import zipfile
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from random import Random

from fuzz import hand_tomls, meshes, urdfs
from fuzz.npz_files import archive
from fuzz.reader import Reader
from grasp_refine.geometry.mesh import load_mesh
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.hands.hand import load_hand
from grasp_refine_apps.viewer.files.uploads import store_upload

NAMES = ("../outside/x.obj", "/etc/x.obj", "a\\..\\b.obj", "C:/x.obj", "a/../b.obj", "\x1b.obj", "a\0.obj", "x" * 300)
NAMES += ("claw/meshes/CUBE.OBJ", "claw/hand.toml", "claw/claw.urdf", "a/" * 30 + "b.obj", ".obj", "link.obj")


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """A hand as a zip, a URDF alone, and meshes."""
    hand = {"claw/claw.urdf": urdfs.HAND.encode(), "claw/meshes/cube.obj": urdfs.CUBE.encode()}
    toml = b'urdf = "claw.urdf"\n[[contact]]\nlink = "left_tip"\n'
    zips = [("hand.zip", archive(hand)), ("toml.zip", archive({**hand, "claw/hand.toml": toml}, packed=True))]
    bodies = [seed for seed in meshes.seeds() if seed[0].startswith(("ball", "two.glb", "two.obj"))]
    return (*zips, ("arm.urdf", urdfs.ARM.encode()), *bodies)


def change(random: Random, name: str, content: bytes) -> bytes:
    """A changed file in the zip, or one more, of another name or kind."""
    if name.endswith(".urdf"):
        return urdfs.change(random, name, content)
    if not name.endswith(".zip"):
        return meshes.change(random, name, content)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            members = {entry.filename: file.read(entry) for entry in file.infolist() if entry.file_size < 2**16}
    except Exception:  # whatever a damaged archive raises
        return content
    key = random.choice(list(members) or ["claw/claw.urdf"])
    kind = random.randrange(6)
    if kind == 0:
        members[random.choice(NAMES)] = members.get(key, b"")
    elif kind == 1:
        members.pop(key, None)
    elif key.endswith(".urdf") and key in members:
        members[key] = urdfs.change(random, key, members[key])
    elif key.endswith(".toml") and key in members:
        members[key] = hand_tomls.READER.change(random, key, members[key])
    elif key in members:
        members[key] = meshes.change(random, key, members[key])
    data = archive(members, packed=random.random() < 0.5)
    if random.random() < 0.15:
        at = data.rfind(b"PK\x01\x02")
        where, word = random.choice(((38, stat.S_IFLNK << 16), (24, 2**31), (20, 1), (8, 1), (10, 14), (42, 2**20)))
        data = data[: at + where] + struct.pack("<I", word) + data[at + where + 4 :]
    return data


def read(path: Path) -> Hashable:
    """What was uploaded, and what its reader makes of it."""
    folder = path.parent / "uploaded"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    upload = store_upload(path.name, path.read_bytes(), folder)
    for file in folder.rglob("*"):
        assert not file.is_symlink() and file.resolve().is_relative_to(folder), file
    if upload.kind == "hand":
        urdfs.check(load_hand(upload.source, candidates=16, hull_limit=float("inf")))
    elif upload.kind == "mesh":
        load_mesh(upload.source)
    else:
        reading(upload.source, within=upload.folder)
    return upload.kind, len(upload.notes)


WORDS = (*meshes.WORDS, *urdfs.WORDS, b"PK\x01\x02", b"PK\x03\x04")
READER = Reader("upload", seeds, read, change, WORDS, starts_programs=True)
