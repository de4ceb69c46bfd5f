"""`refine-grasp assets list`: hands, objects and grasp sets of others that can be fetched, and their terms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.assets.cache import seems_here
from grasp_refine.assets.manifest import KINDS, Asset
from grasp_refine.assets.names import all_assets
from grasp_refine.assets.origin import VARIABLE, Mirror, Origin, chosen_origin, shown, total_bytes
from grasp_refine.core.errors import AssetError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.cache import default_cache
from grasp_refine.results.table import plain_table
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

COLORS = {"open": "green", "unclear": "yellow", "non-commercial": "red"}
"""Terms of a licence -> colour."""

HEADER = ("", "what", "MB", "licence", "terms", "here")

MIN_LICENCE_WIDTH, COLUMN_GAP = 12, 2
"""Minimum width of the licence column, and gap between two columns, characters."""


@dataclass(frozen=True)
class AssetsList:
    """List the hands, objects and grasp sets of others that can be fetched."""

    which: Annotated[
        Positional[DisallowNone[str | None]], arg(metavar="[KIND|TEXT]", help_behavior_hint="(default: all)")
    ] = None
    """hands, objects or grasps; or a part of their names."""
    json: OptionalFile = None
    """Write the facts about them to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            AssetError: nothing matches, or a manifest cannot be used.
        """
        check_writable(self.json, overwrite=self.overwrite)
        assets, origin = _chosen(self.which), chosen_origin()
        save_document(self.json, "assets list", {"assets": [asset_facts(asset, origin) for asset in assets]})
        _show(assets, origin, screen())
        return 0


def _chosen(which: str | None) -> list[Asset]:
    if which is None:
        return list(all_assets())
    if which in KINDS:
        return [asset for asset in all_assets() if asset.kind == which]
    part = which.lower().replace("/", "_")
    chosen = [asset for asset in all_assets() if part in asset.name.lower() or which.lower() in asset.full_name]
    if not chosen:
        raise AssetError(f"no asset has '{which}' in its name; the kinds are {', '.join(KINDS)}")
    return chosen


def asset_facts(asset: Asset, origin: Origin) -> dict[str, Any]:
    """Return the facts about an asset, for JSON; sizes are in bytes, as at the origin."""
    return {
        "kind": asset.kind,
        "name": asset.name,
        "what": asset_type(asset),
        "hand": asset.hand,
        "source": asset.source,
        "files": len(asset.files),
        "bytes": total_bytes(asset, origin.layout),
        "licence": asset.licence,
        "terms": asset.terms,
        "citation": asset.citation,
        "unit": asset.unit,
        "scale": asset.scale,
        "note": asset.note,
        "here": seems_here(asset, origin.layout),
    }


def asset_type(asset: Asset) -> str:
    """Type of an asset, in a word or two."""
    if asset.kind == "hands":
        return "MJCF" if asset.main is not None and asset.main.mirror_place.endswith(".xml") else "URDF"
    if asset.kind == "objects":
        return "mesh"
    return asset.format or "objects"


def _show(assets: list[Asset], origin: Origin, console: Console) -> None:
    for kind in KINDS:
        of_kind = [asset for asset in assets if asset.kind == kind]
        if of_kind:
            console.print(_table(kind, of_kind, origin, console.width), "")
    place = (
        f"the mirror {shown(origin.base)}" if isinstance(origin, Mirror) else f"their sources (a mirror: {VARIABLE})"
    )
    for line in (
        f"{count_text(len(assets), 'asset')}, fetched from {place} into {default_cache('assets')}",
        "refine-grasp assets fetch NAME fetches one, shows its licence and what to cite; "
        "all but open ones need --accept-license",
    ):
        console.print(line, markup=False, soft_wrap=True)


def _table(kind: str, assets: list[Asset], origin: Origin, width: int) -> Table:
    """Table of the assets of a kind; licences are cut at the end of a line, names never."""
    table = plain_table()
    table.add_column(f"{kind} ({len(assets)})", overflow="fold")
    for column in HEADER[1:]:
        table.add_column(column, justify="right" if column == "MB" else "left", no_wrap=True)
    rows = [_cells(asset, origin) for asset in assets]
    others = sum(max(len(row[i]) for row in (HEADER, *rows)) + COLUMN_GAP for i in (0, 1, 2, 4, 5))
    width_left = max(MIN_LICENCE_WIDTH, width - others - COLUMN_GAP)
    for row in rows:
        name, what, size, licence, terms, here = map(escape, row)
        licence = licence if len(row[3]) <= width_left else escape(f"{row[3][: width_left - 1]}…")
        table.add_row(name, what, size, licence, f"[{COLORS[terms]}]{terms}[/]", here)
    return table


def _cells(asset: Asset, origin: Origin) -> tuple[str, ...]:
    size = total_bytes(asset, origin.layout)
    megabytes = "?" if size is None else f"{size / 1e6:.2f}"
    here = "yes" if seems_here(asset, origin.layout) else "-"
    return asset.name, asset_type(asset), megabytes, asset.licence, asset.terms, here
