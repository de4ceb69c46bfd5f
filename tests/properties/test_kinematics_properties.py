"""Forward kinematics of made-up hands, and how links follow the joints: the product of exponentials, written anew."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_twists import DTYPES, Long, angles, axes, exact_exp
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics

FEWER = settings(max_examples=max(6, settings().max_examples // 5))

BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
LIMIT = '<limit lower="-4" upper="4" effort="3" velocity="1"/>'


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a made-up hand; its child is the link of the next number."""

    parent: int
    kind: str
    axis: np.ndarray
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    mimic: tuple[int, float, float] | None
    """Which earlier joint it follows, by what factor, with what offset."""


@dataclass(frozen=True, eq=False)
class Made:
    """A hand of links 0 to len(joints) as a URDF, and its kinematics in extended precision."""

    joints: list[Joint]

    @cached_property
    def hand(self) -> Hand:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "made.urdf"
            path.write_text(self.urdf)
            return load_hand(path, base_link="l0", candidates=16)

    @property
    def urdf(self) -> str:
        def numbers(values: object) -> str:
            return " ".join(repr(float(value)) for value in values)

        links = "".join(f'<link name="l{k}">{BALL}</link>' for k in range(len(self.joints) + 1))
        joints = "".join(
            f'<joint name="j{k}" type="{j.kind}"><parent link="l{j.parent}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{numbers(j.xyz)}" rpy="{numbers(j.rpy)}"/><axis xyz="{numbers(j.axis)}"/>'
            + (f'<mimic joint="j{j.mimic[0]}" multiplier="{j.mimic[1]!r}" offset="{j.mimic[2]!r}"/>' if j.mimic else "")
            + f"{LIMIT}</joint>"
            for k, j in enumerate(self.joints)
        )
        return f'<robot name="made">{links}{joints}</robot>'

    @property
    def free(self) -> list[int]:
        """The independent joints."""
        return [k for k, joint in enumerate(self.joints) if joint.kind != "fixed" and joint.mimic is None]

    def values(self, q: dict[str, Long]) -> list[Long]:
        """The value of every joint, by number."""
        found: list[Long] = []
        for k, joint in enumerate(self.joints):
            if joint.mimic is None:
                found.append(q.get(f"j{k}", Long(0)))
            else:
                leader, factor, offset = joint.mimic
                found.append(Long(factor) * found[leader] + Long(offset))
        return found

    def poses(self, T_root: np.ndarray, q: dict[str, Long]) -> np.ndarray:
        """T_world_link (links, 4, 4): the product of what each joint does."""
        T = [T_root.astype(Long)]
        for joint, value in zip(self.joints, self.values(q), strict=True):
            axis, nothing = joint.axis.astype(Long) / np.linalg.norm(joint.axis.astype(Long)), np.zeros(3)
            parts = {"fixed": (nothing, nothing), "prismatic": (value * axis, nothing)}
            does = exact_exp(np.concatenate(parts.get(joint.kind, (nothing, value * axis))))
            origin = exact_exp(np.array([*joint.xyz, 0, 0, 0]))
            for k in (2, 1, 0):  # roll, then pitch, then yaw about the fixed axes
                origin = origin @ exact_exp(np.concatenate([nothing, joint.rpy[k] * np.eye(3)[k]]))
            T.append(T[joint.parent] @ origin @ does)
        return np.array(T)


small = st.floats(-0.2, 0.2)
turns = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, 0.3, -1.2])


@st.composite
def made_hands(draw: st.DrawFn) -> Made:
    """Trees of up to seven joints: hinges, slides, wheels, fixed ones, and some that follow others."""
    joints: list[Joint] = []
    for k in range(draw(st.integers(1, 7))):
        kind = draw(st.sampled_from(["revolute", "revolute", "prismatic", "continuous", "fixed"]))
        leaders = [i for i, joint in enumerate(joints) if joint.kind in ("revolute", "prismatic")]
        mimic = None
        if kind in ("revolute", "prismatic") and leaders and draw(st.booleans()):
            mimic = (draw(st.sampled_from(leaders)), draw(st.sampled_from([-2.0, -1.0, 0.5, 0.0])), draw(small))
        length = draw(st.sampled_from([1.0, 1.0, 3.0]))  # URDF axes need not be unit vectors
        origin = draw(st.tuples(small, small, small)), draw(st.tuples(turns, turns, turns))
        joints.append(Joint(draw(st.integers(0, k)), kind, length * draw(axes()), *origin, mimic))
    if all(joint.kind == "fixed" for joint in joints):
        joints[-1] = Joint(joints[-1].parent, "revolute", joints[-1].axis, joints[-1].xyz, joints[-1].rpy, None)
    return Made(joints)


@st.composite
def roots(draw: st.DrawFn) -> np.ndarray:
    """Poses (4, 4) of the root, up to a kilometre away."""
    place = draw(st.sampled_from([0.0, 0.3, 1e3])) * draw(axes())
    return exact_exp(np.concatenate([place, draw(angles()) * draw(axes())])).astype(np.float64)


