"""Contact forces against closed forms, and against another solver with another description of the cones."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.optimize import minimize

from grasp_refine.core.se3 import exp_so3
from grasp_refine.forces.programs import MAX_PRESSURE_SHARE, NUM_EDGES
from grasp_refine.forces.wrench import (
    LEVER_M,
    RIDGE,
    ContactForces,
    basis_spin,
    basis_tangents,
    grasp_map,
    turn_loads,
)
from grasp_refine.objects.object import load_object
from single_load import single_load_forces

INNER = np.cos(np.pi / NUM_EDGES)
"""The pyramid lies between the cone of the friction itself and that of this times it."""

ORIGIN = np.zeros(3)


def random_contacts(count: int, contacts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, contacts, 3) on a dented ball of 4 cm and normals that roughly look inward."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, contacts, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return -0.04 * normal + 0.01 * rng.normal(size=normal.shape), normal


def of(normal: list, point: list, **settings: float | np.ndarray) -> ContactForces:
    """The forces of a single grasp about the origin."""
    return single_load_forces(
        np.array(point, dtype=float)[None], np.array(normal, dtype=float)[None], ORIGIN, **settings
    )


# closed forms


def test_two_opposing_contacts_balance() -> None:
    found = of([[-1, 0, 0], [1, 0, 0]], [[0.03, 0, 0], [-0.05, 0, 0]])
    assert found.residual[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(found.force[0], [[-0.5, 0, 0], [0.5, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(found.pressure, 0.5, atol=1e-9)


def test_no_contact_carries_more_than_half() -> None:
    """A contact at +x against two at -x that are not opposite to it: it takes half, they a quarter each."""
    found = of([[-1, 0, 0], [1, 0, 0], [1, 0, 0]], [[0.03, 0, 0], [-0.03, 0.01, 0], [-0.03, -0.01, 0]])
    np.testing.assert_allclose(found.pressure[0], [0.5, 0.25, 0.25], atol=1e-6)
    lopsided = of([[-1, 0, 0], [0, 1, 0], [0, 1, 0]], [[0.03, 0, 0], [0, -0.03, 0], [0, -0.03, 0]], friction=0.0)
    assert lopsided.pressure.max() <= MAX_PRESSURE_SHARE + 1e-9


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
    normal = [[np.cos(a), 0, np.sin(a)], [-np.cos(a), 0, np.sin(a)]]
    found = of(normal, [[-0.03, 0, 0], [0.03, 0, 0]], friction=friction)
    # Within the cone, the pyramid has at least the inner friction in any direction.
    least, most = (max(0.0, np.sin(a) - f * np.cos(a)) for f in (friction, friction * INNER))
    assert least - 1e-6 <= found.residual[0] <= most + 1e-6


def test_torques_count_by_the_length_and_about_the_centre() -> None:
    """A couple of two pushes of 0.5 that miss each other by 2 cm, which friction is not there to stop."""
    point = [[-0.03, 0.01, 0], [0.03, -0.01, 0]]
    found = of([[1, 0, 0], [-1, 0, 0]], point, friction=0.0)
    assert found.residual[0] == pytest.approx(0.5 * 0.02 / LEVER_M)
    moved = single_load_forces(
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
    found = single_load_forces(point, normal, center, friction=friction)
    assert found.solved.all()
    np.testing.assert_allclose(found.pressure.sum(axis=1), 1.0, atol=1e-8)
    assert found.pressure.min() >= 0 and found.pressure.max() <= MAX_PRESSURE_SHARE + 1e-8
    np.testing.assert_allclose((found.force * normal).sum(axis=-1), found.pressure, atol=1e-8)
    across = np.linalg.norm(found.force - found.pressure[..., None] * normal, axis=-1)
    assert (across <= friction * found.pressure + 1e-7).all()
    torque = np.cross(point - center, found.force).sum(axis=1) / LEVER_M
    total = np.concatenate([found.force.sum(axis=1), torque], axis=1)
    np.testing.assert_allclose(found.residual, np.linalg.norm(total, axis=1), atol=1e-9)


@pytest.mark.parametrize(("contacts", "ridge"), [(3, 1e-3), (3, RIDGE)])
def test_no_other_solver_finds_better_forces(contacts: int, ridge: float) -> None:
    """SLSQP over the edges of the pyramids instead of their faces."""
    point, normal = random_contacts(2, contacts, seed=10 + contacts)
    found = single_load_forces(point, normal, ORIGIN, ridge=ridge)
    angle = 2.0 * np.pi * np.arange(NUM_EDGES) / NUM_EDGES
    circle = np.stack([np.cos(angle), np.sin(angle)])
    for m in range(len(point)):
        edges = normal[m][:, :, None] + 0.15 * basis_tangents(normal[m]) @ circle  # (contacts, 3, NUM_EDGES)

        def forces(c: np.ndarray, edges: np.ndarray = edges) -> np.ndarray:
            return (edges @ c.reshape(contacts, NUM_EDGES, 1))[..., 0]

        def cost(f: np.ndarray, m: int = m) -> float:
            torque = np.cross(point[m], f).sum(axis=0) / LEVER_M
            return float((f.sum(axis=0) ** 2).sum() + (torque**2).sum() + ridge * (f**2).sum())

        other = minimize(
            lambda c, cost=cost, forces=forces: cost(forces(c)),
            np.full(contacts * NUM_EDGES, 1.0 / (contacts * NUM_EDGES)),
            bounds=[(0.0, None)] * (contacts * NUM_EDGES),
            constraints=[
                {"type": "eq", "fun": lambda c: c.sum() - 1.0},
                {"type": "ineq", "fun": lambda c: MAX_PRESSURE_SHARE - c.reshape(contacts, NUM_EDGES).sum(axis=1)},
            ],
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert cost(found.force[m]) == pytest.approx(other.fun, rel=1e-4, abs=1e-7)


def test_forces_rotate_with_their_axes() -> None:
    """Loads, forms and pyramids too: each grasp has a rotation of its own."""
    point, normal = random_contacts(40, 4, seed=3)
    load, forms = (np.random.default_rng(5).normal(size=shape) for shape in ((40, 6), (40, 2, 4, 3)))
    axes, R = (exp_so3(np.random.default_rng(seed).normal(size=(40, 3))) for seed in (6, 7))
    here = single_load_forces(point, normal, ORIGIN, load=0.1 * load, forms=forms, axes=axes)
    turned_load = 0.1 * turn_loads(np.eye(6), R).mT @ load[..., None]
    there = single_load_forces(
        point @ R.mT, normal @ R.mT, ORIGIN, load=turned_load[..., 0], forms=forms @ R[:, None].mT, axes=R @ axes
    )
    np.testing.assert_allclose(there.residual, here.residual, atol=1e-12)
    np.testing.assert_allclose(there.force, here.force @ R.mT, atol=1e-9)
    np.testing.assert_allclose(there.local, here.local, atol=1e-9)


# loads and other forms


def test_two_contacts_push_back_along_their_line() -> None:
    """A load of 0.4 on the object along x: what bears on it from the other side takes more, up to its half."""
    point, normal = [[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]]
    for push in (0.0, 0.1, 0.4):
        found = of(normal * 2, point * 2, load=np.array([push, 0, 0, 0, 0, 0]))
        assert found.residual[0] == pytest.approx(0.0, abs=1e-4)
        np.testing.assert_allclose(found.force[0, ::2].sum(axis=0) * 2, [-0.5 * (1 + push) * 2, 0, 0], atol=1e-3)
    # Of two contacts none may carry more than half, and the whole load is left.
    found = of(normal, point, load=np.array([0.4, 0, 0, 0, 0, 0]))
    assert found.residual[0] == pytest.approx(0.4, abs=1e-6)


def test_a_load_across_is_taken_by_friction_up_to_its_limit() -> None:
    """Of 0.2 along a tangent, both contacts together take the friction, the pyramid's along its edges."""
    point, normal = [[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]]
    for push in (0.05, 0.2):
        found = of(normal, point, load=np.array([0, push, 0, 0, 0, 0]), ridge=1e-9)
        low, high = (max(0.0, push - 0.15 * share) for share in (1.0, INNER))
        assert low - 1e-6 <= found.residual[0] <= high + 1e-6


