"""Sampled grasps as a problem: N new grasps of a hand on an object."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from grasp_refine.core.array_types import Bool
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.rows import choose_rows
from grasp_refine.objects.source import check_object_name
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import AUTO, NEAREST, SAMPLE, ProblemSpec
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.scene_check import surroundings_notes

MAX_DRAWS, MAX_VAIN_DRAWS = 8, 2
"""Most draws of as many grasps as are wanted, for an arm that does not reach all; and while it has reached none."""


def check_sampled(spec: ProblemSpec) -> int:
    """Return the number of grasps to sample.

    Raises:
        GraspRefineError: it is no integer, or hand or object is not given.
    """
    request = str(spec.grasps)
    count = request.removeprefix(SAMPLE)
    if not (count.isascii() and count.isdigit() and int(count)):
        raise GraspRefineError(f"`grasps='{request}'`: {SAMPLE}N needs an integer N from 1 on, as in {SAMPLE}32")
    if spec.objects is not None or spec.object_name is not None:
        raise GraspRefineError(f"`objects` and `object_name` are for grasp files; `grasps='{request}'` needs `object`")
    if spec.object is not None:
        check_object_name(spec.object)
    missing = [f"`{name}`" for name in ("hand", "object") if getattr(spec, name) is None]
    if missing:
        raise GraspRefineError(f"`grasps='{request}'` needs a hand and an object: give {' and '.join(missing)}")
    if spec.targets not in (AUTO, NEAREST):
        raise GraspRefineError(f"`targets='{spec.targets}'`: has no rows for the grasps of `grasps='{request}'`")
    return int(count)


def with_samples(
    problem: Problem,
    index: tuple[int, ...],
    seed: int | tuple[int, ...],
    on_wait: Callable[[str], None],
    reaches: Callable[[GraspSet, Scene], Bool[np.ndarray, " N"]] | None = None,
) -> Problem:
    """Return a problem with the grasps that it asks for, sampled on its object among the bodies around that.

    Args:
        problem: Request of grasps, with one group without any.
        index: Numbers of the kept grasps; none: all.
        seed: Seed of the first draw.
        on_wait: Called with a line on what takes time.
        reaches: Mask (N,) of grasps that an arm reaches, in a scene: others are replaced from further draws, up
            to `MAX_DRAWS` in all; where none is reached, they are from the first draw. None: there is no arm.
    """
    from grasp_refine.sampling.sample import sample_grasps

    (group,) = problem.groups
    empty, count = group.scene, int(problem.sampled.removeprefix(SAMPLE))
    hand, obj = empty.hand, empty.object
    began = time.perf_counter()
    on_wait(f"sampling grasps of {hand.name} on {obj.name}")

    def draw(number: int) -> GraspSet:
        draw_seed = seed if number == 0 else (*(seed if isinstance(seed, tuple) else (seed, 0)), number)
        return sample_grasps(hand, obj, count, task=empty.task, seed=draw_seed)

    def posed(grasps: GraspSet) -> Scene:
        return replace(empty, T_world_root=transform_from_pose(grasps.hand_pose), q=grasps.q)

    grasps = draw(0)
    drawn, lacking = len(grasps), f"of {count_text(count, 'grasp')} of '{hand.name}' on '{obj.name}'"
    notes = [f"{obj.name}: {note}" for note in obj.notes]
    found = len(grasps)
    if reaches is not None:
        scene = posed(grasps)
        reached = [grasps.select(np.flatnonzero(reaches(grasps, scene)))]
        while (got := sum(map(len, reached))) < count and len(reached) < (MAX_DRAWS if got else MAX_VAIN_DRAWS):
            more = draw(len(reached))
            drawn += len(more)
            reached.append(more.select(np.flatnonzero(reaches(more, scene))))
        within = GraspSet.join(reached)
        found = min(len(within), count)
        grasps = within.select(np.arange(found)) if found else grasps
        lacking += " within reach of the arm"
    notes.append(f"sampled {count_text(drawn, 'grasp')} in {time.perf_counter() - began:.1f} s")
    if drawn > count and found == count:
        notes.append(f"the first {found} of them within reach of the arm are taken")
    if found < count:
        notes.append(f"found only {found} {lacking}")
    rows = choose_rows(grasps.object, object_name=None, index=index or None)
    grasps = replace(grasps, scale=np.full(len(grasps), group.scale)).select(rows)
    scene = posed(grasps)
    group = replace(group, scene=scene, grasps=grasps, rows=rows, index=rows, place=np.arange(len(rows)))
    notes += surroundings_notes([scene])
    return replace(problem, groups=(group,), notes=tuple(dict.fromkeys((*problem.notes, *notes))))
