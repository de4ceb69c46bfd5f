"""`refine-grasp doctor`: check the installation, missing packages, and the capabilities of this machine."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.markup import escape

from grasp_refine import __version__
from grasp_refine.assets.cache import LAYOUTS, seems_here
from grasp_refine.assets.names import all_assets
from grasp_refine.assets.origin import VARIABLE, chosen_origin, shown
from grasp_refine.collision.engine import VARIABLE as ENGINE
from grasp_refine.collision.engine import chosen, why_not_native
from grasp_refine.core.errors import AssetError, CollisionError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.core.versions import NAME, Requirement, requirements
from grasp_refine.geometry.cache import default_cache
from grasp_refine.hands.hand import list_hands
from grasp_refine.results.table import plain_table
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

BROKEN = 1
"""Exit code when a required package is missing or too old."""

DEVELOPMENT = "test"
"""Extra of the test suite, which is not shown to users."""


@dataclass(frozen=True)
class Doctor:
    """Check the installation: versions of packages, missing extras, devices, collision engine, caches."""

    json: OptionalFile = None
    """Write the findings to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code, which is 0 also when optional packages are missing."""
        check_writable(self.json, overwrite=self.overwrite)
        found = examine()
        save_document(self.json, "doctor", found)
        _show(found, screen())
        return BROKEN if found["problems"] else 0


def examine() -> dict[str, Any]:
    """Return all findings, for JSON; `problems` lists findings that keep the program from working."""
    packages = [_package(need) for need in requirements() if need.extra != DEVELOPMENT]
    problems = [
        f"{package['name']} is {package['state']}, {package['range']} is needed"
        for package in packages
        if package["extra"] is None and package["state"] in ("missing", "too old")
    ]
    if not packages:
        problems.append("grasp-refine is not installed: its requirements are not known")
    devices, fault = _devices()
    if fault:
        problems.append(f"torch does not load: {fault}")
    try:
        hands = list(list_hands())
    except AssetError as error:
        hands = []
        problems.append(str(error))
    engine = _engine()
    if engine["fault"]:
        problems.append(engine["fault"])
    return {
        "platform": platform.platform(),
        "cpu_count": os.cpu_count(),
        "packages": packages,
        "devices": devices,
        "engine": engine,
        "gpu": any(device["name"] != "cpu" for device in devices),
        "cache": _cache(),
        "assets": _assets(),
        "hands": hands,
        "pictures": "software",
        "problems": problems,
    }


def _package(need: Requirement) -> dict[str, Any]:
    return {
        "name": need.name,
        "range": need.range,
        "extra": need.extra,
        "installed": need.installed,
        "state": need.problem or "ok",
    }


def _devices() -> tuple[list[dict[str, str]], str]:
    """Devices that torch can use, and the reason why torch cannot be loaded, or ""."""
    try:
        import torch
    except (ImportError, OSError) as error:
        return [], str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    devices = [{"name": "cpu", "what": platform.processor() or platform.machine()}]
    if torch.cuda.is_available():
        for i in range(torch.cuda.device_count()):
            devices.append({"name": f"cuda:{i}", "what": torch.cuda.get_device_name(i)})
    if torch.backends.mps.is_available():
        devices.append({"name": "mps", "what": "Apple GPU, float32 only"})
    return devices, ""


def _engine() -> dict[str, Any]:
    """Collision engine in use, coal version of the compiled engine, and reason why that one is not available."""
    reason, used, fault, coal, threads = why_not_native(), None, None, None, None
    try:
        used = chosen("auto")
    except CollisionError as error:
        fault = str(error)
    if not reason:
        from grasp_refine.collision.native_search import built_for, has_threads

        coal, threads = built_for(), has_threads()
    return {"used": used, "coal": coal, "threads": threads, "why_not_native": reason or None, "fault": fault}


def _cache() -> dict[str, Any]:
    """Folder, number and size of the cached decompositions."""
    folder = default_cache()
    sizes = [path.stat().st_size for path in folder.glob("*.npz")] if folder.is_dir() else []
    return {"folder": folder, "entries": len(sizes), "bytes": sum(sizes)}


def _assets() -> dict[str, Any]:
    """Folder of fetched assets, numbers of fetched and of all known ones, and the mirror, if there is one."""
    here = sum(any(seems_here(asset, layout) for layout in LAYOUTS) for asset in all_assets())
    mirror, fault = os.environ.get(VARIABLE), None
    try:
        chosen_origin()
    except AssetError as error:
        fault = str(error)
    return {
        "folder": default_cache("assets"),
        "here": here,
        "known": len(all_assets()),
        "mirror": shown(mirror) if mirror else None,
        "fault": fault,
    }


def _show(found: dict[str, Any], console: Console) -> None:
    python = f"Python {platform.python_version()}"
    console.print(f"[bold]{NAME} {__version__}[/]  {python}, {found['platform']}, {found['cpu_count']} CPUs\n")
    table = plain_table()
    for column in ("package", "installed", "needed", "state", "for"):
        table.add_column(column)
    for package in sorted(found["packages"], key=lambda package: package["extra"] or ""):
        optional = package["extra"]
        state = package["state"]
        color = "green" if state == "ok" else "yellow" if optional or state == "too new" else "red"
        text = "not installed" if optional and state == "missing" else state
        table.add_row(
            package["name"],
            package["installed"] or "-",
            package["range"],
            f"[{color}]{'untested, too new' if state == 'too new' else text}[/]",
            f"extra '{optional}'" if optional else "",
        )
    console.print(table, "")
    for line in _lines(found):
        console.print(line, markup=False, soft_wrap=True)
    for problem in found["problems"]:
        console.print(f"[red]problem[/]: {escape(problem)}", soft_wrap=True)
    if set(found["problems"]) - {found["engine"]["fault"]}:
        console.print(f"install again: pip install --upgrade {NAME}")
    elif not found["problems"]:
        console.print("[green]everything required is installed[/]")


def _lines(found: dict[str, Any]) -> list[str]:
    cache, assets = found["cache"], found["assets"]
    devices = [f"{device['name']} ({device['what']})" for device in found["devices"]]
    missing = sorted({p["extra"] for p in found["packages"] if p["extra"] and p["state"] == "missing"})
    lines = [
        f"devices: {', '.join(devices) or 'none'}" + ("" if found["gpu"] else "; no GPU, none is needed"),
        f"engine:  {_engine_text(found['engine'])}",
        f"cache:   {cache['folder']}, {count_text(cache['entries'], 'decomposition')}, {cache['bytes'] / 1e6:.1f} MB",
        f"assets:  {assets['folder']}, {assets['here']} of {assets['known']} are here"
        + (f"; mirror: {assets['mirror']}" if assets["mirror"] and not assets["fault"] else "")
        + (f"; {assets['fault']}" if assets["fault"] else ""),
        f"hands:   {', '.join(found['hands']) or 'none'}",
    ]
    if missing:
        lines.append(f'optional: pip install "{NAME}[{",".join(missing)}]"')
    return lines


def _engine_text(engine: dict[str, Any]) -> str:
    if engine["used"] == "native":
        alone = "" if engine["threads"] else "; one thread, as it was built without OpenMP"
        return f"native, compiled for coal {engine['coal']}{alone}"
    reason = f"; native: {engine['why_not_native']}" if engine["why_not_native"] else f", chosen by {ENGINE}"
    return "none, see the problem" if engine["fault"] else f"python, the slower one{reason}"
