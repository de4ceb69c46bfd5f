"""Names of files and folders in trees of grasps, and their natural order."""

from __future__ import annotations

import re
from collections.abc import Iterable

UNUSUAL = re.compile(r"[^\w.,=+-]+")
"""Characters that names of folders must not have."""


def object_folder(name: str) -> str:
    """Folder name of an object; unusual characters are replaced, and it never leads out of the folder that it is in."""
    return UNUSUAL.sub("_", name).lstrip(".") or "object"


def disambiguate(names: Iterable[str]) -> list[str]:
    """The names, with a number after repeated ones."""
    latest: dict[str, int] = {}
    found = []
    for name in names:
        new = name
        while new in latest:
            latest[name] += 1
            new = f"{name}_{latest[name]}"
        latest[new] = 1
        found.append(new)
    return found


def scale_folder(scale: float) -> str:
    """Generators' name for a scale: 0.06 is scale006."""
    return f"scale{round(scale * 100):03d}"


def floating_folder(name: str, scale: float) -> str:
    """Folder of the grasps of a floating object in BODex and Dexonomy."""
    return f"{object_folder(name)}/floating/{scale_folder(scale)}"


def natural(path: str) -> list[tuple[int, str]]:
    """Sort key of the natural order of paths: 2.npy before 10.npy."""
    return [
        (int(part), "") if part.isdecimal() and part.isascii() else (-1, part)
        for folder in path.split("/")
        for part in ["", *re.split(r"([0-9]{1,18})", folder)]
    ]
