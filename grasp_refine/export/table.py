"""Target `csv` or `parquet`: one row a grasp, and one row a contact, with named columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.array_types import Shaped
from grasp_refine.core.json_files import save_text
from grasp_refine.core.toml_file import toml_text
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.target import Readme
from grasp_refine.grasps.grasp_set import POSE_COLUMNS
from grasp_refine.results.validation_document import check_table, save_table


@dataclass(frozen=True)
class Table:
    """Tables of grasps and of contacts."""

    name: str
    what: str = "one row a grasp: pose, joints by name at all stages, measures; one row a contact: point, normal, force"
    extra: str = ""

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write `grasps` and, where forces are known, `contacts`."""
        check_table(Path(f"grasps.{self.name}"))
        save_table(folder / f"grasps.{self.name}", _rows(grasp_columns(grasps)))
        save_text(folder / "grasps.toml", _mapping(f"grasps.{self.name}", grasps))
        files = {
            f"grasps.{self.name}": "one row a grasp; the grasp itself has plain names, the other stages a prefix",
            "grasps.toml": "what its columns are; refine-grasp reads it back by this file",
        }
        if grasps.forces is not None and len(grasps.forces):
            save_table(folder / f"contacts.{self.name}", _rows(grasps.forces.columns()))
            files[f"contacts.{self.name}"] = "one row a contact of the squeeze; grasp is the row of the other table"
        return Readme(files, use=f'pandas.read_{self.name}("grasps.{self.name}")')


def grasp_columns(grasps: ExportedGrasps) -> dict[str, Shaped[np.ndarray, " N"]]:
    """Return one column (N,) per number or word of the grasps.

    Object and scale; x, y, z, qw, qx, qy, qz of the base link in the object's frame and the values of all joints by
    name, of the grasp, and with `pregrasp_` and `squeeze_` before the names of the other stages; then what results
    know.
    """
    count = len(grasps)
    columns: dict[str, np.ndarray] = {
        "object": np.full(count, grasps.name),
        "scale": np.full(count, grasps.scale),
        "index": grasps.index,
        "hand": np.full(count, grasps.hand.name),
        "base_link": np.full(count, grasps.hand.base_link),
    }
    for name in ("grasp", "pregrasp", "squeeze"):
        at, prefix = STAGES.index(name), "" if name == "grasp" else f"{name}_"
        both = (
            zip(POSE_COLUMNS, grasps.poses[:, at].T, strict=True),
            zip(grasps.joint_names, grasps.joint_values[:, at].T, strict=True),
        )
        columns |= {prefix + column: values for pairs in both for column, values in pairs}
    return columns | dict(grasps.values)


def _mapping(table: str, grasps: ExportedGrasps) -> str:
    """Return the TOML file by which format `table` reads the grasps back."""
    return toml_text(
        {
            "table": table,
            "hand": grasps.hand.name,
            "base_link": grasps.hand.base_link,
            "position": POSE_COLUMNS[:3],
            "rotation": POSE_COLUMNS[3:],
            "notation": "wxyz",
            "joints": grasps.hand.joint_names,
            "object_column": "object",
            "scale_column": "scale",
        }
    )


def _rows(columns: Mapping[str, np.ndarray]) -> list[dict[str, object]]:
    listed = zip(*(values.tolist() for values in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in listed]
