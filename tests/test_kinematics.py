"""Forward kinematics against yourdfpy, its derivative against finite differences, mimic joints, end to end."""

from pathlib import Path

import numpy as np
import pytest
import torch
import yourdfpy

from grasp_refine.collision.query import Pairs
from grasp_refine.errors import HandError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import hull
from grasp_refine.hand import Hand, load_hand
from grasp_refine.kinematics import Kinematics
from grasp_refine.se3 import body_gradient, exp_se3
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics

HANDS = ["allegro/allegro_right", "leap/leap_right", "shadow/shadow_right", "barrett/barrett", "robotiq3f/robotiq3f"]

MIMIC = """<robot name="mimic">
  <link name="palm"/><link name="one"/><link name="two"/><link name="three"/>
  <joint name="j1" type="revolute"><parent link="palm"/><child link="one"/><origin xyz="0 0 0.1" rpy="0.3 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="j2" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 0.05"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
    <mimic joint="j1" multiplier="1.5" offset="0.1"/>
  </joint>
  <joint name="j3" type="prismatic"><parent link="two"/><child link="three"/><origin xyz="0 0 0.04"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="j2" multiplier="-0.01"/>
  </joint>
</robot>"""


def random_q(hand: Hand, count: int, seed: int) -> np.ndarray:
    low, high = np.maximum(hand.lower, -2.0), np.minimum(hand.upper, 2.0)
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def poses(count: int, seed: int) -> np.ndarray:
    return exp_se3(np.random.default_rng(seed).normal(size=(count, 6)) * [0.1, 0.1, 0.1, 1, 1, 1])


@pytest.mark.parametrize("name", HANDS)
def test_poses_agree_with_yourdfpy(name: str, shared_assets: Path) -> None:
    path = shared_assets / f"hands/{name}.urdf"
    hand = load_hand(path, candidates=16)
    kinematics = Kinematics(hand, [link.name for link in hand.links])
    q = random_q(hand, 5, seed=0)
    T = kinematics(torch.eye(4, dtype=torch.float64).expand(5, 4, 4), torch.from_numpy(q)).numpy()
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    for row, values in enumerate(q):
        robot.update_cfg(dict(zip(hand.joint_names, values, strict=True)))
        for column, link in enumerate(kinematics.links):
            np.testing.assert_allclose(T[row, column], robot.get_transform(link, hand.base_link), atol=1e-12)


def test_mimic_joints_follow_in_chains(tmp_path: Path) -> None:
    (tmp_path / "mimic.urdf").write_text(MIMIC)
    hand = load_hand(tmp_path / "mimic.urdf", candidates=16)
    assert hand.joint_names == ("j1",)
    q = torch.tensor([[0.4]], dtype=torch.float64, requires_grad=True)
    T = Kinematics(hand, ["three"])(torch.eye(4, dtype=torch.float64)[None], q)
    robot = yourdfpy.URDF.load(str(tmp_path / "mimic.urdf"), load_meshes=False, build_scene_graph=True)
    # yourdfpy follows one mimic, not a chain of them: j2 = 1.5 j1 + 0.1, j3 = -0.01 j2.
    chain = np.eye(4)
    for joint, value in (("j1", 0.4), ("j2", 0.7), ("j3", -0.007)):
        origin = robot.joint_map[joint].origin
        motion = exp_se3(np.array([value, 0, 0, 0, 0, 0] if joint == "j3" else [0, 0, 0, 0, value, 0]))
        chain = chain @ (np.eye(4) if origin is None else origin) @ motion
    np.testing.assert_allclose(T[0, 0].detach().numpy(), chain, atol=1e-12)
    T[..., :3, 3].sum().backward()
    ends = [
        Kinematics(hand, ["three"])(torch.eye(4).double()[None], q.detach() + h)[..., :3, 3].sum()
        for h in (1e-6, -1e-6)
    ]
    assert q.grad.item() == pytest.approx(((ends[0] - ends[1]) / 2e-6).item(), abs=1e-8)


def test_unknown_links_are_named() -> None:
    hand = load_hand("allegro", candidates=16)
    with pytest.raises(HandError, match="has no link sixth_finger; it has .*link_3.0_tip"):
        Kinematics(hand, ["sixth_finger"])


@pytest.mark.parametrize("name", ["allegro", "shadow"])
def test_gradients_end_to_end(name: str, request: pytest.FixtureRequest) -> None:
    """Link poses, and signed distances to an object, against finite differences in root twist and joints."""
    if name == "shadow":
        path = request.getfixturevalue("shared_assets") / "hands/shadow/shadow_right.urdf"
        hand = load_hand(path, base_link="palm", candidates=64)
    else:
        hand = load_hand("allegro", candidates=64)
    links = [contact.link for contact in hand.contacts]
    obj = build_body("object", [hull(np.random.default_rng(1).normal(size=(60, 3)) * 0.02)], candidates=64)
    layer = WitnessLayer(Pairs.against([hand.links_by_name[link].body for link in links], obj), ContactKinematics())
    kinematics = Kinematics(hand, links)
    T, q = poses(4, seed=3), random_q(hand, 4, seed=4)
    rng = np.random.default_rng(5)
    weight_pose, weight_distance = (
        torch.from_numpy(rng.normal(size=s)) for s in ((4, len(links), 4, 4), (4, len(links)))
    )
    T_object = torch.eye(4, dtype=torch.float64).expand(4, len(links), 4, 4)

    def loss(T_root: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
        T_link = kinematics(T_root, joints)
        distance = layer(T_link, T_object).distance
        return (T_link * weight_pose).sum((1, 2, 3)) + 10 * (distance * weight_distance).sum(1)

    T_root, joints = torch.from_numpy(T).requires_grad_(), torch.from_numpy(q).requires_grad_()
    loss(T_root, joints).sum().backward()
    twist = body_gradient(T, T_root.grad.numpy()) * [1, 1, 1, 2, 2, 2]
    found = np.concatenate([twist, joints.grad.numpy()], axis=1)
    h = 1e-6
    for k in range(found.shape[1]):
        ends = []
        for step in (h, -h):
            move, turn = np.zeros((4, 6)), q.copy()
            if k < 6:
                move[:, k] = step
            else:
                turn[:, k - 6] += step
            ends.append(loss(torch.from_numpy(T @ exp_se3(move)), torch.from_numpy(turn)).detach().numpy())
        np.testing.assert_allclose(found[:, k], (ends[0] - ends[1]) / (2 * h), atol=1e-5)
