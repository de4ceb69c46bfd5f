"""What is near the links of a hand: all pairs by brute force, along a motion, in any frame."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, capsule, sphere
from grasp_refine.hands.chain import integrate
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Surroundings, choose_bodies, scene_depths
from grasp_refine.scene.task import Task
from sliding_gripper import around_object, sliding_gripper

REACH = 0.01


def clutter(count: int, spread: float, seed: int = 0) -> Environment:
    """Random bodies of one to three pieces around the object, in a turned world."""
    rng = np.random.default_rng(seed)
    T_world_object = exp_se3(rng.normal(size=6))
    bodies = []
    for k in range(count):
        T = exp_se3(rng.normal(size=6))
        away = rng.normal(size=3)
        T[:3, 3] = spread * away / np.linalg.norm(away) * rng.uniform(0.8, 1.2)
        pieces = [box([0.02, 0.03, 0.04]), capsule(0.008, [0, 0, 0.02], [0, 0.02, 0.03]), sphere(0.02, [0.03, 0, 0])]
        body = build_body(f"body {k}", pieces[: 1 + k % 3], candidates=16)
        bodies.append(EnvironmentBody(body.name, body, T_world_object @ T, margin=0.002 * (k % 2)))
    return Environment(tuple(bodies), T_world_object)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    hand = sliding_gripper(tmp_path_factory.mktemp("hand"), "box", candidates=256)
    return around_object(hand, 6, 0)


def surroundings(scene: Scene, environment: Environment) -> tuple[Surroundings, np.ndarray]:
    """All bodies of an environment, and the poses of the links."""
    prepared = HandObject.of(scene)
    every = np.arange(len(environment.bodies))
    T = prepared.chain(scene.T_world_root, scene.q).T_world_link
    return Surroundings(prepared.bodies, prepared.bounding_spheres, environment, every), T


def brute_force(of: Surroundings, T: np.ndarray) -> np.ndarray:
    """Signed distances (M, C) of all pairs."""
    T_b = np.broadcast_to(of.environment.T_object_body[of.body], (len(T), len(of.body), 4, 4))
    return query(Pairs(of.pairs.a, of.pairs.b), T[:, of.link], T_b).distance


def margins(of: Surroundings) -> np.ndarray:
    """Margins (C,) of the bodies of all pairs."""
    return np.array([of.environment.bodies[k].margin for k in of.body])


@pytest.mark.parametrize("many", [0, 2048])
def test_all_pairs_that_are_near_are_found_while_hands_fly_through(
    scene: Scene, many: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps of 2 cm, more than the reach: bounds that forgot a part of the motion would miss what comes near."""
    monkeypatch.setattr("grasp_refine.scene.surroundings.MANY_PAIRS", many)
    of, _ = surroundings(scene, clutter(12, 0.09))
    rng, previous, queried = np.random.default_rng(4), None, []
    T_root, q = scene.T_world_root.copy(), scene.q
    T_root[:, 0, 3] -= 0.1
    for _ in range(10):
        T = HandObject.of(scene).chain(T_root, q).T_world_link
        expected = brute_force(of, T)
        with Stopwatch() as watch:
            previous = of.near(T, REACH, previous, most=len(of.link))
        counts = watch.scene_pairs
        assert sum(counts.values()) == expected.size and counts["query"] >= (previous.column >= 0).sum()
        assert (previous.bound <= expected + 1e-9).all()
        near = expected - margins(of) < REACH
        found = np.zeros_like(near)
        row, place = np.nonzero(previous.column >= 0)
        found[row, previous.column[row, place]] = True
        assert near.any() and (found == near).all()
        distance = previous.witness.distance[row, place]
        assert distance == pytest.approx(expected[row, previous.column[row, place]], abs=1e-9)
        queried.append(previous.num_queries.sum())
        T_root = integrate(T_root, np.array([[0.02, 0, 0, 0, 0, 0]]) + rng.normal(size=(len(T), 6)) * 2e-3)
        q = np.clip(q + rng.normal(size=q.shape) * 2e-3, scene.hand.lower, scene.hand.upper)
    assert max(queried) < near.size / 2


