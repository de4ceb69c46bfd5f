"""Timelines of refinements, built from iterations that are only written down."""

import numpy as np
import pytest

from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.refinement.phases import PHASES
from grasp_refine.refinement.solvers.iterate import Point
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.trace import Recorder, Trace

MARGIN_M = 0.001
SLIDE, SETTLE = PHASES[0].name, PHASES[1].name


def pose(gap: float) -> Pose:
    """Both balls of the clamp as far from the object."""
    return Pose(np.eye(4), np.full(2, gap))


def iteration(stage: str, **gaps: float) -> IterationState:
    """An iteration of starts m0, m1, ... whose gaps are given; their losses are the squares."""
    gap, count = np.array([*gaps.values()]), len(gaps)
    point = Point(np.tile(np.eye(4), (count, 1, 1)), np.repeat(gap[:, None], 2, axis=1))
    touching = np.tile([True, True, False], (count, 1))
    member = np.array([int(name[1:]) for name in gaps])
    return IterationState(np.zeros(count, dtype=int), member, point, gap**2, touching, stage)


@pytest.fixture
def recorder(clamp: HandObject) -> Recorder:
    """A start alone, then two starts at once."""
    made = Recorder(clamp, pose(0.02), (), MARGIN_M)
    assert made.trace() is None
    for state in (
        iteration(SLIDE, m0=0.01),
        iteration(SETTLE, m0=0.006),
        iteration(SLIDE, m1=0.03, m2=0.008),
        iteration(SETTLE, m1=-0.003, m2=0.05),
    ):
        made.add(state)
    return made


def assert_shows(trace: Trace, gaps: list[float], labels: list[str]) -> None:
    np.testing.assert_allclose(trace.q[:, 0], gaps)
    assert trace.label == tuple(labels) and len(trace) == len(gaps)
    np.testing.assert_allclose(trace.loss[1:-1], np.square(gaps[1:-1]))


def test_the_first_start_that_is_not_done_is_followed_from_the_input_grasp_on(recorder: Recorder) -> None:
    trace = recorder.trace()
    assert trace is not None
    assert_shows(trace, [0.02, 0.03, -0.003], ["the input grasp", f"{SLIDE}, start 2", f"{SETTLE}, start 2"])
    np.testing.assert_allclose(trace.remaining, [0.019, 0.029, 0.004], atol=1e-9)
    np.testing.assert_allclose(trace.penetration, [0.0, 0.0, 0.003], atol=1e-9)
    np.testing.assert_array_equal(trace.gap, np.tile([MARGIN_M, MARGIN_M, np.nan], (3, 1)))
    assert trace.caption(2).startswith(f"{SETTLE}, start 2: iteration 3 of 3\n")


def test_the_result_ends_the_run_that_came_nearest_to_it(recorder: Recorder) -> None:
    gap = np.array([MARGIN_M, np.nan, np.nan])
    trace = recorder.result(pose(0.0495), gap, 4e-6)
    labels = ["the input grasp", f"{SLIDE}, start 3", f"{SETTLE}, start 3", "the best of all"]
    assert_shows(trace, [0.02, 0.008, 0.05, 0.0495], labels)
    assert trace.loss[-1] == 4e-6 and trace.remaining[-1] == pytest.approx(0.0485, abs=1e-9)
    first = recorder.result(pose(0.0061), gap, 0.0)
    assert_shows(first, [0.02, 0.01, 0.006, 0.0061], ["the input grasp", SLIDE, SETTLE, "the best of all"])


def test_many_iterations_play_faster() -> None:
    def trace(count: int) -> Trace:
        measures = dict.fromkeys(("loss", "remaining", "penetration"), np.zeros(count))
        poses = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 2))
        return Trace.of(*poses, gap=np.zeros((count, 3)), label=("",) * count, **measures)

    np.testing.assert_allclose(trace(5).time, 0.04 * np.arange(5))
    np.testing.assert_allclose(trace(1000).time, 0.01 * np.arange(1000))
