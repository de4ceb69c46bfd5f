"""`refine-grasp run --touch` as a user meets it: colours of a mesh are part of what a result was made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from command_line import refused
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")


def painted(path: Path, axis: int) -> None:
    """Write a box of 4 x 4 x 8 cm of which both sides along an axis are red."""
    mesh = trimesh.creation.box(extents=[0.04, 0.04, 0.08])
    mesh.visual.face_colors[:] = np.where(np.abs(mesh.face_normals[:, axis, None]) > 0.5, [255, 0, 0, 255], 255)
    mesh.export(path)


def test_a_mesh_painted_anew_is_another_object(capfd: pytest.CaptureFixture[str]) -> None:
    """The same command writes its result again, and not over that of other colours."""
    path = Path("box.ply")
    painted(path, 0)
    command = "run --hand franka_hand --object box.ply --grasps sample:1 --starts 1 --iterations 5 --out results"
    red = (*command.split(), "--touch", "color:#ff0000")
    assert main([*red]) == 0 and main([*red]) == 0
    capfd.readouterr()
    painted(path, 1)
    assert_names(refused(capfd, *red), "franka_hand_box.npz", "--overwrite")