@pytest.mark.parametrize("count", [3, 30])
def test_depths_are_of_the_deepest_pair_of_a_link_that_counts(scene: Scene, count: int) -> None:
    """Margins aside; more grasps than are measured at once, one of which is nowhere."""
    environment = clutter(count, 0.07)
    T = np.tile(surroundings(scene, environment)[1], (12, 1, 1, 1))
    T[:, :, :3, 3] += np.random.default_rng(3).uniform(-0.05, 0.05, (len(T), 1, 3))
    T[5] = np.nan
    prepared, counts = HandObject.of(scene), np.array([True, False, True, True])
    found = scene_depths(environment, prepared.bodies, T, counts)
    of = Surroundings.measured(environment, prepared.bodies)
    assert of is not None
    distance = np.where(counts[of.link], brute_force(of, np.nan_to_num(T)), np.inf)
    expected = np.maximum(-distance.min(axis=1), 0.0)
    expected[5] = np.nan
    np.testing.assert_allclose(found.depth, expected, atol=1e-9)
    inside = np.flatnonzero(expected > 0)
    assert 5 < len(inside) < len(T)
    deepest = distance.argmin(axis=1)[inside]
    np.testing.assert_array_equal(found.link[inside], of.link[deepest])
    np.testing.assert_array_equal(found.body[inside], of.body[deepest])


def test_bodies_keep_their_numbers_and_sets_of_them_apart(scene: Scene) -> None:
    """Two bodies far from the object and from each other, and grasps that meet one or the other."""
    T = np.tile(np.eye(4), (2, 1, 1))
    T[0, :3, 3], T[1, :3, 3] = 5.0, -5.0
    bodies = tuple(EnvironmentBody(f"body {k}", build_body("b", [sphere(0.05)], candidates=16), T[k]) for k in (0, 1))
    prepared = HandObject.of(scene)
    first = replace(scene, T_world_root=T[:1], q=scene.q[:1], task=Task(scene=Environment(bodies, np.eye(4))))
    for number in (0, 1):
        here = replace(first, T_world_root=T[number : number + 1])
        links = prepared.chain(here.T_world_root, here.q).T_world_link
        found = scene_depths(here.environment, prepared.bodies, links)
        assert found.depth[0] > 1e-3 and found.body[0] == number
        reached = prepared.surroundings(here)
        assert reached is not None and reached.chosen.tolist() == [number]


def test_the_nearest_pairs_count_where_there_are_too_many(scene: Scene) -> None:
    of, T = surroundings(scene, clutter(30, 0.05))
    expected = np.sort(brute_force(of, T) - margins(of), axis=1)[:, :5]
    found = of.near(T, REACH, most=5)
    slack = np.sort(found.witness.distance - margins(of)[found.column], axis=1)
    assert slack == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("lift", "turn"), [(0.0, [0.5, -1.0, 2.0]), (0.1, [0.0, 0.0, 2.0])])
def test_distances_do_not_change_when_the_whole_world_moves_or_sides_swap(
    scene: Scene, lift: float, turn: list[float]
) -> None:
    """With any motion, or, where the object is lifted, with one that leaves up where it is."""
    environment = replace(clutter(8, 0.08), lift=lift)
    G = exp_se3(np.array([3.0, -2.0, 1.0, *turn]))
    moved = [replace(body, T_world_body=G @ body.T_world_body) for body in environment.bodies]
    (of, T), (there, _) = (
        surroundings(scene, one)
        for one in (environment, Environment(tuple(moved), G @ environment.T_world_object, lift=lift))
    )
    first, second = of.near(T, REACH), there.near(T, REACH)
    assert (first.column == second.column).all()
    valid = first.witness.valid
    assert first.witness.distance[valid] == pytest.approx(second.witness.distance[valid], abs=1e-9)
    T_b = np.broadcast_to(environment.T_object_body[of.body], (len(T), len(of.body), 4, 4))
    swapped = query(Pairs(of.pairs.b, of.pairs.a), T_b, T[:, of.link]).distance
    row, place = np.nonzero(first.column >= 0)
    found = first.witness.distance[row, place]
    assert found == pytest.approx(swapped[row, first.column[row, place]], abs=1e-9)


