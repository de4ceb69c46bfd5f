"""Text of a hand.toml with all keys of a hand, and comments for whoever edits it."""

from __future__ import annotations

import json
import os
import textwrap
from pathlib import Path

import numpy as np

from grasp_refine.core.rpy_poses import rpy_from_transform
from grasp_refine.hands.files.hand_toml import ACTUATOR
from grasp_refine.hands.hand import Hand
from grasp_refine_apps.report.hand_table import show_value


def hand_toml_text(hand: Hand, folder: Path) -> str:
    """Text of a hand.toml in `folder` from which the same hand is read, exact to the last digit."""
    parts = [_head(hand, folder), _rest(hand), _contacts(hand), _coupled(hand), _actuator(hand)]
    if hand.mjcf_joints:
        lines = [f"{_text(joint)} = {_text(name)}" for joint, name in hand.mjcf_joints.items()]
        parts.append("\n".join(["# Names of the joints in the MJCF file.", "[mjcf_joints]", *lines]))
    return "\n\n".join(parts) + "\n"


def _head(hand: Hand, folder: Path) -> str:
    if hand.mjcf == hand.urdf:
        file = [f"mjcf = {_text(_relative(hand.urdf, folder))}"]
    else:
        file = [f"urdf = {_text(_relative(hand.urdf, folder))}"]
    if hand.mjcf == hand.urdf:
        mjcf = ["# It is simulated as it is; with urdf and mjcf, one is refined and the other may be simulated."]
    elif hand.collision == "visual":
        mjcf = ["# Links collide as they look.", 'collision = "visual"']
    elif hand.mjcf is None:
        mjcf = [
            "# The same hand as an MJCF file, where you have one; with collision it is simulated instead of the URDF.",
            '# mjcf = "hand.xml"',
            '# collision = "mjcf"',
        ]
    else:
        mjcf = [
            "# The same hand as an MJCF file, and which of the two is simulated.",
            f"mjcf = {_text(_relative(hand.mjcf, folder))}",
            f"collision = {_text(hand.collision)}",
        ]
    return "\n".join(
        [
            *_comment(f"Settings beyond {hand.urdf.name}. Written by: refine-grasp hands --check {hand.urdf.name}"),
            "# A key that is left out is derived from that file. Units are metres, radians, newtons and newton metres.",
            "",
            "# Name in results and grasp files; left out, that of this folder.",
            f"name = {_text(hand.name)}",
            *file,
            "",
            *_comment(f"Base link of the hand; links above it do not move. Reason for this choice: {hand.base_why}."),
            f"base_link = {_text(hand.base_link)}",
            "",
            *mjcf,
            "",
            '# Limits of joints that follow others: "own", or "leader", the ones that follow from the other joint.',
            f"follower_limits = {_text(hand.follower_limits)}",
            "",
            "# Whether flat faces of its links touch flat faces of objects in patches, not in points.",
            f"patches = {str(hand.patches).lower()}",
            "",
            "# Pose of the flange of an arm that carries it, in the frame of base_link: [x, y, z, roll, pitch, yaw],",
            "# metres, degrees; left out, that frame. In an arm.toml, mount names the link that carries hands.",
            *([] if hand.T_base_flange is None else [f"flange = {rpy_from_transform(hand.T_base_flange)}"]),
        ]
    )


def _rest(hand: Hand) -> str:
    lines = [
        "# A pose between open and closed in which no links touch: grasps are sampled around it, and joints that a",
        "# grasp file does not name stay there. A joint that is left out rests in the middle of its range.",
        "[rest_pose]",
    ]
    for name, value in zip(hand.joint_names, hand.rest.tolist(), strict=True):
        joint = hand.joints_by_name[name]
        unit = "" if joint.kind == "prismatic" else " deg"
        low, high = show_value(joint, joint.lower), show_value(joint, joint.upper)
        span = "continuous" if joint.kind == "continuous" else f"from {low} to {high}"
        lines.append(f"{_text(name)} = {value!r}  # {show_value(joint, value)}{unit}, {span}")
    return "\n".join(lines)


def _contacts(hand: Hand) -> str:
    lines = [
        "# Links that are meant to touch the object, and the finger (group) that each belongs to.",
        *(["# Guessed: the last link with collision geometry of each moving branch."] * hand.contacts_guessed),
        "# point: contact point in the link's frame, in metres; left out: the point nearest to the object.",
        "# normal: the outward normal there; left out: that of the surface.",
    ]
    if not hand.contacts:
        lines += ["# [[contact]]", '# link = "fingertip"', '# group = "index"', "# point = [0.0, 0.0, 0.02]"]
    for contact in hand.contacts:
        lines += ["[[contact]]", f"link = {_text(contact.link)}", f"group = {_text(contact.group)}"]
        lines += [f"point = {list(contact.point)}"] if contact.point else []
        lines += [f"normal = {list(contact.normal)}"] if contact.normal else []
        lines.append("")
    return "\n".join(lines).rstrip()


def _coupled(hand: Hand) -> str:
    lines = ["# Joints that one actuator drives through one tendon: its length is the sum of ratio x joint value."]
    if not hand.coupled:
        names = json.dumps((list(hand.joint_names) + ["outer", "inner"])[:2], ensure_ascii=False)
        lines += ["# [[coupled]]", f"# joints = {names}", "# ratio = [1.0, 1.0]"]
    for group in hand.coupled:
        joints = ", ".join(map(_text, group.joints))
        lines += ["[[coupled]]", f"joints = [{joints}]", f"ratio = {list(group.ratio)}", ""]
    return "\n".join(lines).rstrip()


def _actuator(hand: Hand) -> str:
    """Format each key as one number if all joints have the same value, else as a table."""
    meanings = {
        "kp": "stiffness of the position actuators, Nm/rad or N/m",
        "force_limit": "largest torque or force, Nm or N; by default the effort of the joint",
        "damping": "Nm s/rad or N s/m",
        "armature": "rotor inertia reflected to the joint, kg m^2 or kg",
        "frictionloss": "dry friction, Nm or N",
    }
    if hand.mjcf == hand.urdf:
        return "# Actuators come from the MJCF; [actuator] counts where it has no position servos."
    lines = [
        "# How joints are driven in simulation. One number for all, or { default = 5.0, JOINT = 3.0 }.",
        "[actuator]",
    ]
    for key in ACTUATOR:
        values = dict(zip(hand.joint_names, getattr(hand.actuator, key).tolist(), strict=True))
        known = {name: value for name, value in values.items() if np.isfinite(value)}
        if not known:
            lines += [f"# {key}: {meanings[key]}; not in the file", f"# {key} = 3.0"]
        elif len(set(known.values())) == 1 and len(known) == len(values):
            lines.append(f"{key} = {next(iter(known.values()))!r}  # {meanings[key]}")
        else:
            table = ", ".join(f"{_text(name)} = {value!r}" for name, value in known.items())
            lines += [f"# {key}: {meanings[key]}", f"{key} = {{ {table} }}"]
    return "\n".join(lines)


def _comment(text: str) -> list[str]:
    printable = "".join(character if character.isprintable() else " " for character in text)
    return [f"# {line}" for line in textwrap.wrap(" ".join(printable.split()), 116)]


def _relative(file: Path, folder: Path) -> str:
    """Path of `file` relative to `folder`; absolute where there is no relative path."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return file.resolve().as_posix()


def _text(value: str) -> str:
    """Quote a TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
