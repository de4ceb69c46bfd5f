"""Forward kinematics, ours and that for autograd: against yourdfpy, finite differences and each other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yourdfpy

from grasp_refine.collision.engine import VARIABLE, engines
from grasp_refine.core.array_records import take
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import exp_se3, inverse, transform_points
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, Mimic, load_hand
from grasp_refine.hands.kinematics import Kinematics
from made_hands import BALL, joint, link, links, made_hand, slide
from refusals import refused

WIDE = {"limits": (-1, 2), "effort": 3}

MIMIC = (
    links("base", "arm", "wheel", "hook", "left", "right"),
    link("tip", BALL) + link("frame"),
    joint(
        *("tip_turn", "left", "tip"),
        **WIDE, at="0.02 0 0.01", rpy="0.3 -0.2 0.9", axis="1 1 0", follow=("right_slide", -3, 0.2),
    ),
    joint("lift", "base", "arm", at="0 0.1 0", rpy="0.1 0.2 0.3", axis="0 3 4", **WIDE),
    slide("left_slide", "arm", "left", at="0 0.03 0", rpy="0 0.4 0", axis="0 1 0", **WIDE),
    slide("right_slide", "arm", "right", at="0 -0.03 0", axis="1 -2 0", follow=("left_slide", 0.5, 0.01), **WIDE),
    joint("end", "tip", "frame", "fixed", at="0 0 0.05", rpy="1 0 0"),
    joint("spin", "base", "wheel", "continuous", at="0.05 0 0", axis="0 0 -1"),
    joint("catch", "wheel", "hook", at="0 0.05 0.01", axis="1 0 0", **WIDE),
)  # fmt: skip
"""A slide that follows a slide, and a hinge that follows the follower; two joints of a level have the same parent."""


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return made_hand(tmp_path_factory.mktemp("gripper"), *MIMIC, name="gripper")


@pytest.fixture(scope="module")
def curved(gripper: Hand) -> Hand:
    """The gripper, with followers of two joints on curves."""
    bent = {"right_slide": Mimic("left_slide", 0.5, 0.01, (0.3, -0.2)), "tip_turn": Mimic("lift", -0.7, 0.1, (0.4,))}
    joints = tuple(replace(joint, mimic=bent.get(joint.name, joint.mimic)) for joint in gripper.joints)
    return replace(gripper, joints=joints)


@pytest.fixture(scope="module")
def allegro() -> Hand:
    return load_hand("allegro", candidates=64)


@pytest.fixture(scope="module")
def shadow(shared_assets: Path) -> Hand:
    return load_hand(shared_assets / "hands/shadow/shadow_right.urdf", base_link="forearm", candidates=64)


@pytest.fixture(params=["gripper", "allegro", "shadow"])
def hand(request: pytest.FixtureRequest) -> Hand:
    return request.getfixturevalue(request.param)


def configurations(hand: Hand, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random root poses (count, 4, 4) and joint values (count, n)."""
    rng = np.random.default_rng(seed)
    T = exp_se3(rng.normal(size=(count, 6)) * [0.1, 0.1, 0.1, 1, 1, 1])
    return T, rng.uniform(np.maximum(hand.lower, -3.0), np.minimum(hand.upper, 3.0), (count, len(hand.lower)))


def all_links(hand: Hand) -> list[str]:
    return [link.name for link in hand.links]


def by_chain(hand: Hand, links: list[str], T: np.ndarray, q: np.ndarray) -> np.ndarray:
    return Chain(hand, links)(T, q).T_world_link


def by_torch(hand: Hand, links: list[str], T: np.ndarray, q: np.ndarray) -> np.ndarray:
    return Kinematics(hand, links)(torch.from_numpy(T), torch.from_numpy(q)).numpy()


SHARED = ("allegro/allegro_right", "leap/leap_right", "shadow/shadow_right", "barrett/barrett", "robotiq3f/robotiq3f")
"""URDFs of the shared assets; the joint order of pytorch-kinematics is not the file's for leap and robotiq3f."""


