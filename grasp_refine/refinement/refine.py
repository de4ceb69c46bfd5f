"""Refinement: hands move until their links touch the object where they should, penetrate nothing, and hold it."""

import time
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import choose, take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.profiling import stage
from grasp_refine.core.short_repr import labels, spread, tallied
from grasp_refine.refinement.closing import close_hands
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.force_closure_search import search
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.gap_closing import RELEASE_GAP_M, close_gaps
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.iteration_state import IterationCallback, with_callback
from grasp_refine.refinement.solvers.iterate import Minimum, Point, Progress, minimise
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

__all__ = ["Config", "Refinement", "Scene", "refine"]


JAW_DEPTH_M = 5e-4
"""Depth in metres at which jaws that were open are closed into the object first: from jaws that only touch with an edge
faces hardly turn onto each other."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """N refined grasps with status, loss and cost."""

    T_world_root: np.ndarray
    """Poses (N, 4, 4) of the base link: the best iterate of each grasp by true loss; of several attempts to make it
    hold (`force_closure_search`), the pose of the attempt with the best score."""
    q: np.ndarray
    """Joint values (N, n)."""
    touching: np.ndarray
    """Links (N, L) that were to touch the object."""
    target_link: np.ndarray
    """Targets on the links (N, L, 3), link frames, metres; NaN: none."""
    target_object: np.ndarray
    """Targets on the object (N, L, 3), object frame, metres; NaN: none."""
    status: np.ndarray
    """A `Status` for each grasp (N,)."""
    loss: np.ndarray
    """Loss in m^2 before and after (N, 2), without the force term; NaN where it is not known. Gaps at corners of
    patches count after only where they closed."""
    iterations: np.ndarray
    """Iterations of each grasp (N,), over all attempts."""
    queries: np.ndarray
    """Narrow-phase queries of each grasp (N,)."""
    wall_s: np.ndarray
    """Share of the wall time of each grasp (N,), seconds."""
    cpu_s: np.ndarray
    """Share of the CPU time of each grasp (N,), seconds."""
    starts: np.ndarray
    """Number of starts from which each grasp was tried (N,)."""
    closed_m: np.ndarray | None = None
    """Distance (N,) by which open jaws were closed first, as `ClosedHands.moved_m`; None: the hand has no jaws, or its
    links have targets."""

    def __repr__(self) -> str:
        ended = tallied(self.labels)
        return f"Refinement({count_text(len(self.q), 'grasp')}: {ended}; loss now {spread(self.loss[:, 1])} m^2)"

    @property
    def labels(self) -> np.ndarray:
        """Labels of `status` (N,), such as "converged"."""
        return labels(Status, self.status)


@stage("solver")
def refine(
    scene: Scene,
    config: Config | None = None,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
    *,
    prepared: HandObject | None = None,
) -> Refinement:
    """Refine the grasps of a scene.

    Args:
        scene: Hand, object, initial grasps and, optionally, targets.
        config: All settings; the defaults when None.
        progress: Called after each iteration.
        on_iteration: Called with the state after each iteration; an exception that it raises ends the refinement.
        prepared: Geometry of this hand and object; build it once to refine often, a few grasps at a time.

    Returns:
        The best iterate of each grasp by true loss. Not converging is a status, never an exception.

    Raises:
        GraspRefineError: an argument of another type, a link that should touch or a part to freeze does not exist,
            `prepared` is of another hand or object, or a first-order solver is to move an arm.
    """
    check_kind("scene", scene, Scene)
    check_kind("config", config, Config | None)
    check_kind("progress", progress, Progress | None)
    check_kind("on_iteration", on_iteration, IterationCallback | None)
    check_kind("prepared", prepared, HandObject | None)
    wall, cpu = time.perf_counter(), time.process_time()
    config = config or Config()
    if scene.hand.arm is not None and config.solver.needs_autograd:
        raise GraspRefineError("descent and adam move hands without an arm: use levenberg-marquardt for one on an arm")
    frozen = Frozen.of(scene.hand, config.freeze)
    prepared = prepared or HandObject.of(scene)
    if prepared.hand is not scene.hand or any(a is not b for a, b in zip_longest(prepared.objects, scene.objects)):
        raise GraspRefineError(f"prepared is {prepared!r}, not of the hand and the objects of {scene!r}")
    if scene.others and (config.solver.needs_autograd or config.terms):
        raise GraspRefineError("grasps on several objects need levenberg-marquardt, and no terms of your own")
    sound, original = scene.valid, scene
    status = np.where(sound, Status.RUNNING, np.where(scene.finite, Status.INVALID, Status.NOT_FINITE))
    status[scene.out_of_reach] = Status.OUT_OF_REACH
    starts = sound.astype(np.int64)
    # Contact links are chosen anew: the recorded links are of the input grasps.
    scene, closed = replace(scene.masked(sound), contact_gap=None), None
    if scene.hand.has_two_fingers and scene.target_link is None:
        # Jaws first close on the object; the hand moves by the remaining gap.
        closed = close_hands(scene, prepared, gap=-JAW_DEPTH_M, frozen=frozen.joints)
        scene = replace(scene, q=closed.q)
    if config.holds:
        reached = None
        if scene.target_link is not None:
            # Links first reach their targets from wherever they are; then other links touch, and forces balance.
            aims = goal_of(scene, config.contact_selection, prepared)
            ready = np.where(aims.touching.any(axis=1) | (status != Status.RUNNING), status, Status.NO_TARGET)
            reached = _solve(scene, prepared, aims, config, ready, progress, on_iteration)
        held = search(scene, prepared, config, status, progress, on_iteration, reached=reached)
        goal, found, starts = held.goal, held.minimum, held.starts
    else:
        goal = goal_of(scene, config.contact_selection, prepared, nearest=config.nearest)
        status[sound & ~goal.touching.any(axis=1)] = Status.NO_TARGET
        found = _solve(scene, prepared, goal, config, status, progress, on_iteration)
    unreachable = np.isin(found.status, (Status.STALLED, Status.BUDGET))
    off_surface = config.weights.contact * goal.off_surface
    found.status[unreachable & (off_surface > max(config.tolerance, OFF_SURFACE_LOSS_M2))] = Status.UNREACHABLE
    if config.holds:
        # Gaps that are too small to see are no reason to distrust a grasp.
        tiny = found.loss[:, 1] <= RELEASE_GAP_M**2
        found.status[tiny & np.isin(found.status, (Status.STALLED, Status.BUDGET))] = Status.CONVERGED
    hand, count = scene.hand, max(len(scene.q), 1)
    T, q = frozen.restore(found.point.T, found.point.q, original.T_world_root, original.q)
    T = np.where(sound[:, None, None], T, original.T_world_root)
    q = np.where(sound[:, None], np.clip(q, hand.lower, hand.upper), original.q)
    # The cost of work on all grasps together is divided evenly.
    wall, cpu = time.perf_counter() - wall - found.wall_s.sum(), time.process_time() - cpu - found.cpu_s.sum()
    return Refinement(
        T_world_root=T,
        q=q,
        touching=goal.touching,
        target_link=goal.target_link,
        target_object=goal.target_object,
        status=found.status,
        loss=np.where(np.isfinite(found.loss), found.loss, np.nan),
        iterations=found.iterations,
        queries=goal.queries + found.queries,
        wall_s=found.wall_s + wall / count,
        cpu_s=found.cpu_s + cpu / count,
        starts=starts,
        closed_m=None if closed is None else closed.moved_m,
    )


OFF_SURFACE_LOSS_M2 = 1e-8
"""Loss in m^2 from targets off their surfaces above which they are unreachable: that of a tenth of a millimetre."""


SINGLE_STAGE = "to the contacts"
"""Value of `IterationState.stage` for refinements of one stage."""


def _solve(
    scene: Scene,
    prepared: HandObject,
    goal: Goal,
    config: Config,
    status: np.ndarray,
    progress: Progress | None,
    on_iteration: IterationCallback | None,
) -> Minimum:
    """Refine in one stage: by gradients, or by least squares and, with targets, from inverse kinematics."""
    initial = Point(scene.T_world_root, np.clip(scene.q, scene.hand.lower, scene.hand.upper))
    settings: dict[str, Any] = {"seconds": config.seconds, "progress": progress}
    settings["on_iteration"] = with_callback(on_iteration, goal, SINGLE_STAGE)
    config = replace(config, weights=replace(config.weights, wrench=0.0))
    if config.solver.needs_autograd:
        # With pytorch-kinematics, which takes a second to load.
        from grasp_refine.refinement.objective import Objective

        objective = Objective(scene, goal, config, prepared)
        return minimise(objective, initial, config.solver, config.tolerance, status=status, **settings)
    problem = GraspProblem(scene, goal, config, prepared)
    if not goal.aimed.any():
        return close_gaps(problem, initial, config.solver, config.tolerance, status=status, **settings)
    before, num_queries = np.full(len(status), np.nan), np.zeros(len(status), dtype=np.int64)
    rows = np.flatnonzero(status == Status.RUNNING)
    for block in np.split(rows, range(config.width, len(rows), config.width)):
        known = problem.evaluate(block, take(initial, block), None)
        before[block], num_queries[block] = known.loss, known.num_queries
    status = np.where(before < config.tolerance, Status.CONVERGED, status)
    rows = np.flatnonzero(status == Status.RUNNING)
    start = Point(initial.T.copy(), initial.q.copy())
    reached = problem.solve_position_ik(rows, take(initial, rows))
    start.T[rows], start.q[rows] = reached.T, reached.q
    found = close_gaps(problem, start, config.solver, config.tolerance, status=status, **settings)
    # The input grasp may still be the best.
    first = before <= found.loss[:, 1]
    found.status[first & (found.status == Status.NOT_FINITE)] = Status.STALLED
    loss = np.stack([before, np.where(first, before, found.loss[:, 1])], axis=1)
    return replace(found, point=choose(first, initial, found.point), loss=loss, queries=found.queries + num_queries)
