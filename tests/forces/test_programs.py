"""The compiled solver of contact forces against DAQP: degenerate contacts, other loads, threads."""

import daqp
import numpy as np
import pytest

from grasp_refine.collision.engine import VARIABLE, why_not_native
from grasp_refine.forces.equilibrium import LOADS
from grasp_refine.forces.programs import (
    DAQP_OPTIMAL,
    MAX_PRESSURE_SHARE,
    NUM_EDGES,
    _constraints,
    solve_programs,
)
from grasp_refine.forces.wrench import PLANNING_FRICTION, RIDGE, grasp_map
from single_load import single_load_forces

compiled = pytest.mark.skipif(bool(why_not_native()), reason=f"no compiled engine: {why_not_native()}")

FEASIBLE = 2e-6
"""DAQP's tolerance on constraints, in forces: by it, its values may be too good."""

Contacts = tuple[np.ndarray, np.ndarray]


def random(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    normal = rng.normal(size=(count, contacts, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return -0.04 * normal + 0.01 * rng.normal(size=normal.shape), normal


def coincident(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    point, normal = random(rng, count, contacts)
    return np.repeat(point[:, :1], contacts, axis=1), np.repeat(normal[:, :1], contacts, axis=1)


def twins(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    point, normal = random(rng, count, contacts)
    return point[:, np.arange(contacts) // 2], normal[:, np.arange(contacts) // 2]


def parallel(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    point, normal = random(rng, count, contacts)
    return point, np.repeat(normal[:, :1], contacts, axis=1)


def opposite(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    """All on one line, from both sides."""
    normal = random(rng, count, 1)[1] * np.where(np.arange(contacts) % 2, 1.0, -1.0)[:, None]
    return -0.04 * normal, normal


def box(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    """On a grid on the sides of a cube: many ties."""
    normal = np.concatenate([np.eye(3), -np.eye(3)])[rng.integers(0, 6, (count, contacts))]
    return -0.04 * normal + 0.01 * rng.integers(-2, 3, normal.shape), normal


def central(rng: np.random.Generator, count: int, contacts: int) -> Contacts:
    point, normal = random(rng, count, contacts)
    return 0.0 * point, normal


def broken_constraints(local: np.ndarray, there: np.ndarray, friction: float) -> np.ndarray:
    """By how much forces (N, P, K, 3) break the worst of their constraints (N, P)."""
    angle = (np.arange(NUM_EDGES) + 0.5) * 2.0 * np.pi / NUM_EDGES
    rim = friction * np.cos(np.pi / NUM_EDGES)
    face = np.stack([np.full(NUM_EDGES, -rim), np.cos(angle), np.sin(angle)], axis=1)
    cap = np.maximum(MAX_PRESSURE_SHARE, 1.0 / there.sum(axis=1))[:, None]
    pressure = local[..., 0]
    parts = [
        (local @ face.T).max(axis=(-2, -1)), pressure.max(axis=-1) - cap, -pressure.min(axis=-1),
        np.abs(pressure.sum(axis=-1) - 1.0), np.abs(np.where(there[:, None, :, None], 0.0, local)).max(axis=(-2, -1)),
    ]  # fmt: skip
    return np.max(parts, axis=0)


def value(G: np.ndarray, outer: np.ndarray, local: np.ndarray, ridge: float) -> np.ndarray:
    unbalanced = outer + np.einsum("nkri,npki->npr", G, local)
    return (unbalanced**2).sum(axis=-1) + ridge * (local**2).sum(axis=(-2, -1))


def both(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> list[tuple[np.ndarray, np.ndarray]]:
    found = []
    for engine in ("native", "python"):
        monkeypatch.setenv(VARIABLE, engine)
        found.append(solve_programs(*arguments))
    return found


def test_contacts_of_a_link_share_its_largest_pressure() -> None:
    """As DAQP finds it with one constraint more for each link; a link that touches alone has all of the pressure."""
    rng = np.random.default_rng(3)
    link = np.array([[0, 1, 0, 1, 0, 2], [0, 1, 0, 0, 0, 0], [4, 4, 4, 4, 4, 4]])
    point, normal = random(rng, 3, 6)
    G, _ = grasp_map(point, normal, np.zeros(3))
    outer = np.tile(np.concatenate([np.zeros((1, 6)), LOADS]), (3, 1, 1))
    there = np.ones((3, 6), dtype=bool)
    mine, solved = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE, link=link)
    free, _ = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE)
    assert solved.all() and (mine[2] == free[2]).all()
    heavier = 0
    for n, p in np.ndindex(2, len(outer[0])):
        same = link[n] == link[n, :, None]
        assert (same @ mine[n, p, :, 0]).max() < MAX_PRESSURE_SHARE + 2e-5
        heavier += (same @ free[n, p, :, 0]).max() > MAX_PRESSURE_SHARE + 0.01
        A = np.moveaxis(G[n], 1, 0).reshape(6, -1)
        rows, upper, lower, sense = _constraints(6, PLANNING_FRICTION)
        sums = np.kron(same, [1.0, 0.0, 0.0])
        x, _, flag, _ = daqp.solve(
            A.T @ A + RIDGE * np.eye(18),
            outer[n, p] @ A,
            np.concatenate([rows, sums]),
            np.concatenate([upper, np.full(6, MAX_PRESSURE_SHARE)]),
            np.concatenate([lower, np.zeros(6)]),
            np.concatenate([sense, np.zeros(6, dtype=np.int32)]),
        )
        theirs = x.reshape(1, 1, 6, 3)
        assert flag == DAQP_OPTIMAL
        values = (value(G[n : n + 1], outer[n : n + 1, p : p + 1], f, RIDGE) for f in (mine[n, p][None, None], theirs))
        np.testing.assert_allclose(*values, rtol=0, atol=2e-5)
    assert heavier >= 4


@compiled
@pytest.mark.parametrize("place", [random, coincident, twins, parallel, opposite, box, central])
@pytest.mark.parametrize(
    ("friction", "ridge"), [(PLANNING_FRICTION, RIDGE), (0.0, RIDGE), (0.7, RIDGE), (PLANNING_FRICTION, 0.2)]
)
def test_both_solvers_find_the_same_forces(
    monkeypatch: pytest.MonkeyPatch, place: object, friction: float, ridge: float
) -> None:
    """Some contacts are none; with loads, and forms that are minimised with the wrench."""
    rng = np.random.default_rng(1)
    for contacts in (1, 2, 3, 5, 8, 15):
        point, normal = place(rng, 6, contacts)
        forms = rng.normal(size=(6, contacts % 3, contacts, 3)) if contacts % 3 else None
        point[5, contacts // 2 + 1 :] = np.nan
        G, _ = grasp_map(point, normal, np.zeros(3), forms)
        outer = np.zeros((6, 6, G.shape[2]))
        outer[..., :6] = np.concatenate([np.zeros((1, 6)), LOADS, [[0, 0, 0, 0.1, -0.3, 0.2]]])
        there = np.isfinite(point[..., 0])
        (mine, solved), (theirs, also) = both(monkeypatch, G, there, outer, friction, ridge)
        assert solved.all() and also.all()
        assert broken_constraints(mine, there, friction).max() < 1e-12
        assert broken_constraints(theirs, there, friction).max() < FEASIBLE
        # The value is strictly convex: the forces are the same, as far as DAQP's are allowed.
        np.testing.assert_allclose(value(G, outer, mine, ridge), value(G, outer, theirs, ridge), rtol=0, atol=1e-9)
        np.testing.assert_allclose(mine, theirs, atol=1e-4)


@compiled
def test_forces_depend_on_the_grasp_and_load_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of any number of threads, to the last bit; a load after another one starts elsewhere, and ends there too."""
    monkeypatch.setenv(VARIABLE, "native")
    from grasp_refine.collision.native_search import solve_forces

    rng = np.random.default_rng(2)
    point, normal = random(rng, 300, 6)
    there = rng.random((300, 6)) < 0.8
    G, _ = grasp_map(point, normal, np.zeros(3))
    outer = np.repeat(LOADS[None], 300, axis=0)
    together, solved = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE)
    np.testing.assert_array_equal(solved, np.repeat(there.any(axis=1)[:, None], 4, axis=1))
    for threads in (1, 3):
        local, _ = solve_forces(G, there, outer, None, PLANNING_FRICTION, MAX_PRESSURE_SHARE, RIDGE, threads)
        np.testing.assert_array_equal(local, together)
    for n in range(0, 300, 50):
        rows = slice(n, n + 1)
        local, _ = solve_programs(G[rows], there[rows], outer[rows], PLANNING_FRICTION, RIDGE)
        np.testing.assert_array_equal(local[0], together[n])
    for p in range(4):
        local, _ = solve_programs(G, there, outer[:, p : p + 1], PLANNING_FRICTION, RIDGE)
        np.testing.assert_allclose(local[:, 0], together[:, p], atol=1e-7)


@compiled
@pytest.mark.parametrize("place", [random, parallel, opposite, box])
def test_the_forces_do_not_depend_on_where_they_start(monkeypatch: pytest.MonkeyPatch, place: object) -> None:
    """From those of a grasp nearby, also one with other contacts, under other loads, or none."""
    monkeypatch.setenv(VARIABLE, "native")
    rng = np.random.default_rng(5)
    point, normal = place(rng, 40, 6)
    there = np.ones((40, 6), dtype=bool)
    there[1::4, 3], there[2::4, 1:], there[3::4, 2:] = False, False, False
    outer = np.repeat(LOADS[None], 40, axis=0)
    G, _ = grasp_map(point, normal, np.zeros(3))
    expected, _ = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE)
    nearby, _ = grasp_map(point + 1e-3 * rng.normal(size=point.shape), normal, np.zeros(3))
    with_all, _ = solve_programs(nearby, np.ones_like(there), outer, PLANNING_FRICTION, RIDGE)
    with_them, _ = solve_programs(nearby, there, outer, PLANNING_FRICTION, RIDGE)
    unknown = with_them.copy()
    unknown[::2, 1::2] = np.nan
    one = np.zeros_like(with_all)
    one[..., 0, 0] = 1.0  # as if the first contact had been the only one
    for start in (expected, with_them, with_all, with_them[:, ::-1].copy(), unknown, 0.0 * with_all, one):
        local, solved = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE, start)
        assert solved.all() and broken_constraints(local, there, PLANNING_FRICTION).max() < 1e-12
        np.testing.assert_allclose(value(G, outer, local, RIDGE), value(G, outer, expected, RIDGE), rtol=0, atol=1e-10)
        np.testing.assert_allclose(local, expected, atol=1e-6)


@compiled
def test_a_load_that_is_not_finite_has_no_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loads after it, and the other grasps, have theirs."""
    monkeypatch.setenv(VARIABLE, "native")
    point, normal = random(np.random.default_rng(3), 60, 5)
    G, _ = grasp_map(point, normal, np.zeros(3))
    there, outer = np.ones((60, 5), dtype=bool), np.repeat(LOADS[None], 60, axis=0)
    expected, _ = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE)
    outer[::2, 1, 2] = np.nan
    local, solved = solve_programs(G, there, outer, PLANNING_FRICTION, RIDGE)
    np.testing.assert_array_equal(np.argwhere(~solved), [[n, 1] for n in range(0, 60, 2)])
    assert not local[~solved].any()
    np.testing.assert_allclose(local[solved], expected[solved], atol=1e-7)


def test_a_solver_that_gives_up_is_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "python")
    monkeypatch.setattr("daqp.solve", lambda *arguments: (np.ones(6), 0.0, -4, {}))
    point, normal = opposite(np.random.default_rng(4), 1, 2)
    found = single_load_forces(point, normal, np.zeros(3))
    assert not found.solved[0] and np.isnan(found.residual[0]) and not found.force.any()