def test_other_forms_count_with_the_rest_but_are_no_residual() -> None:
    """A form that weighs heavily is kept at 0 where contacts can do without; here the third contact's pressure."""
    angle = 2.0 * np.pi * np.arange(4) / 4
    normal = -np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)[None]
    forms = np.zeros((1, 1, 4, 3))
    forms[0, 0, 2] = 100.0 * normal[0, 2]
    free = single_load_forces(-0.04 * normal, normal, ORIGIN)
    found = single_load_forces(-0.04 * normal, normal, ORIGIN, forms=forms)
    np.testing.assert_allclose(free.pressure, 0.25, atol=1e-4)
    # Without the third, the first has no opponent but friction of the other two.
    assert found.pressure[0, 2] < 1e-3 and found.pressure[0, [1, 3]].min() > 0.4
    assert found.unbalanced.shape == (1, 7) and found.unbalanced[0, 6] == pytest.approx(100.0 * found.pressure[0, 2])
    assert found.residual[0] == pytest.approx(np.linalg.norm(found.unbalanced[0, :6]))


def test_the_grasp_map_gives_what_forces_come_to() -> None:
    point, normal = random_contacts(6, 4, seed=14)
    point[1, 2] = np.nan
    center, forms = np.array([0.01, 0.0, -0.02]), np.random.default_rng(2).normal(size=(6, 3, 4, 3))
    G, basis = grasp_map(point, normal, center, forms)
    found = single_load_forces(point, normal, center, forms=forms)
    np.testing.assert_allclose(np.einsum("mcij,mcj->mi", G, found.local), found.unbalanced, atol=1e-12)
    np.testing.assert_allclose((basis @ found.local[..., None])[..., 0], found.force, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(basis), 1.0)
    there = np.isfinite(point[..., 0])
    np.testing.assert_allclose(basis[there][..., 0], normal[there], atol=1e-15)
    assert not G[1, 2].any()
    torque = np.cross(np.nan_to_num(point) - center, found.force).sum(axis=1) / LEVER_M
    total = np.concatenate([found.force.sum(axis=1), torque, np.einsum("meci,mci->me", forms, found.force)], axis=1)
    np.testing.assert_allclose(found.unbalanced, total, atol=1e-9)


