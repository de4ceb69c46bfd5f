"""`refine-grasp assets fetch NAME`: download hands, objects and grasps of others, on their terms."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn
from tyro.conf import Positional, arg

from grasp_refine.assets.cache import asset_folder, is_whole, main_path
from grasp_refine.assets.fetching import fetch_asset
from grasp_refine.assets.hub import HubDataset, fetch_dataset, hub_dataset, is_on_hub
from grasp_refine.assets.licence import Licensed, check_accepted
from grasp_refine.assets.manifest import Asset
from grasp_refine.assets.names import choose_asset
from grasp_refine.assets.origin import Origin, Upstream, chosen_origin, wanted
from grasp_refine.core.errors import AssetError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.grasps.formats.content import SUFFIXES, TABLE_SUFFIXES
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen


@dataclass(frozen=True)
class AssetsFetch:
    """Fetch hands, objects or grasp sets of others, each file checked, and show their licences and what to cite."""

    names: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME [NAME ...]", help_behavior_hint="(required)")] = ()
    """Names from `refine-grasp assets list`; the part after a _ is enough where it is unique. Or
    hf://OWNER/NAME[/PATH], grasps of the Hugging Face Hub (extra hub)."""
    accept_license: bool = False
    """Confirm that you have read the licence and may use the assets; required unless the licence is open."""
    json: OptionalFile = None
    """Write the fetched assets and their paths to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            AssetError: no such asset, a licence that is not accepted, or one that cannot be fetched.
        """
        check_writable(self.json, overwrite=self.overwrite)
        if not self.names:
            raise AssetError("assets fetch needs a NAME; `refine-grasp assets list` shows them")
        on_hub = [hub_dataset(Path(name), lambda line: None) for name in self.names if is_on_hub(Path(name))]
        assets = list(dict.fromkeys(choose_asset(name) for name in self.names if not is_on_hub(Path(name))))
        origin, console = chosen_origin(), screen()
        if not self.accept_license:
            licensed: list[Licensed] = [*assets, *on_hub]
            for one in licensed:
                check_accepted(one)
        facts = [_fetch(asset, origin, self.accept_license, console) for asset in assets]
        facts += [_fetch_from_hub(dataset, self.accept_license, console) for dataset in on_hub]
        save_document(self.json, "assets fetch", {"assets": facts})
        return 0


def _fetch_from_hub(dataset: HubDataset, accepted: bool, console: Console) -> dict[str, Any]:
    """Fetch the grasp files of a data set of the Hub, and print its licence and path; return the facts for JSON."""
    console.print(f"[bold]{escape(dataset.full_name)}[/]")
    console.print(f"  licence: {dataset.licence} ({dataset.terms})", markup=False, soft_wrap=True)
    path = fetch_dataset(dataset, (*SUFFIXES, *TABLE_SUFFIXES), lambda line: None, accept_license=accepted)
    console.print(f"  here:    {path}", markup=False, soft_wrap=True)
    return {"kind": dataset.kind, "name": dataset.name, "path": path, "licence": dataset.licence} | {
        "terms": dataset.terms
    }


def _fetch(asset: Asset, origin: Origin, accepted: bool, console: Console) -> dict[str, Any]:
    """Fetch an asset, and print its source, licence and path; return the facts for JSON."""
    console.print(f"[bold]{escape(asset.full_name)}[/]")
    facts = {"source": asset.source, "licence": f"{asset.licence} ({asset.terms})", "cite": asset.citation}
    if asset.note:
        facts["note"] = asset.note
    for word, text in facts.items():
        console.print(f"  {word + ':':<9}{text}", markup=False, soft_wrap=True)
    began, here = time.perf_counter(), _is_here(asset, origin)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), DownloadColumn(), console=console, transient=True,
        disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task("")

        def progress(place: str, done: int, total: int | None) -> None:
            bar.update(task, description=f"  {escape(place)}", completed=done, total=total)

        fetch_asset(asset, origin, accept_license=accepted, progress=progress)
    seconds = time.perf_counter() - began
    path = main_path(asset, origin.layout)
    folder = asset_folder(asset, origin.layout)
    size = sum((folder / wanted(file, origin.layout).place).stat().st_size for file in asset.files)
    count = f"{count_text(len(asset.files), 'file')}, {size / 1e6:.2f} MB"
    console.print(f"  here:    {path}", markup=False, soft_wrap=True)
    console.print(f"           {count}{', was here before' if here else f', fetched in {seconds:.1f} s'}", markup=False)
    if isinstance(origin, Upstream) and any(file.changed for file in asset.files):
        changed = next(file.changed for file in asset.files if file.changed)
        console.print(f"  note:    as upstream has it; a mirror's copy may differ ({changed})", markup=False)
    return {
        "kind": asset.kind,
        "name": asset.name,
        "path": path,
        "folder": folder,
        "files": len(asset.files),
        "bytes": size,
        "licence": asset.licence,
        "terms": asset.terms,
        "citation": asset.citation,
        "was_here": here,
        "wall_s": seconds,
    }


def _is_here(asset: Asset, origin: Origin) -> bool:
    try:
        return is_whole(asset, origin.layout)
    except OSError:
        return False
