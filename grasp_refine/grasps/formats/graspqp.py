"""GraspQP: one .pt file per object, a dict with named joints and the pose of the root link of the hand's URDF.

`parameters` holds `root_pose` (N, 7), x y z (metres), qw qx qy qz in the object's frame, and (N,) values of each joint
under its name. Meshes are in metres, so that the scale is 1. `values`, the energy, and `grasp_velocities` are the
optimiser's. The file names neither hand nor object: both are in its path, OBJECT/grasp_predictions/HAND/...

Its Allegro and Shadow hands are models of their own. Here are their frames and joints relative to the manufacturers',
computed from both URDFs: all axes agree; the tip of the Allegro's thumb lies 2.4 mm apart, Shadow's little finger 1.7
mm, its thumb 0.4 mm, all other joints 0.1 mm at most.

Source: github.com/leggedrobotics/graspqp, scripts/fit.py, graspqp_isaaclab/src/graspqp_isaaclab/utils/data.py, and the
URDFs in graspqp/assets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.format import (
    ENERGY,
    SINGLE_PRECISION,
    Format,
    Load,
    Part,
    check_file_names,
    omission_notes,
)
from grasp_refine.grasps.formats.grippers import FRANKA, FRANKA_JOINTS, FRANKA_LINK, without_follower
from grasp_refine.grasps.formats.layout import ALLEGRO, SHADOW_FINGERS, SHADOW_THUMB, Layout
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import fit_layout, root_poses
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

PREDICTIONS = "grasp_predictions"
"""Folder between the object's and the hand's."""
ROOT = "root_pose"
ENDING = ".dexgrasp"
"""End of the name of a file, before .pt."""


@dataclass(frozen=True)
class Model:
    """One hand of GraspQP."""

    root: str
    """Root link of its URDF."""
    joints: tuple[str, ...]
    """Names of its joints in files."""
    layout: Layout
    """Hand and link that its grasps become ours with, its joints in the same order."""
    reversed_joints: tuple[str, ...] = ()
    """Names in files of joints with the opposite sign."""
    apart: str = ""
    """Note for the user on the distance of the two models."""
    signs: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Compute the signs of the joints."""
        signs = np.array([-1.0 if joint in self.reversed_joints else 1.0 for joint in self.joints])
        object.__setattr__(self, "signs", signs)


def _own(hand: str, root: str, link: str, joints: tuple[str, ...], pose: tuple[float, ...]) -> Model:
    """Model of a hand whose joints keep their names; `pose` is that of `link` in its root."""
    return Model(root, joints, Layout(hand, link, joints, pose))


SHADOW = ("WRJ2", "WRJ1") + SHADOW_FINGERS + SHADOW_THUMB
IDENTITY = (1.0, 0.0, 0.0, 0.0)
ROBOTIQ = (
    *("RIQ_palm_RIQ_link_0_joint", "RIQ_palm_RIQ_link_0_joint_b", "RIQ_palm_RIQ_link_1_joint_a"),
    *(f"RIQ_link_{n}_RIQ_link_{n + 1}_joint_{f}" for f in "abc" for n in (0, 1, 2) if (n, f) != (0, "a")),
)
RIQ_PALM = (0.5003982, 0.4999998, -0.4996018, -0.4999998)
"""Roll 1.57, pitch 0, yaw -1.57, as its URDF has them, as a quaternion."""
MODELS = {
    "allegro": Model(
        "allegro",
        tuple(f"{finger}_joint_{n}" for finger in ("index", "middle", "ring", "thumb") for n in range(4)),
        Layout("allegro", "base_link", ALLEGRO, (0.0013325, 0.0266425, -0.0313034, 0.5, -0.5, -0.5, -0.5)),
        apart="2.4 mm at the thumb",
    ),
    "shadow_hand": Model(
        "root",
        tuple(f"robot0_{joint[:3]}{int(joint[3:]) - 1}" for joint in SHADOW),
        Layout("shadow", "forearm", SHADOW, (0.0, -0.3175106, -0.0455861, 0.7141857, -0.6999563, 0.0, 0.0)),
        ("robot0_FFJ3", "robot0_MFJ3", "robot0_THJ1", "robot0_THJ0"),
        "1.7 mm at the little finger",
    ),
    "panda": _own(FRANKA, "panda", FRANKA_LINK, FRANKA_JOINTS[:1], (0.0, 0.0, -0.075, *IDENTITY)),
    "robotiq2": _own("robotiq_2f_140", "Root", "robotiq_arg2f_base_link", ("finger_joint",), (0, 0, -0.125, *IDENTITY)),
    "robotiq3": _own("robotiq_3finger", "RobotIQ", "RIQ_palm", ROBOTIQ, (0, 0, -0.08, *RIQ_PALM)),
    "schunk2": _own("schunk_egu_50", "root_link", "root_link", ("egu_50_prismatic_1",), (0, 0, 0, *IDENTITY)),
    "ability_hand": _own(
        "ability_hand",
        "ability_hand",
        "ability_hand",
        (*(f"{finger}_q1" for finger in ("index", "middle", "ring", "pinky", "thumb")), "thumb_q2"),
        (0, 0, 0, *IDENTITY),
    ),
}
"""Its name of a hand -> the hand."""


