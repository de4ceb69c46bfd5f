"""The forward cells of the benchmark of stability: states are what they say, and what is wrong is seen and counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine_apps.bench.mujoco_distance import MujocoBodies
from grasp_refine_apps.bench.stability import forward
from grasp_refine_apps.bench.stability.bodies import BodyPairs, make_pairs
from grasp_refine_apps.bench.stability.cases import (
    STATE_DISTANCES,
    STATE_DISTANCES_M,
    STATES,
    Forward,
    Kind,
    State,
    Task,
)
from grasp_refine_apps.bench.stability.forward import forward_cells
from grasp_refine_apps.bench.stability.judging import AnswerFaults, judge, tolerance
from grasp_refine_apps.bench.stability.poses import PosedBodies, pose_samplers
from grasp_refine_apps.bench.stability.rows import wrong

PYTHON = Forward(engine="python")


def test_a_body_without_thickness_is_refused_and_counted():
    task = Task("slivers", 0.1, ("near",), (PYTHON,), queries=8)
    (cell,) = forward_cells(task)
    assert (cell.queries, cell.refused) == (8, 2) and "flat, 8.6e-08 of its diagonal thick" in cell.refusal


def posed(kind: Kind, diagonal: float, state: State, count: int, pair: int = 0) -> tuple[BodyPairs, PosedBodies]:
    made = make_pairs(kind, diagonal, 0)
    found = pose_samplers(made, Task(kind, diagonal, (state,)))[pair].pose(state, count)
    assert found is not None
    return made, found


@pytest.mark.parametrize("state", [state for state in STATES if state in STATE_DISTANCES or state in STATE_DISTANCES_M])
def test_convex_bodies_are_as_far_apart_as_the_state_says(state: State):
    for kind, diagonal in (("box", 0.1), ("needle", 1e-3), ("ball", 10.0)):
        _, found = posed(kind, diagonal, state, 12)
        wanted = STATE_DISTANCES_M.get(state, STATE_DISTANCES.get(state, 0.0) * diagonal)
        np.testing.assert_allclose(found.truth.distance, wanted, rtol=1e-12, atol=2e-15 * diagonal)


def test_other_states_are_what_they_say():
    for kind in ("box", "near-duplicates"):
        made, shallow = posed(kind, 1.0, "shallow", 32)
        assert (shallow.truth.distance < 0).all() and shallow.truth.distance.min() > -0.011
        _, deep = posed(kind, 1.0, "deep", 32)
        assert np.median(deep.truth.distance) < -0.02
        _, concentric = posed(kind, 1.0, "concentric", 16)
        assert (concentric.truth.distance < deep.truth.distance.max()).all()
        centers = [np.array([T[:3, :3] @ body.pieces[0].bounds.mean(0) + T[:3, 3] for T in Ts])
                   for body, Ts in zip(made.pairs[0], (concentric.T_a, concentric.T_b), strict=True)]  # fmt: skip
        np.testing.assert_allclose(centers[0], centers[1], rtol=0, atol=1e-15)


@pytest.mark.parametrize("kind", ["box", "plate", "slivers", "concave40"])
def test_features_lie_against_each_other(kind: Kind):
    for state in ("face-face", "edge-edge", "vertex-vertex"):
        _, found = posed(kind, 1.0, state, 32, pair=1)
        distance = found.truth.distance
        touching = np.abs(distance) < 2e-15
        assert touching.any() and (np.abs(distance - 1e-9) < 1e-14).any() and (np.abs(distance - 1e-3) < 1e-14).any()
        if state == "face-face":
            assert not found.truth.unique[touching].any()
    assert pose_samplers(make_pairs("ball", 1.0, 0), Task("ball", 1.0, ()))[0].pose("edge-edge", 4) is None
    assert not list(forward_cells(Task("ball", 0.1, ("face-face",), (PYTHON,))))


def test_the_tolerance_is_the_one_that_was_agreed():
    position = np.array([0.0, 1e6])
    np.testing.assert_allclose(tolerance(0.1, position), [1e-9 + 1e-12, 1e-9 + 1e-12 + 1e-9], rtol=1e-12)
    single = np.finfo(np.float32).eps * (position + 0.1)
    np.testing.assert_allclose(tolerance(0.1, position, "float32"), tolerance(0.1, position) + single, rtol=1e-12)


@pytest.fixture(scope="module")
def answered() -> tuple[Witness, PosedBodies, Pairs]:
    """Right answers about two boxes near each other."""
    made, found = posed("box", 0.1, "near", 16)
    pairs = Pairs(*((body,) for body in made.pairs[0]), engine="python")
    return query(pairs, found.T_a[:, None], found.T_b[:, None]).pairs(0), found, pairs


def one(found: PosedBodies) -> int:
    """A pose in which there is only one pair of points; the last one where there is none."""
    return int(np.append(np.flatnonzero(found.truth.unique), len(found.T_a) - 1)[0])


def judged(answered: tuple[Witness, PosedBodies, Pairs], **broken: Any) -> AnswerFaults:
    witness, found, pairs = answered
    changed = {}
    for name, change in broken.items():
        changed[name] = getattr(witness, name).copy()
        changed[name][one(found)] = change(changed[name][one(found)])
    return judge(replace(witness, **changed), found.truth, pairs.piece_pairs, found.T_a, found.T_b, 0.1)


def counts(found: AnswerFaults) -> dict[str, int]:
    names = ("failed", "not_finite", "wrong_distance", "wrong_sign", "wrong_points")
    return {name: int(getattr(found, name).sum()) for name in names if getattr(found, name).any()}


def test_nothing_is_wrong_with_right_answers(answered: tuple[Witness, PosedBodies, Pairs]):
    found = judged(answered)
    assert counts(found) == {} and found.compared.sum() >= 8 and (found.error < 1e-3 * found.tolerance).all()


def test_every_fault_is_seen(answered: tuple[Witness, PosedBodies, Pairs]):
    step = np.array([1.0, -1.0, 0.5])
    normal = answered[0].normal[one(answered[1])]
    assert counts(judged(answered, status=lambda _: QueryStatus.FAILED, distance=lambda _: np.nan)) == {"failed": 1}
    assert counts(judged(answered, status=lambda _: QueryStatus.FAR)) == {"failed": 1}
    assert counts(judged(answered, status=lambda _: QueryStatus.NOT_FINITE)) == {"not_finite": 1}
    assert counts(judged(answered, distance=lambda _: np.nan)) == {"not_finite": 1}
    assert counts(judged(answered, point_b=lambda x: x * np.inf)) == {"not_finite": 1}
    # Off by 1.1 times the tolerance, the points with it.
    error = 1.1 * tolerance(0.1, np.array([0.2]))[0]
    off = judged(answered, distance=lambda d: d + error, point_b=lambda x: x + error * normal)
    assert counts(off) == {"wrong_distance": 1}
    assert (
        counts(judged(answered, distance=lambda d: d + 0.5 * error, point_b=lambda x: x + 0.5 * error * normal)) == {}
    )
    flipped = counts(judged(answered, distance=lambda d: -d, status=lambda _: QueryStatus.PENETRATING))
    assert flipped["wrong_sign"] == flipped["wrong_distance"] == 1
    assert counts(judged(answered, status=lambda _: QueryStatus.PENETRATING)) == {"wrong_sign": 1}
    both = {name: lambda x: x + 1e-4 * step for name in ("point_a", "point_b")}
    assert counts(judged(answered, **both)) == {"wrong_points": 1}
    assert counts(judged(answered, point_a=lambda x: x + 1e-5 * step)) == {"wrong_points": 1}
    assert counts(judged(answered, normal=lambda n: -n)) == {"wrong_points": 1}
    assert counts(judged(answered, normal=lambda n: 1.001 * n)) == {"wrong_points": 1}


def test_points_may_slide_by_what_the_error_of_the_distance_allows_and_no_more():
    """Points of balls may be 1e-5 diagonals off for the tolerance of their distance, and not for its error."""
    made, found = posed("ball", 0.1, "near", 16)
    pairs = Pairs(*((body,) for body in made.pairs[0]), engine="python")
    right = query(pairs, found.T_a[:, None], found.T_b[:, None]).pairs(0), found, pairs
    assert counts(judged(right)) == {} and judged(right).points_error.max() < 1e-3
    across = np.cross(right[0].normal[one(found)], [0.3, 0.5, 0.8])
    off = {name: lambda x: x + 1e-6 * across / np.linalg.norm(across) for name in ("point_a", "point_b")}
    assert counts(judged(right, **off)) == {"wrong_points": 1}
    assert judged(right, **off).points_error[one(found)] == pytest.approx(1e-6 / 1.9e-7, rel=0.3)
    # The same with a distance that is off by 1e-9 diagonals.
    slack = judged(right, **off, distance=lambda d: d + 1e-10)
    assert counts(slack) == {} and slack.points_error[one(found)] < 1.0


def test_a_wrong_answer_of_the_query_is_counted_in_its_cell(monkeypatch: pytest.MonkeyPatch):
    def broken(*asked: Any) -> Witness:
        found = query(*asked)
        found.distance[0, 0] += 1e-3
        return found

    task = Task("box", 0.1, ("near", "deep"), (PYTHON,), translations=(0.0, 1e3), queries=12, mujoco=0)
    right = list(forward_cells(task))
    monkeypatch.setattr(forward, "query", broken)
    bad = list(forward_cells(task))
    assert [wrong(cell.row()) for cell in right] == [0] * 4 and all(cell.queries == 12 for cell in right)
    # The first pose of each call, which asks for both translations.
    assert [cell.wrong_distance for cell in bad] == [1, 0] * 2
    assert bad[0].error_max == pytest.approx(1e-3 / tolerance(0.1, np.array([0.0]))[0], rel=0.3)
    assert bad[0].where == "box 0a and box 0b: pose 0 of 4" and right[0].where is right[0].refusal is None


@pytest.mark.parametrize("kind", ["ball", "box", "plate", "near-duplicates"])
def test_mujoco_agrees_with_the_truth(kind: Kind):
    for state in ("far", "near", "gap-1e-9", "deep"):
        made, found = posed(kind, 1e-3, state, 4)
        second = MujocoBodies(*made.pairs[0], 1e-3, precise=True).loop(found.T_a, found.T_b)()
        # It keeps vertices in single precision.
        np.testing.assert_allclose(second, found.truth.distance, rtol=1e-9, atol=1e-7 * 1e-3)
