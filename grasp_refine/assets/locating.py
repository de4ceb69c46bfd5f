"""Local path of an asset, fetched where it is missing and its licence allows it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from grasp_refine.assets.cache import asset_folder, is_whole, main_path
from grasp_refine.assets.fetching import Progress, fetch_asset
from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.origin import chosen_origin
from grasp_refine.core.errors import AssetError


def locate_asset(
    asset: Asset,
    *,
    fetch: bool = True,
    progress: Progress = lambda place, done, total: None,
) -> Path:
    """Return the main file of an asset, or the folder of a grasp set; all its files are in the cache and checked.

    Args:
        asset: Asset to locate.
        fetch: Fetch missing and damaged files, when the licence is open or was accepted.
        progress: Called as files are fetched.

    Raises:
        AssetError: the asset is not in the cache and may not or cannot be fetched; names the remedy.
    """
    origin = chosen_origin()
    folder = asset_folder(asset, origin.layout)
    try:
        here = is_whole(asset, origin.layout)
    except OSError as error:
        raise AssetError(f"{folder}: cannot be read ({error.strerror or error})") from error
    if not here and not fetch:
        raise AssetError(f"{asset.full_name} is not here: refine-grasp assets fetch {asset.full_name}")
    if not here:
        fetch_asset(asset, origin, progress=progress)
    return main_path(asset, origin.layout)


def fetched(asset: Asset, on_message: Callable[[str], None]) -> Path:
    """Locate an asset as `locate_asset`; calls `on_message` once with a line when files have to be fetched.

    Raises:
        AssetError: as in `locate_asset`.
    """
    announced = False

    def announce(place: str, done: int, total: int | None) -> None:
        nonlocal announced
        if not announced:
            size = "" if total is None else f", {total / 1e6:.1f} MB"
            announced = True
            on_message(f"fetching {asset.full_name} (licence: {asset.licence}{size}) ...")

    return locate_asset(asset, progress=announce)