@pytest.mark.parametrize("name", [*SHARED, "ours"])
def test_link_poses_are_as_in_yourdfpy_in_the_order_of_the_links(name: str, request: pytest.FixtureRequest) -> None:
    source = "allegro" if name == "ours" else request.getfixturevalue("shared_assets") / f"hands/{name}.urdf"
    hand = load_hand(source, candidates=16)
    T, q = configurations(hand, 4, seed=0)
    links = np.random.default_rng(2).permutation(all_links(hand)).tolist()
    robot = yourdfpy.URDF.load(str(hand.urdf), load_meshes=False, load_collision_meshes=False, build_scene_graph=True)
    expected = []
    for T_root, values in zip(T, q, strict=True):
        robot.update_cfg(dict(zip(hand.joint_names, values, strict=True)))
        expected.append([T_root @ robot.get_transform(link, hand.base_link) for link in links])
    for found in (by_chain(hand, links, T, q), by_torch(hand, links, T, q)):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_subtree_is_posed_by_its_own_base(shadow: Hand) -> None:
    palm = load_hand(shadow.urdf, base_link="palm", candidates=64)
    assert len(palm.joint_names) == len(shadow.joint_names) - 2
    T, q = configurations(palm, 3, seed=3)
    whole = np.zeros((3, len(shadow.joint_names)))
    whole[:, [shadow.joint_names.index(name) for name in palm.joint_names]] = q
    tips = [contact.link for contact in palm.contacts]
    T_palm, *T_tips = by_chain(shadow, ["palm", *tips], T, whole).swapaxes(0, 1)
    np.testing.assert_allclose(by_chain(palm, tips, T_palm, q).swapaxes(0, 1), T_tips, atol=1e-12)


def test_joints_that_move_none_of_the_links_are_left_out(gripper: Hand) -> None:
    T, q = configurations(gripper, 3, seed=1)
    chain = Chain(gripper, ["frame", "arm"])
    frames = chain(T, q)
    assert chain.dof == 4 and chain.links == ("frame", "arm")
    assert chain.joints == ("lift", "left_slide", "tip_turn")
    assert frames.axes.shape == (3, 6, 6 + 3)
    np.testing.assert_allclose(frames.T_world_link, by_torch(gripper, ["frame", "arm"], T, q), atol=1e-12)


@pytest.mark.parametrize("kinematics", [Chain, Kinematics])
def test_unknown_links_are_refused_with_the_ones_that_exist(allegro: Hand, kinematics: type) -> None:
    with refused(HandError, "allegro", "knee", "base_link, ", "link_3.0_tip"):
        kinematics(allegro, ["base_link", "knee"])


@pytest.mark.parametrize("relative", [False, True], ids=["one link", "two links"])
@pytest.mark.parametrize("name", ["gripper", "curved", "allegro", "shadow"])
def test_pulled_wrenches_are_the_slopes_of_their_work(
    name: str, relative: bool, request: pytest.FixtureRequest
) -> None:
    hand = request.getfixturevalue(name)
    chain = Chain(hand, all_links(hand))
    T, q = configurations(hand, 3, seed=5)
    rng = np.random.default_rng(6)
    rows = 2 * len(chain.links)
    link, minus = rng.permutation(rows) % len(chain.links), rng.integers(len(chain.links), size=rows)
    force, point = rng.normal(size=(3, rows, 3)), rng.normal(size=(3, rows, 3)) * 0.1
    frames = chain(T, q)
    on_link = transform_points(inverse(frames.T_world_link[:, link]), point)
    on_minus = transform_points(inverse(frames.T_world_link[:, minus]), point)

    def work(T: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Each constant force times the place of its point of the link, less that of the same point of `minus`."""
        poses = chain(T, q).T_world_link
        path = transform_points(poses[:, link], on_link)
        if relative:
            path = path - transform_points(poses[:, minus], on_minus)
        return (force * path).sum(axis=-1)

    h = 1e-6
    root, joints = np.split(h * np.eye(6 + chain.dof), [6], axis=1)
    slopes = [
        (work(integrate(T, np.tile(r, (3, 1))), q + j) - work(integrate(T, np.tile(-r, (3, 1))), q - j)) / (2 * h)
        for r, j in zip(root, joints, strict=True)
    ]
    wrench = np.concatenate([force, np.cross(point, force)], axis=-1)
    pulled = chain.to_joint_space(frames, wrench, link, minus if relative else None)
    np.testing.assert_allclose(pulled, np.moveaxis(slopes, 0, -1), atol=2e-9)


def test_joints_are_pulled_as_what_they_carry(hand: Hand) -> None:
    """Places after those of the links: a joint's own point, which a link that hangs from it carries too."""
    chain = Chain(hand, all_links(hand))
    T, q = configurations(hand, 2, seed=10)
    frames, links = chain(T, q), len(chain.links)
    child = [chain.links.index(hand.joints_by_name[name].child) for name in chain.joints]
    covector = np.random.default_rng(11).normal(size=(2, len(child), 6))
    by_joints = chain.to_joint_space(frames, covector, links + np.arange(len(child)))
    np.testing.assert_array_equal(by_joints, chain.to_joint_space(frames, covector, np.array(child)))
    # The twist of one relative to the other is none.
    relative = chain.to_joint_space(frames, covector, links + np.arange(len(child)), np.array(child))
    assert not relative.any()


def test_axes_move_as_what_their_joints_carry(hand: Hand) -> None:
    """An axis (v, w) of a joint that moves by the spatial twist V changes by V x (v, w), the Lie bracket."""
    chain = Chain(hand, all_links(hand))
    T, q = configurations(hand, 1, seed=12)
    frames, links, m = chain(T, q), len(chain.links), len(chain.joints)
    eye = np.tile(np.eye(6), (m, 1))[None]
    twist = chain.to_joint_space(frames, eye, links + np.repeat(np.arange(m), 6)).reshape(m, 6, -1)
    v, w = frames.axes[0, :3, 6:].T, frames.axes[0, 3:, 6:].T
    V, W = twist[:, :3], twist[:, 3:]
    bracket = [
        np.cross(W, v[..., None], axis=1) + np.cross(V, w[..., None], axis=1),
        np.cross(W, w[..., None], axis=1),
    ]
    expected, h = np.concatenate(bracket, axis=1), 1e-6
    for k in range(6 + chain.dof):
        dx = h * np.eye(6 + chain.dof)[k]
        ahead, behind = (chain(integrate(T, s * dx[None, :6]), q + s * dx[6:]).axes[0, :, 6:].T for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * h), expected[..., k], atol=1e-8)


