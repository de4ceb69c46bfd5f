"""The path of an asset on this machine, fetched when it is not here and may be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from grasp_refine.assets.cache import asset_folder, is_whole, main_path
from grasp_refine.assets.download import PAUSE
from grasp_refine.assets.fetching import Progress, fetch_asset
from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.origin import chosen_origin
from grasp_refine.core.errors import AssetError


def located(
    asset: Asset, *, fetch: bool = True, progress: Progress = lambda place, done, total: None, pause: float = PAUSE
) -> Path:
    """The main file of an asset, or the folder of a grasp set; all its files are here and checked.

    Args:
        asset: What to locate.
        fetch: Fetch what is missing or damaged, when the licence is open or was accepted.
        progress: Hears how far that is.
        pause: Seconds before the second attempt at a file.

    Raises:
        AssetError: it is not here and may not or cannot be fetched; says what to do.
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
        fetch_asset(asset, origin, progress=progress, pause=pause)
    return main_path(asset, origin.layout)


def fetched(asset: Asset, say: Callable[[str], None]) -> Path:
    """As `located`; `say` hears once when something has to be fetched.

    Raises:
        AssetError: as `located`.
    """
    told: list[str] = []

    def tell(place: str, done: int, total: int | None) -> None:
        if not told:
            size = "" if total is None else f", {total / 1e6:.1f} MB"
            told.append(f"fetching {asset.full_name} (licence: {asset.licence}{size}) ...")
            say(told[0])

    return located(asset, progress=tell)
