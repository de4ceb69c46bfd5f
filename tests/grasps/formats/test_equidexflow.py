"""EquiDexFlow: index fingers are where its own constants put them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kinematics import Kinematics
from refusals import refused

Load = Callable[..., Hand]
Q = np.pi / 2
CHAINS: dict[str, Any] = {
    "allegro": (
        [
            ((0, 0.0435, 0.093458), (-np.radians(5), 0, 0), (0, 0, 1)),
            ((0, 0, 0.0164), (0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.054), (0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.0384), (0, 0, 0), (0, 1, 0)),
        ],
        "link_3.0",
    ),
    "leap": (
        [
            ((0, 0.038, 0.098), (0, -Q, 0), None),
            ((-0.007, 0.023, -0.0187), (Q, Q, 0), (0, 0, -1)),
            ((-0.0122, 0.0381, 0.0145), (-Q, 0, Q), (0, 0, -1)),
            ((0.015, 0.0143, -0.013), (Q, -Q, 0), (0, 0, -1)),
            ((0, -0.0361, 0.0002), (0, 0, 0), (0, 0, -1)),
        ],
        "fingertip",
    ),
}
"""Hand -> position, roll pitch yaw and axis of each joint of the index finger, and our name of its last link."""


def last_link(name: str, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Position of the origin of the last link of the index finger, by its constants."""
    values = iter(q)
    for position, rpy, axis in CHAINS[name][0]:
        step = np.eye(4)
        turn = Rotation.from_euler("xyz", rpy)
        if axis is not None:
            turn = turn * Rotation.from_rotvec(np.array(axis) * next(values))
        step[:3, :3], step[:3, 3] = turn.as_matrix(), position
        T = T @ step
    return T[:3, 3]


def content(count: int = 3) -> dict[str, Any]:
    random = np.random.default_rng(4)
    grasps = []
    for row in range(count):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.random(random_state=row).as_matrix(), random.normal(size=3) * 0.1
        grasp: dict[str, Any] = {
            "wrist_pose_object": T.tolist(),
            "hand_dof_values": random.uniform(-0.5, 1, 16).tolist(),
        }
        grasps.append(
            grasp | {"epsilon_quality": 0.1 * row, "volume_quality": 1e-5, "contact_points_mm": [[0, 0, 1]] * 4}
        )
    return {"object_name": "mustard_bottle", "n_grasps": count, "grasps": grasps}


def save(folder: Path, held: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "mustard_bottle.json"
    path.write_text(json.dumps(held))
    return path


@pytest.mark.parametrize("name", CHAINS)
def test_index_fingers_are_where_its_constants_put_them(name: str, load: Load, tmp_path: Path):
    held = content()
    read = reading(save(tmp_path / name, held))
    grasps = read.grasps
    assert (read.format.name, grasps.hand, set(grasps.object)) == ("equidexflow", name, {"mustard_bottle"})
    np.testing.assert_allclose(grasps.labels["epsilon_quality"], [0, 0.1, 0.2])
    hand = load(name, grasps.base_link)
    columns = [grasps.joint_names.index(joint) for joint in hand.joint_names]
    T = torch.as_tensor(transform_from_pose(np.asarray(grasps.hand_pose)))
    found = Kinematics(hand, (CHAINS[name][1],))(T, torch.as_tensor(grasps.q[:, columns]))[:, 0, :3, 3].numpy()
    expected = [
        last_link(name, np.array(grasp["wrist_pose_object"]), np.array(grasp["hand_dof_values"][:4]))
        for grasp in held["grasps"]
    ]
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_other_hands_and_missing_poses_are_refused(tmp_path: Path):
    held = content()
    with refused(GraspFileError, "allegro", "leap"):
        reading(save(tmp_path / "v3", held))
    del held["grasps"][1]["wrist_pose_object"]
    with refused(GraspFileError, "grasp 1", "wrist_pose_object"):
        reading(save(tmp_path / "leap", held))
    held = content()
    held["grasps"][2]["hand_dof_values"].pop()
    with refused(GraspFileError, "hand_dof_values"):
        reading(save(tmp_path / "allegro", held))