def test_torch_and_numpy_agree(hand: Hand) -> None:
    chain = Chain(hand, all_links(hand))
    T, q = configurations(hand, 4, seed=7)
    rng = np.random.default_rng(8)
    link, minus = rng.integers(len(chain.links), size=(2, 9))
    covector, dx = rng.normal(size=(4, 9, 6)), rng.normal(size=(4, 6))
    expected, at = chain(T, q), integrate(T, dx)
    for dtype, tolerance in ((torch.float64, 1e-13), (torch.float32, 1e-5)):
        T_t, q_t, covector_t, dx_t = (torch.from_numpy(a).to(dtype) for a in (T, q, covector, dx))
        frames = chain(T_t, q_t)
        for found, wanted in (
            (frames.T_world_link, expected.T_world_link),
            (frames.axes, expected.axes),
            (chain.to_joint_space(frames, covector_t, link), chain.to_joint_space(expected, covector, link)),
            (
                chain.to_joint_space(frames, covector_t, link, minus),
                chain.to_joint_space(expected, covector, link, minus),
            ),
            (integrate(T_t, dx_t), at),
        ):
            assert found.dtype == dtype
            np.testing.assert_allclose(found.numpy(), wanted, atol=tolerance)


# gradients by autograd


@pytest.mark.parametrize("which", ["gripper", "curved", "allegro"])
def test_both_engines_have_the_same_kinematics(
    which: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "native" not in engines():
        pytest.skip("the compiled engine is not built")
    hand = request.getfixturevalue(which)
    chain, rng, count = Chain(hand, [link.name for link in hand.links]), np.random.default_rng(0), 4
    T, q = exp_se3(rng.normal(size=(count, 6))), rng.normal(size=(count, len(hand.joint_names)))
    covector, link = rng.normal(size=(count, 7, 6)), rng.integers(0, len(hand.links), (count, 7))
    found = []
    for engine in ("native", "python"):
        monkeypatch.setenv(VARIABLE, engine)
        frames = chain(T, q)
        rows = [chain.to_joint_space(frames, covector, *of) for of in ((link[0],), (link[0], link[1]))]
        each = [chain.to_joint_space(take(frames, slice(k, k + 1)), covector[[k]], link[k]) for k in range(count)]
        if engine == "native":
            np.testing.assert_array_equal(chain.to_joint_space(frames, covector, link), np.concatenate(each))
        found.append((frames.T_world_link, frames.axes, *rows, *each))
    for native, python in zip(*found, strict=True):
        np.testing.assert_allclose(native, python, atol=1e-13)


@pytest.mark.usefixtures("engine")
def test_a_configuration_that_is_not_finite_has_no_pose_and_spoils_no_other(gripper: Hand) -> None:
    chain = Chain(gripper, [link.name for link in gripper.links])
    q = np.full((3, len(gripper.joint_names)), 0.1)
    T = np.tile(np.eye(4), (3, 1, 1))
    whole = chain(T, q).T_world_link
    q[1, 0] = np.nan
    with np.errstate(invalid="ignore"):
        frames = chain(T, q)
    # The links that hang from joints.
    assert np.isnan(frames.T_world_link[1, 1:]).any(axis=(1, 2)).all()
    np.testing.assert_array_equal(frames.T_world_link[[0, 2]], whole[[0, 2]])
