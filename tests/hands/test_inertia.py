"""Inertias: closed forms of solid shapes, and what is done about impossible ones."""

import mujoco
import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, quaternion_from_matrix
from grasp_refine.geometry.pieces import box, capsule, sphere
from grasp_refine.hands.files.inertia import Inertia

TURN = exp_so3(np.array([0.3, -0.8, 0.5]))
T = np.block([[TURN, np.array([[0.1], [0.2], [-0.3]])], [np.zeros((1, 3)), np.ones((1, 1))]])


def test_a_box_and_a_ball_have_the_moments_of_the_textbook() -> None:
    a, b, c = 0.02, 0.03, 0.05
    solid = Inertia.of([box([a, b, c], T)], 500.0)
    mass = 500.0 * a * b * c
    expected = mass / 12 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    assert solid.mass == pytest.approx(mass)
    np.testing.assert_allclose(solid.centre, T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(solid.matrix, TURN @ expected @ TURN.T, atol=1e-12 * mass)
    ball = Inertia.of([sphere(0.02, [1, 2, 3])])
    assert ball.mass == pytest.approx(1000 * 4 / 3 * np.pi * 0.02**3)
    np.testing.assert_allclose(ball.matrix, 0.4 * ball.mass * 0.02**2 * np.eye(3))
    np.testing.assert_array_equal(ball.centre, [1, 2, 3])


def test_a_capsule_is_what_its_fine_mesh_is() -> None:
    piece = capsule(0.01, [0.01, 0, 0], [0.01, 0.03, 0.02])
    mesh = piece.mesh()
    mesh.density = 1000.0
    ours = Inertia.of([piece])
    assert ours.mass == pytest.approx(mesh.mass, rel=0.02)
    np.testing.assert_allclose(ours.centre, mesh.center_mass, atol=1e-9)
    np.testing.assert_allclose(ours.matrix, mesh.moment_inertia, atol=0.03 * mesh.moment_inertia.max())


def test_parts_add_up() -> None:
    whole = Inertia.of([box([0.02, 0.02, 0.06])])
    halves = [box([0.02, 0.02, 0.03], np.array(T0)) for T0 in (shifted(0.015), shifted(-0.015))]
    joined = Inertia.of(halves)
    assert joined.mass == pytest.approx(whole.mass)
    np.testing.assert_allclose(joined.matrix, whole.matrix, atol=1e-15)
    np.testing.assert_allclose(joined.centre, 0, atol=1e-15)


def shifted(z: float) -> np.ndarray:
    moved = np.eye(4)
    moved[2, 3] = z
    return moved


def test_moments_are_given_in_a_frame_of_their_own() -> None:
    moments = np.diag([1.0, 2.0, 2.5])
    inertia = Inertia.about(2.0, T, moments)
    np.testing.assert_allclose(inertia.matrix, TURN @ moments @ TURN.T)
    np.testing.assert_array_equal(inertia.centre, T[:3, 3])
    values, axes = inertia.principal()
    np.testing.assert_allclose(values, [1, 2, 2.5])
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes @ np.diag(values) @ axes.T, inertia.matrix, atol=1e-14)


@pytest.mark.parametrize(
    ("moments", "possible", "balanced"),
    [
        ([2, 2, 3], True, [2, 2, 3]),
        ([1, 1, 2], True, [1, 1, 2]),
        ([1, 2, 7], False, [3, 4, 7]),
        ([1, 6, 7.000001], True, [1.0000005, 6.0000005, 7.000001]),
    ],
)
def test_impossible_moments_are_raised_to_the_bound(moments: list, possible: bool, balanced: list) -> None:
    inertia = Inertia.about(1.0, T, np.diag(np.array(moments, dtype=float)))
    assert inertia.positive() and inertia.possible() == possible
    values, _ = inertia.balanced().principal()
    np.testing.assert_allclose(values, balanced, rtol=1e-8)
    assert values[0] + values[1] > values[2]


def test_what_is_no_inertia() -> None:
    for mass, moments in ((0.0, [1, 1, 1]), (1.0, [0, 1, 1]), (1.0, [-1, 1, 1]), (1.0, [1e-20, 1e-20, 1e-20])):
        assert not Inertia.about(mass, T, np.diag(np.array(moments, dtype=float))).positive()


@pytest.mark.parametrize("moments", [[1.1e-15, 1.2e-15, 1.3e-15], [2e-15, 1e-6, 1e-6], [1e-14, 1e-14, 1e-14]])
def test_what_mujoco_accepts_is_left_alone(moments: list[float]) -> None:
    inertia = Inertia.about(1e-3, T, np.diag(moments))
    assert inertia.positive()
    np.testing.assert_allclose(inertia.balanced().principal()[0], moments, rtol=1e-6)
    assert _compiles(inertia.balanced())


@pytest.mark.parametrize(("mass", "moment"), [(1e-3, 1e-16), (1e-17, 1e-18), (1e-17, 1e-6)])
def test_tiny_masses_and_moments_are_raised_to_what_mujoco_accepts(mass: float, moment: float) -> None:
    inertia = Inertia.about(mass, T, moment * np.eye(3))
    assert not inertia.positive() and not _compiles(inertia)
    assert _compiles(inertia.balanced())


def _compiles(inertia: Inertia) -> bool:
    """Whether MuJoCo accepts it for a body that moves."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="a")
    body.add_joint(axis=[0, 0, 1])
    moments, axes = inertia.principal()
    body.mass, body.inertia, body.explicitinertial = inertia.mass, moments, True
    body.ipos, body.iquat = inertia.centre, quaternion_from_matrix(axes)
    try:
        spec.compile()
    except ValueError:
        return False
    return True
