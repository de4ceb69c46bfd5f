"""ACRONYM: one .h5 file per object with poses of the Panda gripper; its .json files, and the .json files of GraspGen.

`grasps/transforms` (N, 4, 4) are poses of the gripper in the frame of the object's mesh, times `object/scale`, metres.
The gripper's frame has the origin of our panda_hand and its z, towards the object; its x is the direction in which the
fingers move, which is our y. The hand is the same when turned by half a turn about z, so that which finger is the left
one is a choice of ours. `gripper/configuration` is the opening of the fingers before they close, one for all grasps.

Source: github.com/NVlabs/acronym, acronym_tools/acronym.py and data/examples; github.com/NVlabs/GraspGen,
docs/GRASP_DATASET_FORMAT.md and docs/GRIPPER_DESCRIPTION.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.folders import disambiguate, object_folder
from grasp_refine.grasps.formats.format import SUCCESS, Format, Load, Part, omission_notes, rows_by_object
from grasp_refine.grasps.formats.grippers import (
    FRANKA,
    FRANKA_JOINTS,
    FRANKA_LINK,
    hand_named,
    open_joints,
    without_follower,
)
from grasp_refine.grasps.formats.layout import Layout
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import fit_layout, root_poses
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

PANDA = Layout(FRANKA, FRANKA_LINK, FRANKA_JOINTS[:1], (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0))
"""The gripper: turned by a quarter turn about z, so that the first finger moves along x of the file."""
UNNAMED = "gripper"
"""Hand and link of a file that does not name its gripper."""
MAX_APART_M = 1e-9
"""Greatest difference between openings that are written as one, metres."""


@dataclass(frozen=True)
class Acronym(Format):
    """Files `.h5`, and `.json` with the same tree or with ACRONYM's flat keys."""

    name: str = "acronym"
    what: str = "ACRONYM, and GraspGen's dataset: one .h5 (or .json) file per object, a Panda gripper"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        flat = missing_keys(content, ("transforms", "object", "object_scale"))
        tree = missing_keys(content, ("grasps", "object"))
        if tree:
            return "" if not flat else tree
        tree = missing_keys(content["grasps"], ("transforms",))
        tree = tree and f"its grasps: {tree}"
        return tree or (
            f"its object: {lacking}" if (lacking := missing_keys(content["object"], ("file", "scale"))) else ""
        )

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = _as_tree(source.content)
        T_object_gripper = source.transforms(held["grasps"]["transforms"], "grasps/transforms")
        count = len(T_object_gripper)
        if not count:
            raise source.error("grasps/transforms must have shape (N, 4, 4); it is empty")
        gripper = held.get("gripper")
        gripper = gripper if isinstance(gripper, Mapping) else {}
        said = gripper.get("type", gripper.get("name"))
        named = None if said is None else hand_named(source.text(said, "gripper/type"))
        notes = []
        joints, q, opened = open_joints(hand, count)
        if named == FRANKA:
            layout = PANDA
            if gripper.get("configuration") is not None:
                opening = source.finite(gripper["configuration"], "gripper/configuration").ravel()
                if len(opening) not in (1, 2):
                    raise source.error(
                        f"gripper/configuration must be one opening of the fingers; it has {len(opening)}"
                    )
                joints, q = layout.joints, np.full((count, 1), opening[0])
                notes.append("the fingers are as open as before they close: the file has no other joint values")
            else:
                notes.append(opened)
            if hand is not None and FRANKA_LINK not in hand.links_by_name:
                raise source.error(f"is for the Panda gripper, from link {FRANKA_LINK} on, which '{hand.name}' lacks")
        else:
            layout = Layout(named or UNNAMED, hand.base_link if hand else UNNAMED, ())
            notes.append(opened)
            taken = f"read as poses of link {layout.base_link}" if hand else "give it with `hand`"
            notes.append(f"poses are of the base of the gripper {named or 'that it does not name'}: {taken}")
        grasps = replace(layout, joints=joints).grasps(
            hand,
            pose_from_transform(T_object_gripper @ layout.T_root_base),
            q,
            object=source.object_name(held["object"]["file"], "object/file"),
            scale=source.scale(held["object"]["scale"], "object/scale"),
            labels=_success(source, held["grasps"], count),
        )
        return grasps, notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object and scale."""
        moved, layout = fit_layout(without_follower(grasps), (PANDA,), load, self.name)
        T = transform_from_pose(root_poses(moved, layout))
        success, lost = grasps.labels.get(SUCCESS), []
        if success is None:
            success = np.ones(len(grasps))
            lost.append("object_in_gripper 1 is written for every grasp: success is unknown")
        elif np.isnan(success).any():
            raise GraspFileError(f"format {self.name} records the success of every grasp; some have no {SUCCESS}")
        groups = rows_by_object(grasps)
        files = disambiguate(f"{object_folder(name)}_{scale!r}" for name, scale in groups)
        parts = []
        for file, ((name, scale), rows) in zip(files, groups.items(), strict=True):
            opening = moved.q[rows, 0]
            if np.ptp(opening) > MAX_APART_M:
                raise GraspFileError(
                    f"format {self.name} holds one opening of the fingers for all grasps of an object; the grasps of "
                    f"'{name}' have {opening.min():.4g} to {opening.max():.4g} m"
                )
            content = {
                "grasps": {
                    "transforms": T[rows],
                    "qualities": {"flex": {"object_in_gripper": success[rows].astype(np.int64)}},
                },
                "gripper": {"type": "panda", "configuration": opening[:1].copy()},
                "object": {"file": f"meshes/{name}.obj", "scale": scale},
            }
            parts.append(Part(f"{file}.h5", rows, content))
        return parts, [*lost, *omission_notes(grasps, FRANKA_JOINTS, stages=False, labels=(SUCCESS,))]


def _as_tree(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """The contents with the keys of .h5 files."""
    if "grasps" in content:
        return content
    return {
        "grasps": {
            "transforms": content["transforms"],
            "object_in_gripper": content.get("quality_flex_object_in_gripper"),
        },
        "gripper": {"type": content.get("gripper", "panda"), "configuration": content.get("gripper_configuration")},
        "object": {"file": content["object"], "scale": content["object_scale"]},
    }


def _success(source: Source, grasps: Mapping[str, Any], count: int) -> dict[str, Float[np.ndarray, " N"]]:
    """Whether each grasp held in simulation, a label: 1 or 0."""
    qualities = grasps.get("qualities")
    flex = qualities.get("flex") if isinstance(qualities, Mapping) else None
    recorded = flex.get("object_in_gripper") if isinstance(flex, Mapping) else grasps.get("object_in_gripper")
    if recorded is None:
        return {}
    held = np.asarray(recorded)
    if held.dtype.kind not in "biuf" or held.shape != (count,):
        raise source.error(f"object_in_gripper must have shape ({count},); it has {held.shape}")
    return {SUCCESS: held.astype(np.float64)}
