"""Grasps as least squares: the Jacobian against finite differences, culling, limits, new starts."""

from dataclasses import replace

import numpy as np
import pytest

from boxed_example import boxed_example
from grasp_refine.collision.query import QueryStatus
from grasp_refine.core.se3 import exp_se3, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.chain import integrate
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.region import HalfSpace
from grasp_refine.refinement import variables
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.grasp_problem import RESTART_NOISE, GraspProblem, sample_noise
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.refinement.solvers.rows import NEAR_DISTANCE_M
from grasp_refine.refinement.terms.term import State
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.refinement.variables import MAX_STEP
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from sliding_gripper import around_object, sliding_gripper


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return sliding_gripper(tmp_path_factory.mktemp("gripper"))


@pytest.fixture(scope="module")
def examples() -> Scene:
    """The four example grasps of the embedded hand on the embedded box."""
    return boxed_example()


def aimed_at(scene: Scene, links: int, seed: int) -> Scene:
    """The first links should touch at points that are near neither now."""
    rng = np.random.default_rng(seed)
    shape = (len(scene.q), len(scene.links), 3)
    on_link, on_object = np.full((2, *shape), np.nan)
    on_link[:, :links] = 0.02 * rng.normal(size=(shape[0], links, 3))
    on_object[:, :links] = 0.03 * rng.normal(size=(shape[0], links, 3))
    return replace(scene, target_link=on_link, target_object=on_object)


def with_directions(scene: Scene, links: int, seed: int) -> Scene:
    wanted = np.full((len(scene.q), len(scene.links), 3), np.nan)
    n = np.random.default_rng(seed).normal(size=(len(scene.q), links, 3))
    wanted[:, :links] = n / np.linalg.norm(n, axis=-1, keepdims=True)
    return replace(scene, direction=wanted)


def partly(goal: Goal, extra: int) -> Goal:
    """The goal, and that `extra` more links should touch anywhere."""
    touching = goal.touching.copy()
    first = int(goal.aimed.any(axis=0).sum())
    touching[:, first : first + extra] = True
    return replace(goal, touching=touching)


ALL = Weights(1.0, 50.0, 30.0, table=20.0, stay_near=1e-4, direction=1e-3, wrench=0.0)
NO_FORCES = Weights(wrench=0.0)


def point_of(scene: Scene) -> Point:
    hand = scene.hand
    return Point(scene.T_world_root, np.clip(scene.q, hand.lower, hand.upper))


def stepped(point: Point, dx: np.ndarray) -> Point:
    """Points after the same step (6 + n,) without any limits."""
    return Point(integrate(point.T, np.tile(dx[:6], (len(point.q), 1))), point.q + dx[6:])


