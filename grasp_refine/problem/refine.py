"""Refinement of a problem: each group of grasps is refined and measured and, on request, simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.closing.motion import Motion, closing_motion
from grasp_refine.core.array_records import join, take
from grasp_refine.hands.self_collision import ignored_overlaps
from grasp_refine.measures.measures import SIDES
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.scanned import EFFORT, refine_scanned
from grasp_refine.problem.together import sets_of, together
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.closing import closing_notes
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.iteration_state import IterationCallback
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.iterate import Progress
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.engine_table import MUJOCO, EngineChoice, EngineName
from grasp_refine.validation.trials import Trials

if TYPE_CHECKING:
    from grasp_refine.validation.engines.mujoco.world import World


WORTH_MOVING = 0.1
"""Quality by which a transferred grasp must be better away from its original's contacts, unless it is good enough."""


class Listener:
    """Callbacks of the progress of `refine_problem`; a subclass overrides the ones that it needs."""

    def refining(self, groups: Sequence[Group]) -> Progress | None:
        """Return the progress callback of the refinement of groups that are refined together, which begins now."""
        return None

    def note(self, line: str) -> None:
        """Receive a note for the user on the refined grasps, or on the hand that is refined or simulated."""

    def simulating(self, group: Group) -> Callable[[str, float], None]:
        """Return the callback of the simulation of a group: name of the simulation, number of finished grasps."""
        return lambda what, done: None


def refine_problem(
    problem: Problem,
    config: Config | None = None,
    *,
    engines: Sequence[EngineChoice] = (),
    listener: Listener | None = None,
    cache: InputCache | None = None,
    threads: int | None = None,
    on_refined: Callable[[RefinedGrasps], None] = lambda refined: None,
    parts: Sequence[Outcome] | None = None,
) -> RefinedGrasps:
    """Refine and measure all grasps of a problem, and, on request, simulate its task with them before and after.

    Simulated worlds are built first, so that a hand that MuJoCo refuses costs no refinement.

    Args:
        problem: Hand, objects, grasps and task.
        config: All settings of the refinement; the defaults when None.
        engines: Names of the engines that simulate them; the first one decides; none: they are not simulated.
        listener: Callbacks of the progress.
        cache: Keeps hands and worlds of the simulation for the next problem.
        threads: CPU threads of the simulation; by default as many as there are.
        on_refined: Called with the refined grasps before they are simulated.
        parts: Outcomes of its groups, by `refine_groups`; None: they are refined here.

    Raises:
        GraspRefineError: a link that should touch does not exist, or MuJoCo cannot compile the hand or the world, or
            an engine cannot be used.
    """
    config, listener = config or Config(), listener or Listener()
    worlds = worlds_of(problem, cache=cache, on_note=listener.note) if engines else None
    parts = parts if parts is not None else refine_groups(problem.groups, config, listener)
    outcome = Outcome.join(parts).select(problem.order)
    if ignored := ignored_overlaps(problem.hand, outcome.q):
        listener.note(ignored)
    refined = RefinedGrasps(problem, config, outcome)
    on_refined(refined)
    if worlds is None:
        return refined
    return replace(refined, simulated=_simulate(problem, parts, worlds, listener, threads, engines))


def refine_groups(groups: Sequence[Group], config: Config, listener: Listener) -> list[Outcome]:
    """Refine groups, of one problem or of several, together where they can be; return the outcome of each.

    Raises:
        GraspRefineError: a link that should touch does not exist.
    """
    parts = [
        part
        for some in sets_of(groups, config)
        for part in refine_together(some, config, progress=listener.refining(some), on_note=listener.note)
    ]
    return _without_targets(groups, parts, config, listener)


def _without_targets(
    groups: Sequence[Group], parts: Sequence[Outcome], config: Config, listener: Listener
) -> list[Outcome]:
    """Return outcomes in which transferred grasps that hardly hold at their originals' contacts are refined without.

    A grasp without targets counts where it is good enough, or better by `WORTH_MOVING`.
    """
    weak = [
        np.flatnonzero(~(part.quality[:, 1] >= config.confidence) & ~np.isnan(group.scene.target_link).all(axis=(1, 2)))
        if group.scene.original is not None and group.scene.target_link is not None and config.holds
        else np.zeros(0, dtype=np.int64)
        for group, part in zip(groups, parts, strict=True)
    ]
    again = [group.select(rows) for group, rows in zip(groups, weak, strict=True) if len(rows)]
    free = [replace(group, scene=replace(group.scene, target_link=None, target_object=None)) for group in again]
    found = iter(
        part for some in sets_of(free, config) for part in refine_together(some, config, on_note=listener.note)
    )
    return [
        _better(part, rows, next(found), config) if len(rows) else part for part, rows in zip(parts, weak, strict=True)
    ]


