"""Whether what lies in the cache of assets is still what the manifests say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from grasp_refine.assets.cache import LAYOUTS, asset_folder, file_states
from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.origin import Layout
from grasp_refine.core.errors import AssetError

State = Literal["whole", "incomplete", "damaged"]


@dataclass(frozen=True)
class Verdict:
    """What was found of an asset from one origin in the cache."""

    asset: Asset
    """The asset."""
    layout: Layout
    """Where its files came from."""
    folder: Path
    """Where they lie."""
    state: State
    """Whole; incomplete: some files were never fetched; damaged: some are not what the manifest says."""
    files: int
    """How many files it has in all."""
    missing: tuple[str, ...]
    """Files that are not there."""
    damaged: tuple[str, ...]
    """Files with another hash."""
    reason: str
    """What keeps it from being read at all; empty: nothing."""


def verify(assets: Iterable[Asset]) -> Iterator[Verdict]:
    """A verdict for each origin from which an asset is in the cache, however little of it; all hashes are computed."""
    for asset in assets:
        for layout in LAYOUTS:
            folder = asset_folder(asset, layout)
            if folder.exists() or folder.is_symlink():
                yield _verdict(asset, layout, folder)


def _verdict(asset: Asset, layout: Layout, folder: Path) -> Verdict:
    try:
        states = list(file_states(asset, layout))
    except (AssetError, OSError) as error:
        return Verdict(asset, layout, folder, "damaged", len(asset.files), (), (), str(error))
    missing = tuple(state.place for state in states if state.state == "missing")
    damaged = tuple(state.place for state in states if state.state == "damaged")
    state: State = "damaged" if damaged else "incomplete" if missing else "whole"
    return Verdict(asset, layout, folder, state, len(states), missing, damaged, "")
