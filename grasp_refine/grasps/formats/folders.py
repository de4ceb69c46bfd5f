"""Names of files and folders in trees of grasps, and the order in which people count them."""

from __future__ import annotations

import re
from collections.abc import Iterable

UNUSUAL = re.compile(r"[^\w.,=+-]+")
"""What names of folders do not have."""


def object_folder(name: str) -> str:
    """A folder for an object; what is unusual in its name is replaced, and it never leads out of where it lies."""
    return UNUSUAL.sub("_", name).lstrip(".") or "object"


def disambiguate(names: Iterable[str]) -> list[str]:
    """The names, with a number after those that came before."""
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
    """What generators call a scale: 0.06 is scale006."""
    return f"scale{round(scale * 100):03d}"


def floating_folder(name: str, scale: float) -> str:
    """Where BODex and Dexonomy keep the grasps of an object that lies on nothing."""
    return f"{object_folder(name)}/floating/{scale_folder(scale)}"


def natural(path: str) -> list[tuple[int, str]]:
    """The key that sorts paths as people do: 2.npy comes before 10.npy."""
    return [
        (int(part), "") if part.isdecimal() and part.isascii() else (-1, part)
        for folder in path.split("/")
        for part in ["", *re.split(r"([0-9]{1,18})", folder)]
    ]
