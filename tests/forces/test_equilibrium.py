"""The equilibrium term: its value by hand, its derivative against finite differences, its rows against dense KKT."""

from dataclasses import replace

import numpy as np
import pytest

from claw import TIPS, around, claw, objects
from grasp_refine.core.se3 import exp_se3
from grasp_refine.forces.equilibrium import UNSOLVED_VALUE, Equilibrium
from grasp_refine.forces.infeasible_torques import LEVER_M as TORQUE_LEVER_M
from grasp_refine.forces.programs import MAX_PRESSURE_SHARE, NUM_EDGES
from grasp_refine.forces.wrench import LEVER_M, PLANNING_FRICTION, RIDGE, grasp_map
from grasp_refine.hands.chain import integrate
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.terms.term import State
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.refinement.terms.wrench import Wrench
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

ONLY = Weights(contact=0.0, penetration=0.0, self_penetration=0.0, table=0.0, wrench=1.0)
SCALES = (1.0, 0.05, 0.04)
"""A radian of the root, and of a joint, is as much movement as so many metres of the root."""

SHALLOW = 0.004
"""Tips deeper in an edge than half their radius follow it less than they should (`counted_distance`), metres."""


@pytest.fixture(scope="module")
def bodies() -> dict[str, Object]:
    return objects()


