"""Skipped work is told by the counters of the refinement, and never negative."""

from __future__ import annotations

from dataclasses import replace

import pytest

from grasp_refine.hands.self_collision import classify_pairs
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.queries.study import skips


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two grasps of the embedded hand on a convex object."""
    (group,) = load_problem(ProblemSpec(hand="allegro", object="rounded_box")).groups
    return replace(group.scene, T_world_root=group.scene.T_world_root[:2], q=group.scene.q[:2])


def test_counts_are_as_in_the_refinement(scene: Scene):
    queries, done, pairs, frames = skips("here", scene, 0, lambda share: None)
    found, hand, judged = refine(scene, Config()), scene.hand, classify_pairs(scene.hand)
    assert queries["with"] == found.queries.sum() and done["with"] == found.iterations.sum()
    assert done["without"] == 2 * found.iterations.max() and queries["without"] > 5 * queries["with"]
    assert (pairs["without"] - pairs["with"], pairs["with"]) == (judged.never, len(judged.checked))
    assert frames["without"] - frames["with"] == sum(link.body is None for link in hand.links)
    for row in (queries, done, pairs, frames):
        assert row["saved_share"] == pytest.approx(1 - row["with"] / row["without"]) and row["table"] == "skips"
