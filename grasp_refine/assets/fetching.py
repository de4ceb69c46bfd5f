"""Fetching of all files of an asset, from upstream or a mirror into the cache; intact files there are kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from grasp_refine.assets.cache import asset_folder, file_states
from grasp_refine.assets.download import RETRY_PAUSE_S, download
from grasp_refine.assets.licence import accept, check_accepted
from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.origin import Origin, chosen_origin, total_bytes, wanted
from grasp_refine.core.errors import AssetError
from grasp_refine.geometry.cache import default_cache

Progress = Callable[[str, int, int | None], None]
"""Called with the file, the bytes of the asset received so far, and its total bytes, where known."""


def fetch_asset(
    asset: Asset,
    origin: Origin | None = None,
    *,
    accept_license: bool = False,
    progress: Progress = lambda place, done, total: None,
    pause: float = RETRY_PAUSE_S,
) -> Path:
    """Fetch missing and damaged files of an asset, and return its folder.

    When a file fails, files fetched before it stay, so that the next call resumes there; a file itself starts again.

    Args:
        asset: Asset to fetch.
        origin: Source of the files; None: set by `GRASP_REFINE_ASSETS`.
        accept_license: The user has accepted a licence that restricts use; this is recorded.
        progress: Called as files are fetched.
        pause: Seconds before the second attempt at a file.

    Raises:
        AssetError: the licence is not accepted, a source is missing, unreachable or provides other files, or the cache
            is not writable.
    """
    if accept_license:
        accept(asset)
    check_accepted(asset)
    origin = chosen_origin() if origin is None else origin
    folder = asset_folder(asset, origin.layout)
    try:
        states = list(file_states(asset, origin.layout))
    except OSError as error:
        raise AssetError(f"{folder}: cannot be read ({error.strerror or error})") from error
    missing = [i for i, state in enumerate(states) if state.state != "ok"]
    # Checked for all before the first is fetched: half an asset is useless.
    sources = {i: origin.source(asset, asset.files[i]) for i in missing}
    files = [wanted(file, origin.layout) for file in asset.files]
    sizes = [file.size for file in files]
    total = total_bytes(asset, origin.layout)
    done = sum(size or 0 for i, size in enumerate(sizes) if i not in sources)
    try:
        for i, source in sources.items():
            place, before = files[i].place, done
            progress(place, before, total)

            def on_bytes(count: int, place: str = place, before: int = before) -> None:
                progress(place, before + count, total)

            what, size, sha256 = f"{asset.full_name}, {place}", sizes[i], files[i].sha256
            assert sha256 is not None  # or there is no source
            download(source, states[i].path, sha256, what=what, size=size, on_bytes=on_bytes, pause=pause)
            done += states[i].path.stat().st_size if size is None else size
    except BaseException:
        _remove_empty(folder)
        raise
    return folder


def _remove_empty(folder: Path) -> None:
    """Remove empty folders at and below `folder`, and above it within the cache of assets."""
    below = [path for path in folder.rglob("*") if path.is_dir() and not path.is_symlink()]
    above = [path for path in (folder, *folder.parents) if path.is_relative_to(default_cache("assets"))]
    for path in (*sorted(below, reverse=True), *above):
        try:
            path.rmdir()
        except OSError:
            continue
