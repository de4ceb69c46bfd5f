"""Interface of the programs that grasps are exported to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from grasp_refine.export.exported import ExportedGrasps


@dataclass(frozen=True)
class Readme:
    """Contents of a README of a folder: a few lines for who finds it."""

    files: Mapping[str, str] = field(default_factory=dict)
    """File name -> contents in a line."""
    use: str = ""
    """Command or call that uses the folder."""
    notes: tuple[str, ...] = ()
    """Conventions, and what the program does not take."""


@runtime_checkable
class Target(Protocol):
    """Program, or format, that grasps are exported to."""

    @property
    def name(self) -> str:
        """Name by which it is chosen."""

    @property
    def what(self) -> str:
        """Contents of the folder in a line."""

    @property
    def extra(self) -> str:
        """Extra of grasp-refine that writing needs; empty: none."""

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write the files of the grasps into an empty folder.

        Raises:
            GraspRefineError: the program cannot take these grasps, or a package is not installed.
        """
