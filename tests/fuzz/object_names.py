"""Objects by a text, as a command line, a job or a grasp file may have them, and TOML files of objects' meshes."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from random import Random

import numpy as np

from fuzz.mutations import NUMBERS, VALUES
from fuzz.reader import Reader
from fuzz.toml import WORDS, changed_toml, toml
from grasp_refine.objects.object import load_object
from grasp_refine.objects.source import is_known, named_object

TEXTS = tuple(value for value in VALUES if isinstance(value, str))
LISTED = {"cup": "meshes/cup.obj", "mug": "mug", "die": "box:0.02,0.02,0.02"}


def seeds() -> list[tuple[str, bytes]]:
    """The primitives."""
    return [(f"{i}.txt", text) for i, text in enumerate((b"box:0.1,0.2,0.3", b"sphere:0.05", b"cylinder:0.05,0.1"))]


def change(random: Random, name: str, content: bytes) -> bytes:
    """Another number, or another text altogether."""
    if random.random() < 0.2:
        return random.choice(TEXTS).encode()
    kind, _, numbers = content.partition(b":")
    sizes = numbers.split(b",")
    sizes[random.randrange(len(sizes))] = random.choice((*NUMBERS, b"1e-9", b"1e-60", b"1e60", b""))
    return kind + b":" + b",".join(sizes * random.choice((1, 1, 1, 2)))


def silent(line: str) -> None:
    raise AssertionError(f"fetched: {line}")


def read(path: Path) -> Hashable:
    """The object."""
    text = path.read_bytes().decode("utf-8", errors="replace")
    known = is_known(text)
    if known:
        named_object(text, None, Path("grasps.npz"), silent)
    loaded = load_object(text, candidates=16, cache=None)
    assert np.isfinite(loaded.mesh.vertices).all() and np.isfinite(loaded.mesh.extents).all()
    assert all(np.isfinite(piece.vertices).all() and np.isfinite(piece.radius) for piece in loaded.body.pieces)
    return known, len(loaded.body.pieces)


def read_list(path: Path) -> Hashable:
    """What three names mean by a TOML file."""
    found = [named_object(name, path, Path("grasps.npz"), silent) for name in LISTED]
    return tuple(type(one.source).__name__ for one in found)


READER = Reader(
    "object",
    seeds,
    read,
    change,
    (b"box:", b"sphere:", b"cylinder:", b"mug", b"."),
    beyond=lambda path: True,  # `load_object` opens the folder that its caller names
)
LIST_READER = Reader("objects.toml", lambda: [("objects.toml", toml(LISTED))], read_list, changed_toml(), WORDS)
