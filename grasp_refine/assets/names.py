"""Lookup of assets by name."""

from __future__ import annotations

from collections.abc import Sequence

from grasp_refine.assets.manifest import KINDS, Asset, Kind, read_manifest
from grasp_refine.core.errors import AssetError, did_you_mean


def all_assets() -> tuple[Asset, ...]:
    """All assets of the manifests: hands, objects, grasps."""
    return tuple(asset for kind in KINDS for asset in read_manifest(kind).values())


def find_asset(name: str, kind: Kind) -> Asset | None:
    """Return the asset of a kind with this `name`; None: there is none.

    An exact match comes first, then the only name that ends with it after a `_`. Case does not count, and `/`, `-` and
    `_` are equivalent, so that `ycb/011_banana`, `ycb_011_banana`, `011_banana` and `banana` are one. The kind may
    precede the name: `hands/leap`.

    Raises:
        AssetError: several names end with it.
    """
    first, _, rest = name.partition("/")
    if first in KINDS and rest:
        if first != kind:
            return None
        name = rest
    return _match(name, list(read_manifest(kind).values()))


def choose_asset(name: str) -> Asset:
    """Return the asset of any kind with this `name`, by the rules of `find_asset`.

    Raises:
        AssetError: there is none, or several; names the candidates.
    """
    first, _, rest = name.partition("/")
    found = find_asset(name, first) if first in KINDS and rest else _match(name, all_assets())
    if found is not None:
        return found
    names = [asset.name for asset in all_assets()]
    meant = did_you_mean(_normalize(name), names, most=3)
    raise AssetError(f"no asset is called '{name}'{meant} `refine-grasp assets list` shows all {len(names)}")


def _match(name: str, among: Sequence[Asset]) -> Asset | None:
    plain = _normalize(name)
    if not plain.strip("_"):
        return None
    for fits in (
        [asset for asset in among if _normalize(asset.name) == plain],
        [asset for asset in among if _normalize(asset.name).endswith(f"_{plain}")],
    ):
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise AssetError(f"'{name}' could be any of {', '.join(asset.full_name for asset in fits)}")
    return None


def _normalize(name: str) -> str:
    return name.lower().replace("/", "_").replace("-", "_")
