"""The refinement of the grasp that is shown, watched and interruptible."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.pipeline.problem import Group
from grasp_refine.pipeline.refine import refine_group
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import most_iterations
from grasp_refine.refinement.goal import goal_of
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.target import Target
from grasp_refine_apps.viewer.trace import Recorder, Trace
from grasp_refine_apps.viewer.worker import Control

SHOWN_EVERY = 0.04
"""Seconds between two states that are shown while a refinement runs."""


@dataclass(frozen=True, eq=False)
class Refined:
    """What became of a grasp."""

    pose: Pose
    """Where the hand is."""
    trace: Trace
    """How it came there."""
    outcome: Outcome
    """Before and after, one row."""


def refined(
    prepared: HandObject,
    scene: Scene,
    pose: Pose,
    targets: tuple[Target, ...],
    config: Config,
    control: Control,
    show: Callable[[Trace], None],
    group: Group,
) -> Refined:
    """Refine one grasp from where the hand is.

    Args:
        prepared: Hand and object.
        scene: The scene of this grasp.
        pose: Where the hand is.
        targets: Where links should touch; empty: anywhere.
        config: All settings.
        control: Is told how far it is, and stops it.
        show: Gets the iterations so far, often, and after each step of a paused refinement.
        group: The grasps that this one belongs to, for the names in what comes out.

    Raises:
        GraspRefineError: a link that should touch is not there.
        Stopped: nobody wants it any more.
    """
    scene = aimed(scene, pose, targets)
    config.contact_selection.named(scene.hand, scene.links)
    recorder = Recorder(prepared, targets, config.margin)
    held = config.holds and not targets
    most = most_iterations(config) if held else config.solver.iterations
    last, count = -np.inf, 0

    def watch(state: IterationState) -> None:
        nonlocal last, count
        control.check()
        recorder.see(state)
        count += 1
        now = time.monotonic()
        if now - last >= SHOWN_EVERY or control.paused:
            last = now
            control.tell(min(count / most, 1.0), f"{state.stage}, iteration {count}")
            trace = recorder.trace()
            if trace is not None:
                show(trace)

    control.tell(None, "preparing")
    alone = replace(group, scene=scene, rows=np.zeros(1, dtype=int), index=np.zeros(1, dtype=int))
    outcome = refine_group(
        alone, config, prepared=prepared, on_iteration=watch, on_opening=lambda *done: control.check()
    )
    end = Pose(transform_from_pose(outcome.hand_pose)[0], outcome.q[0])
    recorder.keep(end, outcome.touching[0], float(outcome.loss[0, 1]), "the best of all")
    trace = recorder.trace()
    assert trace is not None
    return Refined(end, trace, outcome)


def aimed(scene: Scene, pose: Pose, targets: tuple[Target, ...]) -> Scene:
    """The scene with the hand at a pose, and with other targets."""
    posed = replace(scene, T_world_root=pose.T_object_root[None], q=pose.q[None], direction=None)
    if not targets:
        return replace(posed, target_link=None, target_object=None)
    points = np.full((2, 1, len(scene.links), 3), np.nan)
    columns = list(scene.links)
    for target in targets:
        at = columns.index(target.link)
        # A link with several contact points has as many columns.
        columns[at] = columns[at] if columns.count(target.link) == 1 else ""
        points[:, 0, at] = target.point_link, target.point_object
    return replace(posed, target_link=points[0], target_object=points[1])


def targets_of(scene: Scene) -> tuple[Target, ...]:
    """The targets of the one grasp of a scene."""
    if scene.target_link is None or scene.target_object is None:
        return ()
    given = zip(scene.links, scene.target_link[0], scene.target_object[0], strict=True)
    return tuple(Target(*target) for target in given if np.isfinite(target[1:]).all())


def nearest_targets(prepared: HandObject, scene: Scene, pose: Pose, config: Config) -> tuple[Target, ...]:
    """Targets where the links that should touch are nearest to the object."""
    scene = aimed(scene, pose, ())
    goal = goal_of(scene, config.contact_selection, prepared, nearest=True)
    return targets_of(replace(scene, target_link=goal.target_link, target_object=goal.target_object))
