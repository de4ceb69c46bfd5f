"""GraspM3: the frame before the lift, with the wrist of its URDF and the object on the table, computed in MuJoCo."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.trajectories import frames_before_lift
from refusals import refused

WRIST = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
HINGES = ("1 0 0", "0 1 0", "0 0 1")
"""The six joints of `linkerhand_o6_right6d.urdf`, from the world to the palm."""
BOX = np.array([[x, y, z] for x in (-0.5, 0.7) for y in (-0.3, 0.2) for z in (-0.9, 1.1)])
FACES = ((1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7), (1, 7, 5))
FACES += ((2, 6, 8), (2, 8, 4))
LIFT, FRAMES = 12, 20


def wrist_pose(values: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the palm in the world, of MuJoCo, with position and angles of the wrist."""
    hand = '<geom size="0.01"/>'
    for axis in reversed(HINGES):
        hand = f'<body><joint type="hinge" axis="{axis}"/><geom size="0.01"/>{hand}</body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body>{WRIST}<geom size='0.01'/>{hand}</body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[:] = values
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.xmat[-1].reshape(3, 3), data.xpos[-1]
    return T


@pytest.fixture
def content(tmp_path: Path) -> dict[str, Any]:
    """Two trajectories that approach, close, and lift from frame 12 on; the mesh lies beside them."""
    mesh = tmp_path / "data/object_meshdata/mug[1]/coacd/decomposed.obj"
    mesh.parent.mkdir(parents=True)
    lines = [f"v {x} {y} {z}" for x, y, z in BOX] + [f"f {a} {b} {c}" for a, b, c in FACES]
    mesh.write_text("\n".join(lines))
    random = np.random.default_rng(3)
    seqs = np.tile(random.uniform(-0.8, 0.8, (2, 1, 12)), (1, FRAMES, 1))
    seqs[:, :, :3] += np.linspace([-0.1, 0.05, 0.02], 0.0, FRAMES)[None] * (np.arange(FRAMES) < LIFT)[None, :, None]
    seqs[:, LIFT:, :3] = seqs[:, [LIFT], :3]
    seqs[:, LIFT:, 2] += 0.008 * np.arange(FRAMES - LIFT)
    seqs[:, :, 6:] += 0.01 * np.arange(FRAMES)[:, None]
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    return {
        "grasp_seqs": seqs.astype(np.float32),
        "obj_rotmat": np.stack([turn, np.eye(3)]).astype(np.float32),
        "obj_scale": np.array([0.06, 0.1], dtype=np.float32),
        "obj_code_idx": [3, 3],
    }


def save(folder: Path, content: dict[str, Any]) -> Path:
    (folder / "data/trajectories").mkdir(parents=True, exist_ok=True)
    path = folder / "data/trajectories/mug[1].npy"
    np.save(path, np.array(content, dtype=object))
    return path


def test_the_palm_is_where_its_wrist_puts_it_before_the_lift_with_the_object_on_the_table(content: Any, tmp_path: Path):
    read = reading(save(tmp_path, content))
    assert (read.format.name, read.grasps.hand, read.grasps.base_link) == (
        "graspm3",
        "linkerhand_o6_right",
        "rh_hand_base_link",
    )
    assert read.grasps.joint_names[0] == "rh_thumb_cmc_yaw" and read.grasps.joint_names[5] == "rh_pinky_mcp_pitch"
    for row, T_object_hand in enumerate(transform_from_pose(read.grasps.hand_pose)):
        frame, R = content["grasp_seqs"][row, LIFT].astype(float), content["obj_rotmat"][row].astype(float)
        T = np.eye(4)
        T[:3, :3] = R
        T[2, 3] = -(BOX @ R.T)[:, 2].min() * content["obj_scale"][row]
        np.testing.assert_allclose(T @ T_object_hand, wrist_pose(frame[:6]), atol=1e-6)
        np.testing.assert_allclose(read.grasps.q[row], frame[6:])


def test_a_hand_that_lifts_nothing_has_its_grasp_at_the_end():
    position = np.zeros((4, 10, 3))
    position[0, :, 0] = np.linspace(0, 0.1, 10)  # moves sideways until the end
    position[1, 4:, 2] = 0.01 * np.arange(6)  # lifts from frame 4 on
    position[2, :6, 2] = np.linspace(0.2, 0, 6)  # comes down, then stands
    position[3, 3:7, 2], position[3, 7:, 2] = 0.01 * np.arange(4), 0.03  # lifts, then waits
    assert frames_before_lift(position).tolist() == [9, 4, 9, 3]
    assert frames_before_lift(position[:, :1]).tolist() == [0] * 4


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"grasp_seqs": np.zeros((2, 5, 28))}, "22"),
        ({"obj_rotmat": np.zeros((2, 3, 3))}, "obj_rotmat"),
        ({"obj_scale": np.array([0.1])}, "obj_scale"),
        ({"obj_scale": 0.1}, "obj_scale"),
        ({"obj_scale": np.array([0.1, -1.0])}, "obj_scale"),
        ({"grasp_seqs": np.zeros((2, 12))}, "grasp_seqs"),
    ],
)
def test_defects_are_named(change: dict[str, Any], word: str, content: Any, tmp_path: Path):
    with refused(GraspFileError, word):
        reading(save(tmp_path, content | change))


def test_without_its_mesh_a_file_is_refused_with_the_place_of_the_mesh(content: Any, tmp_path: Path):
    other = save(tmp_path / "elsewhere/far/below/all", content)
    with refused(GraspFileError, "meshdata/mug[1]/coacd/decomposed.obj"):
        reading(other)
    with refused(GraspFileError, "meshdata/mug[1]/coacd/decomposed.obj"):
        reading(save(tmp_path, content), within=tmp_path / "data/trajectories")
