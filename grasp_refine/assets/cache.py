"""Cache folder of fetched assets: nothing is read from it unchecked, and nothing is written outside of it.

One folder for each asset, origin and state of the manifest, named by the hashes in it: `hands/leap/mirror-<digest>/`.
Files of upstream and of a mirror never mix, and files of an older manifest are never used for a newer one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.origin import Layout, wanted
from grasp_refine.core.errors import AssetError
from grasp_refine.geometry.cache import default_cache

LAYOUTS: tuple[Layout, ...] = ("upstream", "mirror")

HASH_DIGITS = 12
"""Hexadecimal digits of the hash in the name of a folder."""


@dataclass(frozen=True)
class FileState:
    """A file of an asset in the cache."""

    path: Path
    """Absolute path of the file, whether it exists or not."""
    place: str
    """Path in the asset's folder."""
    state: Literal["ok", "missing", "damaged"]
    """State of the file; damaged: its hash differs from the manifest's."""


def asset_folder(asset: Asset, layout: Layout) -> Path:
    """Folder of an asset's files from one origin; it may not exist yet."""
    files = [wanted(file, layout) for file in asset.files]
    text = "\n".join(sorted(f"{file.place} {file.sha256}" for file in files))
    digest = hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]
    return default_cache("assets") / asset.kind / asset.name / f"{layout}-{digest}"


def main_path(asset: Asset, layout: Layout) -> Path:
    """Path of an asset's main file from one origin, or the folder of a grasp set; it may not exist yet."""
    folder = asset_folder(asset, layout)
    return folder if asset.main is None else folder / wanted(asset.main, layout).place


def path_inside(folder: Path, place: str) -> Path:
    """Return the path of `place` in a folder of the cache.

    Raises:
        AssetError: the path would leave the cache: `place` is not a plain relative path, or a link or a folder is in
            the way; or it cannot be a path at all.
    """
    root = default_cache("assets")
    path = folder / place
    relative = path.relative_to(root) if path.is_relative_to(root) else None
    if relative is None or not place or ".." in relative.parts or "\\" in place:
        raise AssetError(f"'{place}' does not stay in the cache of assets, {root}")
    parents = [root / Path(*relative.parts[: i + 1]) for i in range(len(relative.parts))]
    try:
        link, folder_there = next((parent for parent in parents if parent.is_symlink()), None), path.is_dir()
    except OSError as error:
        raise AssetError(f"'{place}' cannot be the name of a file: {error.strerror}") from None
    if link is not None:
        raise AssetError(f"{link}: is a link, nothing is read or written through it; remove it and fetch again")
    if folder_there:
        raise AssetError(f"{path}: is a folder where a file should be; remove it and fetch again")
    return path


def file_states(asset: Asset, layout: Layout) -> Iterator[FileState]:
    """Yield the state of each file of an asset from one origin; hashes are computed anew.

    Raises:
        AssetError: a link or a folder is in the place of a file.
        OSError: a file cannot be read.
    """
    folder = asset_folder(asset, layout)
    for file in (wanted(file, layout) for file in asset.files):
        path = path_inside(folder, file.place)
        if not path.is_file():
            yield FileState(path, file.place, "missing")
        else:
            yield FileState(path, file.place, "ok" if sha256_of(path) == file.sha256 else "damaged")


def is_whole(asset: Asset, layout: Layout) -> bool:
    """Return whether all files of an asset are in the cache with the hashes of the manifest."""
    return all(state.state == "ok" for state in file_states(asset, layout))


def seems_here(asset: Asset, layout: Layout) -> bool:
    """Return whether all files of an asset are in the cache, by name and size alone, which is fast."""
    folder = asset_folder(asset, layout)
    for file in (wanted(file, layout) for file in asset.files):
        path = folder / file.place
        if not path.is_file() or (file.size is not None and path.stat().st_size != file.size):
            return False
    return True


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
