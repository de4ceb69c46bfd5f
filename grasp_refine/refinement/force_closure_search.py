"""Search for force closure: grasps whose contacts touch and whose forces balance, from one start or several.

Attempts go from small changes to large ones: first the input grasp with its contacts closed, then with forces that
balance, held back to the input grasp less and less, and then, where the grasp is still not good enough, from starts
nearby, the nearest first. Each attempt goes through `PHASES`, which choose the contact links anew. `Config.prefer` says
which attempt counts, without any simulation: the nearest of those that are good enough, by `Displacement`, or the
strongest.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_records import join, take
from grasp_refine.core.se3 import exp_so3, matvec
from grasp_refine.forces.quality import DEEP
from grasp_refine.hands.displacement import Displacement
from grasp_refine.measures.formulas import room_share
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.gap_closing import close_gaps, release_links, release_targets
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.iteration_state import IterationCallback, with_callback
from grasp_refine.refinement.judging import MISS_SCALE_M, judge, original_miss, target_miss
from grasp_refine.refinement.phases import CLOSE, KEEP, PHASES, STAYS, Phase
from grasp_refine.refinement.pinches import BEST_SCORE
from grasp_refine.refinement.solvers.iterate import Minimum, Point, Progress, limited, minimise
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.scene.contact_patches import patch_misses
from grasp_refine.scene.goal import Goal, goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

GOOD_SCORE = 0.1
"""Score, with two fingers `BEST_SCORE` more, up to which a grasp is good enough where its quality does not decide: with
two fingers, whose forces hardly say what holds (`pinches`), or unless the closest grasp is preferred."""

MOVED_SHARE = 0.2
"""Share of the probability of failing that `Config.confidence` allows, for grasps that are moved to make them hold:
grasps that a search brings just over a bar hold less often than input grasps of that quality. Of 21 grasps of BODex,
DexGraspNet and FRoGGeR that were moved to a quality from 0.95 to 0.99, 67 % held in protocol `strict`; of 51 above it
98 %."""

PINCH_SHARE = 0.7
"""Share of its score below which a grasp of two contact points is replaced by one from another start, unless that is
good: forces at two points make no torque about the line between them, whatever the pads do, so that the scores of such
grasps hardly predict which of them holds."""

START_ROTATION_RAD, START_TRANSLATION_M, START_JOINTS_RAD = 0.25, 0.008, 0.1
"""Standard deviations of further starts: rotation about each axis through the contacts, translation, joint values."""

FULL_START = 3
"""Start from which on noise has these deviations; starts before it are nearer, in proportion to their numbers."""

STARTS_AT_ONCE = 16
"""Target number of members of a batch: of few grasps, several starts are tried at once."""


SAME_SCORE = 1e-6
"""Difference of scores below which the earlier attempt stays, so that a last bit does not choose between two."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of the search for N grasps."""

    minimum: Minimum
    goal: Goal
    """Links that touch in the best attempts."""
    starts: np.ndarray
    """Number of starts from which each grasp was tried (N,)."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """M grasps after all phases of an attempt."""

    minimum: Minimum
    """Minima of the last phase."""
    goal: Goal
    """Links that touch in that phase."""
    score: np.ndarray
    """Score (M,), lower is better; infinite where the attempt failed."""
    pinches: np.ndarray
    """True where there are at most two contact points (M,)."""
    quality: np.ndarray
    """Quality (M,), less where links are where they should not be; 0 where the attempt failed."""
    enough: np.ndarray
    """True where the attempt is good enough (M,)."""
    displacement: np.ndarray
    """Displacement (M,) from the input grasp, metres."""


def most_iterations(config: Config, *, aimed: bool = False) -> int:
    """Return the largest number of iterations of a grasp, over all its starts; `aimed`: links have targets."""
    most = config.solver.iterations
    if not config.holds:
        return most
    each = sum(min(phase.iterations, most) for phase in PHASES)
    held_back = 0 if config.prefer == "strongest" else len(STAYS) - 1
    closing = (2 if config.prefer == "closest" else 1) * min(CLOSE.iterations, most)
    from_targets = most + closing + (1 + held_back) * each if aimed else 0
    return from_targets + closing + (config.starts + held_back) * each


def search(
    scene: Scene,
    prepared: HandObject,
    config: Config,
    status: np.ndarray,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
    *,
    reached: Minimum | None = None,
) -> SearchResult:
    """Refine grasps towards force closure.

    Args:
        scene: Hand, object and grasps.
        prepared: Geometry of the hand and the object.
        config: Settings, for Levenberg-Marquardt.
        status: Grasps (N,) with another status than RUNNING are left out.
        progress: As for `minimise`.
        on_iteration: Called after each iteration of all attempts.
        reached: Grasps (N,) whose links are at their targets: attempts begin there, too. None: there are no targets.
    """
    search = Search(scene, prepared, config, status, progress, on_iteration, reached)
    rows = np.flatnonzero(status == Status.RUNNING)
    if search.by_quality:
        search.good_inputs[rows] = search.judge(rows, take(search.inputs, rows))[2] >= config.confidence
    for start in (search.inputs,) if reached is None else (search.inputs, reached.point):
        tried = search.unsatisfied(rows)
        for phase in (KEEP, CLOSE):
            if len(some := tried[search.good_inputs[tried]] if phase is KEEP else tried):
                closed = search.attempt(some, take(start, some), (phase,))
                search.touching[some] = closed.goal.touching
                search.take(some, closed)
        for stay in STAYS if search.nearest else (0.0,):
            if len(some := search.unsatisfied(rows)):
                phases = tuple(replace(phase, stay=stay if phase.balance else 0.0) for phase in PHASES)
                search.take(some, search.attempt(some, take(start, some), phases))
    search.starts[rows] = 1
    if search.by_quality:
        rows = rows[search.best.quality[rows] < config.confidence]
    while len(rows := search.unsatisfied(rows[search.starts[rows] < config.starts])):
        # The result of a grasp does not depend on how many starts are tried at once: the first good one counts.
        first = search.starts[rows]
        each = np.minimum(config.starts - first, max(1, STARTS_AT_ONCE // len(rows)))
        member = np.repeat(rows, each)
        place = np.arange(len(member)) - np.repeat(np.cumsum(each) - each, each)
        found = search.attempt(member, search.perturb(member, np.repeat(first, each) + place), PHASES)
        for k in range(int(each.max())):
            at = np.flatnonzero(place == k)
            at = at[~search.best.enough[member[at]]]
            search.take(member[at], take(found, at), PINCH_SHARE)
            search.starts[member[at]] += 1
    return search.result()


class Search:
    """Best attempt at each grasp so far, and the cost of all attempts."""

    def __init__(
        self,
        scene: Scene,
        prepared: HandObject,
        config: Config,
        status: np.ndarray,
        progress: Progress | None,
        on_iteration: IterationCallback | None,
        reached: Minimum | None = None,
    ) -> None:
        """Begin with the input grasps, without an attempt; arguments are as for `search`."""
        N, L = len(scene.q), len(scene.links)
        self.scene, self.prepared, self.config = scene, prepared, config
        self.progress, self.on_iteration = progress, on_iteration
        self.q = np.clip(scene.q, scene.hand.lower, scene.hand.upper)
        self.clearance = clearances(config, scene.hand, prepared.chain)
        self.good = GOOD_SCORE + (BEST_SCORE if scene.hand.has_two_fingers else 0.0)
        """Score up to which a grasp is not tried from another start."""
        self.free = GraspProblem(replace(scene, q=self.q), Goal.nothing(N, L), config, prepared)
        """Problem in which no link should touch."""
        self.iterations, self.queries, self.starts = np.zeros((3, N), dtype=np.int64)
        self.cpu, self.wall = np.zeros((2, N))
        self.ticks = 0
        self.touching = np.zeros((N, L), dtype=bool)
        """Links (N, L) that touch in the input grasps."""
        if reached is not None:
            self.iterations, self.queries = reached.iterations.copy(), reached.queries.copy()
            self.cpu, self.wall = reached.cpu_s.copy(), reached.wall_s.copy()
        self.inputs = Point(scene.T_world_root, self.q)
        """Input grasps, within the joint limits."""
        self.aims = self.inputs if reached is None else reached.point
        """Grasps about which further starts lie."""
        self.others = np.zeros((N, L), dtype=bool)
        """Links (N, L) that touch in input grasps with targets, wherever these take the hand."""
        if reached is not None:
            plain = replace(scene, target_link=None, target_object=None)
            self.others = goal_of(plain, config.contact_selection, prepared).touching
        point = Point(scene.T_world_root.copy(), self.q.copy())
        minimum = Minimum(
            point, np.full((N, 2), np.nan), status.copy(), self.iterations, self.queries, self.cpu, self.wall
        )
        goal = replace(Goal.nothing(N, L), direction=scene.direction)
        no, none = np.zeros(N, dtype=bool), np.zeros(N)
        self.best = Attempt(minimum, goal, np.full(N, np.inf), no, none, no, np.full(N, np.inf))
        self.good_inputs = np.zeros(N, dtype=bool)
        """True where the input grasp (N,) is good enough as it is."""
        self.nearest = config.prefer != "strongest"
        """Whether, of two attempts that are good enough, the nearer one counts."""
        self.by_quality = config.prefer == "closest" and not scene.hand.has_two_fingers
        """Whether quality decides which attempt is good enough; False: the score."""

    def perturb(self, member: np.ndarray, number: np.ndarray) -> Point:
        """Return starts near the grasps: turned about the mean of their contact links, shifted, joints perturbed."""
        noise, variables = self.free.sample_noise(member, number), self.free.variables
        if self.nearest:
            noise = noise * np.minimum(number / FULL_START, 1.0)[:, None]
        initial = take(self.aims, member)
        T = self.prepared.chain(initial.T, initial.q).T_world_link
        touching = self.touching[member][..., None]
        middle = np.where(touching, T[..., :3, 3], 0.0).sum(axis=1) / np.maximum(touching.sum(axis=1), 1)
        R = exp_so3(START_ROTATION_RAD * noise[:, 3:6])
        palm = variables.palm(initial)
        T = palm.copy()
        T[:, :3, :3] = R @ palm[:, :3, :3]
        T[:, :3, 3] = middle + matvec(R, palm[:, :3, 3] - middle) + START_TRANSLATION_M * noise[:, :3]
        hand, start = self.scene.hand, variables.placed(initial, T)
        joints = START_JOINTS_RAD * hand.per_radian * noise[:, 6:]
        return Point(start.T, start.q + np.where(hand.arm_joints, 0.0, joints))

    def unsatisfied(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows of grasps that are not good yet and have CPU time left."""
        return rows[~self.best.enough[rows] & (self.cpu[rows] < self.config.seconds)]

    def take(self, rows: np.ndarray, found: Attempt, pinch_share: float = 1.0) -> None:
        """Keep attempts at different grasps that are better than the best so far, pinches only by that share."""
        best = self.best.score[rows]
        least = np.where(self.best.pinches[rows] & (found.score > self.good), pinch_share, 1.0) * best - SAME_SCORE
        better = found.score < least
        if self.nearest:
            nearer = found.displacement < self.best.displacement[rows]
            better = np.where(found.enough, nearer | ~self.best.enough[rows], better & ~self.best.enough[rows])
        never = self.best.minimum.status[rows] == Status.RUNNING
        kept = rows[better | never]
        place = np.arange(len(self.starts))
        place[kept] = len(place) + np.flatnonzero(better | never)
        self.best = take(join(self.best, found), place)

    def attempt(self, rows: np.ndarray, start: Point, phases: tuple[Phase, ...]) -> Attempt:
        """Return the grasps `rows` from some starts, through some phases."""
        scene = self._scene(rows)
        point = self.free.project(rows, start)
        for phase in phases:
            found, goal = self._run_phase(phase, scene, rows, point)
            point = found.point
        score, pinches, value = self.judge(rows, point)
        usable = ~np.isin(found.status, UNUSABLE)
        score, value = np.where(usable, score, np.inf), np.where(usable, value, 0.0)
        allowed = (1.0 - self.config.confidence) * np.where(
            self.good_inputs[rows] & (phases in ((KEEP,), (CLOSE,))), 1.0, MOVED_SHARE
        )
        enough = value >= 1.0 - allowed if self.by_quality else score <= self.good
        first = take(self.inputs, rows)
        displacement = Displacement.of(self.prepared.hand).between(first.T, first.q, point.T, point.q)
        return Attempt(found, goal, score, pinches, value, enough, displacement)

    def judge(self, rows: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `judge` of the grasps `rows` at some points, with what is in the way and where links should touch."""
        scene, prepared = self._scene(rows), self.prepared
        known = self.free.evaluate(rows, point, None)
        score, pinches, value = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool), np.zeros(len(rows))
        for k, alone in enumerate(prepared.alone):
            if len(at := np.flatnonzero(scene.number == k)):
                frames = take(known.frames, at)
                score[at], pinches[at], value[at] = judge(alone, frames, self.clearance, self.scene.demand)
        depth = self.free.other_depth(known)
        score, value = score + depth / DEEP, value * room_share(depth)
        if scene.regions is not None:
            bodies_and_witness = prepared.bodies, prepared.object.body, known.frames.T_world_link, known.witness
            miss = patch_misses(scene.regions, *bodies_and_witness).miss.max(axis=1)
            score, value = score + miss / MISS_SCALE_M, value * room_share(miss)
        if scene.target_link is not None:
            miss = target_miss(scene, known.T_link)
            if scene.original is not None:
                miss = np.fmin(miss, original_miss(scene, known.witness, known.frames))
            score, value = score + miss / MISS_SCALE_M, value * room_share(miss)
        return score, pinches, value

    def _run_phase(self, phase: Phase, scene: Scene, rows: np.ndarray, start: Point) -> tuple[Minimum, Goal]:
        """Return the grasps `rows` of the scene after a phase, and its goal."""
        config, prepared = self.config, self.prepared
        wall, cpu = time.perf_counter(), time.process_time()
        now = replace(scene, T_world_root=start.T, q=start.q)
        goal = goal_of(now, phase.touching(config.contact_selection), prepared, others=True)
        goal = replace(goal, touching=goal.touching | self.others[rows])
        problem = GraspProblem(scene, goal, replace(config, weights=phase.weights(config.weights)), prepared)
        problem.restarts = False  # an attempt ends near its start
        solver = limited(config.solver, iterations=phase.iterations, last_patience=phase.patience)
        status = np.where(goal.touching.any(axis=1), Status.RUNNING, Status.NO_TARGET)
        # Several starts of a grasp share the CPU time that it has left.
        left = (config.seconds - self.cpu[rows]) / np.bincount(rows, minlength=len(self.cpu))[rows]
        solve = minimise if phase.balance else close_gaps
        found = solve(
            problem,
            start,
            solver,
            config.tolerance,
            status=status,
            seconds=left,
            progress=self._report,
            on_iteration=with_callback(self.on_iteration, goal, phase.name, rows),
        )
        if not phase.balance:
            if scene.original is not None:
                # Contacts of another hand are wishes: where they are out of reach, links touch beside them.
                found, problem = release_targets(problem, found, solver, seconds=left, progress=self._report)
            found, problem = release_links(problem, found, solver, seconds=left, progress=self._report)
            goal = problem.goal
        share = 1.0 / max(len(rows), 1)
        np.add.at(self.iterations, rows, found.iterations)
        np.add.at(self.queries, rows, found.queries + goal.queries)
        np.add.at(self.cpu, rows, (time.process_time() - cpu) * share)
        np.add.at(self.wall, rows, (time.perf_counter() - wall) * share)
        return found, goal

    def _report(self, finished: int, iteration: int, loss: float) -> None:
        """Report progress; which grasps are good is known after an attempt only."""
        self.ticks += 1
        if self.progress is not None:
            self.progress(int(self.best.enough.sum()), self.ticks, loss)

    def _scene(self, rows: np.ndarray) -> Scene:
        return replace(self.scene, q=self.q).select(rows)

    def result(self) -> SearchResult:
        """Return the best attempts with the cost of all; losses are of the last phase."""
        # Queries of selections are in the cost of their phases.
        found, goal = self.best.minimum, replace(self.best.goal, queries=np.zeros_like(self.queries))
        rows = np.flatnonzero(np.isfinite(self.best.score))
        loss = np.full((len(self.starts), 2), np.nan)
        config = replace(self.config, weights=PHASES[-1].weights(self.config.weights))
        problem = GraspProblem(self._scene(rows), take(goal, rows), config, self.prepared).in_points()
        for column, point in enumerate((take(self.inputs, rows), take(found.point, rows))):
            loss[rows, column] = problem.evaluate(np.arange(len(rows)), point, None).loss
        minimum = replace(
            found, loss=loss, iterations=self.iterations, queries=self.queries, cpu_s=self.cpu, wall_s=self.wall
        )
        return SearchResult(minimum, goal, self.starts)
