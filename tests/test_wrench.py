"""Contact forces against closed forms, and against another solver with another description of the cones."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.optimize import minimize

from grasp_refine import wrench
from grasp_refine.objects import load_object
from grasp_refine.se3 import exp_so3, tangents
from grasp_refine.wrench import EDGES, LENGTH, MOST, RIDGE, ContactForces, center_of_mass, contact_forces

INNER = np.cos(np.pi / EDGES)
"""The pyramid lies between the cone of the friction itself and that of this times it."""

ORIGIN = np.zeros(3)


def random_contacts(count: int, contacts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, contacts, 3) on a dented ball of 4 cm and normals that roughly look inward."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, contacts, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return -0.04 * normal + 0.01 * rng.normal(size=normal.shape), normal


def of(normal: list, point: list, **settings: float) -> ContactForces:
    """The forces of a single grasp about the origin."""
    return contact_forces(np.array(point, dtype=float)[None], np.array(normal, dtype=float)[None], ORIGIN, **settings)


# closed forms


def test_two_opposing_contacts_balance() -> None:
    found = of([[-1, 0, 0], [1, 0, 0]], [[0.03, 0, 0], [-0.05, 0, 0]])
    assert found.residual[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.force[0], [[-0.5, 0, 0], [0.5, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(found.pressure, 0.5, atol=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.15, 1.0])
def test_contacts_on_one_side_push_with_all_they_have(friction: float) -> None:
    """Nothing opposes the pressures, whose sum is 1; both act 2 cm beside the centre, which friction cannot mend."""
    found = of([[1, 0, 0], [1, 0, 0]], [[0, 0.02, 0], [0, 0.02, 0]], friction=friction)
    assert found.residual[0] == pytest.approx(np.hypot(1.0, 0.02 / LENGTH), abs=1e-6)


@pytest.mark.parametrize("friction", [0.0, 0.15])
def test_three_contacts_around_a_disc_share_the_load(friction: float) -> None:
    angle = 2.0 * np.pi * np.arange(3) / 3
    normal = -np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    found = of(normal, -0.04 * normal, friction=friction)
    assert found.residual[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.force[0], normal / 3, atol=1e-6)


def test_no_contact_carries_more_than_half() -> None:
    """A contact at +x against two at -x that are not opposite to it: it takes half, they a quarter each."""
    found = of([[-1, 0, 0], [1, 0, 0], [1, 0, 0]], [[0.03, 0, 0], [-0.03, 0.01, 0], [-0.03, -0.01, 0]])
    np.testing.assert_allclose(found.pressure[0], [0.5, 0.25, 0.25], atol=1e-6)
    lopsided = of([[-1, 0, 0], [0, 1, 0], [0, 1, 0]], [[0.03, 0, 0], [0, -0.03, 0], [0, -0.03, 0]], friction=0.0)
    assert lopsided.pressure.max() <= MOST + 1e-9


def test_a_single_contact_pushes_alone() -> None:
    found = of([[0, 0, 1]], [[0, 0, -0.03]])
    assert found.residual[0] == pytest.approx(1.0)
    np.testing.assert_allclose(found.force[0], [[0, 0, 1]], atol=1e-9)
    assert found.pressure[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("friction", [0.1, 0.15, 0.5])
@pytest.mark.parametrize("beyond", [-0.05, -1e-3, 1e-3, 0.05])
def test_a_wedge_slips_when_its_slope_is_above_the_friction(friction: float, beyond: float) -> None:
    """Faces that lean by a: forces along x balance and need tan a; with less, sin a - mu cos a of each is left."""
    a = np.arctan(friction + beyond)
    # These tangents are edges of the pyramid, so that it has the friction of the cone here.
    normal = [[np.cos(a), 0, np.sin(a)], [-np.cos(a), 0, np.sin(a)]]
    found = of(normal, [[-0.03, 0, 0], [0.03, 0, 0]], friction=friction)
    assert found.residual[0] == pytest.approx(max(0.0, np.cos(a) * beyond), abs=1e-6)


def test_torques_count_by_the_length_and_about_the_centre() -> None:
    """A couple of two pushes of 0.5 that miss each other by 2 cm, which friction is not there to stop."""
    point = [[-0.03, 0.01, 0], [0.03, -0.01, 0]]
    found = of([[1, 0, 0], [-1, 0, 0]], point, friction=0.0)
    assert found.residual[0] == pytest.approx(0.5 * 0.02 / LENGTH)
    moved = contact_forces(
        np.array(point)[None] + [1.0, 2.0, 3.0],
        np.array([[[1.0, 0, 0], [-1.0, 0, 0]]]),
        np.array([1.0, 2.0, 3.0]),
        friction=0.0,
    )
    assert moved.residual[0] == pytest.approx(found.residual[0])


# properties


@pytest.mark.parametrize(("contacts", "friction"), [(2, 0.15), (3, 0.15), (5, 0.15), (5, 0.0), (12, 0.6)])
def test_forces_are_allowed_and_make_the_residual(contacts: int, friction: float) -> None:
    point, normal = random_contacts(50, contacts, seed=contacts)
    center = np.array([0.003, -0.002, 0.001])
    found = contact_forces(point, normal, center, friction=friction)
    assert found.solved.all()
    np.testing.assert_allclose(found.pressure.sum(axis=1), 1.0, atol=1e-8)
    assert found.pressure.min() >= 0 and found.pressure.max() <= MOST + 1e-8
    np.testing.assert_allclose((found.force * normal).sum(axis=-1), found.pressure, atol=1e-8)
    across = np.linalg.norm(found.force - found.pressure[..., None] * normal, axis=-1)
    assert (across <= friction * found.pressure + 1e-7).all()
    torque = np.cross(point - center, found.force).sum(axis=1) / LENGTH
    total = np.concatenate([found.force.sum(axis=1), torque], axis=1)
    np.testing.assert_allclose(found.residual, np.linalg.norm(total, axis=1), atol=1e-9)


@pytest.mark.parametrize(("contacts", "ridge"), [(2, RIDGE), (3, 1e-3), (5, RIDGE), (5, 0.2)])
def test_no_other_solver_finds_better_forces(contacts: int, ridge: float) -> None:
    """SLSQP over the edges of the pyramids instead of their faces."""
    point, normal = random_contacts(6, contacts, seed=10 + contacts)
    found = contact_forces(point, normal, ORIGIN, ridge=ridge)
    angle = 2.0 * np.pi * np.arange(EDGES) / EDGES
    circle = np.stack([np.cos(angle), np.sin(angle)])
    for m in range(len(point)):
        edges = normal[m][:, :, None] + 0.15 * tangents(normal[m]) @ circle  # (contacts, 3, EDGES)

        def forces(c: np.ndarray, edges: np.ndarray = edges) -> np.ndarray:
            return (edges @ c.reshape(contacts, EDGES, 1))[..., 0]

        def cost(f: np.ndarray, m: int = m) -> float:
            torque = np.cross(point[m], f).sum(axis=0) / LENGTH
            return float((f.sum(axis=0) ** 2).sum() + (torque**2).sum() + ridge * (f**2).sum())

        other = minimize(
            lambda c, cost=cost, forces=forces: cost(forces(c)),
            np.full(contacts * EDGES, 1.0 / (contacts * EDGES)),
            bounds=[(0.0, None)] * (contacts * EDGES),
            constraints=[
                {"type": "eq", "fun": lambda c: c.sum() - 1.0},
                {"type": "ineq", "fun": lambda c: MOST - c.reshape(contacts, EDGES).sum(axis=1)},
            ],
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert cost(found.force[m]) == pytest.approx(other.fun, rel=1e-4, abs=1e-7)


def test_moving_everything_changes_nothing() -> None:
    """But for the pyramids, which are turned otherwise in their cones."""
    point, normal = random_contacts(40, 4, seed=3)
    center, shift = np.array([0.01, 0.0, -0.005]), np.array([0.3, -0.1, 0.2])
    R = exp_so3(np.array([0.4, -1.1, 0.7]))

    def residual(friction: float) -> np.ndarray:
        return contact_forces(point, normal, center, friction=friction).residual

    def turned(friction: float) -> ContactForces:
        return contact_forces(point @ R.T + shift, normal @ R.T, R @ center + shift, friction=friction)

    np.testing.assert_allclose(turned(0.0).residual, residual(0.0), atol=1e-9)
    without = contact_forces(point, normal, center, friction=0.0)
    np.testing.assert_allclose(turned(0.0).force, without.force @ R.T, atol=1e-6)
    assert (turned(0.15).residual <= residual(0.15 * INNER) + 1e-5).all()
    assert (turned(0.15).residual >= residual(0.15 / INNER) - 1e-5).all()


def test_more_friction_never_harms() -> None:
    point, normal = random_contacts(40, 3, seed=4)
    residuals = [contact_forces(point, normal, ORIGIN, friction=f, ridge=1e-9).residual for f in (0.0, 0.1, 0.3, 0.9)]
    assert (np.diff(residuals, axis=0) <= 1e-7).all() and residuals[3].mean() < 0.5 * residuals[0].mean()


def test_a_large_ridge_spreads_the_load() -> None:
    point, normal = random_contacts(40, 8, seed=5)
    little, much = (contact_forces(point, normal, ORIGIN, ridge=ridge) for ridge in (RIDGE, 0.2))
    assert ((much.pressure**2).sum(axis=1) <= (little.pressure**2).sum(axis=1) + 1e-9).all()
    assert (much.residual >= little.residual - 1e-9).all()


# what is no contact


def test_what_is_no_contact_counts_nothing() -> None:
    point, normal = random_contacts(5, 4, seed=6)
    alone = contact_forces(point, normal, ORIGIN)
    place = [5, 0, 3, 2]
    wide_point, wide_normal = np.full((2, 5, 6, 3), np.nan)
    wide_point[:, place], wide_normal[:, place] = point, normal
    wide_point[:, 1] = 0.01  # a point without a normal
    wide = contact_forces(wide_point, wide_normal, ORIGIN)
    np.testing.assert_allclose(wide.residual, alone.residual, atol=1e-7)
    np.testing.assert_allclose(wide.force[:, place], alone.force, atol=1e-5)
    assert not wide.force[:, [1, 4]].any() and not wide.pressure[:, [1, 4]].any()


def test_grasps_do_not_depend_on_the_others() -> None:
    point, normal = random_contacts(7, 4, seed=7)
    point[2, 1:], normal[5, 0] = np.nan, np.nan
    together = contact_forces(point, normal, ORIGIN)
    for m in range(7):
        alone = contact_forces(point[m : m + 1], normal[m : m + 1], ORIGIN)
        np.testing.assert_array_equal(alone.force[0], together.force[m])
        np.testing.assert_array_equal(alone.residual[0], together.residual[m])


def test_without_contacts_there_is_no_residual() -> None:
    point, normal = random_contacts(2, 3, seed=8)
    normal[1] = np.nan
    found = contact_forces(point, normal, ORIGIN)
    np.testing.assert_array_equal(found.solved, [True, False])
    np.testing.assert_array_equal(np.isnan(found.residual), [False, True])
    assert not found.force[1].any() and not found.pressure[1].any()
    assert not contact_forces(np.zeros((2, 0, 3)), np.zeros((2, 0, 3)), ORIGIN).solved.any()
    assert len(contact_forces(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), ORIGIN).residual) == 0


def test_a_solver_that_gives_up_is_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    gave_up = SimpleNamespace(solve=lambda *arguments: (np.ones(6), 0.0, -4, {}))
    monkeypatch.setattr(wrench, "daqp", gave_up)
    found = of([[-1, 0, 0], [1, 0, 0]], [[0.03, 0, 0], [-0.03, 0, 0]])
    assert not found.solved[0] and np.isnan(found.residual[0]) and not found.force.any()


# centre of mass


def test_centre_of_mass_is_that_of_the_closed_mesh(tmp_path: Path) -> None:
    np.testing.assert_allclose(center_of_mass(load_object("box:0.1,0.2,0.3", candidates=16)), 0.0, atol=1e-9)
    # Two boxes of 1 and 3 litres, one on top of the other, as one mesh of two closed parts.
    low, high = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.3))
    high.apply_translation([0.0, 0.02, 0.2])
    path = tmp_path / "tower.obj"
    trimesh.util.concatenate([low, high]).export(path)
    tower = load_object(path, scale=0.5, candidates=16)
    np.testing.assert_allclose(center_of_mass(tower), [0.0, 0.5 * 0.015, 0.5 * 0.15], atol=1e-6)


def test_an_open_surface_beside_given_pieces_has_no_centre_of_mass(tmp_path: Path) -> None:
    """Pieces of 1 and 3 litres, whose centre is known; the surface lacks a triangle and is 2 m away."""
    low, high = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.3))
    high.apply_translation([0.0, 0.02, 0.2])
    (tmp_path / "mesh").mkdir()
    low.export(tmp_path / "a.obj")
    high.export(tmp_path / "b.obj")
    ball = trimesh.creation.icosphere(radius=0.1)
    ball.update_faces(np.arange(len(ball.faces)) > 80)
    ball.apply_translation([2.0, 0.0, 0.0])
    ball.export(tmp_path / "mesh" / "simplified.obj")
    tower = load_object(tmp_path, scale=0.5, candidates=16)
    assert any("not watertight" in note for note in tower.notes)
    np.testing.assert_allclose(center_of_mass(tower), [0.0, 0.5 * 0.015, 0.5 * 0.15], atol=1e-6)