def _better(first: Outcome, rows: np.ndarray, second: Outcome, config: Config) -> Outcome:
    """Return an outcome with those of its `rows` that a second refinement made better; effort is that of both."""
    quality, before = np.nan_to_num(second.quality[:, 1]), np.nan_to_num(first.quality[rows, 1])
    better = (quality >= config.confidence) | (quality > before + WORTH_MOVING)
    place = np.arange(len(first))
    place[rows[better]] = len(first) + np.flatnonzero(better)
    effort = {name: first[name].copy() for name in EFFORT}
    for name, values in effort.items():
        values[rows] += second[name]
    found = take(join(first, second), place)
    return replace(found, measures={**found.measures, **effort})


def refine_group(
    group: Group,
    config: Config,
    *,
    prepared: HandObject | None = None,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
    on_opening: Progress | None = None,
    on_note: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Refine the grasps of one object, give them pregrasps and squeezes, and measure them before and after.

    Args:
        group: The grasps.
        config: All settings of the refinement.
        prepared: Geometry of their hand and object; None: built here.
        progress: As for `refine`.
        on_iteration: As the `on_iteration` of `refine`.
        on_opening: As the `progress` of `closing_motion`.
        on_note: Called with notes for the user on open jaws.

    Raises:
        GraspRefineError: a link that should touch does not exist.
    """
    (outcome,) = refine_together(
        [group],
        config,
        prepared=prepared,
        progress=progress,
        on_iteration=on_iteration,
        on_opening=on_opening,
        on_note=on_note,
    )
    return outcome


def refine_together(
    groups: Sequence[Group],
    config: Config,
    *,
    prepared: HandObject | None = None,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
    on_opening: Progress | None = None,
    on_note: Callable[[str], None] = lambda line: None,
) -> list[Outcome]:
    """Refine groups of a set of `sets_of` in one batch; arguments are as for `refine_group`."""
    if groups[0].scene.object.hypotheses:
        return [refine_scanned(group, config, progress, on_iteration) for group in groups]
    scene = together([group.scene for group in groups])
    prepared = prepared or HandObject.of(scene)
    refinement = refine(scene, config, progress, on_iteration, prepared=prepared)
    for note in () if refinement.closed_m is None else closing_notes(refinement.closed_m, jaws=True):
        on_note(note)
    alone = dict(zip(prepared.objects, prepared.alone, strict=True))
    outcomes, begin = [], 0
    for group in groups:
        before, found = group.scene, take(refinement, slice(begin, begin + len(group.rows)))
        begin += len(group.rows)
        after = replace(before, T_world_root=found.T_world_root, q=found.q)
        outcome = compare(
            before,
            found,
            closing_motion(after, alone[before.object], on_opening, pressure=config.pressure),
            margin=config.margin,
            clearance=clearances(config, scene.hand, prepared.chain),
            selection=config.contact_selection,
            name=group.object,
            scale=group.scale,
            row=group.rows,
            index=group.index,
        )
        outcomes.append(replace(outcome, labels=group.grasps.labels))
    return outcomes


def simulate_refined(
    refined: RefinedGrasps,
    *,
    listener: Listener | None = None,
    cache: InputCache | None = None,
    threads: int | None = None,
    engines: Sequence[EngineChoice] = (MUJOCO,),
) -> SimulatedGrasps:
    """Simulate the task of refined grasps with them as they were given and as they are now.

    Arguments are as in `refine_problem`.

    Raises:
        GraspRefineError: MuJoCo cannot compile the hand or the world, or an engine cannot be used.
    """
    problem, listener = refined.problem, listener or Listener()
    worlds = worlds_of(problem, cache=cache, on_note=listener.note)
    parts = [refined.outcome.select(group.place) for group in problem.groups]
    return _simulate(problem, parts, worlds, listener, threads, engines)


def _simulate(
    problem: Problem,
    parts: Sequence[Outcome],
    worlds: Sequence[World],
    listener: Listener,
    threads: int | None,
    engines: Sequence[EngineChoice],
) -> SimulatedGrasps:
    """Simulate the grasps of each group in its world, before and after; `parts` are the outcomes of the groups."""
    from grasp_refine.validation.engine_table import ENGINES, chosen_engines, engine_of
    from grasp_refine.validation.robustness import judge
    from grasp_refine.validation.set_points import clipping_note

    names = chosen_engines(engines, worlds, listener.note)
    trials: dict[EngineName, tuple[list[Trials], list[Trials]]] = {name: ([], []) for name in names}
    motions: list[Motion] = []
    for group, part, world in zip(problem.groups, parts, worlds, strict=True):
        report = listener.simulating(group)
        motions.append(part.motion)
        for name, sides in trials.items():
            engine = engine_of(name, world)
            for motion, found, when in zip((group.motion(), part.motion), sides, SIDES, strict=True):
                progress = partial(report, f"simulating in {ENGINES[name].title}, {when}")
                found.append(
                    judge(world, motion, numbers=group.rows, threads=threads, progress=progress, engine=engine)
                )
    if clipped := clipping_note(worlds, motions):
        listener.note(clipped)
    order = problem.order
    protocol = problem.task.test(patches=problem.hand.patches)
    before, after = (
        {name: Trials.join(sides[side]).select(order) for name, sides in trials.items()} for side in (0, 1)
    )
    return SimulatedGrasps(protocol, before, problem.closing(), after)
