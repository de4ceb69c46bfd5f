"""Options of `validate --margins`, its trials and its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rich.console import Console
from rich.markup import escape

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.results.margins_document import margins_entry, margins_row, margins_totals
from grasp_refine.results.margins_table import margins_comparison, margins_table
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.margins.draws import MAX_DRAWS, Draws, draw
from grasp_refine.validation.margins.factors import Factors
from grasp_refine.validation.margins.margins import Margins, check_pushes
from grasp_refine.validation.validate import Validated
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.margins.charts import Side
from grasp_refine_apps.margins.page import page


@dataclass(frozen=True)
class MarginsOptions:
    """Margins of the grasps: success when friction, mass, pose and contacts differ."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("margins"),)

    margins: bool = False
    """Try each grasp again in worlds drawn at random, with all factors at once and with each alone (pose of the object,
    friction, mass and its direction, contacts, servos, thickness), and search the lowest friction and the largest force
    and torque that it holds. About 40 times the time of the simulation."""
    draws: int = 32
    """Number of drawn worlds, the same for all grasps; best a power of 2. Only with --margins."""

    def check(self, protocol: Protocol | None) -> None:
        """Refuse options that are invalid, or have no effect.

        Raises:
            GraspRefineError: names them.
        """
        if not self.margins:
            if self.draws != MarginsOptions.draws:
                raise GraspRefineError("--draws needs --margins")
            return
        if self.draws > MAX_DRAWS:
            raise GraspRefineError(f"--draws must be at most {MAX_DRAWS}, got {self.draws}")
        if protocol is not None:
            check_pushes(protocol)

    def drawn(self, seed: int) -> Draws | None:
        """Return the drawn worlds; None without --margins."""
        return draw(Factors(), self.draws, seed) if self.margins else None


@dataclass(frozen=True, eq=False)
class MeasuredFile:
    """Margins of the grasps of one file."""

    path: Path
    """The file."""
    hand: str
    """Name of the hand."""
    validated: Validated
    """Labels of the grasps."""
    margins: Margins
    """Their margins."""


def show_margins(console: Console, files: Sequence[MeasuredFile], *, compared: bool, verbose: bool) -> None:
    """Print the tables of the margins: of each file, and of the changes between two files.

    Args:
        console: Console.
        files: The files.
        compared: Whether two files hold the same grasps before and after.
        verbose: Whether all grasps are listed.
    """
    for each in files:
        if len(files) > 1:
            console.print(f"[bold]{escape(str(each.path))}[/]\n", soft_wrap=True)
        labels = each.validated
        console.print(margins_table(each.margins, labels.object, labels.index, each.hand, verbose=verbose))
        console.print()
    if compared:
        before, after = files
        console.print(margins_comparison(before.margins, after.margins, after.hand))
        console.print()
    cost = np.concatenate([each.margins.cpu_s for each in files])
    console.print(f"CPU: {cost.sum():.1f} s for the margins ({cost.mean():.2f} s a grasp)")


def add_margins(document: dict[str, Any], files: Sequence[MeasuredFile], drawn: Draws) -> None:
    """Add the margins to the document of a validation, in all and for each grasp."""
    document["totals"]["margins"] = margins_totals([each.margins for each in files], Factors(), drawn)
    entries = (margins_entry(each.margins, i) for each in files for i in range(len(each.margins)))
    for grasp, entry in zip(document["grasps"], entries, strict=True):
        grasp["margins"] = entry


def add_columns(rows: Sequence[dict[str, Any]], files: Sequence[MeasuredFile]) -> None:
    """Add the margins to the flat rows of a validation."""
    columns = (margins_row(each.margins, i) for each in files for i in range(len(each.margins)))
    for row, found in zip(rows, columns, strict=True):
        row |= found


def margins_page(files: Sequence[MeasuredFile], *, compared: bool, seed: int) -> str:
    """Return the charts of the margins, a part of a page; empty without margins."""
    if not files:
        return ""
    names = ["before", "after"] if compared else [each.path.name for each in files]
    sides = [Side(name, each.margins) for name, each in zip(names, files, strict=True)]
    names = [str(each.path) for each in files]
    return page(names, sides, compared=compared, seed=seed)
