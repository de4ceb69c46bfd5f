"""Our own format: the .npz files of `grasps.load_grasps`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.format import Format, Load, Part
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps
from grasp_refine.hands.hand import Hand


@dataclass(frozen=True)
class Ours(Format):
    """Files .npz with joint names, which hold everything."""

    name: str = "ours"
    what: str = "grasp-refine: one .npz file with joint names, objects, stages and targets"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" for None, which stands for an .npz file."""
        return "" if content is None else "it is no .npz file of plain arrays"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        return load_grasps(source.path), ()

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file."""
        return [Part("grasps.npz", np.arange(len(grasps)), grasps)], ()
