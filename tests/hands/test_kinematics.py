"""Forward kinematics against yourdfpy, and its derivatives against finite differences along twists."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import yourdfpy

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import exp_se3, inverse
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.distance import Distance
from refusals import refused
from shapes_for_tests import convex_body
from twists import gradient_along_twists

TIP = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="1"/>'

MIMIC = f"""<robot name="gripper">
  <link name="base">{TIP}</link><link name="arm">{TIP}</link><link name="left">{TIP}</link>
  <link name="right">{TIP}</link><link name="tip">{TIP}</link><link name="frame"/><link name="wheel">{TIP}</link>
  <joint name="tip_turn" type="revolute">
    <parent link="left"/><child link="tip"/><origin xyz="0.02 0 0.01" rpy="0.3 -0.2 0.9"/><axis xyz="1 1 0"/>
    <mimic joint="right_slide" multiplier="-3" offset="0.2"/>{LIMIT}
  </joint>
  <joint name="lift" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0.1 0" rpy="0.1 0.2 0.3"/><axis xyz="0 3 4"/>{LIMIT}
  </joint>
  <joint name="left_slide" type="prismatic">
    <parent link="arm"/><child link="left"/><origin xyz="0 0.03 0"/><axis xyz="0 1 0"/>{LIMIT}
  </joint>
  <joint name="right_slide" type="prismatic">
    <parent link="arm"/><child link="right"/><origin xyz="0 -0.03 0"/><axis xyz="0 -1 0"/>
    <mimic joint="left_slide" multiplier="0.5" offset="0.01"/>{LIMIT}
  </joint>
  <joint name="end" type="fixed"><parent link="tip"/><child link="frame"/><origin xyz="0 0 0.05" rpy="1 0 0"/></joint>
  <joint name="spin" type="continuous">
    <parent link="base"/><child link="wheel"/><origin xyz="0.05 0 0"/><axis xyz="0 0 1"/>
  </joint>
</robot>"""
"""A slide that follows a slide, and a hinge that follows the follower; the file names the last one first."""


@pytest.fixture
def gripper(tmp_path: Path) -> Hand:
    path = tmp_path / "gripper.urdf"
    path.write_text(MIMIC)
    return load_hand(path, candidates=64)


@pytest.fixture(scope="module")
def allegro() -> Hand:
    return load_hand("allegro", candidates=64)


@pytest.fixture(scope="module")
def shadow(shared_assets: Path) -> Hand:
    return load_hand(shared_assets / "hands/shadow/shadow_right.urdf", base_link="forearm", candidates=64)


HANDS = ("allegro", "shadow")


def configurations(hand: Hand, count: int, seed: int) -> np.ndarray:
    lower, upper = np.maximum(hand.lower, -3.0), np.minimum(hand.upper, 3.0)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def root_poses(count: int, seed: int) -> np.ndarray:
    return exp_se3(np.random.default_rng(seed).normal(size=(count, 6)) * [0.1, 0.1, 0.1, 1, 1, 1])


def forward(hand: Hand, links: list[str], T: np.ndarray, q: np.ndarray) -> np.ndarray:
    return Kinematics(hand, links)(torch.from_numpy(T), torch.from_numpy(q)).numpy()


def slopes(value: Callable[[np.ndarray, np.ndarray], np.ndarray], T: np.ndarray, q: np.ndarray, h: float) -> np.ndarray:
    """Central differences (6 + n, batch) of value(T, q) along the root's spatial twists and the joints."""
    ends = [[value(exp_se3(s * h * unit) @ T, q) for s in (1, -1)] for unit in np.eye(6)]
    ends += [[value(T, q + s * h * unit) for s in (1, -1)] for unit in np.eye(q.shape[1])]
    return np.array([(forth - back) / (2 * h) for forth, back in ends])


def all_links(hand: Hand) -> list[str]:
    return [link.name for link in hand.links]


# poses


def yourdfpy_poses(hand: Hand, q: np.ndarray) -> np.ndarray:
    robot = yourdfpy.URDF.load(str(hand.urdf), load_meshes=False, load_collision_meshes=False, build_scene_graph=True)
    poses = []
    for values in q:
        robot.update_cfg(dict(zip(hand.joint_names, values, strict=True)))
        poses.append([robot.get_transform(link, hand.base_link) for link in all_links(hand)])
    return np.array(poses)


