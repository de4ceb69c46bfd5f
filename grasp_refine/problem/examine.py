"""Checks of grasps that need the convex pieces of their objects: conventions, frames, surroundings, other pieces."""

from __future__ import annotations

from dataclasses import replace

from grasp_refine.problem.frame_check import frame_notes
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.recorded_objects import Recorded
from grasp_refine.scene.convention_check import convention_notes, refuse_conventions
from grasp_refine.scene.scene_check import surroundings_notes


def examined(problem: Problem, *, as_is: bool) -> Problem:
    """Return a problem with notes on its grasps and the pieces of its objects.

    Args:
        problem: Grasps, as read.
        as_is: Whether grasps that are most likely in another convention are noted, not refused.

    Raises:
        ConventionError: the grasps are most likely in another convention.
        GraspRefineError: an object is in the table or in a body of its scene.
    """
    scenes = [group.scene for group in problem.groups]
    doubts = convention_notes(scenes)
    if not as_is:
        refuse_conventions(doubts, *map(str, problem.files[:1]))
    found = (
        *(f"{group.object}: {note}" for group in problem.groups for note in group.scene.object.notes),
        *Recorded.of(problem.files).check_objects(problem.groups, other=True),
        *surroundings_notes(scenes),
        *doubts,
        *(() if doubts else frame_notes(scenes)),
    )
    return replace(problem, notes=tuple(dict.fromkeys((*problem.notes, *found))), convention_notes=doubts)
