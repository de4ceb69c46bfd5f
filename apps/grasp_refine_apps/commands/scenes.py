"""`refine-grasp scenes`: scenes that come with the program, or the bodies of one scene, your own too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.results.table import plain_table
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.scene_check import body_notes, check_object
from grasp_refine.scene.scene_file import list_scenes, load_scene
from grasp_refine_apps.commands.options import OptionalFile, Overwrite
from grasp_refine_apps.report.json_document import save_document
from grasp_refine_apps.report.screen import screen


@dataclass(frozen=True)
class Scenes:
    """List the scenes that come with the program, or show and check the bodies of one, or of your own file."""

    scene: Annotated[
        Positional[DisallowNone[str | None]], arg(metavar="[SCENE]", help_behavior_hint="(default: list all)")
    ] = None
    """Name from the list, or a TOML file."""
    json: OptionalFile = None
    """Write the facts to this file."""
    overwrite: Overwrite = False

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: there is no such scene, its file is wrong, or, after the list, it cannot be.
        """
        check_writable(self.json, overwrite=self.overwrite)
        console = screen()
        if self.scene is None:
            entries = []
            table = plain_table("scenes, for --scene NAME", between=2)
            for column in ("name", "object", "bodies", "what"):
                table.add_column(column, no_wrap=column != "what")
            for name, path in list_scenes().items():
                found, what = load_scene(name), path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
                entries.append({"name": name, "object": found.object, "bodies": len(found.bodies), "what": what})
                table.add_row(name, found.object, str(len(found.bodies)), what)
            save_document(self.json, "scenes", {"scenes": entries})
            console.print(table)
            return 0
        found = load_scene(self.scene, on_message=console.print)
        facts = scene_facts(found)
        save_document(self.json, "scenes", {"scene": facts})
        table = plain_table(f"{found.name}: {found.object or 'an object'} and {count_text(len(found.bodies), 'other')}")
        for column in ("body", "size\nmm", "at, world\nmm", "margin\nmm", "from object\nmm", ""):
            table.add_column(column, justify="left" if column in ("body", "") else "right")
        for one in facts["bodies"]:
            size, at = (" ".join(f"{1e3 * x:.0f}" for x in one[key]) for key in ("size_m", "position_m"))
            distance = "-" if one["distance_m"] is None else f"{1e3 * one['distance_m']:.1f}"
            mass = "" if one["mass_kg"] is None else f", {1e3 * one['mass_kg']:.0f} g"
            kind = f"movable{mass}" if one["movable"] else "fixed"
            table.add_row(one["name"], size, at, f"{1e3 * one['margin_m']:g}", distance, kind)
        console.print(table)
        notes = body_notes(found)
        if found.object is not None:
            notes = (*check_object(found.load_object(), None, found), *notes)
        for note in notes:
            console.print(f"note: {note}", markup=False, soft_wrap=True)
        return 0


def scene_facts(environment: Environment) -> dict[str, Any]:
    """Return what a scene holds, for JSON: metres, world frame; distances are between the object and each body."""
    distance = np.full(len(environment.bodies), np.nan)
    if environment.object is not None and environment.bodies:
        obj = environment.load_object().body
        bodies = tuple(one.body for one in environment.bodies)
        T = environment.T_object_body[None]
        distance = query(Pairs(bodies, (obj,) * len(bodies)), T, np.broadcast_to(np.eye(4), T.shape)).distance[0]
    return {
        "name": environment.name,
        "object": environment.object,
        "object_pose": pose_from_transform(environment.T_world_object),
        "sha256": environment.digest,
        "bodies": [
            {
                "name": one.name,
                "pose": pose_from_transform(one.T_world_body),
                "position_m": one.T_world_body[:3, 3],
                "size_m": np.ptp(np.concatenate([piece.bounds for piece in one.body.pieces]), axis=0),
                "pieces": len(one.body.pieces),
                "margin_m": one.margin,
                "movable": one.movable,
                "mass_kg": one.mass,
                "distance_m": float(apart) if np.isfinite(apart) else None,
            }
            for one, apart in zip(environment.bodies, distance, strict=True)
        ],
    }
