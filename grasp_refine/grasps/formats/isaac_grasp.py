"""isaac_grasp: a YAML file of the grasps of one object by one gripper, as Isaac Sim, GraspGen and GraspDataGen write.

Each grasp has a position (metres) and an orientation {w, xyz} of the gripper's frame in the object's, named joints of
the gripper, and of the gripper before it closes. `object_frame` and `gripper_frame` (in 2024 with _link behind) are
for people only. GraspGen and GraspGenX leave both and all joints out: their frame has the origin of the gripper's
base, z towards the object and x along the motion of the fingers, which are open. GraspDataGen adds the files of object
and gripper, and a scale.

Source: docs.isaacsim.omniverse.nvidia.com, robot_simulation/grasp_editor; nvidia-isaac-ros.github.io,
concepts/manipulation/isaac_grasp; github.com/NVlabs/GraspGen, grasp_gen/dataset/eval_utils.py and
docs/GRIPPER_DESCRIPTION.md; github.com/NVlabs/GraspDataGen, scripts/graspgen/grasp_guess.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.folders import disambiguate, object_folder, scale_folder
from grasp_refine.grasps.formats.format import CONFIDENCE, SUCCESS, Format, Load, Part, omission_notes, rows_by_object
from grasp_refine.grasps.formats.grippers import hand_named, open_joints
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.jaws import jaws_of

NAME, VERSION = "isaac_grasp", 1.0
JOINTS, OPEN_JOINTS = "cspace_position", "pregrasp_cspace_position"
UNNAMED = "gripper"
"""Hand and link of a file that names neither."""


@dataclass(frozen=True)
class IsaacGrasp(Format):
    """Files `.yaml` with `format: isaac_grasp` and `format_version: 1.0`."""

    name: str = NAME
    what: str = "Isaac Sim, GraspGen, GraspDataGen: one .yaml file per object, joints by name"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("format", "grasps"))
        if lacking:
            return lacking
        return "" if content["format"] == NAME else f"its format is no {NAME}"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content
        version = held.get("format_version", VERSION)
        if _number(version) != VERSION:
            raise source.error(f"is of format_version {str(version)[:20]!r}; {VERSION} is read")
        listed = held["grasps"]
        if not isinstance(listed, Mapping) or not listed:
            raise source.error("grasps must be a mapping of one grasp or more, each with its name")
        poses = np.array([_pose(source, str(name), grasp) for name, grasp in listed.items()])
        poses = source.poses(poses, "position and orientation of grasps")
        joints, q = _joints(source, JOINTS)
        opening, open_q = _joints(source, OPEN_JOINTS)
        notes = []
        posed = joints or opening
        if not joints and opening:
            joints, q = opening, open_q
            notes.append(f"there is no {JOINTS}: the joints of {OPEN_JOINTS} are taken for the grasp")
        elif not joints:
            joints, q, note = open_joints(hand, len(poses))
            notes.append(note)
        pregrasp = None
        if opening and opening is not joints:
            if set(opening) != set(joints):
                raise source.error(
                    f"{OPEN_JOINTS} must have the joints of {JOINTS}, {', '.join(joints)}; it has {', '.join(opening)}"
                )
            pregrasp = Stage(poses, open_q[:, [opening.index(name) for name in joints]])
        hand_name, base_link, more = _gripper(source, hand)
        jaws = None if hand is None or posed or _frame(held) is not None else jaws_of(hand)
        if jaws is not None:
            poses = pose_from_transform(transform_from_pose(poses) @ jaws.T_jaws_base)
            more = [
                "it names neither gripper_frame nor joints, as files of GraspGen: its jaws move along x and point "
                f"along z, from the origin of link {base_link}"
            ]
        thing = held.get("object_file") or held.get("object_frame") or held.get("object_frame_link")
        name = source.path.stem if thing is None else source.object_name(thing, "object_file or object_frame")
        grasps = GraspSet(
            hand=hand_name,
            base_link=base_link,
            joint_names=joints,
            object=np.full(len(poses), name),
            scale=np.full(len(poses), source.scale(held.get("object_scale", 1.0), "object_scale")),
            hand_pose=poses,
            q=q,
            pregrasp=pregrasp,
            labels=_confidence(source),
        )
        return grasps, [*notes, *more]

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object and scale."""
        notes = []
        label = next((name for name in (CONFIDENCE, SUCCESS) if name in grasps.labels), None)
        if label is None:
            notes.append("confidence 1.0 is written for every grasp: these have none")
        confidence = np.ones(len(grasps)) if label is None else grasps.labels[label]
        opened = grasps.q
        if grasps.pregrasp is None:
            notes.append("there is no pregrasp: the joints of the grasp itself are written in its place")
        elif (grasps.pregrasp.pose != grasps.hand_pose).any():
            notes.append("a pregrasp with another pose of the hand has no place in this format and is left out")
        else:
            opened = grasps.pregrasp.q
        if grasps.squeeze is not None:
            notes.append("squeeze has no place in this format and is left out")
        groups = rows_by_object(grasps)
        files = disambiguate(f"{object_folder(name)}_{scale_folder(scale)}" for name, scale in groups)
        parts = []
        for file, ((name, scale), rows) in zip(files, groups.items(), strict=True):
            content = {
                "format": NAME,
                "format_version": VERSION,
                "object_frame": f"/World/{name}",
                "gripper_frame": f"/World/{grasps.base_link}",
                "object_file": f"{name}.obj",
                "object_scale": scale,
                "gripper_file": f"{grasps.hand}.usd",
                "grasps": {
                    f"grasp_{at}": {"confidence": float(confidence[row]), **_entry(grasps, opened, row)}
                    for at, row in enumerate(rows.tolist())
                },
            }
            parts.append(Part(f"{file}.yaml", rows, content))
        return parts, [*notes, *omission_notes(grasps, grasps.joint_names, labels=() if label is None else (label,))]