# what is no contact


def test_what_is_no_contact_counts_nothing() -> None:
    point, normal = random_contacts(5, 4, seed=6)
    alone = single_load_forces(point, normal, ORIGIN)
    place = [5, 0, 3, 2]
    wide_point, wide_normal = np.full((2, 5, 6, 3), np.nan)
    wide_point[:, place], wide_normal[:, place] = point, normal
    wide_point[:, 1] = 0.01  # a point without a normal
    wide = single_load_forces(wide_point, wide_normal, ORIGIN)
    np.testing.assert_allclose(wide.residual, alone.residual, atol=1e-7)
    np.testing.assert_allclose(wide.force[:, place], alone.force, atol=1e-5)
    assert not wide.force[:, [1, 4]].any() and not wide.pressure[:, [1, 4]].any()


def test_without_contacts_there_is_no_residual() -> None:
    point, normal = random_contacts(2, 3, seed=8)
    normal[1] = np.nan
    found = single_load_forces(point, normal, ORIGIN)
    np.testing.assert_array_equal(found.solved, [True, False])
    np.testing.assert_array_equal(np.isnan(found.residual), [False, True])
    assert not found.force[1].any() and not found.pressure[1].any()
    assert not single_load_forces(np.zeros((2, 0, 3)), np.zeros((2, 0, 3)), ORIGIN).solved.any()
    assert len(single_load_forces(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), ORIGIN).residual) == 0


# the basis of local forces


def unit(count: int, seed: int) -> np.ndarray:
    normal = np.random.default_rng(seed).normal(size=(count, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_the_basis_is_a_rotation_wherever_the_normal_points() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    normal = np.concatenate([unit(50, 0), axes])
    basis = np.concatenate([normal[..., None], basis_tangents(normal)], axis=-1)
    np.testing.assert_allclose(basis.mT @ basis, np.broadcast_to(np.eye(3), basis.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(basis), 1.0)


def test_the_basis_turns_by_its_spin_and_with_its_normal() -> None:
    """Against differences along all tangents."""
    normal, h = unit(50, 1), 1e-6
    axes = exp_so3(np.array([0.3, -0.8, 0.5]))
    E = basis_tangents(normal, axes)
    spin = basis_spin(normal, E, axes)
    for k in range(2):
        ahead, behind = (normal + step * E[..., k] for step in (h, -h))
        ahead, behind = (n / np.linalg.norm(n, axis=1, keepdims=True) for n in (ahead, behind))
        turned = (basis_tangents(ahead, axes) - basis_tangents(behind, axes)) / (2 * h)
        omega = np.cross(normal, E[..., k]) + spin[:, k, None] * normal
        np.testing.assert_allclose(turned, np.cross(omega[..., None], E, axis=1), atol=1e-4)


# centre of mass


def test_centre_of_mass_is_that_of_the_closed_mesh(tmp_path: Path) -> None:
    np.testing.assert_allclose(load_object("box:0.1,0.2,0.3", candidates=16).center_of_mass, 0.0, atol=1e-9)
    # Two boxes of 1 and 3 litres, one on top of the other, as one mesh of two closed parts.
    low, high = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.3))
    high.apply_translation([0.0, 0.02, 0.2])
    path = tmp_path / "tower.obj"
    trimesh.util.concatenate([low, high]).export(path)
    tower = load_object(path, scale=0.5, candidates=16)
    np.testing.assert_allclose(tower.center_of_mass, [0.0, 0.5 * 0.015, 0.5 * 0.15], atol=1e-6)


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
    np.testing.assert_allclose(tower.center_of_mass, [0.0, 0.5 * 0.015, 0.5 * 0.15], atol=1e-6)