def linearized(problem: GraspProblem, at: Point, known: State, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (M, m) and Jacobians (M, m, 6 + n); one-sided rows that are not positive are zero."""
    count = len(at.q)
    linear = problem.linearize(np.arange(count), at, known, np.full(count, width))
    counts = np.ones(linear.residual.shape, dtype=bool)
    if linear.unilateral is not None:
        counts = ~linear.unilateral | (linear.residual > 0)
    return np.where(counts, linear.residual, 0.0), np.where(counts[..., None], linear.jacobian, 0.0)


def every(scene: Scene) -> np.ndarray:
    return np.arange(len(scene.q))


# the Jacobian


def test_the_squares_of_the_rows_are_the_loss_less_the_misses_along_the_normals(examples: Scene) -> None:
    """Those have no derivative: seen from its body, a witness point moves along its surface."""
    scene = with_directions(replace(aimed_at(examples, 3, 6), task=Task(table=-0.02)), 3, 7)
    config = Config(weights=ALL, margin=2e-3, clearance=1e-3)
    goal = partly(goal_of(scene, ContactSelection()), 4)
    problem = GraspProblem(scene, goal, config)
    rows, at = every(scene), stepped(point_of(scene), np.concatenate([np.full(6, 0.01), np.zeros(16)]))
    known = problem.evaluate(rows, at, None)
    residual, J = linearized(problem, at, known, 1.0)
    w, T = known.witness.pairs(slice(0, 3)), known.T_link[:, :3]
    along = [
        ((w.point_a - transform_points(T, goal.target_link[:, :3])) * w.normal).sum(axis=-1),
        ((w.point_b - goal.target_object[:, :3]) * w.normal).sum(axis=-1),
    ]
    normal_misses = sum((a**2).sum(axis=1) for a in along)
    assert (normal_misses > 0.01 * known.loss).any()
    np.testing.assert_allclose((residual**2).sum(axis=1) + ALL.contact * normal_misses, known.loss, rtol=1e-10)
    assert J.shape == (*residual.shape, 6 + 16) and np.isfinite(J).all()


# the loss


@pytest.fixture(scope="module")
def surrounded(gripper: Hand) -> Scene:
    """Hands about a ball, a half of which they should touch, with two other balls beside it."""
    scene = around_object(gripper, 6, 25)
    bodies = [
        EnvironmentBody(name, build_body(name, [sphere(0.02)]), exp_se3(np.array([x, 0.01, 0.02, 0, 0, 0])), 0.003)
        for name, x in (("left", 0.09), ("right", -0.08))
    ]
    around = Environment(tuple(bodies), np.eye(4))
    return replace(scene, task=Task(scene=around, touch=(HalfSpace("half", np.array([0.6, 0.8, 0.0]), 0.0),)))


@pytest.mark.parametrize("size", [2e-3, 0.03], ids=["small", "large"])
@pytest.mark.parametrize("kind", ["targets", "gaps", "forces", "surroundings"])
def test_culling_by_the_last_answer_changes_no_loss(examples: Scene, surrounded: Scene, kind: str, size: float) -> None:
    """Walks of random steps, each with the answers at the last one, and whatever its loss was."""
    scene = {"targets": aimed_at(examples, 2, 11), "surroundings": surrounded}.get(kind, examples)
    weights = {"forces": Weights(), "surroundings": replace(NO_FORCES, penetration=0.0)}.get(kind, NO_FORCES)
    selection = ContactSelection(links=("left",)) if kind == "surroundings" else ContactSelection()
    problem = GraspProblem(scene, goal_of(scene, selection), Config(weights=weights))
    rng, count, n = np.random.default_rng(12), *scene.q.shape
    rows, at = every(scene), point_of(scene)
    known = problem.evaluate(rows, at, None)
    asked, rejected, steps = np.zeros(2, dtype=int), 0, 10
    near, deep, positive = [], [], []
    for step in range(steps):
        dx = size * rng.normal(size=(count, 6 + n)) * np.concatenate([np.ones(3), np.full(3 + n, 8.0)])
        dx[:, :6] *= step % 2  # now and then only the joints move, and links towards each other
        if kind == "surroundings":
            dx[:, 6] /= 8.0
        at, before = problem.integrate(rows, at, dx), known
        plain = problem.evaluate(rows, at, None)
        known = problem.evaluate(rows, at, replace(before, loss=np.full(count, np.inf)))
        np.testing.assert_allclose(known.loss, plain.loss, rtol=1e-6, atol=1e-12)
        asked += np.array([known.num_queries.sum(), plain.num_queries.sum()])
        deep.append(min(w.distance.min(initial=np.inf) for w in (plain.witness, plain.self_witness)))
        near.append(None if plain.nearby is None else (plain.nearby.column >= 0).sum())
        positive.append(np.mean([(term.residuals(plain)[0] > 0).any() for _, term in problem.terms]))
        # A bound is no larger than the distance.
        for bound, truth in ((known.witness, plain.witness), (known.self_witness, plain.self_witness)):
            both = (bound.status == QueryStatus.FAR) & truth.valid
            assert (bound.distance[both] <= truth.distance[both] + 1e-9).all()
        # A loss that is not below the last one need not be exact, but must not look as if it were below.
        short = problem.evaluate(rows, at, before).loss
        worse = plain.loss >= before.loss
        np.testing.assert_allclose(short[~worse], plain.loss[~worse], rtol=1e-6, atol=1e-12)
        assert (short[worse] >= before.loss[worse]).all() and (short <= plain.loss * (1 + 1e-6)).all()
        rejected += worse.sum()
    assert min(deep) < 0 and asked[0] <= 1.1 * asked[1] and 0 < rejected < count * steps
    assert kind != "surroundings" or (max(near) > 0 and max(positive) > 0.5)


def test_a_pose_that_is_not_finite_has_no_loss_and_spoils_no_other(examples: Scene) -> None:
    problem = GraspProblem(examples, goal_of(examples, ContactSelection()), Config())
    at = point_of(examples)
    clean = problem.evaluate(every(examples), at, None).loss
    T = at.T.copy()
    T[1, 0, 3] = np.nan
    found = problem.evaluate(every(examples), Point(T, at.q), None).loss
    assert np.isnan(found[1])
    np.testing.assert_array_equal(found[[0, 2, 3]], clean[[0, 2, 3]])


# steps


def test_steps_that_move_the_root_too_far_are_shortened_as_a_whole(gripper: Hand) -> None:
    """By its translation or its rotation, whatever their directions."""
    scene = around_object(gripper, 4, 17)
    scene = replace(scene, q=np.tile([0.02, 0.3], (4, 1)))
    problem = GraspProblem(scene, goal_of(scene, ContactSelection(links=scene.links)), Config())
    dx = np.tile([0.03, 0.0, 0.0, 0.0, 0.0, 0.6, 0.001, 0.1], (4, 1))
    dx[1, :3], dx[2, 3:6], dx[3, :6] = [0.03, 0.06, 0.06], [0.0, 1.2, 1.6], 0.0
    found = problem.integrate(every(scene), point_of(scene), dx)
    dx *= np.array([1.0, MAX_STEP[0] / 0.09, MAX_STEP[1] / 2.0, 1.0])[:, None]
    np.testing.assert_allclose(found.T, integrate(scene.T_world_root, dx[:, :6]), atol=1e-12)
    np.testing.assert_allclose(found.q, scene.q + dx[:, 6:], atol=1e-12)


def test_bounds_are_what_the_limits_leave_of_the_largest_step(gripper: Hand, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variables, "MAX_STEP", (0.02, 1.0, 0.5))
    scene = around_object(gripper, 4, 17)
    problem = GraspProblem(scene, goal_of(scene, ContactSelection(links=scene.links)), Config())
    at = Point(scene.T_world_root, np.array([[0.0, 1.2], [0.05, -0.5], [0.02, 0.3], [0.049, 0.0]]))
    lower, upper = problem.step_bounds(every(scene), at)
    # A metre of the root or a slide counts 1, a radian of the root 5 cm, one of a hinge 4 cm.
    np.testing.assert_allclose(problem.metric(every(scene)), np.tile([1, 1, 1, *[0.05**2] * 3, 1, 0.04**2], (4, 1)))
    # Those of the root are those of its length, not of each unknown.
    assert np.isposinf(upper[:, :6]).all() and np.isneginf(lower[:, :6]).all()
    # A slide moves as far as the root, in metres, the hinge by the bound of joints.
    np.testing.assert_allclose(upper[:, 6:], [[0.02, 0.0], [0.0, 0.5], [0.02, 0.5], [0.001, 0.5]], atol=1e-15)
    np.testing.assert_allclose(lower[:, 6:], [[0.0, -0.5], [-0.02, 0.0], [-0.02, -0.5], [-0.02, -0.5]], atol=1e-15)


def test_new_starts_are_keyed_by_the_grasp_not_by_its_place(examples: Scene) -> None:
    scene, order = aimed_at(examples, 3, 18), np.array([2, 0, 3, 1])
    other = Scene(
        scene.hand, scene.object, *(getattr(scene, name)[order] for name in (
            "T_world_root", "q", "target_link", "target_object"
        ))
    )  # fmt: skip
    number = np.array([1, 2, 3, 4])
    found, again = (
        GraspProblem(one, goal_of(one, ContactSelection()), Config()).restart(
            every(one), k, point_of(one), point_of(one)
        )
        for one, k in ((scene, number), (other, number[order]))
    )
    np.testing.assert_allclose(again.q, found.q[order], atol=1e-12)
    np.testing.assert_allclose(again.T, found.T[order], atol=1e-12)
    # Grasps that differ, however little, start elsewhere; so does another seed.
    nudged = replace(scene, q=scene.q + 1e-9)
    for one, seed in ((nudged, 0), (scene, 1)):
        problem = GraspProblem(one, goal_of(one, ContactSelection()), Config(seed=seed))
        elsewhere = problem.restart(every(one), number, point_of(one), point_of(one))
        assert (np.abs(elsewhere.q - found.q).max(axis=1) > 1e-3).all()


def test_noise_turns_with_the_scene_and_has_a_sample_for_each_number(gripper: Hand) -> None:
    """Of palms in other frames of the object the same, turned; the same key and number give the same sample."""
    scene, member, number = around_object(gripper, 3, 23), np.array([0, 1, 2, 1, 1]), np.array([1, 1, 1, 1, 2])
    turn = exp_se3(np.array([0.0, 0.0, 0.0, 0.4, -1.1, 0.7]))
    T = scene.T_world_root[member]
    here, there = sample_noise(scene, T, member, number, 0), sample_noise(scene, turn @ T, member, number, 0)
    # The object stays where it is, a ball about the origin.
    for part in (slice(3), slice(3, 6)):
        np.testing.assert_allclose(there[:, part], here[:, part] @ turn[:3, :3].T, atol=1e-9)
    np.testing.assert_array_equal(there[:, 6:], here[:, 6:])
    np.testing.assert_array_equal(here[1], here[3])
    distinct = np.concatenate([here[[0, 1, 2, 4]], sample_noise(scene, T[:1], member[:1], number[:1], 1)])
    assert np.abs(distinct[:, None] - distinct + 10.0 * np.eye(5)[..., None]).max(axis=-1).min() > 0.3


def test_new_starts_are_as_far_away_as_their_noise_each_in_its_unit(gripper: Hand) -> None:
    """From the best grasp and, every other time, from the present one. A slide once moved by 0.1 m, for radians."""
    scene = around_object(gripper, 400, 22)
    scene = replace(scene, q=np.tile([0.025, 0.35], (400, 1)))
    problem = GraspProblem(scene, goal_of(scene, ContactSelection(links=scene.links)), Config())
    at = point_of(scene)
    far = Point(at.T + 0.5 * np.eye(4, k=3), at.q)
    found = problem.restart(every(scene), np.ones(400, dtype=int), at, far)
    again = problem.restart(every(scene), np.full(400, 2), far, at)
    for one in (found, again):
        moved = np.linalg.norm((one.T - at.T)[:, :3, 3], axis=1)
        assert np.sqrt((moved**2).mean() / 3) == pytest.approx(RESTART_NOISE[0], rel=0.15)
    translation, rotation, joint = RESTART_NOISE
    slide, turn = (found.q - at.q).std(axis=0)
    # Limits at 2.5 standard deviations cut off a little.
    assert slide == pytest.approx(translation, rel=0.15) and turn == pytest.approx(joint, rel=0.15)
    turned = (np.trace(found.T[:, :3, :3] @ at.T[:, :3, :3].mT, axis1=1, axis2=2) - 1) / 2
    assert np.sqrt((np.arccos(turned) ** 2).mean() / 3) == pytest.approx(rotation, rel=0.15)


def test_inverse_kinematics_brings_target_points_together_without_a_query(examples: Scene) -> None:
    """Targets of hands that exist, from hands 2 cm and 15 degrees away: 8 steps bring them to a tenth of that."""
    problem = GraspProblem(examples, goal_of(examples, ContactSelection(), nearest=True), Config())
    goal, rng = problem.goal, np.random.default_rng(19)
    there = problem.evaluate(every(examples), point_of(examples), None)
    # Points on the object where those of the links are now.
    on_object = transform_points(there.T_link, np.nan_to_num(goal.target_link))
    reachable = np.where(goal.aimed[..., None], on_object, np.nan)
    problem = GraspProblem(examples, replace(goal, target_object=reachable), Config())
    dx = rng.normal(size=(4, 22)) * np.concatenate([np.full(3, 0.012), np.full(3, 0.15), np.full(16, 0.2)])
    start = problem.integrate(every(examples), point_of(examples), dx)

    def miss(point: Point) -> np.ndarray:
        T = problem.chain(point.T, point.q).T_world_link
        gap = np.linalg.norm(transform_points(T, np.nan_to_num(goal.target_link)) - on_object, axis=-1)
        return np.where(goal.aimed, gap, 0.0).max(axis=1)

    reached = problem.solve_position_ik(every(examples), start)
    assert (miss(start) > 0.01).all() and (miss(reached) < 1e-3).all()
    assert (reached.q >= examples.hand.lower).all() and (reached.q <= examples.hand.upper).all()


def test_depths_that_are_not_yet_there_come_as_one_sided_rows(examples: Scene) -> None:
    """Pairs less than 3 mm apart: minus their distance, with its slope, so that a step does not run into them."""
    weights = Weights(contact=0.0, penetration=1.0, self_penetration=0.0)
    problem = GraspProblem(examples, goal_of(examples, ContactSelection()), Config(weights=weights))
    rows, at = every(examples), point_of(examples)
    known = problem.evaluate(rows, at, None)
    linear = problem.linearize(rows, at, known, np.ones(4))
    w = known.witness
    near = w.valid & (w.distance < NEAR_DISTANCE_M)
    assert linear.unilateral is not None and (near & (w.distance > 0)).any()
    for m in range(4):
        found = linear.residual[m][linear.unilateral[m] & linear.jacobian[m].any(axis=-1)]
        np.testing.assert_allclose(np.sort(found), np.sort(-w.distance[m][near[m]]), rtol=1e-12)
