"""The judge of derivatives: right ones pass, and each way to be wrong is seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench
from grasp_refine_apps.bench.stability import cases
from grasp_refine_apps.bench.stability.bodies import make_pairs
from grasp_refine_apps.bench.stability.cases import Task
from grasp_refine_apps.bench.stability.derivative import Faults, derivative_cells, judged, method_of
from grasp_refine_apps.bench.stability.motion import Scene, forms_of, move, rigid_motion, sphere_motion
from grasp_refine_apps.bench.stability.poses import pose_samplers
from grasp_refine_apps.bench.stability.presets import derivatives_of
from grasp_refine_apps.bench.stability.rows import wrong

WAYS = tuple(derivatives_of(cases.METHODS, cases.NEIGHBORHOODS, cases.DTYPES))
NAMES = ("failed", "not_finite", "unbounded", "wrong_sign", "unscaled")

Pull = tuple[np.ndarray, np.ndarray]


@cache
def scene(kind: cases.Kind = "ball", state: cases.State = "near", diagonal: float = 1e-3, pair: int = 0) -> Scene:
    """Some bodies in one state, at four poses."""
    poser = pose_samplers(make_pairs(kind, diagonal, 0), Task(kind, diagonal, (state,)))[pair]
    return Scene.of(poser.a, poser.b, poser.pose(state, 4), 0)


def counts(faults: Faults) -> dict[str, int]:
    return {name: int(getattr(faults, name).sum()) for name in NAMES}


@pytest.mark.parametrize("kind", ["ball", "needle"])
def test_no_derivative_is_wrong(kind: cases.Kind) -> None:
    """Of some kinds and states; the whole matrix is that of `bench stability`."""
    states = ("far", "gap-1e-12", "face-face", "deep")
    cells = list(derivative_cells(Task(kind, 1e-3, states, derivatives=WAYS, differentiated=2)))
    assert len(cells) == len(WAYS) * (3 if kind == "ball" else 4)
    assert [cell for cell in cells if wrong(cell.row())] == []
    assert {cell.queries for cell in cells} == {2}
    assert all(cell.measure == "derivative" and cell.derivative_error_max < 1.0 for cell in cells)


# each way to be wrong


@dataclass(frozen=True)
class Spoiled:
    """Contact kinematics, spoiled."""

    spoil: Callable[[Pull, Pull], Pull]
    """From what it found and a force on the point of body a, both reversed on body b, with its length in metres."""

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> Pull:
        found = ContactKinematics().pull_back(scene, force_a, force_b, force_n)
        slip = wrench(scene.witness.point_a, force_a)
        return self.spoil(found, (slip, slip * scene.length[0]))


def with_nan(found: Pull, slip: Pull) -> Pull:
    found[0][1, 0, 2] = np.nan
    return found


SPOILS = {
    "not_finite": with_nan,
    "unbounded": lambda found, slip: (found[0] - 1e12 * slip[0], found[1] + 1e12 * slip[0]),
    # When they move together, points are left behind.
    "wrong_sign": lambda found, slip: (0.9 * found[0], 0.9 * found[1]),
    # As if a slip without unit were a length.
    "unscaled": lambda found, slip: (found[0] - slip[1], found[1] + slip[1]),
}


@pytest.mark.parametrize("kind", ["ball", "box"])
@pytest.mark.parametrize("name", SPOILS)
def test_what_is_wrong_is_counted(name: str, kind: cases.Kind) -> None:
    way = cases.Derivative("contact-kinematics")
    assert counts(judged(scene(kind), way)) == dict.fromkeys(NAMES, 0)
    found = counts(judged(scene(kind), way, Spoiled(SPOILS[name])))
    assert found[name] > 0
    if name == "unscaled":
        assert found == {**dict.fromkeys(NAMES, 0), "unscaled": 4}


@pytest.mark.parametrize("pair", [0, 1])
@pytest.mark.parametrize("state", ["near", "gap-1e-6"])
def test_points_of_spheres_that_do_not_slip_at_all_are_seen(state: cases.State, pair: int) -> None:
    """Of polytopes they are not: there, no slip may be the true one."""
    one = scene("ball", state, pair=pair)
    # A gap of 1e-6 diagonals is not told from none in single precision.
    for way in (way for way in WAYS if state == "near" or way.dtype == "float64"):
        assert counts(judged(one, way, Rigid())) == {**dict.fromkeys(NAMES, 0), "wrong_sign": 4}
        assert counts(judged(one, way)) == dict.fromkeys(NAMES, 0)
    assert counts(judged(scene("box", "near"), cases.Derivative(), Rigid())) == dict.fromkeys(NAMES, 0)


@pytest.mark.parametrize("method", ["analytical", "finite-difference"])
@pytest.mark.parametrize("state", ["far", "near", "gap-1e-6", "gap-1um"])
def test_exact_methods_have_to_slip_by_as_much_as_spheres(method: cases.Method, state: cases.State) -> None:
    """A slip too long by 1 in 1000 is right for a method that estimates curvatures, and wrong for one that is exact."""

    @dataclass(frozen=True)
    class TooFar:
        def pull_back(self, scene: WitnessScene, *forces: np.ndarray | None) -> Pull:
            way = method_of(cases.Derivative(method, None))
            pairs = zip(way.pull_back(scene, *forces), Rigid().pull_back(scene, *forces), strict=True)
            first, second = (rigid + 1.001 * (found - rigid) for found, rigid in pairs)
            return first, second

    exact, other = cases.Derivative(method, None), cases.Derivative("contact-kinematics")
    assert counts(judged(scene("ball", state), exact)) == dict.fromkeys(NAMES, 0)
    assert counts(judged(scene("ball", state), exact, TooFar())) == {**dict.fromkeys(NAMES, 0), "wrong_sign": 4}
    assert counts(judged(scene("ball", state), other, TooFar())) == dict.fromkeys(NAMES, 0)


# what it is judged by


def test_the_motion_without_slip_is_that_of_rigid_points() -> None:
    one = scene("box")
    asked = one.posed.T_a, one.posed.T_b, one.targets, forms_of(one), torch.float64
    found = move(one.pairs, Rigid(), *asked)
    np.testing.assert_allclose(rigid_motion(found), found.covectors, atol=1e-12)


def test_the_derivatives_of_spheres_are_as_in_their_points() -> None:
    one = scene("ball")
    D, step = one.diagonal, 1e-6
    expected = np.empty((4, 2, 9, 6))

    def answer(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        w = query(one.pairs, T_a[:, None], T_b[:, None])
        return np.concatenate([w.point_a / D, w.point_b / D, w.normal], axis=-1)[:, 0]

    w = query(one.pairs, one.posed.T_a[:, None], one.posed.T_b[:, None])
    for side, point in enumerate((w.point_a[:, 0], w.point_b[:, 0])):
        for k in range(6):
            moved = []
            for sign in (1.0, -1.0):
                poses = [one.posed.T_a.copy(), one.posed.T_b.copy()]
                T = poses[side]
                twist = sign * step * np.eye(6)[k]
                T[:, :3, 3] -= point
                T[:] = exp_se3(twist * np.array([0, 0, 0, 1, 1, 1])) @ T
                T[:, :3, 3] += point + D * twist[:3]
                moved.append(answer(*poses))
            expected[:, side, :, k] = (moved[0] - moved[1]) / (2.0 * step)
    np.testing.assert_allclose(sphere_motion(one), expected, atol=1e-8)
    # And what goes through the layer comes out in the same units.
    posed = one.posed
    found = move(one.pairs, Analytical(), posed.T_a, posed.T_b, one.targets, np.eye(9), torch.float64)
    np.testing.assert_allclose(found.covectors[:, :, :6], sphere_motion(one)[:, :, :6], atol=1e-9)
    found = move(one.pairs, FiniteDifference(1e-4), posed.T_a, posed.T_b, one.targets, np.eye(9), torch.float64)
    np.testing.assert_allclose(found.covectors, sphere_motion(one), atol=1e-6)