SHARED = ("allegro/allegro_right", "leap/leap_right", "shadow/shadow_right", "barrett/barrett", "robotiq3f/robotiq3f")
"""URDFs of the shared assets; the joint order of pytorch-kinematics is not the file's for leap and robotiq3f."""


@pytest.mark.parametrize("name", [*SHARED, "ours"])
def test_link_poses_are_those_of_yourdfpy(name: str, request: pytest.FixtureRequest) -> None:
    if name == "ours":
        hand = request.getfixturevalue("allegro")
    else:
        hand = load_hand(request.getfixturevalue("shared_assets") / f"hands/{name}.urdf", candidates=16)
    q = configurations(hand, 4, seed=0)
    found = forward(hand, all_links(hand), np.tile(np.eye(4), (4, 1, 1)), q)
    np.testing.assert_allclose(found, yourdfpy_poses(hand, q), atol=1e-12)


def test_mimic_joints_have_the_values_that_they_follow(gripper: Hand, tmp_path: Path) -> None:
    # yourdfpy takes 0 for a joint that follows a follower, so it gets the same file without mimic joints.
    q = configurations(gripper, 4, seed=0)
    (tmp_path / "free").mkdir()
    (tmp_path / "free/free.urdf").write_text(re.sub("<mimic .*?/>", "", MIMIC))
    free = load_hand(tmp_path / "free/free.urdf", candidates=64)
    assert free.joint_names == ("tip_turn", "lift", "left_slide", "right_slide", "spin")
    lift, left, spin = q.T
    right = 0.5 * left + 0.01
    expected = yourdfpy_poses(free, np.stack([-3 * right + 0.2, lift, left, right, spin], axis=1))
    order = [all_links(free).index(name) for name in all_links(gripper)]
    found = forward(gripper, all_links(gripper), np.tile(np.eye(4), (4, 1, 1)), q)
    np.testing.assert_allclose(found, expected[:, order], atol=1e-12)


def test_the_root_pose_moves_all_links(allegro: Hand) -> None:
    q, T = configurations(allegro, 3, seed=1), root_poses(3, seed=1)
    at_rest = forward(allegro, all_links(allegro), np.tile(np.eye(4), (3, 1, 1)), q)
    np.testing.assert_allclose(forward(allegro, all_links(allegro), T, q), T[:, None] @ at_rest, atol=1e-14)


def test_links_come_in_the_order_in_which_they_were_asked_for(allegro: Hand) -> None:
    q, T = configurations(allegro, 2, seed=2), root_poses(2, seed=2)
    names = all_links(allegro)
    order = np.random.default_rng(2).permutation(len(names))
    mixed = forward(allegro, [names[i] for i in order], T, q)
    np.testing.assert_array_equal(mixed, forward(allegro, names, T, q)[:, order])
    base = forward(allegro, [allegro.base_link], T, q)
    np.testing.assert_array_equal(base[:, 0], T)


def test_a_subtree_is_posed_by_its_own_base(shadow: Hand) -> None:
    palm = load_hand(shadow.urdf, base_link="palm", candidates=64)
    assert len(palm.joint_names) == len(shadow.joint_names) - 2
    q = configurations(palm, 3, seed=3)
    whole = np.zeros((3, len(shadow.joint_names)))
    whole[:, [shadow.joint_names.index(name) for name in palm.joint_names]] = q
    tips = [contact.link for contact in palm.contacts]
    T_palm, *T_tips = forward(shadow, ["palm", *tips], root_poses(3, 3), whole).swapaxes(0, 1)
    np.testing.assert_allclose(
        forward(palm, tips, np.tile(np.eye(4), (3, 1, 1)), q).swapaxes(0, 1), inverse(T_palm) @ T_tips, atol=1e-12
    )


def test_unknown_links_are_refused_with_the_ones_that_exist(allegro: Hand) -> None:
    with refused(HandError, "allegro", "knee", "base_link, ", "link_3.0_tip"):
        Kinematics(allegro, ["base_link", "knee"])


def test_number_type_and_batch_size_follow_the_arguments(allegro: Hand) -> None:
    kinematics = Kinematics(allegro, ["link_3.0_tip"], dtype=torch.float32)
    for count in (0, 1, 5):
        T, q = root_poses(count, 4), configurations(allegro, count, 4)
        found = kinematics(torch.as_tensor(T).float(), torch.as_tensor(q).float())
        assert found.dtype == torch.float32 and found.shape == (count, 1, 4, 4)
        np.testing.assert_allclose(found.numpy(), forward(allegro, ["link_3.0_tip"], T, q), atol=1e-6)


