"""Grasps for Isaac Sim: its file, read back, has the palms, fingers and pregrasps of the program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from ball_hand import FROM_ABOVE, ball_hand, grasp
from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.targets import export
from grasp_refine.grasps.formats.reading import load_grasps
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.scene.scene import Scene
from refusals import refused

T_BASE = transform_from_rpy([-0.5, 0.0, -0.06])


@pytest.mark.parametrize("where", ["free", "arm"])
def test_the_file_read_back_has_the_palms_and_fingers(where: str, tmp_path: Path):
    hand = ball_hand(tmp_path / "hand")
    scene, motion = grasp(hand)
    q = motion.q + np.array([0.0, 0.001])
    fingers, T = q, np.repeat(FROM_ABOVE[None], 3, axis=0)
    if where == "arm":
        whole = mount(load_hand("ur5e", candidates=32), hand)
        alone = [GraspSet.of(hand, T[:1], q[:, k]) for k in range(3)]
        q = np.stack([np.hstack([on_arm(one, whole, T_BASE)[0].q[:, :6], one.q]) for one in alone], axis=1)
        hand, motion = whole, replace(motion, T_world_root=np.tile(T_BASE, (1, 3, 1, 1)))
    # A second grasp has no numbers.
    motion = Motion(np.repeat(motion.T_world_root, 2, axis=0), np.concatenate([q, q * np.nan]))
    scene = Scene(hand, scene.object, motion.T_world_root[:, 1], motion.q[:, 1], task=scene.task)
    part = ExportedGrasps("the/ball", 1.0, scene, motion, np.arange(2), values={"quality": np.array([0.25, 1.0])})
    (folder,) = export([part], "isaac_grasp", tmp_path / "isaac")
    read = load_grasps(folder / "grasps.yaml", hand=hand)
    assert (len(read), read.base_link, set(read.joint_names)) == (1, "palm", {"l", "r"})
    np.testing.assert_allclose(transform_from_pose(read.hand_pose), FROM_ABOVE[None], atol=1e-9)
    order = [read.joint_names.index(name) for name in ("l", "r")]
    np.testing.assert_array_equal(read.q[:, order], fingers[:, 1])
    np.testing.assert_array_equal(read.pregrasp.q[:, order], fingers[:, 0])
    content = yaml.safe_load((folder / "grasps.yaml").read_text())
    assert [one["confidence"] for one in content["grasps"].values()] == [0.25]
    mesh = trimesh.load_mesh(folder / content["object_file"])
    np.testing.assert_allclose(mesh.bounds, part.object.mesh.bounds, atol=1e-6)
    with refused(GraspRefineError, "the/ball"):
        export([replace(part, motion=Motion(motion.T_world_root, motion.q * np.nan))], "isaac_grasp", tmp_path / "no")
