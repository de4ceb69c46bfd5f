"""The forward cells of the benchmark of stability: states are what they say, and what is wrong is seen and counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from grasp_refine.collision import engine
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.mujoco_distance import MujocoBodies
from grasp_refine_apps.bench.stability import forward
from grasp_refine_apps.bench.stability.bodies import BodyPairs, make_pairs
from grasp_refine_apps.bench.stability.cases import (
    DIAGONALS,
    KINDS,
    STATE_DISTANCES,
    STATE_DISTANCES_M,
    STATES,
    Forward,
    Kind,
    State,
    Task,
    diagonals_of,
)
from grasp_refine_apps.bench.stability.forward import forward_cells
from grasp_refine_apps.bench.stability.judging import AnswerFaults, judge, tolerance
from grasp_refine_apps.bench.stability.poses import PosedBodies, pose_samplers
from grasp_refine_apps.bench.stability.rows import wrong

PYTHON = Forward(engine="python")


@pytest.mark.parametrize("diagonal", [1e-6, 0.1, 10.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_larger_body_of_a_pair_has_the_diagonal(kind: Kind, diagonal: float):
    made = make_pairs(kind, diagonal, 0)
    assert made.pairs
    for a, b in made.pairs:
        assert max(a.diagonal, b.diagonal) == pytest.approx(diagonal, rel=1e-12)


def test_kinds_are_what_they_are_called():
    made = {kind: make_pairs(kind, 0.1, 0).pairs for kind in KINDS}
    assert [len(body.pieces[0].vertices) for body in made["hull1000"][0]] == [1000, 300]
    assert [len(body.pieces) for body in made["concave40"][0]] == [40, 40]
    thickness = np.ptp(made["plate"][0][0].pieces[0].vertices, axis=0) / 0.1
    assert thickness.min() == pytest.approx(1e-4) and thickness.max() > 0.7
    copies = made["near-duplicates"][0][0].pieces[0].vertices / 0.1
    gaps = np.linalg.norm(copies[:, None] - copies, axis=2)[np.triu_indices(len(copies), 1)]
    assert gaps.min() < 1e-7 and 8 < len(copies)
    assert diagonals_of("box")[0] == 1e-6 and diagonals_of("ball") == DIAGONALS


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


def test_poses_are_the_same_again_and_others_with_another_seed():
    made = make_pairs("box", 0.1, 0)
    again, other = (pose_samplers(made, Task("box", 0.1, (), seed=seed))[0].pose("near", 8) for seed in (0, 1))
    first = pose_samplers(made, Task("box", 0.1, ("far", "near")))[0].pose("near", 8)
    np.testing.assert_array_equal(first.T_b, again.T_b)
    assert not np.array_equal(first.T_b, other.T_b)
    T_a, T_b = first.moved(1e3)
    np.testing.assert_allclose(np.linalg.norm(T_a[:, :3, 3] - first.T_a[:, :3, 3], axis=1), 1e3, rtol=1e-12)
    np.testing.assert_allclose(T_b[:, :3, 3] - T_a[:, :3, 3], first.T_b[:, :3, 3] - first.T_a[:, :3, 3], atol=1e-12)


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


def test_gaps_that_are_reported_as_contact_are_counted_and_are_no_fault():
    made, found = posed("box", 0.1, "gap-1e-9", 16)
    pairs = Pairs(*((body,) for body in made.pairs[0]), engine="python")
    right = query(pairs, found.T_a[:, None], found.T_b[:, None]).pairs(0), found, pairs
    before = judged(right)
    # In contact, the length of a normal changes no point.
    assert counts(judged(right, normal=lambda n: 1.001 * n)) == {"wrong_points": 1}
    touching = {"distance": lambda _: 0.0, "status": lambda _: QueryStatus.PENETRATING}
    after = judged(right, **touching)
    assert counts(after) == {} and after.collapsed.sum() == before.collapsed.sum() + 1
    # What rounding of the poses cannot tell is none.
    (T_a, T_b), w = found.moved(1e6), right[0]
    shut = replace(w, distance=np.zeros(16), point_b=w.point_a, status=np.full(16, QueryStatus.PENETRATING))
    move = (T_a - found.T_a)[:, :3, 3]
    shut = replace(shut, point_a=w.point_a + move, point_b=w.point_a + move)
    assert not judge(shut, found.truth, pairs.piece_pairs, T_a, T_b, 0.1).collapsed.any()


def test_points_that_are_not_the_only_ones_have_to_be_on_the_bodies():
    made, found = posed("box", 0.1, "face-face", 16, pair=1)
    pairs = Pairs(*((body,) for body in made.pairs[1]), engine="python")
    right = query(pairs, found.T_a[:, None], found.T_b[:, None]).pairs(0), found, pairs
    assert not found.truth.unique.any() and counts(judged(right)) == {}
    # Along the faces, but beyond their ends.
    along = np.cross(right[0].normal[-1], [0.3, 0.5, 0.8])
    beyond = {name: lambda x: x + along for name in ("point_a", "point_b")}
    assert counts(judged(right, **beyond)) == {"wrong_points": 1}


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


def test_ways_to_ask():
    ways = (PYTHON, Forward("float32", engine="python"), Forward(batch=1, engine="python"))
    cells = list(forward_cells(Task("ball", 1e-3, ("gap-1e-6",), ways, (), (0.0, 1e6), queries=20, mujoco=4)))
    assert [(cell.dtype, cell.batch, cell.translation) for cell in cells] == [
        (way.dtype, way.batch, far) for way in ways for far in (0.0, 1e6)
    ]
    assert [wrong(cell.row()) for cell in cells] == [0] * 6 and sum(cell.mujoco_queries for cell in cells) == 5
    # Poses in single precision are rounded; how many are asked at once changes nothing.
    assert cells[1].distance_error_max_m > 100 * cells[0].distance_error_max_m
    assert cells[2].distance_error_max_m > 100 * cells[0].distance_error_max_m
    assert cells[4].distance_error_max_m == cells[0].distance_error_max_m


def test_an_engine_that_refuses_is_a_message_not_an_end(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(engine, "why_not_native", lambda: "does not load")
    way = replace(PYTHON, engine="native")
    cells = list(forward_cells(Task("box", 0.1, ("near",), (way,), queries=6, mujoco=0)))
    assert [(cell.queries, cell.refused, wrong(cell.row())) for cell in cells] == [(6, 6, 0)]
    assert cells[0].refusal is not None and "\n" not in cells[0].refusal
    assert all(name in cells[0].refusal for name in ("engine is 'native'", "does not load", "python"))


def test_a_query_that_refuses_is_a_fault(monkeypatch: pytest.MonkeyPatch):
    def refuses(*asked: Any) -> Witness:
        raise GraspRefineError("nothing can be answered")

    monkeypatch.setattr(forward, "query", refuses)
    (cell,) = forward_cells(Task("slivers", 0.1, ("near",), (PYTHON,), queries=8))
    # The pair that could not be built was never asked.
    assert (cell.queries, cell.refused, cell.failed, wrong(cell.row())) == (8, 2, 6, 6)
    assert cell.where == "nothing can be answered" and "flat" in cell.refusal


@pytest.mark.parametrize("kind", ["ball", "box", "plate", "near-duplicates"])
def test_mujoco_agrees_with_the_truth(kind: Kind):
    for state in ("far", "near", "gap-1e-9", "deep"):
        made, found = posed(kind, 1e-3, state, 4)
        second = MujocoBodies(*made.pairs[0], 1e-3, precise=True).loop(found.T_a, found.T_b)()
        # It keeps vertices in single precision.
        np.testing.assert_allclose(second, found.truth.distance, rtol=1e-9, atol=1e-7 * 1e-3)
