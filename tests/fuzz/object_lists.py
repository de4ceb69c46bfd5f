"""A TOML file that says where the mesh of each object is."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path

from fuzz.reader import Reader
from fuzz.toml import WORDS, changed_toml, toml
from grasp_refine.objects.source import named_object


def seeds() -> list[tuple[str, bytes]]:
    """A mesh, an embedded object, a primitive."""
    return [("objects.toml", toml({"cup": "meshes/cup.obj", "mug": "mug", "die": "box:0.02,0.02,0.02"}))]


def read(path: Path) -> Hashable:
    """What is meant by three names."""

    def silent(line: str) -> None:
        raise AssertionError(f"fetched: {line}")

    found = [named_object(name, path, Path("grasps.npz"), silent) for name in ("cup", "mug", "die")]
    return tuple(type(one.source).__name__ for one in found)


READER = Reader("objects.toml", seeds, read, changed_toml(), WORDS)
