"""`refine-grasp assets verify`: check that fetched assets are complete and unchanged."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Any

from rich.console import Console
from tyro.conf import Positional, arg

from grasp_refine.assets.names import all_assets, choose_asset
from grasp_refine.assets.verifying import Verdict, verify
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.cache import default_cache
from grasp_refine_apps.commands.options import NOTHING_USABLE, OptionalFile, Overwrite
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen

MAX_NAMED = 3
"""Maximum number of files named for each asset; the JSON document has all."""


@dataclass(frozen=True)
class AssetsVerify:
    """Recompute the hashes of all fetched files; exit code 1 if one differs from the manifest."""

    names: Annotated[
        Positional[tuple[str, ...]], arg(metavar="[NAME ...]", help_behavior_hint="(default: all that is here)")
    ] = ()
    """Assets to check; named ones that are not here count as failures."""
    json: OptionalFile = None
    """Write the results to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            AssetError: no such asset.
        """
        check_writable(self.json, overwrite=self.overwrite)
        assets = list(dict.fromkeys(choose_asset(name) for name in self.names)) if self.names else all_assets()
        verdicts = list(verify(assets))
        here = {verdict.asset.full_name for verdict in verdicts}
        absent = [asset.full_name for asset in assets if asset.full_name not in here] if self.names else []
        found = [_facts(verdict) for verdict in verdicts]
        save_document(self.json, "assets verify", {"assets": found, "not_here": absent})
        _show(verdicts, absent, screen())
        return NOTHING_USABLE if absent or any(verdict.state != "whole" for verdict in verdicts) else 0


def _facts(verdict: Verdict) -> dict[str, Any]:
    return {
        "kind": verdict.asset.kind,
        "name": verdict.asset.name,
        "origin": verdict.layout,
        "folder": verdict.folder,
        "state": verdict.state,
        "files": verdict.files,
        "missing": verdict.missing,
        "damaged": verdict.damaged,
        "reason": verdict.reason,
    }


def _show(verdicts: list[Verdict], absent: list[str], console: Console) -> None:
    def say(line: str) -> None:
        console.print(line, markup=False, soft_wrap=True)

    for verdict in verdicts:
        if verdict.state == "whole":
            continue
        name = verdict.asset.full_name
        if verdict.reason:
            say(f"{name}: cannot be used: {verdict.reason}")
            continue
        faults = [f"{len(verdict.damaged)} damaged: {_some(verdict.damaged)}"] if verdict.damaged else []
        faults += [f"{len(verdict.missing)} missing: {_some(verdict.missing)}"] if verdict.missing else []
        of = count_text(verdict.files, "file")
        say(f"{name}: of {of} {'; '.join(faults)} (from {verdict.layout}, {verdict.folder})")
        say(f"  refine-grasp assets fetch {name} fetches them again")
    for name in absent:
        say(f"{name}: is not here: refine-grasp assets fetch {name}")
    counts = Counter(verdict.state for verdict in verdicts)
    files = sum(verdict.files for verdict in verdicts if verdict.state == "whole")
    if not verdicts and not absent:
        say(f"nothing was fetched yet into {default_cache('assets')}")
    else:
        others = "".join(f", {counts[state]} {state}" for state in ("incomplete", "damaged") if counts[state])
        say(f"whole: {counts['whole']} ({count_text(files, 'file')}){others}; in {default_cache('assets')}")


def _some(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return ", ".join(names[:MAX_NAMED]) + more
