"""MultiGripperGrasp: one .json file for each gripper and object, poses of the gripper and joints in Isaac Sim's order.

`pose` (N, 7) is x y z (metres), qw qx qy qz of the root link of the gripper in the object's frame, `dofs` (N, n) its
joints, radians or metres, in the order in which Isaac Sim has them: level by level from the root. The files do not name
the joints; the project's description of that order lists eleven of its grippers. Objects have their own size.

Source: github.com/IRVLUTD/isaac_sim_grasping, docs/grasp_data_format.md and managers.py; README.md of its branch
iros_2024 for the order; the URDFs in grippers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats.folders import disambiguate, object_folder
from grasp_refine.grasps.formats.format import FALL_TIME, SUCCESS, Format, Load, Part, omission_notes
from grasp_refine.grasps.formats.grippers import FRANKA, FRANKA_JOINTS, FRANKA_LINK
from grasp_refine.grasps.formats.layout import Layout
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import fit_layout
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

BASE = "base_link"
SHADOW = tuple(
    f"{finger}joint{level}"
    for level in range(1, 6)
    for finger in ("index_finger_", "little_finger_", "middle_finger_", "ring_finger_", "thumb_")
    if level < 5 or finger in ("little_finger_", "thumb_")
)
"""Joints of its Shadow hand, level by level."""
MISSPELT = {"index_finger_joint2": "index_finger_join2"}
"""Joint -> its name in its URDF."""
HUMAN = tuple(
    f"{before.format(finger)}_{after.format(finger)}_joint"
    for before, after in (("palm", "{}1_0"), ("{}1_0", "{}1"), ("{}1", "{}2"), ("{}2", "{}3"))
    for finger in ("index", "mid", "pinky", "ring", "thumb")
)
ROBOTIQ = (
    *("RIQ_palm_RIQ_link_0_joint", "RIQ_palm_RIQ_link_0_joint_b", "RIQ_palm_RIQ_link_1_joint_a"),
    *("RIQ_link_0_RIQ_link_1_joint_c", "RIQ_link_0_RIQ_link_1_joint_b", "RIQ_link_1_RIQ_link_2_joint_a"),
    *("RIQ_link_1_RIQ_link_2_joint_c", "RIQ_link_1_RIQ_link_2_joint_b", "RIQ_link_2_RIQ_link_3_joint_a"),
    *("RIQ_link_2_RIQ_link_3_joint_c", "RIQ_link_2_RIQ_link_3_joint_b"),
)
LABELS = {"result": SUCCESS, "fall_time": FALL_TIME}
"""Verdict of its simulation on a grasp -> label."""
GRIPPERS = {
    "Allegro": Layout("allegro", BASE, tuple(f"joint_{first + n}.0" for n in range(4) for first in (0, 12, 4, 8))),
    "Barrett": Layout(
        "Barrett",
        BASE,
        (
            *("a_palm_link1_joint", "b_palm_link1_joint", "c_palm_link2_joint_0"),
            *("a_link1_link2_joint", "b_link1_link2_joint", "c_link2_link3_joint"),
            *("a_link2_link3_joint", "b_link2_link3_joint"),
        ),
    ),
    "HumanHand": Layout("HumanHand", BASE, HUMAN),
    "fetch_gripper": Layout("fetch_gripper", BASE, ("l_gripper_finger_joint", "r_gripper_finger_joint")),
    "franka_panda": Layout(FRANKA, FRANKA_LINK, FRANKA_JOINTS),
    "h5_hand": Layout("h5_hand", BASE, ("left_link_joint", "right_link_joint", "left_tip_joint", "right_tip_joint")),
    "jaco_robot": Layout("jaco_robot", BASE, tuple(f"jaco_finger_joint_{n}" for n in (0, 2, 4))),
    "robotiq_3finger": Layout("robotiq_3finger", "RIQ_palm", ROBOTIQ),
    "sawyer": Layout("sawyer", BASE, ("finger_joint1", "finger_joint2")),
    "shadow_hand": Layout("shadow_hand", BASE, tuple(MISSPELT.get(name, name) for name in SHADOW)),
    "wsg_50": Layout("wsg_50", BASE, ("base_joint_gripper_left", "base_joint_gripper_right")),
}
"""Its name of a gripper -> hand, root link, and joints in the order of Isaac Sim, named as in its URDF."""


@dataclass(frozen=True)
class MultiGripperGrasp(Format):
    """Files such as `Allegro-Mug.json`, before and after its simulation."""

    name: str = "multigripper"
    what: str = "MultiGripperGrasp: one .json file for each gripper and object"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("gripper", "pose"))
        if lacking:
            return lacking
        return "" if "object_id" in content or "object_ID" in content else "it lacks object_id"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content
        gripper = source.text(held["gripper"], "gripper")
        poses = source.poses(held["pose"], "pose")
        layout = GRIPPERS.get(gripper)
        notes = []
        if held.get("dofs") is None:
            notes.append("the file has no joint values (dofs), only poses of the gripper")
            base = layout.base_link if layout else hand.base_link if hand else BASE
            layout = Layout(layout.hand if layout else gripper, base, ())
        elif layout is None:
            known = "; ".join(f"{name}: {', '.join(known.joints)}" for name, known in GRIPPERS.items())
            raise source.error(
                f"is for the gripper '{gripper[:40]}' and names no joints; Isaac Sim's order is known for {known}"
            )
        else:
            notes.append(f"joints are in the order of Isaac Sim for {gripper}, which the file does not name")
        q = np.zeros((len(poses), 0))
        if layout.joints:
            q = source.numbers(held["dofs"], "dofs", (len(poses), len(layout.joints)))
        if hand is not None:
            there = {joint.name for joint in hand.joints}
            if layout.base_link not in hand.links_by_name or not set(layout.joints) <= there:
                raise source.error(
                    f"is for the gripper {gripper} from link {layout.base_link} on, with the joints "
                    f"{', '.join(layout.joints)}; hand '{hand.name}' has {', '.join(hand.joint_names)}"
                )
        thing = held.get("object_id", held.get("object_ID"))
        labels = {
            name: source.numbers(held[key], key, (len(poses),))
            for key, name in LABELS.items()
            if held.get(key) is not None
        }
        grasps = layout.grasps(hand, poses, q, object=source.object_name(thing, "object_id"), labels=labels)
        if held.get("final_dofs") is not None:
            notes.append("final_dofs, the joints once the gripper had closed, have no place in a grasp set")
        return grasps, notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object."""
        moved, layout = fit_layout(_with_follower(grasps), tuple(GRIPPERS.values()), load, self.name)
        gripper = next(name for name, known in GRIPPERS.items() if known == layout)
        if layout.hand not in ("allegro", FRANKA) and grasps.hand != layout.hand:
            raise GraspFileError(f"format {self.name} means its own {gripper}; these grasps are of '{grasps.hand}'")
        things = list(dict.fromkeys(grasps.object.tolist()))
        parts = []
        for file, name in zip(disambiguate(map(object_folder, things)), things, strict=True):
            rows = np.flatnonzero(grasps.object == name)
            content = {
                "gripper": gripper,
                "object_id": name,
                "pose": moved.hand_pose[rows].tolist(),
                "dofs": moved.q[rows].tolist(),
                **{key: grasps.labels[name][rows].tolist() for key, name in LABELS.items() if name in grasps.labels},
            }
            parts.append(Part(f"{gripper}-{file}.json", rows, content))
        size = "objects have their own size"
        return parts, omission_notes(grasps, layout.joints, stages=False, labels=LABELS.values(), size=size)


def _with_follower(grasps: GraspSet) -> GraspSet:
    """Grasps of the Franka hand with its second finger where the first is; others as they are."""
    if grasps.joint_names != FRANKA_JOINTS[:1] or grasps.base_link != FRANKA_LINK:
        return grasps
    return replace(
        grasps, joint_names=FRANKA_JOINTS, q=np.repeat(grasps.q, 2, axis=1), pregrasp=None, squeeze=None, targets=None
    )