@pytest.fixture(scope="module", params=[False, True], ids=["free", "coupled"])
def hand(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"), coupled=request.param)


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"), coupled=True)


def at(scene: Scene) -> Point:
    return Point(scene.T_world_root, scene.q)


def every(scene: Scene) -> np.ndarray:
    return np.arange(len(scene.q))


ALL_TIPS = ContactSelection(links=TIPS)
NEAR = ContactSelection()


def problem_of(scene: Scene, touching: ContactSelection | Goal = ALL_TIPS, weights: Weights = ONLY) -> GraspProblem:
    goal = touching if isinstance(touching, Goal) else goal_of(scene, touching)
    return GraspProblem(scene, goal, Config(weights=weights))


def equilibrium_of(problem: GraspProblem) -> Equilibrium:
    (term,) = (term for _, term in problem.terms if isinstance(term, Wrench))
    return term.equilibrium


def loads_of(problem: GraspProblem) -> np.ndarray:
    """Loads (P, M, 6) in the world: those of each grasp turn with the hand that it begins with."""
    R = problem.scene.T_world_root[:, :3, :3]
    parts = [[R @ part for part in np.split(load, 2)] for load in equilibrium_of(problem).loads]
    return np.array([np.concatenate(part, axis=-1) for part in parts])


def stepped(point: Point, dx: np.ndarray) -> Point:
    """Points after steps (M, 6 + n)."""
    return Point(integrate(point.T, dx[:, :6]), point.q + dx[:, 6:])


def loss_at(problem: GraspProblem, point: Point) -> np.ndarray:
    return problem.evaluate(np.arange(len(point.q)), point, None).loss


def rows(problem: GraspProblem, point: Point, known: State, width: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    linear = problem.linearize(np.arange(len(point.q)), point, known, np.full(len(point.q), width))
    return linear.residual, linear.jacobian


def slopes(problem: GraspProblem, point: Point, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Central differences (M, 6 + n) of the loss, and whether those of both sides are the same (M,)."""
    count, n = point.q.shape[0], 6 + point.q.shape[1]
    here, ahead, behind = loss_at(problem, point), np.empty((count, n)), np.empty((count, n))
    for k in range(n):
        dx = np.tile(h * np.eye(n)[k], (count, 1))
        ahead[:, k] = (loss_at(problem, stepped(point, dx)) - here) / h
        behind[:, k] = (here - loss_at(problem, stepped(point, -dx))) / h
    return 0.5 * (ahead + behind), cosine(ahead, behind) > 0.9999


def scaled(gradient: np.ndarray) -> np.ndarray:
    root, turn, joint = SCALES
    return gradient * np.concatenate([np.full(3, root), np.full(3, turn), np.full(gradient.shape[1] - 6, joint)])


def cosine(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    one, other = scaled(one), scaled(other)
    return (one * other).sum(axis=1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1))


# the value


@pytest.mark.parametrize("body", ["sphere", "box"])
def test_the_value_is_what_the_forces_leave_unbalanced(hand: Hand, bodies: dict[str, Object], body: str) -> None:
    """Forces and torques about the centre, torques that a tendon cannot make, and a little for the forces."""
    scene = around(hand, bodies[body], 8, 1)
    problem = problem_of(scene)
    # The hands have turned since; loads have not.
    turned = np.tile(np.concatenate([np.zeros(3), [0.2, -0.3, 0.1], np.zeros(scene.q.shape[1])]), (8, 1))
    known = problem.evaluate(every(scene), stepped(at(scene), turned), None)
    w, frames = known.witness, known.frames
    expected = np.zeros(8)
    for p, load in enumerate(loads_of(problem)):
        f = known.forces.force[:, p]
        x = np.where(f.any(axis=-1, keepdims=True), w.point_b, 0.0)
        total = np.concatenate([f.sum(axis=1), np.cross(x, f).sum(axis=1) / LEVER_M], axis=1) + load
        torque = problem.chain.to_joint_space(
            frames, np.concatenate([f, np.cross(x, f)], axis=-1), np.arange(f.shape[1])
        )
        torque = torque[..., 6:].sum(axis=1)
        for group in hand.coupled:
            own = torque[:, [hand.joint_names.index(name) for name in group.joints]]
            ratio = np.array(group.ratio) / np.linalg.norm(group.ratio)
            expected += ((own - (own @ ratio)[:, None] * ratio) ** 2).sum(axis=1) / TORQUE_LEVER_M**2
        expected += (total**2).sum(axis=1) + RIDGE * (f**2).sum(axis=(1, 2))
    np.testing.assert_allclose(known.loss, expected / len(equilibrium_of(problem).loads), rtol=1e-9)


def test_no_other_allowed_forces_are_better(coupled: Hand, bodies: dict[str, Object]) -> None:
    """Random changes of the forces, what they break mended by scaling: the value is a minimum, tendons included."""
    scene, rng = around(coupled, bodies["sphere"], 6, 2), np.random.default_rng(0)
    problem = problem_of(scene)
    known = problem.evaluate(every(scene), at(scene), None)
    G = problem_map(problem, at(scene), known.forces.local.any(axis=1)[..., 0])
    for p, load in enumerate(loads_of(problem)):
        local, outer = known.forces.local[:, p], np.zeros((6, G.shape[2]))
        outer[:, :6] = load

        def value(local: np.ndarray, outer: np.ndarray = outer) -> np.ndarray:
            unbalanced = outer + np.einsum("mcij,mcj->mi", G, local)
            return (unbalanced**2).sum(axis=1) + RIDGE * (local**2).sum(axis=(1, 2))

        best = value(local)
        for size in (1e-4, 1e-2, 0.3):
            for _ in range(50):
                pressure = np.maximum(local[..., 0] + size * rng.normal(size=local.shape[:2]), 0.0)
                pressure = np.where(known.witness.valid & problem.goal.touching, pressure, 0.0)
                pressure /= pressure.sum(axis=1, keepdims=True)
                across = local[..., 1:] + size * rng.normal(size=(*local.shape[:2], 2))
                length = np.linalg.norm(across, axis=-1, keepdims=True)
                # Within the circle that the pyramid holds.
                most = PLANNING_FRICTION * np.cos(np.pi / NUM_EDGES) * pressure[..., None]
                across = across * np.minimum(1.0, most / np.maximum(length, 1e-12))
                other = np.concatenate([pressure[..., None], across], axis=-1)
                allowed = pressure.max(axis=1) <= MAX_PRESSURE_SHARE
                assert (value(other) >= best - 1e-9)[allowed].all()


# the derivative


@pytest.mark.parametrize("seed", [4, 5])
@pytest.mark.parametrize("body", ["sphere", "box", "capsule"])
def test_the_gradient_is_that_of_the_loss(hand: Hand, bodies: dict[str, Object], body: str, seed: int) -> None:
    """Points and normals slide on both surfaces, axes move with their joints; tendons, slides, a mimic joint."""
    scene = around(hand, bodies[body], 12, seed)
    problem = problem_of(scene)
    known = problem.evaluate(every(scene), at(scene), None)
    residual, J = rows(problem, at(scene), known)
    found = 2.0 * np.einsum("mrk,mr->mk", J, residual)
    expected, smooth = slopes(problem, at(scene), 1e-6)
    # Features of a box, and the edges of friction pyramids, may change in between.
    smooth &= (known.witness.distance[:, :4] > -SHALLOW).all(axis=1)
    assert smooth.sum() >= 8
    assert (cosine(found, expected)[smooth] >= 0.999).all()
    length, wanted = (np.linalg.norm(scaled(g), axis=1)[smooth] for g in (found, expected))
    np.testing.assert_allclose(length, wanted, rtol=0.03 if body == "box" else 1e-3)


def test_contacts_that_are_switched_off_have_no_part_in_the_gradient(coupled: Hand, bodies: dict[str, Object]) -> None:
    """Each grasp has other links that touch."""
    scene = around(coupled, bodies["sphere"], 6, 6)
    goal = goal_of(scene, ContactSelection(links=TIPS))
    touching = goal.touching.copy()
    touching[[0, 1, 2, 3], [0, 1, 2, 3]] = False
    problem = problem_of(scene, replace(goal, touching=touching), replace(ONLY, penetration=1e-12))
    known = problem.evaluate(every(scene), at(scene), None)
    residual, J = rows(problem, at(scene), known)
    expected, smooth = slopes(problem, at(scene), 1e-6)
    assert smooth.sum() >= 4
    found = 2.0 * np.einsum("mrk,mr->mk", J, residual)
    assert (cosine(found, expected)[smooth] >= 0.999).all()
    # The finger that does not touch balances nothing, wherever its own joints are.
    names = list(coupled.joint_names)
    joints = found[:, 6:]
    assert not joints[0, [names.index(name) for name in ("I2", "I1")]].any()
    assert not joints[2, names.index("T2")] and not joints[3, names.index("S1")]


def problem_map(problem: GraspProblem, point: Point, pushing: np.ndarray) -> np.ndarray:
    """What the local forces of all links come to (M, L, R, 3) where the hands are at some points."""
    known = problem.evaluate(np.arange(len(point.q)), point, None)
    there = (pushing & known.witness.valid)[..., None]
    p, n = (np.where(there, side, np.nan) for side in (known.witness.point_b, known.witness.normal))
    forms = equilibrium_of(problem).infeasible.forms(known.frames, np.where(there, p, 0.0))
    return grasp_map(p, n, problem.scene.centers(np.arange(len(p))), forms, problem.scene.T_world_root[:, :3, :3])[0]


def active_rows(local: np.ndarray) -> np.ndarray:
    """Constraints (A, 3 L) on changes of the forces (L, 3) of a grasp that keep what is active as it is."""
    angle = (np.arange(NUM_EDGES) + 0.5) * 2.0 * np.pi / NUM_EDGES
    rim = PLANNING_FRICTION * np.cos(np.pi / NUM_EDGES)
    face = np.stack([np.full(NUM_EDGES, -rim), np.cos(angle), np.sin(angle)], axis=1)
    active = [np.tile([1.0, 0.0, 0.0], len(local))]
    for link, f in enumerate(local):
        place = np.zeros((3, len(local), 3))
        place[:, link] = np.eye(3)
        place = place.reshape(3, -1)
        if f[0] < 1e-7:
            active += list(place)
            continue
        active += [row @ place for row in face if row @ f > -1e-7]
        active += [place[0]] if f[0] > MAX_PRESSURE_SHARE - 1e-7 else []
    return np.array(active)


@pytest.mark.parametrize("body", ["sphere", "box"])
def test_the_rows_report_the_best_forces_of_the_linear_problem(
    hand: Hand, bodies: dict[str, Object], body: str
) -> None:
    """|r + J dx|^2 is the minimum over forces within the active constraints, by a dense KKT system, for any dx."""
    scene, rng = around(hand, bodies[body], 10, 8), np.random.default_rng(1)
    problem, h = problem_of(scene), 1e-6
    known = problem.evaluate(every(scene), at(scene), None)
    shallow = (known.witness.distance[:, :4] > -SHALLOW).all(axis=1)
    assert shallow.sum() >= 6
    residual, J = rows(problem, at(scene), known)
    pushing = known.forces.local.any(axis=1)[..., 0]
    G = problem_map(problem, at(scene), pushing)
    tolerance = 0.03 if body == "box" else 2e-3
    for size in (1e-4, 1e-2):
        dx = size * rng.normal(size=(10, J.shape[2])) * np.concatenate([np.ones(3), np.full(J.shape[2] - 3, 10.0)])
        dG = (problem_map(problem, stepped(at(scene), h * dx), pushing)) - problem_map(
            problem, stepped(at(scene), -h * dx), pushing
        )
        before, after = np.zeros((2, 10))
        for p in range(len(equilibrium_of(problem).loads)):
            local = known.forces.local[:, p]
            v = np.einsum("mcij,mcj->mi", dG, local) / (2.0 * h)
            for m in range(10):
                A, g = active_rows(local[m]), np.moveaxis(G[m], 0, 1).reshape(G.shape[2], -1)
                u, f = known.forces.unbalanced[m, p], local[m].reshape(-1)
                H = g.T @ g + RIDGE * np.eye(len(f))
                # The constraints may depend on each other: least squares instead of a solve.
                kkt = np.block([[H, A.T], [A, np.zeros((len(A), len(A)))]])
                right = np.concatenate([-(g.T @ (u + v[m]) + RIDGE * f), np.zeros(len(A))])
                d = np.linalg.lstsq(kkt, right, rcond=1e-13)[0][: len(f)]
                before[m] += (u**2).sum() + RIDGE * (f**2).sum()
                after[m] += ((u + v[m] + g @ d) ** 2).sum() + RIDGE * ((f + d) ** 2).sum()
        share = 1.0 / len(equilibrium_of(problem).loads)
        predicted = ((residual + np.einsum("mrk,mk->mr", J, dx)) ** 2).sum(axis=1) - (residual**2).sum(axis=1)
        predicted, change = predicted[shallow], share * (after - before)[shallow]
        np.testing.assert_allclose(predicted, change, atol=tolerance * np.abs(change).max())


# what is no grasp


def test_without_contacts_nothing_is_to_be_gained(coupled: Hand, bodies: dict[str, Object]) -> None:
    """The value is that of a single contact, and has no derivative; other grasps are as ever."""
    scene = around(coupled, bodies["sphere"], 4, 11)
    goal = goal_of(scene, ContactSelection(links=TIPS))
    touching = goal.touching.copy()
    touching[1] = False
    weights = replace(ONLY, penetration=1e-12)
    plain, problem = problem_of(scene, goal, weights), problem_of(scene, replace(goal, touching=touching), weights)
    known, clean = (one.evaluate(every(scene), at(scene), None) for one in (problem, plain))
    assert known.loss[1] == pytest.approx(UNSOLVED_VALUE)
    np.testing.assert_allclose(known.loss[[0, 2, 3]], clean.loss[[0, 2, 3]], rtol=1e-9)
    residual, J = rows(problem, at(scene), known)
    assert np.isfinite(residual).all() and np.isfinite(J).all()
    np.testing.assert_allclose(np.einsum("mrk,mr->mk", J, residual)[1], 0.0, atol=1e-12)


# real hands


def agreement(scene: Scene, touching: ContactSelection = NEAR) -> np.ndarray:
    """Cosines of the gradient, with the curvatures of the exact features, and differences; NaN where these jump."""
    problem = problem_of(scene, touching, replace(ONLY, penetration=1e-12))
    known = problem.evaluate(every(scene), at(scene), None)
    residual, J = rows(problem, at(scene), known)
    expected, smooth = slopes(problem, at(scene), 1e-6)
    return np.where(smooth, cosine(np.einsum("mrk,mr->mk", J, residual), expected), np.nan)


def test_the_gradient_of_a_real_hand() -> None:
    """Fingertips of many small faces on a ball; here and there a face, edge or vertex is taken for another."""
    allegro, rng = load_hand("allegro", candidates=64), np.random.default_rng(14)
    ball = load_object("sphere:0.035", candidates=64)
    q = np.clip(allegro.rest + 0.1 * rng.normal(size=(16, 16)), allegro.lower, allegro.upper)
    tips = HandObject(allegro, ball).chain(np.tile(np.eye(4), (16, 1, 1)), q).T_world_link[:, :4, :3, 3]
    T = exp_se3(rng.normal(size=(16, 6)) * [0.0, 0.0, 0.0, 0.2, 0.2, 0.2])
    T[:, :3, 3] -= (T[:, None, :3, :3] @ tips[..., None])[..., 0].mean(axis=1)
    found = agreement(Scene(allegro, ball, T, q), ContactSelection(reach=0.03, other_link_distance=0.0))
    assert np.isfinite(found).sum() >= 12
    assert (found[np.isfinite(found)] >= 0.999).mean() >= 0.75
