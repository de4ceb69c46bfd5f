"""Skips, undone: the work is done and counted, and the grasps that come out are the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine.hands.self_collision import candidate_pairs, judged_pairs
from grasp_refine.pipeline.load import load_problem
from grasp_refine.pipeline.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.losses import Weights
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine_apps.bench.queries.bodies import make_pairs
from grasp_refine_apps.bench.queries.cases import Case
from grasp_refine_apps.bench.queries.poses import draw_poses
from grasp_refine_apps.bench.queries.skip import Example, Skip, measure_calls, replace_attribute, several
from grasp_refine_apps.bench.queries.skips_querying import query_skips, unbounded
from grasp_refine_apps.bench.queries.skips_solving import (
    NUM_CONFIGURATIONS,
    curvature_skip,
    finished_skip,
    frame_skip,
    layer_skip,
)
from grasp_refine_apps.bench.queries.skips_starting import (
    _modules,
    decomposition_skip,
    import_skips,
    self_collision_skips,
)


@pytest.fixture(scope="module")
def example() -> Example:
    """Four grasps whose contacts close; forces do not count."""
    (group,) = load_problem(ProblemSpec(hand="allegro", object="rounded_box")).groups
    config = Config(weights=Weights(wrench=0.0), solver=LevenbergMarquardt(iterations=12))
    return Example("allegro", "rounded_box", group.scene, config)


def by_name(skips: list[Skip]) -> dict[str, Skip]:
    return {skip.skip: skip for skip in skips}


def test_grasps_come_again_disturbed_within_the_limits(example: Example):
    scene = several(example.scene, 11, 5)
    assert len(scene.q) == len(scene.T_world_root) == 11
    np.testing.assert_array_equal(scene.q[:4], example.scene.q)
    np.testing.assert_array_equal(scene.T_world_root[:4], example.scene.T_world_root)
    assert (scene.q >= scene.hand.lower).all() and (scene.q <= scene.hand.upper).all()
    palm = np.linalg.norm(scene.T_world_root[4:8, :3, 3] - example.scene.T_world_root[:, :3, 3], axis=1)
    assert (
        (palm > 1e-4).all() and (palm < 0.03).all() and (scene.q[4:] != example.scene.q[np.arange(7) % 4]).any(1).all()
    )
    np.testing.assert_array_equal(several(example.scene, 2, 5).q, example.scene.q[:2])


def test_every_piece_pair_is_asked_where_nothing_is_known_of_them():
    pairs = make_pairs(Case("concave", 4), 0)
    T = draw_poses(pairs, 0.004, 6, 0)
    plain, every = query(pairs, *T), query(unbounded(pairs), *T)
    assert (every.num_queries == 16).all() and (plain.num_queries < 16).all()
    np.testing.assert_allclose(every.distance, plain.distance, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(every.winner, plain.winner)


def test_queries_that_are_skipped_change_nothing_but_their_number(example: Example):
    found = by_name(list(query_skips(example, 1)))
    assert len(found) == 4
    # The other two have nothing to save here: no step is rejected, and what is asked first is right without a last one.
    for skip in found.values():
        assert 0 < skip.with_ <= skip.without and skip.difference < 1e-6
    assert found["links that are far from everything"].without > 5 * found["links that are far from everything"].with_
    # One piece against those of each link.
    assert found["pieces whose bounds cannot win"].without > found["pieces whose bounds cannot win"].with_


def test_grasps_that_are_done_leave_the_batch(example: Example):
    T = example.scene.T_world_root.copy()
    T[:, 0, 3] += [0.0, 0.02, -0.02, 0.01]
    shifted = replace(example, scene=replace(example.scene, T_world_root=T))
    skip, found = finished_skip(shifted, 1), shifted.refined()
    # All are in one batch, until the last one is done.
    assert skip.with_ == found.iterations.sum() < skip.without == 4 * found.iterations.max()
    assert skip.difference < 1e-6


def test_curvatures_are_fitted_where_forces_look(example: Example):
    scene = replace(example.scene, T_world_root=example.scene.T_world_root[:1], q=example.scene.q[:1])
    forces = Config(solver=LevenbergMarquardt(iterations=3), starts=1)
    skip = curvature_skip(Example("allegro", "rounded_box", scene, forces))
    assert skip.without % len(scene.links) == 0 and 0 < skip.with_ < 0.5 * skip.without


def test_the_layer_differentiates_where_a_loss_looks(example: Example):
    skip = layer_skip(example, 1)
    assert (skip.with_, skip.without) == (
        NUM_CONFIGURATIONS * len(example.scene.hand.contacts),
        NUM_CONFIGURATIONS * len(example.scene.links),
    )


def test_frames_of_links_without_bodies_are_not_computed(example: Example):
    hand, skip = example.scene.hand, frame_skip(example, 1)
    solid = [link for link in hand.links if link.body is not None]
    assert skip.without - skip.with_ == len(hand.links) - len(solid) > 0


def test_pairs_that_never_meet_are_found_once(example: Example):
    hand = example.scene.hand
    pairs, again = self_collision_skips(hand, 0, 1)
    judged = judged_pairs(hand)
    assert pairs.with_ == len(judged.watched) and pairs.without == pairs.with_ + judged.never
    assert len(candidate_pairs(hand)) == pairs.without + len(judged.at_rest) + len(judged.nearly_always)
    assert (again.without, again.with_) == (3129, 0) and again.cpu_with_s < 0.2 * again.cpu_without_s


def test_a_convex_object_is_not_cut(example: Example):
    skip = decomposition_skip(example.scene.object)
    assert (skip.without, skip.with_) == (1, 0) and skip.cpu_with_s < skip.cpu_without_s
    assert skip.how.endswith(" instead of 1")


def test_help_loads_few_modules():
    assert 20 < _modules(["--help"], everything=False) < 200


@pytest.mark.slow
def test_help_does_not_load_what_nobody_uses():
    (skip,) = import_skips(["--help"])
    assert skip.with_ < 200 and skip.without > 1500 and skip.cpu_with_s < 0.2 * skip.cpu_without_s


def test_rows_are_flat_and_say_what_is_saved():
    row = Skip("work", "steps", "here", 40, 10, 2.0, 0.5, "it was done").row()
    assert (row["saved_share"], row["cpu_saved_s"], row["difference"]) == (0.75, 1.5, None)
    assert json.loads(json.dumps(row)) == row and row["table"] == "skips"
    assert Skip("work", "steps", "here", 0, 0, None, None, "").row()["saved_share"] == 0.0


def test_what_is_replaced_comes_back():
    before = Path.cwd
    with pytest.raises(KeyError), replace_attribute(Path, "cwd", lambda: Path("elsewhere")):
        assert Path.cwd() == Path("elsewhere")
        raise KeyError
    assert Path.cwd == before


def test_several_rounds_are_timed_in_turn_after_a_first_time():
    called: list[str] = []
    found = measure_calls({name: (lambda name=name: called.append(name) or name) for name in "ab"}, 2)
    assert "".join(called) == "ababab" and {name: result for name, (result, _) in found.items()} == {"a": "a", "b": "b"}
    called.clear()
    measure_calls({"a": lambda: called.append("a")})
    assert called == ["a"]
