"""UniDexGrasp: one .npz file per grasp, in a folder named after its object; read, not written.

`qpos` is that of DexGraspNet, a pickled dict of named values in the object's frame. `scale` is the inverse of
the mesh's scale: 12.5 is 0.08. `plane` (a, b, c, d) is the table, a x + b y + c z + d = 0 in the same frame and in
metres, with its normal upwards; the pose of the hand does not depend on it, and it is not read.

Source: github.com/PKU-EPIC/UniDexGrasp, dexgrasp_policy/dexgrasp/tasks/shadow_hand_grasp.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats.dexgraspnet import ANGLES, POSITION, named_grasps
from grasp_refine.grasps.formats.format import Format, Load, Part
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

SCALE_DIGITS = 6
"""Decimal places of a scale, whose inverse is stored in single precision."""


@dataclass(frozen=True)
class UniDexGrasp(Format):
    """Files OBJECT/NUMBER.npz."""

    name: str = "unidexgrasp"
    what: str = "UniDexGrasp: a folder per object with one .npz file per grasp; read only"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("qpos", "scale"))
        if lacking:
            return lacking
        named = isinstance(content["qpos"], Mapping) and any(name in content["qpos"] for name in (*POSITION, *ANGLES))
        return "" if named else "its qpos is no dict with WRJTx"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasp of a file."""
        scale = round(1.0 / source.scale(source.content["scale"], "scale"), SCALE_DIGITS)
        name = source.path.absolute().parent.name
        notes = ["plane, the table under the object, is not read"] if "plane" in source.content else []
        return named_grasps(source, [source.content["qpos"]], [scale], name, hand), notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """Refuse: a file of this format needs the plane of a table.

        Raises:
            GraspFileError: always.
        """
        raise GraspFileError(f"format {self.name} is read only; dexgraspnet holds the same grasps")