@dataclass(frozen=True)
class GraspQP(Format):
    """Files `OBJECT.dexgrasp.pt`."""

    name: str = "graspqp"
    what: str = "GraspQP: a folder of .pt files, each with all grasps of one object, joints by name"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("parameters",))
        if lacking:
            return lacking
        lacking = missing_keys(content["parameters"], (ROOT,))
        return f"its parameters: {lacking}" if lacking else ""

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content["parameters"]
        poses = source.poses(held[ROOT], ROOT)
        names = source.names([name for name in held if name != ROOT], "parameters")
        columns = [source.numbers(held[name], name, (len(poses),)) for name in names]
        q = np.stack(columns, axis=1) if names else np.zeros((len(poses), 0))
        thing, folder = _path_names(source)
        notes = []
        if source.content.get("grasp_velocities") is not None:
            notes.append("grasp_velocities, which close the hand, have no place in a grasp set")
        found = next((model for model in MODELS.values() if set(model.joints) == set(names)), None)
        if found is not None and (hand is None or set(found.layout.joints) <= set(hand.joint_names)):
            order = [names.index(joint) for joint in found.joints]
            names, q = found.layout.joints, q[:, order] * found.signs
            hand_name, base_link = found.layout.hand, found.layout.base_link
            poses = pose_from_transform(transform_from_pose(poses) @ found.layout.T_root_base)
            if found.apart:
                notes.append(f"its model of the hand differs from that of the maker: {found.apart}")
        else:
            hand_name, base_link = folder, found.root if found else "root"
            if hand is None:
                notes.append("the file does not name its hand: give it with `hand`, which begins at its root link")
        if hand is not None and base_link not in hand.links_by_name:
            notes.append(f"poses are of the root link of its URDF, and read as poses of {hand.base_link}")
            base_link = hand.base_link
        layout = Layout(hand_name, base_link, names)
        return layout.grasps(hand, poses, q, object=thing, labels=_energy(source, len(poses))), notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object."""
        check_file_names(grasps, self.name)
        grasps = without_follower(grasps)
        moved, layout = fit_layout(grasps, tuple(model.layout for model in MODELS.values()), load, self.name)
        hand, model = next((name, model) for name, model in MODELS.items() if model.layout == layout)
        q = moved.q * model.signs
        poses = root_poses(moved, layout)
        energy = grasps.labels.get(ENERGY, np.zeros(len(grasps)))
        parts = []
        for thing in dict.fromkeys(grasps.object.tolist()):
            rows = np.flatnonzero(grasps.object == thing)
            values = dict(zip(model.joints, q[rows].astype(np.float32).T, strict=True))
            zeros = dict.fromkeys(model.joints, np.zeros(len(rows), np.float32))
            content = {
                "values": energy[rows].astype(np.float32),
                "parameters": values | {ROOT: poses[rows].astype(np.float32)},
                "grasp_velocities": zeros,
                "full_grasp_velocities": zeros,
                "grasp_velocities_off": zeros,
            }
            place = f"{thing}/{PREDICTIONS}/{hand}/12_contacts/graspqp/default"
            parts.append(Part(f"{place}/{thing}{ENDING}.pt", rows, content))
        zeros_of = "velocities" if ENERGY in grasps.labels else "energies and velocities"
        size = "meshes are in metres"
        lost = omission_notes(grasps, layout.joints, stages=False, labels=(ENERGY,), size=size)
        return parts, [f"{zeros_of} are written as 0", SINGLE_PRECISION, *lost]


def _path_names(source: Source) -> tuple[str, str]:
    """Names of object and hand, from the path."""
    parts = source.path.absolute().parts
    if PREDICTIONS in parts[1:-2]:
        at = len(parts) - 1 - parts[::-1].index(PREDICTIONS)
        return parts[at - 1], parts[at + 1]
    return source.path.stem.removesuffix(ENDING), "hand"


def _energy(source: Source, count: int) -> dict[str, Float[np.ndarray, " N"]]:
    """Energy of each grasp, a label, lower is better; files that say 0 of all have none."""
    energies = source.content.get("values")
    if energies is None:
        return {}
    values = source.numbers(energies, "values").ravel()
    if values.shape != (count,):
        raise source.error(f"values must have shape ({count},); it has {values.shape}")
    return {ENERGY: values} if values.any() else {}