# derivatives


def loss_gradient(
    loss: Callable[[torch.Tensor, torch.Tensor], torch.Tensor], T: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """Derivatives (6 + n, batch) of loss(T, q) (batch,) along the root's spatial twists and the joints."""
    T_root, joints = torch.from_numpy(T).requires_grad_(), torch.from_numpy(q).requires_grad_()
    loss(T_root, joints).sum().backward()
    return np.concatenate([gradient_along_twists(T_root.grad.numpy(), T), joints.grad.numpy().T])


@pytest.mark.parametrize("name", [*HANDS, "gripper"])
def test_the_pull_back_of_link_poses_is_exact(name: str, request: pytest.FixtureRequest) -> None:
    hand = request.getfixturevalue(name)
    kinematics = Kinematics(hand, all_links(hand))
    T, q = root_poses(3, seed=5), configurations(hand, 3, seed=5)
    weight = np.random.default_rng(5).normal(size=(len(hand.links), 3, 4))

    def value(T: np.ndarray, q: np.ndarray) -> np.ndarray:
        poses = kinematics(torch.from_numpy(T), torch.from_numpy(q)).numpy()
        return (poses[:, :, :3] * weight).sum((1, 2, 3))

    found = loss_gradient(lambda T, q: (kinematics(T, q)[:, :, :3] * torch.from_numpy(weight)).sum((1, 2, 3)), T, q)
    np.testing.assert_allclose(found, slopes(value, T, q, 1e-6), atol=1e-7)


@pytest.mark.parametrize("other", ["sphere", "hull"])
@pytest.mark.parametrize("name", HANDS)
def test_signed_distance_to_root_and_joints_end_to_end(name: str, other: str, request: pytest.FixtureRequest) -> None:
    hand = request.getfixturevalue(name)
    links = [contact.link for contact in hand.contacts]
    body = build_body("ball", [sphere(0.03)]) if other == "sphere" else convex_body(6)
    pairs = Pairs.against([hand.links_by_name[link].body for link in links], body)
    kinematics = Kinematics(hand, links)
    # Three configurations, each put where the first contact link is 4 mm deep and where it is 8 mm away.
    q = np.tile(configurations(hand, 3, seed=6), (2, 1))
    T = np.tile(root_poses(3, seed=6), (2, 1, 1))
    wanted = np.repeat([-0.004, 0.008], 3)
    T_object = np.broadcast_to(np.eye(4), (6, len(links), 4, 4))
    T[:, :3, 3] -= forward(hand, links, T, q)[:, 0, :3, 3] - 0.02
    for _ in range(12):
        found = query(pairs, forward(hand, links, T, q), T_object)
        T[:, :3, 3] -= (wanted - found.distance[:, 0])[:, None] * found.normal[:, 0]
    assert np.abs(query(pairs, forward(hand, links, T, q), T_object).distance[:, 0] - wanted).max() < 1e-6

    def distance(T: np.ndarray, q: np.ndarray) -> np.ndarray:
        return query(pairs, forward(hand, links, T, q), T_object).distance

    layer = WitnessLayer(pairs, Distance())
    weights = np.random.default_rng(7).uniform(1, 2, len(links))
    near, far = (slopes(distance, T, q, h) @ weights for h in (1e-6, 4e-6))
    found = loss_gradient(
        lambda T, q: layer(kinematics(T, q), torch.from_numpy(T_object.copy())).distance @ torch.from_numpy(weights),
        T,
        q,
    )
    # Where two step sizes disagree, a witness jumps from one feature to another within the step.
    smooth = np.abs(near - far).max(axis=0) < 1e-5
    assert smooth.sum() >= 4
    np.testing.assert_allclose(found[:, smooth], near[:, smooth], atol=1e-5)


def test_a_mimic_joint_adds_its_share_to_the_joint_it_follows(gripper: Hand) -> None:
    kinematics = Kinematics(gripper, ["left", "right"])
    q = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    arm = Kinematics(gripper, ["arm"])(torch.eye(4, dtype=torch.float64)[None], q.detach())[0, 0, :3, :3]
    T = kinematics(torch.eye(4, dtype=torch.float64)[None], q)
    # Both slides open: the distance of the fingers grows by 1 + 0.5.
    ((T[0, 0, :3, 3] - T[0, 1, :3, 3]) @ arm)[1].backward()
    np.testing.assert_allclose(q.grad.numpy(), [[0.0, 1.5, 0.0]], atol=1e-14)
