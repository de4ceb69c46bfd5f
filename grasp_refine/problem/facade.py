"""Functions of `import grasp_refine as gr`: refine, evaluate, simulate and show grasps that are in memory."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.grasps.on_arm import on_arm
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, as_object
from grasp_refine.problem.arms import arm_clearance
from grasp_refine.problem.examine import examined
from grasp_refine.problem.margins import GraspMargins, problem_margins
from grasp_refine.problem.problem import Group, Problem, scene_of
from grasp_refine.problem.refine import Listener, refine_problem, simulate_refined
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.transferred import at_rest, transferred
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.terms.term import Term
from grasp_refine.results.console import html_of, text_of
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.results.validation_table import validation_table
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import as_task
from grasp_refine.transfers.key_points import KeyPoints
from grasp_refine.validation.engine_table import MUJOCO, EngineChoice, chosen_engines
from grasp_refine.validation.margins.factors import Factors
from grasp_refine.validation.validate import Validated, validate

if TYPE_CHECKING:
    from grasp_refine.objects.object import Mesh

VIEWERS = "grasp_refine.viewers"
"""Group of entry points of viewers: functions that show `RefinedGrasps` or a `Problem` and return the viewer."""


def problem_of(
    hand: Hand,
    obj: Object | Mesh,
    grasps: GraspSet,
    *,
    task: Task | str | Path | None = None,
    as_is: bool = False,
) -> Problem:
    """Return grasps of a hand on an object as a problem, in memory.

    Args:
        hand: The hand.
        obj: The object, or its mesh as for `load_object`, in metres; scales of the grasps apply to its mesh.
        grasps: Grasps on this object alone, joint values by name.
        task: What the grasps must do, and where: a `Task`, or its name or file, as of `load_task`. Its `base` is needed
            for a hand on an arm and grasps that give poses of its palm, which inverse kinematics reaches.
        as_is: Whether to take grasps that are most likely in other units, quaternions or frames than the arguments of
            `GraspSet`, such as joint values in degrees; they are then warned about, not refused.

    Raises:
        ConventionError: the grasps are most likely in another convention.
        GraspRefineError: an argument of another type, grasps of several objects, or of other joints, or a region that
            cannot be used.
    """
    check_kind("hand", hand, Hand)
    obj = as_object("object", obj)
    check_kind("grasps", grasps, GraspSet)
    names = list(dict.fromkeys(grasps.object.tolist()))
    if len(names) > 1 or len(np.unique(grasps.scale)) > 1:
        listing = ", ".join(f"{name} ({np.count_nonzero(grasps.object == name)})" for name in names)
        raise GraspRefineError(
            f"the grasps are on several objects or scales: {listing}; choose the grasps on {obj.name} with "
            "grasps.select(...), or give the file to load_problem"
        )
    task = as_task(task)
    notes: tuple[str, ...] = ()
    if hand.arm is not None and grasps.base_link == hand.palm != hand.base_link:
        if task.base is None:
            raise GraspRefineError(f"{hand.name} needs the pose of its base: task=Task(base=[x, y, z, ...])")
        grasps, notes = on_arm(grasps, hand, task.T_object_base, clearance=arm_clearance(hand, obj, task))
    if grasps.base_link != hand.base_link:
        of = "" if grasps.hand == hand.name else f"the grasps are of hand '{grasps.hand}', not '{hand.name}'; "
        raise GraspRefineError(
            f"{of}the grasps give poses of link '{grasps.base_link}', the hand begins at '{hand.base_link}': "
            f"load_hand(..., base_link='{grasps.base_link}')"
        )
    q, matched = match_joints(grasps, hand)
    rows = np.arange(len(grasps))
    made = scene_of(hand, obj, grasps, q, task)
    name, scale = (names[0], float(grasps.scale[0])) if names else (obj.name, 1.0)
    group = Group(name, scale, made, grasps, rows, rows, rows)
    problem = examined(Problem(hand, (), (group,), (*hand.notes, *notes, *matched)), as_is=as_is)
    for note in problem.convention_notes:
        warnings.warn(note, stacklevel=2)
    return problem


def refine(
    hand: Hand | Problem,
    object: Object | Mesh | None = None,
    grasps: GraspSet | None = None,
    config: Config | None = None,
    *,
    task: Task | str | Path | None = None,
    terms: Sequence[Term] = (),
    as_is: bool = False,
    listener: Listener | None = None,
) -> RefinedGrasps:
    """Refine grasps of a hand on an object until its links touch, penetrate nothing and hold.

        hand, mug = gr.load_hand("allegro"), gr.load_object("mug")
        grasps = gr.GraspSet.of(hand, pose, q)      # (N, 7), (N, n); or gr.sample_grasps(hand, mug, 16)
        refined = gr.refine(hand, mug, grasps, task=gr.Task(table=-0.05))
        refined.after.hand_pose, refined.after.q    # (N, 7), (N, n)
        refined.quality                             # (N, 2), before and after, from 0 to 1

    Poses are of the hand's base link in the object's frame: x, y, z in metres, then the quaternion w, x, y, z.
    Joint values are in radians, or metres of joints that slide, in the order of `hand.joint_names`.

    Args:
        hand: The hand; or a problem of `load_problem`, which has object and grasps.
        object: The object, or its mesh as for `load_object`, in metres.
        grasps: N grasps on it, whose joint values are matched by name.
        config: Settings: solver, weights, bounds on the movement; the defaults when None.
        task: What the grasps must do, and where: a `Task`, or its name or file, as of `load_task`.
        terms: Terms of your own, minimised beside ours: after the terms of the settings. `check_term` checks them.
        as_is: Whether to take grasps that are most likely in other units, quaternions or frames, as of `problem_of`.
        listener: Callbacks of the progress.

    Returns:
        The N grasps before and after, in their order, with status, measures, pregrasps, squeezes and the contact forces
        of the squeezes in newtons. A grasp that does not converge has a status that says so.

    Raises:
        GraspRefineError: an argument of another type, grasps of another hand or of several objects, or a term that
            does not fit.
    """
    check_kind("config", config, Config | None)
    if terms:
        config = config or Config()
        config = replace(config, terms=(*config.terms, *terms))
    problem = _problem(hand, object, grasps, task, as_is=as_is)
    return refine_problem(problem, config, listener=listener)


def transfer(
    hand: Hand | Problem | KeyPoints,
    object: Object | Mesh | None = None,
    grasps: GraspSet | None = None,
    *,
    to: Hand,
    config: Config | None = None,
    task: Task | str | Path | None = None,
    as_is: bool = False,
    listener: Listener | None = None,
) -> RefinedGrasps:
    """Transfer grasps of one hand to another, and refine them.

        refined = gr.transfer(shadow, mug, grasps, to=allegro)
        refined.outcome.fidelity                    # (N,), such as "same grasp" or "fingers dropped"
        refined.outcome["original_pinch_shift_m"]   # (N,), thumb and opposing finger from the original's contacts

    The thumb takes the place of the thumb, and the other fingers keep their order from its side on, by the geometry of
    both hands. Fingers touch the object where the fingers in whose places they are do, and the palm comes from the same
    side; then the grasps are refined as of `refine`.

    Args:
        hand: The hand of the grasps; or a problem of `load_problem`, which has object and grasps; or the grasps of a
            human hand, `KeyPoints`.
        object: The object, or its mesh as for `load_object`, in metres.
        grasps: N grasps on it.
        to: The other hand.
        config: Settings of the refinement; the defaults when None.
        task: What the grasps must do, and where, as of `load_task`.
        as_is: Whether to take grasps that are most likely in other units, quaternions or frames, as of `problem_of`.
        listener: Callbacks of the progress.

    Raises:
        GraspRefineError: an argument of another type, a hand on an arm, or one that cannot grip.
    """
    check_kind("to", to, Hand)
    check_kind("config", config, Config | None)
    if isinstance(hand, KeyPoints):
        if object is None or grasps is not None:
            raise GraspRefineError("key points are grasps: give them and their object alone")
        obj, (T, q), rows = as_object("object", object), at_rest(to, len(hand)), np.arange(len(hand))
        places = Group(obj.name, 1.0, Scene(to, obj, T, q, task=as_task(task)), GraspSet.of(to, T, q), rows, rows, rows)
        return refine_problem(transferred(Problem(to, (), (places,), ()), to, hand), config, listener=listener)
    problem = _problem(hand, object, grasps, task, as_is=as_is)
    return refine_problem(transferred(problem, to), config, listener=listener)


def simulate(
    refined: RefinedGrasps,
    task: Task | str | Path | None = None,
    *,
    engines: Sequence[EngineChoice] = (MUJOCO,),
    listener: Listener | None = None,
) -> SimulatedGrasps:
    """Simulate the task of refined grasps with them, before and after their refinement.

    Args:
        refined: Result of `refine`.
        task: Another task, as of `load_task`, which counts where it names something. None: the task of the
            refinement, with protocol `scene` in a scene, else `dexgraspbench`, where it names none.
        engines: Names of engines, the first one decides, or "all": every installed one that can simulate this.
        listener: Callbacks of the progress.

    Raises:
        GraspRefineError: there is no such task or engine, or MuJoCo cannot compile the hand or the world.
    """
    check_kind("refined", refined, RefinedGrasps)
    return simulate_refined(
        replace(refined, problem=refined.problem.for_task(task)), listener=listener, engines=engines
    )


def evaluate(
    hand: Hand | Problem,
    object: Object | Mesh | None = None,
    grasps: GraspSet | None = None,
    task: Task | str | Path | None = None,
    *,
    engines: Sequence[EngineChoice] = (MUJOCO,),
    as_is: bool = False,
) -> Evaluation:
    """Measure grasps as they are, refined or not, and, for a task with a protocol, simulate them.

    Args:
        hand: The hand; or a problem of `load_problem`.
        object: The object, or its mesh as for `load_object`, in metres.
        grasps: Grasps on it, with their own pregrasps and squeezes where they have some.
        task: What the grasps must do, and where, as of `load_task`. Without a protocol, nothing is simulated.
        engines: As for `simulate`.
        as_is: Whether to take grasps that are most likely in other units, quaternions or frames, as of `problem_of`.

    Raises:
        GraspRefineError: an argument of another type, grasps of another hand or of several objects.
    """
    problem = _problem(hand, object, grasps, task, as_is=as_is)
    simulated = problem.task.protocol is not None
    if not simulated and tuple(engines) != (MUJOCO,):
        raise GraspRefineError("engines simulate tasks with a protocol: give evaluate one, as task='dexgraspbench'")
    worlds = worlds_of(problem) if simulated else [None] * len(problem.groups)
    names = chosen_engines(engines, [world for world in worlds if world is not None])
    parts = []
    for group, world in zip(problem.groups, worlds, strict=True):
        labels: dict[str, Any] = {"name": group.object, "scale": group.scale, "rows": group.rows, "index": group.index}
        motion = None if world is None else group.motion()
        parts.append(validate(group.scene, **labels, world=world, motion=motion, engines=names))
    chosen = problem.task.test(patches=problem.hand.patches) if simulated else None
    return Evaluation(problem, chosen, Validated.join(parts).select(problem.order))


def margins(
    hand: Hand | Problem,
    object: Object | Mesh | None = None,
    grasps: GraspSet | None = None,
    task: Task | str | Path | None = None,
    *,
    factors: Factors | None = None,
    draws: int = 32,
    seed: int = 0,
    with_limits: bool = True,
    as_is: bool = False,
    listener: Listener | None = None,
) -> GraspMargins:
    """Simulate each grasp in drawn worlds around the world of a task, and search the limits of the grasp.

    Args:
        hand: The hand; or a problem of `load_problem`.
        object: The object, or its mesh as for `load_object`, in metres.
        grasps: Grasps on it, with their own pregrasps and squeezes where they have some.
        task: What the grasps must do, and where, as of `load_task`, for everything that is not drawn. Its protocol, by
            default `dexgraspbench`, pushes.
        factors: Ranges of the random factors; the defaults when None.
        draws: Number of drawn worlds, the same for all grasps.
        seed: Seed of the draws: with the same one, results of other grasps are compared in the same worlds.
        with_limits: Whether lowest friction, largest force and largest torque are searched too.
        as_is: Whether to take grasps that are most likely in other units, quaternions or frames, as of `problem_of`.
        listener: Callbacks of the progress.

    Raises:
        GraspRefineError: an argument of another type, grasps of another hand, or a protocol that lifts.
    """
    check_kind("factors", factors, Factors | None)
    problem = _problem(hand, object, grasps, task, as_is=as_is)
    return problem_margins(problem, factors, draws=draws, seed=seed, with_limits=with_limits, listener=listener)


def view(grasps: RefinedGrasps | Problem) -> Any:
    """Show grasps in a browser and return the viewer; its `address` is the page's, `close()` ends it.

    Args:
        grasps: Refined grasps, shown with what they were before and their measures; or a problem.

    Raises:
        GraspRefineError: no viewer is registered, as in a checkout that is not installed.
    """
    check_kind("grasps", grasps, RefinedGrasps | Problem)
    viewers = entry_points(group=VIEWERS)
    if not viewers:
        raise GraspRefineError("no viewer is registered: install grasp-refine again, a checkout by pip install -e .")
    return next(iter(viewers)).load()(grasps)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Measures of N grasps and, where they were simulated, their trials."""

    problem: Problem
    """Hand, objects and grasps."""
    protocol: Protocol | None
    """Protocol of the simulation; None: not simulated."""
    validated: Validated
    """Measures and trials, in the requested order of the grasps."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.validated)

    @property
    def quality(self) -> np.ndarray:
        """Estimated quality (N,) from 0 to 1; NaN without contacts."""
        return self.validated.metrics.quality

    @property
    def held(self) -> np.ndarray:
        """True where a grasp (N,) held in simulation.

        Raises:
            GraspRefineError: they were not simulated.
        """
        if self.protocol is None:
            raise GraspRefineError("the grasps were not simulated: evaluate(..., task='dexgraspbench')")
        return self.validated.success

    def table(self, *, verbose: bool = False) -> RenderableType:
        """Return the table of `refine-grasp validate`, for a console of rich; `verbose` lists all of many grasps."""
        return validation_table(self.validated, self.problem.hand.name, self.protocol, (), verbose=verbose)

    def __repr__(self) -> str:
        return f"Evaluation({count_text(len(self), 'grasp')} of {self.problem.hand.name}: {self.validated.metrics})"

    def __str__(self) -> str:
        return text_of(self.table())

    def _repr_html_(self) -> str:
        """Return the table as HTML, for a notebook."""
        return html_of(self.table())


def _problem(
    hand: Hand | Problem,
    obj: Object | Mesh | None,
    grasps: GraspSet | None,
    task: Task | str | Path | None,
    *,
    as_is: bool,
) -> Problem:
    if isinstance(hand, Problem):
        if obj is not None or grasps is not None:
            raise GraspRefineError("a problem has its object and grasps: give it alone")
        return hand.for_task(task)
    if obj is None or grasps is None:
        raise GraspRefineError("a hand, an object and grasps are needed, or a problem of load_problem")
    return problem_of(hand, obj, grasps, task=task, as_is=as_is)