def test_what_hangs_above_is_as_far_as_it_comes_while_hands_rise(scene: Scene) -> None:
    """Against dense sampling of the way up; pieces of all shapes, whose rounding is told."""
    environment = replace(clutter(9, 0.1), lift=0.05)
    of, T = surroundings(scene, environment)
    heights = np.linspace(0.0, 0.05, 41)
    pairs = Pairs(of.pairs.a, tuple(environment.bodies[k].body for k in of.body))
    T_b = np.broadcast_to(environment.T_object_body[of.body], (len(T), len(of.body), 4, 4))
    rising = np.array([query(pairs, raised(T, h * environment.up)[:, of.link], T_b).distance for h in heights])
    expected, found = rising.min(axis=0), brute_force(of, T)
    hanging = [environment.cleared(k) is not one.body for k, one in enumerate(environment.bodies)]
    assert any(hanging) and not all(hanging)
    rests = ~np.array(hanging)[of.body]
    assert found[:, rests] == pytest.approx(rising[0][:, rests], abs=1e-9)
    # Where only some of the pieces of a body hang, the others are not swept.
    whole = np.array([len(one.body.pieces) == 1 for one in environment.bodies])[of.body] & ~rests
    clear = (expected > 0) & whole
    assert clear.sum() > 10
    assert found[clear] == pytest.approx(expected[clear], abs=1e-3)
    assert (found <= rising[0] + 1e-9).all()


def raised(T: np.ndarray, way: np.ndarray) -> np.ndarray:
    moved = T.copy()
    moved[..., :3, 3] += way
    return moved


def test_grasps_that_are_not_finite_have_nothing_near_and_leave_others_alone(scene: Scene) -> None:
    of, T = surroundings(scene, clutter(12, 0.08))
    broken = T.copy()
    broken[1] = np.nan
    expected, found = of.near(T, REACH), of.near(broken, REACH)
    assert (found.column[1] == -1).all() and not found.failed.any()
    rest = [0, 2, 3, 4, 5]
    assert (found.column[rest] == expected.column[rest]).all()


def test_bodies_count_whose_boxes_the_grown_box_of_the_links_meets(scene: Scene) -> None:
    """And what hangs is as far as it comes while the object is lifted."""
    environment = replace(clutter(40, 0.3), lift=0.05)
    _, T = surroundings(scene, environment)
    T = T[:2].copy()
    T[1] = np.nan
    spheres = HandObject.of(scene).bounding_spheres
    center = T[0, :, :3, :3] @ spheres[:, :3, None]
    center = center[..., 0] + T[0, :, :3, 3]
    box = np.array([-0.3, 0.0, -0.1]), np.array([-0.2, 0.1, 0.1])
    for slack, more in ((0.12, None), (0.25, None), (0.12, box)):
        low, high = (center - spheres[:, 3:]).min(axis=0) - slack, (center + spheres[:, 3:]).max(axis=0) + slack
        if more is not None:
            low, high = np.minimum(low, more[0] - slack), np.maximum(high, more[1] + slack)
        bounds = []
        for k, T_body in enumerate(environment.T_object_body):
            corners = [piece.transformed(T_body).bounds for piece in environment.cleared(k).pieces]
            bounds.append([np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1))])
        meets = [bool(((first <= high) & (last >= low)).all()) for first, last in bounds]
        assert 0 < sum(meets) < 40
        assert choose_bodies(environment, spheres, T, slack, more).tolist() == np.flatnonzero(meets).tolist()
    assert choose_bodies(environment, spheres, T[1:], 1.0).tolist() == []
