"""Target `isaac_grasp`: the grasps as Isaac Sim's grasp editor writes them, and the object's mesh in metres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_bytes
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.target import Readme
from grasp_refine.grasps.formats.folders import object_folder
from grasp_refine.grasps.formats.format import CONFIDENCE
from grasp_refine.grasps.formats.isaac_grasp import IsaacGrasp
from grasp_refine.grasps.formats.texts import dump_yaml
from grasp_refine.grasps.grasp_set import GraspSet, Stage


@dataclass(frozen=True)
class Isaac:
    """Folder for Isaac Sim's grasp editor and Isaac ROS."""

    name: str = "isaac_grasp"
    what: str = "Isaac Sim's grasp file, joints by name, with the object's mesh"
    extra: str = ""

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write the grasps and the mesh.

        Raises:
            GraspRefineError: no grasp has a pose and joint values that are finite.
        """
        hand, thing = grasps.hand, object_folder(grasps.name)
        rows, fingers = np.flatnonzero(grasps.motion.finite), np.flatnonzero(~hand.arm_joints)
        if not len(rows):
            raise GraspRefineError(f"{grasps.name}: no grasp has a pose and joint values that are finite")
        opened, closed = (STAGES.index(name) for name in ("pregrasp", "grasp"))
        pose, q = grasps.palm_poses[rows], grasps.motion.q[rows][..., fingers]
        quality = grasps.values.get("quality")
        palm = hand.palm
        held = GraspSet(
            hand=hand.name,
            base_link=palm,
            joint_names=tuple(hand.joint_names[joint] for joint in fingers),
            object=np.full(len(rows), thing),
            scale=np.ones(len(rows)),
            hand_pose=pose[:, closed],
            q=q[:, closed],
            pregrasp=Stage(pose[:, closed], q[:, opened]),
            labels={} if quality is None else {CONFIDENCE: np.nan_to_num(quality[rows])},
        )
        ((part,), notes) = IsaacGrasp().write(held, lambda link: hand)
        save_bytes(folder / "grasps.yaml", dump_yaml(part.content))
        grasps.object.mesh.export(folder / f"{thing}.obj")
        moved = np.linalg.norm(pose[:, opened, :3] - pose[:, closed, :3], axis=1).max()
        left_out = len(grasps) - len(rows)
        return Readme(
            {"grasps.yaml": "the grasps; confidence is the quality", f"{thing}.obj": "the object, metres"},
            use="isaacsim.robot_setup.grasp_editor.import_grasps_from_file('grasps.yaml')",
            notes=(
                f"position and orientation: link {palm} in the frame of {thing}.obj, metres; quaternion w, xyz.",
                "Joints have the names of the hand's file, where USD replaces characters such as dots; those that "
                "follow others are not named.",
                f"A pregrasp has the palm of the grasp: ours is up to {moved * 1e3:.1f} mm away. There is no squeeze.",
                *notes,
                *([f"{left_out} without finite numbers left out."] if left_out else ()),
            ),
        )
