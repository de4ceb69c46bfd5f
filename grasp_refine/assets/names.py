"""Which asset a name means."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches

from grasp_refine.assets.manifest import KINDS, Asset, Kind, read_manifest
from grasp_refine.core.errors import AssetError


def all_assets() -> tuple[Asset, ...]:
    """All assets that the manifests know: hands, objects, grasps."""
    return tuple(asset for kind in KINDS for asset in read_manifest(kind).values())


def find_asset(name: str, kind: Kind) -> Asset | None:
    """The asset of a kind that `name` means; None: there is none.

    It means the one that is called so, else the only one whose name ends with it after a `_`. Case does not count, and
    `/`, `-` and `_` are the same, so that `ycb/011_banana`, `ycb_011_banana`, `011_banana` and `banana` are one.
    The kind may stand before the name: `hands/leap`.

    Raises:
        AssetError: the end of several names.
    """
    first, _, rest = name.partition("/")
    if first in KINDS and rest:
        if first != kind:
            return None
        name = rest
    return _meant(name, list(read_manifest(kind).values()))


def choose_asset(name: str) -> Asset:
    """The asset of any kind that `name` means, by the rules of `find_asset`.

    Raises:
        AssetError: there is none, or there are several; names what there is.
    """
    first, _, rest = name.partition("/")
    found = find_asset(name, first) if first in KINDS and rest else _meant(name, all_assets())
    if found is not None:
        return found
    names = [asset.name for asset in all_assets()]
    close = get_close_matches(_plain(name), names, n=3)
    meant = f", did you mean {' or '.join(close)}?" if close else ";"
    raise AssetError(f"no asset is called '{name}'{meant} `refine-grasp assets list` shows all {len(names)}")


def _meant(name: str, among: Sequence[Asset]) -> Asset | None:
    plain = _plain(name)
    if not plain.strip("_"):
        return None
    for fits in (
        [asset for asset in among if _plain(asset.name) == plain],
        [asset for asset in among if _plain(asset.name).endswith(f"_{plain}")],
    ):
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise AssetError(f"'{name}' could be any of {', '.join(asset.full_name for asset in fits)}")
    return None


def _plain(name: str) -> str:
    return name.lower().replace("/", "_").replace("-", "_")
