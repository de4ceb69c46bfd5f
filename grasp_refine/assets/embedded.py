"""Folders of the files that come with the program: robots and asset manifests."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from grasp_refine.core.errors import AssetError


def resource_dir(name: Literal["robots", "assets_manifest"]) -> Path:
    """Return the folder `name` that comes with the program: inside the package, or beside it in a checkout.

    Raises:
        AssetError: neither folder exists: the installation is incomplete.
    """
    package = Path(__file__).resolve().parents[1]
    places = [package / f"{name}", package.parent / f"{name}"]
    for place in places:
        if place.is_dir():
            return place
    raise AssetError(f"the folder '{name}' is missing: tried {places[0]} and {places[1]}; install it again")
