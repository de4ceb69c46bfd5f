"""Lookup of an object by its name: an embedded object, a primitive, a mesh or folder of the user's, or an asset."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from grasp_refine.assets.locating import fetched
from grasp_refine.assets.manifest import Asset, read_manifest
from grasp_refine.assets.names import find_asset
from grasp_refine.core.errors import AssetError, MeshError, did_you_mean, quote_value
from grasp_refine.core.names import exists, is_folder
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine.geometry.shapes import EMBEDDED, primitive_pieces
from grasp_refine.objects.folders import find_object
from grasp_refine.objects.object import PRIMITIVE_FORMS
from grasp_refine.scans.reading import SCAN_SUFFIXES


@dataclass(frozen=True)
class ObjectSource:
    """Source that `load_object` should load."""

    source: str | Path
    """Name or path."""
    asset: Asset | None = None
    """The asset, if it is one; its `scale` makes it fit a hand."""
    record: Mapping[str, Any] | None = None
    """Arguments of `load_object` with which a scan was read before, see `Object.record`."""


def chosen_object(name: str, on_message: Callable[[str], None]) -> ObjectSource:
    """Source of the object that a user calls `name`; a missing asset is fetched, which `on_message` gets a line on.

    Raises:
        AssetError: the name could be several assets, or the one that it is cannot be fetched.
    """
    asset = _asset_meant(name)
    return ObjectSource(name) if asset is None else ObjectSource(fetched(asset, on_message), asset)


def check_object_name(name: str) -> None:
    """Refuse a `name` of no object, before anything is loaded or fetched.

    Raises:
        AssetError: no object has this name, or several assets have.
        MeshError: it is the path of a mesh file that does not exist.
    """
    if ":" not in name and Path(name).suffix.lower() in (*SUFFIXES, *SCAN_SUFFIXES) and not exists(Path(name)):
        raise MeshError(f"{name}: no such file")
    _asset_meant(name)


def _asset_meant(name: str) -> Asset | None:
    """Return the asset that `name` means, or None where it means an embedded object, a primitive or a path."""
    if name in EMBEDDED or ":" in name or Path(name).suffix or exists(Path(name)):
        return None
    # In another case, an embedded name is not that of an asset that ends with it.
    asset = None if name.casefold() in EMBEDDED else find_asset(name, "objects")
    if asset is None:
        meant = did_you_mean(name.replace("/", "_"), [*EMBEDDED, *read_manifest("objects")], otherwise=":")
        raise AssetError(
            f"no object '{name}'{meant} embedded ones are {', '.join(EMBEDDED)}; primitives are {PRIMITIVE_FORMS}; or "
            f"give a mesh file ({', '.join(SUFFIXES)}), a scan ({', '.join(SCAN_SUFFIXES)}), a folder of convex "
            "pieces, or an asset (refine-grasp assets list objects)"
        )
    return asset


def named_object(name: str, objects: Path | None, file: Path, on_message: Callable[[str], None]) -> ObjectSource:
    """Source of the object that the grasps in `file` call `name`, which is never taken as a path.

    Args:
        name: The object's name in the file.
        objects: A folder of meshes or folders of pieces, or a TOML file that names them; None: it is one of ours, a
            primitive, or an asset of exactly this name.
        file: The grasp file, for messages.
        on_message: Called with a line on each download.

    Raises:
        AssetError: there is no such object, or it cannot be fetched.
    """
    if objects is not None:
        if is_folder(objects):
            return ObjectSource(find_object(name, objects))
        listed = _read_objects(objects)
        if name not in listed:
            raise AssetError(f"{objects}: no object '{name}'; it names {', '.join(listed) or 'nothing'}")
        return ObjectSource(listed[name])
    if needs_no_file(name):
        return ObjectSource(name)
    asset = read_manifest("objects").get(name)
    if asset is not None:
        return ObjectSource(fetched(asset, on_message), asset)
    raise AssetError(
        f"{file}: its object '{name}' is none of the embedded ones ({', '.join(EMBEDDED)}); give its mesh with "
        f"`object`, a folder of meshes with `objects`, or a primitive ({PRIMITIVE_FORMS}){_suggestion(name)}"
    )


def is_known(name: str) -> bool:
    """Return True if an object of this name in a grasp file needs no mesh from the user."""
    return needs_no_file(name) or name in read_manifest("objects")


def needs_no_file(name: str) -> bool:
    """Return True if an object is made from its name alone: an embedded one or a primitive."""
    try:
        return name in EMBEDDED or bool(primitive_pieces(name))
    except MeshError:
        return False


def _suggestion(name: str) -> str:
    """Suggestion of the asset that a name in a grasp file may mean; it is never used without the user's choice."""
    try:
        asset = find_asset(name, "objects")
    except AssetError:
        return ""
    return "" if asset is None else f"; it may be the asset {asset.name}: `object='{asset.name}'`"


def _read_objects(path: Path) -> Mapping[str, str | Path]:
    """Object name -> source of the object, from a TOML file; paths are relative to it."""
    try:
        raw = read_toml(path)
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file or folder of objects") from None
    except UNREADABLE as error:
        raise AssetError(f'{path}: cannot be read as TOML lines name = "path" ({error})') from None
    for name, value in raw.items():
        if not isinstance(value, str) or not value:
            raise AssetError(f"{path}: {name} must be a path in quotes, got {quote_value(value)}")
    return {name: value if value in EMBEDDED or ":" in value else path.parent / value for name, value in raw.items()}
