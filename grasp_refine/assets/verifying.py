"""Verification of cached assets against the manifests."""

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
    """State of an asset from one origin in the cache."""

    asset: Asset
    """The asset."""
    layout: Layout
    """Origin of its files."""
    folder: Path
    """Folder of its files."""
    state: State
    """Whole; incomplete: some files are missing; damaged: some have other hashes than the manifest."""
    files: int
    """Number of files of the asset."""
    missing: tuple[str, ...]
    """Files that are missing."""
    damaged: tuple[str, ...]
    """Files with another hash."""
    reason: str
    """Error that prevents reading it; empty: none."""


def verify(assets: Iterable[Asset]) -> Iterator[Verdict]:
    """Yield a verdict for each asset and origin with any file in the cache; all hashes are computed."""
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