def _entry(grasps: GraspSet, opened: Float[np.ndarray, "N n"], row: int) -> dict[str, Any]:
    x, y, z, qw, qx, qy, qz = grasps.hand_pose[row].tolist()
    return {
        "position": [x, y, z],
        "orientation": {"w": qw, "xyz": [qx, qy, qz]},
        JOINTS: dict(zip(grasps.joint_names, grasps.q[row].tolist(), strict=True)),
        OPEN_JOINTS: dict(zip(grasps.joint_names, opened[row].tolist(), strict=True)),
    }


def _number(value: Any) -> Any:
    """The number of a value; PyYAML reads one without a point, such as 1e-05, as text."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _pose(source: Source, name: str, grasp: Any) -> Float[np.ndarray, " 7"]:
    """Pose of one grasp; the quaternion has its length."""
    lacking = missing_keys(grasp, ("position", "orientation"))
    lacking = lacking or missing_keys(grasp["orientation"], ("w", "xyz"))
    if lacking:
        raise source.error(f"grasp {name[:40]!r}: {lacking}")
    values = [grasp["position"], [grasp["orientation"]["w"]], grasp["orientation"]["xyz"]]
    position, w, xyz = (
        source.numbers(
            [_number(one) for one in value] if isinstance(value, list) else value,
            f"{what} of grasp {name[:40]!r}",
            (length,),
        )
        for value, what, length in zip(values, ("position", "orientation w", "orientation xyz"), (3, 1, 3), strict=True)
    )
    return np.concatenate([position, w, xyz])


def _joints(source: Source, key: str) -> tuple[tuple[str, ...], Float[np.ndarray, "N n"]]:
    """Names of the joints under a key of all grasps, and their values; none where the grasps have none."""
    listed = source.content["grasps"]
    having = {name: grasp[key] for name, grasp in listed.items() if grasp.get(key)}
    if not having:
        return (), np.zeros((len(listed), 0))
    without = [name for name in listed if name not in having]
    if without:
        raise source.error(f"grasp {str(without[0])[:40]!r} lacks {key}, which {str(next(iter(having)))[:40]!r} has")
    first: tuple[str, ...] | None = None
    rows = []
    for name, joints in having.items():
        what = f"{key} of grasp {str(name)[:40]!r}"
        if not isinstance(joints, Mapping):
            raise source.error(f"{what} must be a mapping of joints")
        names = source.names(list(joints), f"joints of {what}")
        first = first or names
        if set(names) != set(first):
            raise source.error(f"{what} must have the joints {', '.join(first)}; it has {', '.join(names)}")
        rows.append([_number(joints[joint]) for joint in first])
    assert first is not None
    return first, source.numbers(rows, key, (len(listed), len(first)))


def _frame(held: Mapping[str, Any]) -> Any:
    """Frame of the gripper that a file names; None: it names none."""
    return held.get("gripper_frame") or held.get("gripper_frame_link")


def _gripper(source: Source, hand: Hand | None) -> tuple[str, str, list[str]]:
    """Hand and base link of the grasps, and notes."""
    held, frame = source.content, _frame(source.content)
    link = "" if frame is None else PurePosixPath(source.text(frame, "gripper_frame")).name
    if hand is not None:
        if link in hand.links_by_name:
            return hand.name, link, []
        said = f"its gripper_frame {link} is no link of hand '{hand.name}'" if link else "it names no gripper_frame"
        return hand.name, hand.base_link, [f"{said}: poses are read as poses of its link {hand.base_link}"]
    file = held.get("gripper_file")
    named = hand_named(source.text(file, "gripper_file")) if file is not None else hand_named(link) if link else UNNAMED
    if link:
        return named, link, []
    return named, UNNAMED, ["the file names no gripper_frame: give the gripper with `hand`, which begins there"]


def _confidence(source: Source) -> dict[str, Float[np.ndarray, " N"]]:
    """Confidence of each grasp, a label; 0 marks one that failed, NaN one that has none."""
    confidences = [grasp.get("confidence", np.nan) for grasp in source.content["grasps"].values()]
    values = source.numbers([_number(value) for value in confidences], "confidence")
    return {} if np.isnan(values).all() else {CONFIDENCE: values}
