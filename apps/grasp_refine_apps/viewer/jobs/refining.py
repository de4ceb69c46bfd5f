"""Refinement of the shown grasp, with progress and interruption."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.measures.geometry import measure, worst_over_links
from grasp_refine.problem.problem import Group
from grasp_refine.problem.refine import refine_group
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import most_iterations
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.pose import Pose, Target, posed_scene, targets_of
from grasp_refine_apps.viewer.model.trace import Recorder, Trace

SHOW_PERIOD_S = 0.04
"""Seconds between two states shown while a refinement runs."""


@dataclass(frozen=True, eq=False)
class RefinedGrasp:
    """Result of the refinement of a grasp."""

    pose: Pose
    """Refined pose of the hand."""
    trace: Trace
    """Iterations of the refinement."""
    outcome: Outcome
    """Measures before and after, one row."""


def refine_grasp(
    prepared: HandObject,
    scene: Scene,
    pose: Pose,
    targets: tuple[Target, ...],
    config: Config,
    control: Control,
    show: Callable[[Trace], None],
    group: Group,
    counted: Counted | None = None,
) -> RefinedGrasp:
    """Refine one grasp from a pose of the hand.

    Args:
        prepared: Hand and object.
        scene: The scene of this grasp.
        pose: Initial pose of the hand.
        targets: Target points of links on the object; empty: links touch anywhere.
        config: All settings.
        control: Receives the progress, and can stop the refinement.
        show: Called with the iterations so far, often, and after each step of a paused refinement.
        group: Group of this grasp, for the names in the outcome.
        counted: Contact links of this grasp, as shown; None: from `contact_gaps`.

    Raises:
        GraspRefineError: a link that should touch does not exist.
        Stopped: the job was stopped.
    """
    scene = posed_scene(scene, pose, targets)
    if counted is not None:
        scene = replace(scene, contact_gap=counted.gap[None])
    config.contact_selection.named(scene.hand, scene.links)
    recorder = Recorder(prepared, pose, targets, config.margin, counted)
    max_count = most_iterations(config, aimed=bool(targets))
    last, count = -np.inf, 0

    def on_iteration(state: IterationState) -> None:
        nonlocal last, count
        control.check()
        recorder.add(state)
        count += 1
        now = time.monotonic()
        if now - last >= SHOW_PERIOD_S or control.paused:
            last = now
            control.report(min(count / max_count, 1.0), f"{state.stage}, iteration {count}")
            trace = recorder.trace()
            if trace is not None:
                show(trace)

    control.describe("preparing")
    alone = replace(group, scene=scene, rows=np.zeros(1, dtype=int), index=np.zeros(1, dtype=int))
    outcome = refine_group(
        alone, config, prepared=prepared, on_iteration=on_iteration, on_opening=lambda *done: control.check()
    )
    end = Pose(transform_from_pose(outcome.hand_pose)[0], outcome.q[0])
    trace = recorder.result(end, outcome.contact_gap[0], float(outcome["loss_m2"][0]))
    return RefinedGrasp(end, recounted(trace, scene, outcome), outcome)


def recounted(trace: Trace, scene: Scene, outcome: Outcome) -> Trace:
    """Return a trace with its measures, the remaining gap of each iteration over the contact links of the result.

    Each phase of a refinement chooses links anew, so that gaps of its own links do not compare.
    """
    count = len(trace)
    gap, target_link, target_object = (
        np.repeat(values, count, axis=0)
        for values in (outcome.contact_gap, outcome.target_point_link, outcome.target_point_object)
    )
    geometry = measure(
        HandObject.of(scene),
        trace.T_root,
        trace.q,
        target_link,
        target_object,
        gap,
        ~np.isnan(gap),
    )
    remaining = worst_over_links(geometry.contact_error)
    return replace(trace, gap=gap, remaining=remaining, penetration=geometry.penetration)


def nearest_targets(prepared: HandObject, scene: Scene, pose: Pose, config: Config) -> tuple[Target, ...]:
    """Return targets where the links that should touch are nearest to the object."""
    scene = posed_scene(scene, pose)
    goal = goal_of(scene, config.contact_selection, prepared, nearest=True)
    return targets_of(replace(scene, target_link=goal.target_link, target_object=goal.target_object))