def drawn_values(made: Made, seed: int) -> np.ndarray:
    """Joint values (n,), some of them whole quarter turns or nothing."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3.0, 3.0, len(made.hand.joint_names))
    return np.where(rng.random(len(q)) < 0.3, np.round(q) * np.pi / 4, q)


def expected_poses(made: Made, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    return made.poses(T, {name: Long(value) for name, value in zip(made.hand.joint_names, q, strict=True)})


def reach(made: Made, T: np.ndarray) -> float:
    """A length that no link's distance from the world's origin exceeds much, in metres."""
    return 1.0 + np.abs(T[:3, 3]).max() + 4.0 * len(made.joints)


seeds = st.integers(0, 2**32 - 1)


@FEWER
@given(made_hands(), roots(), seeds)
def test_links_are_where_the_product_of_exponentials_is(made: Made, T: np.ndarray, seed: int) -> None:
    """Both kinematics, as NumPy arrays and as tensors, in double and in single precision."""
    assert sorted(made.hand.joint_names) == sorted(f"j{k}" for k in made.free)
    q = drawn_values(made, seed)
    links = [f"l{k}" for k in range(len(made.joints) + 1)]
    chain = Chain(made.hand, links)
    for dtype in DTYPES:
        T_d, q_d = T.astype(dtype), q.astype(dtype)
        exact = expected_poses(made, T_d, q_d)
        tensors = torch.from_numpy(T_d)[None], torch.from_numpy(q_d)[None]
        for found in (
            chain(T_d[None], q_d[None]).T_world_link,
            chain(*tensors).T_world_link.numpy(),
            Kinematics(made.hand, links, dtype=getattr(torch, dtype))(*tensors).numpy(),
        ):
            assert found.dtype == dtype
            away, eps = np.abs(found[0] - exact), 20 * float(np.finfo(dtype).eps)
            assert away[:, :3, :3].max() < eps * (1 + len(made.joints))
            assert away[:, :3, 3].max() < eps * reach(made, T)


@FEWER
@given(made_hands(), roots(), seeds)
def test_the_jacobian_is_the_derivative_of_the_product(made: Made, T: np.ndarray, seed: int) -> None:
    """Central differences in extended precision, of points on links, in root twist and joints."""
    q, rng = drawn_values(made, seed), np.random.default_rng(seed + 1)
    links = [f"l{k}" for k in range(len(made.joints) + 1)]
    chain = Chain(made.hand, links)
    frames = chain(T[None], q[None])
    count, n = len(links), len(q)
    point, force = rng.uniform(-0.1, 0.1, (count, 3)), rng.normal(size=(count, 3))
    world = np.einsum("lij,lj->li", frames.T_world_link[0, :, :3, :3], point) + frames.T_world_link[0, :, :3, 3]
    covector = np.concatenate([force, np.cross(world, force)], axis=1)[None]
    found = chain.to_joint_space(frames, covector, np.arange(count))[0]
    h = Long(1e-6)

    def value(step: np.ndarray) -> np.ndarray:
        turned = exact_exp(np.concatenate([np.zeros(3), step[3:6]]))[:3, :3]
        root = T.astype(Long)
        root[:3, :3], root[:3, 3] = turned @ root[:3, :3], root[:3, 3] + step[:3]
        names = zip(made.hand.joint_names, q + step[6:], strict=True)
        poses = made.poses(root, dict(names))
        return np.einsum("lij,lj,li->l", poses[:, :3, :3], point, force) + (poses[:, :3, 3] * force).sum(axis=1)

    for k, unit in enumerate(np.eye(6 + n, dtype=Long)):
        slope = (value(h * unit) - value(-h * unit)) / (2 * h)
        np.testing.assert_allclose(found[:, k], slope.astype(float), rtol=0, atol=1e-9 + 1e-13 * reach(made, T) * 10)


@FEWER
@given(made_hands(), roots(), seeds)
def test_gradients_of_poses_are_as_in_the_jacobian(made: Made, T: np.ndarray, seed: int) -> None:
    """Autograd through `Kinematics` against the geometric Jacobian of `Chain`, for a covector on every link."""
    q, rng = drawn_values(made, seed), np.random.default_rng(seed + 2)
    links = [f"l{k}" for k in range(len(made.joints) + 1)]
    chain = Chain(made.hand, links)
    frames = chain(T[None], q[None])
    point, force = rng.uniform(-0.1, 0.1, (len(links), 3)), rng.normal(size=(len(links), 3))
    tensor = torch.from_numpy(q)[None].requires_grad_()
    poses = Kinematics(made.hand, links)(torch.from_numpy(T)[None], tensor)[0]
    world = torch.einsum("lij,lj->li", poses[:, :3, :3], torch.from_numpy(point)) + poses[:, :3, 3]
    (gradient,) = torch.autograd.grad((world * torch.from_numpy(force)).sum(), tensor)
    world = world.detach().numpy()
    covector = np.concatenate([force, np.cross(world, force)], axis=1)[None]
    pulled = chain.to_joint_space(frames, covector, np.arange(len(links)))[0, :, 6:].sum(axis=0)
    np.testing.assert_allclose(gradient[0].numpy(), pulled, rtol=0, atol=1e-12 * reach(made, T))


@given(roots(), axes(), angles(), st.sampled_from(DTYPES))
def test_steps_of_the_root_turn_it_about_its_own_origin(
    T: np.ndarray, axis: np.ndarray, angle: float, dtype: str
) -> None:
    """R <- exp(w) R and p <- p + v: rotations stay rotations to the last digits, however many steps."""
    dx = np.concatenate([0.1 * axis[::-1], angle * axis]).astype(dtype)
    T = T.astype(dtype)
    found, eps = integrate(T, dx), float(np.finfo(dtype).eps)
    exact = exact_exp(np.concatenate([np.zeros(3), dx[3:]]))[:3, :3] @ T[:3, :3].astype(Long)
    assert found.dtype == dtype and np.abs(found[:3, :3] - exact).max() < 12 * eps
    np.testing.assert_array_equal(found[:3, 3], T[:3, 3] + dx[:3])
    for _ in range(30):
        found = integrate(found, dx)
    R = found[:3, :3].astype(Long)
    assert np.abs(R.T @ R - np.eye(3)).max() < 6 * eps
