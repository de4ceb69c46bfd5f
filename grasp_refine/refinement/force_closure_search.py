"""Grasps that hold: contacts that touch and whose forces balance, found from one start or several.

Each attempt goes through `PHASES`, which choose anew what touches. The best attempt by `quality.score` counts, without
any simulation: first the grasp as it came with its contacts closed, then with forces that balance, and then, where it
is still not good, from starts nearby.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import query
from grasp_refine.core.array_records import join, take
from grasp_refine.core.se3 import exp_so3, matvec
from grasp_refine.forces.quality import DEEP, quality
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.hands.chain import Frames
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.goal import Goal, goal_of
from grasp_refine.refinement.grasp_problem import GraspProblem, sample_noise
from grasp_refine.refinement.iteration_state import IterationCallback, with_callback
from grasp_refine.refinement.losses import Weights
from grasp_refine.refinement.solvers.least_squares import Minimum, Point, Progress, minimise
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

GOOD_QUALITY = 0.05
"""A grasp with at most this score is not tried from another start."""

START_ROTATION_RAD, START_TRANSLATION_M, START_JOINTS_RAD = 0.25, 0.008, 0.1
"""Standard deviations of other starts: about each axis through the contacts in radians, in metres, of joints."""

STARTS_AT_ONCE = 16
"""Several starts of few grasps are tried at once, for so many members in all."""


@dataclass(frozen=True)
class Phase:
    """A part of the way to a grasp."""

    name: str
    """What contacts do in it, for people."""
    iterations: int
    """Most iterations."""
    farther: tuple[float, float] = (0.0, 0.0)
    """How much farther than in the end contact links, and other links, may be to be drawn in, in metres."""
    soft: float = 1.0
    """Factor of the weights of what must not penetrate: while contacts slide, it may a little."""
    balance: bool = True
    """Whether forces should balance."""

    def touching(self, touching: ContactSelection) -> ContactSelection:
        """What touches, given what does in the end."""
        tips, others = self.farther
        return replace(touching, reach=touching.reach + tips, other_link_distance=touching.other_link_distance + others)

    def weights(self, weights: Weights) -> Weights:
        """The weights, given those of the end."""
        return replace(
            weights,
            penetration=self.soft * weights.penetration,
            self_penetration=self.soft * weights.self_penetration,
            wrench=weights.wrench if self.balance else 0.0,
        )


SLIDE = Phase("contacts slide", 25, farther=(0.01, 0.005), soft=0.01)
SETTLE = Phase("contacts settle", 15)
CLOSE = Phase("gaps close", 40, balance=False)
PHASES = (SLIDE, SETTLE, CLOSE)
"""Contacts slide to where forces balance; they settle without penetration; last, by geometry alone, gaps close."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What came out for N grasps."""

    minimum: Minimum
    goal: Goal
    """What touches at last."""
    starts: np.ndarray
    """From how many starts each grasp was tried (N,)."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """M grasps after all stages."""

    minimum: Minimum
    goal: Goal
    score: np.ndarray
    """What speaks against them (M,), infinite where nothing came out."""


def most_iterations(config: Config) -> int:
    """Most iterations of a grasp, over all its starts."""
    most = config.solver.iterations
    each = sum(min(stage.iterations, most) for stage in PHASES)
    return min(CLOSE.iterations, most) + config.starts * each


def search(
    scene: Scene,
    prepared: HandObject,
    config: Config,
    status: np.ndarray,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
) -> SearchResult:
    """Refine grasps so that they hold.

    Args:
        scene: Hand, object and grasps; without targets.
        prepared: Of the hand and the object.
        config: Settings, for Levenberg-Marquardt.
        status: Grasps (N,) with another status than RUNNING are left out.
        progress: As for `minimise`.
        on_iteration: Sees all attempts.
    """
    search = _Search(scene, prepared, config, status, progress, on_iteration)
    rows = np.flatnonzero(status == Status.RUNNING)
    closed = search.attempt(rows, search.given(rows), (CLOSE,))
    search.touching[rows] = closed.goal.touching
    search.take(rows, closed)
    rows = search.unsatisfied(rows)
    search.take(rows, search.attempt(rows, search.given(rows), PHASES))
    search.starts[status == Status.RUNNING] = 1
    while len(rows := search.unsatisfied(rows[search.starts[rows] < config.starts])):
        # What one grasp comes to does not depend on how many starts are tried at once: the first good one counts.
        first = search.starts[rows]
        each = np.minimum(config.starts - first, max(1, STARTS_AT_ONCE // len(rows)))
        member = np.repeat(rows, each)
        place = np.arange(len(member)) - np.repeat(np.cumsum(each) - each, each)
        found = search.attempt(member, search.disturbed(member, np.repeat(first, each) + place), PHASES)
        for k in range(int(each.max())):
            at = np.flatnonzero(place == k)
            at = at[search.best.score[member[at]] > GOOD_QUALITY]
            search.take(member[at], take(found, at))
            search.starts[member[at]] += 1
    return search.held()


class _Search:
    """The best attempt at each grasp so far, and what all cost."""

    def __init__(
        self,
        scene: Scene,
        prepared: HandObject,
        config: Config,
        status: np.ndarray,
        progress: Progress | None,
        on_iteration: IterationCallback | None,
    ) -> None:
        N, L = len(scene.q), len(scene.links)
        self.scene, self.prepared, self.config = scene, prepared, config
        self.progress, self.on_iteration = progress, on_iteration
        self.q = np.clip(scene.q, scene.hand.lower, scene.hand.upper)
        self.iterations, self.queries, self.starts = np.zeros((3, N), dtype=np.int64)
        self.cpu, self.wall = np.zeros((2, N))
        self.ticks = 0
        self.touching = np.zeros((N, L), dtype=bool)
        """Which links touch in the grasps as they came."""
        point = Point(scene.T_world_root.copy(), self.q.copy())
        minimum = Minimum(
            point, np.full((N, 2), np.nan), status.copy(), self.iterations, self.queries, self.cpu, self.wall
        )
        goal = replace(Goal.nothing(N, L), direction=scene.direction)
        self.best = _Attempt(minimum, goal, np.full(N, np.inf))

    def given(self, rows: np.ndarray) -> Point:
        """The grasps as they came."""
        return Point(self.scene.T_world_root[rows], self.q[rows])

    def disturbed(self, member: np.ndarray, number: np.ndarray) -> Point:
        """Starts near the grasps: hands turned about the middle of their contacts, shifted, with other joint values."""
        noise = sample_noise(self.scene, member, number, self.config.seed)
        given = self.given(member)
        T = self.prepared.chain(given.T, given.q).T_world_link
        touching = self.touching[member][..., None]
        middle = np.where(touching, T[..., :3, 3], 0.0).sum(axis=1) / np.maximum(touching.sum(axis=1), 1)
        R = exp_so3(START_ROTATION_RAD * noise[:, 3:6])
        T = given.T.copy()
        T[:, :3, :3] = R @ given.T[:, :3, :3]
        T[:, :3, 3] = middle + matvec(R, given.T[:, :3, 3] - middle) + START_TRANSLATION_M * noise[:, :3]
        return Point(T, given.q + START_JOINTS_RAD * noise[:, 6:])

    def unsatisfied(self, rows: np.ndarray) -> np.ndarray:
        """Those of the grasps that could be better, and may still cost something."""
        return rows[(self.best.score[rows] > GOOD_QUALITY) & (self.cpu[rows] < self.config.seconds)]

    def take(self, rows: np.ndarray, found: _Attempt) -> None:
        """Account for attempts at different grasps, and keep what is better than what there was."""
        better = found.score < self.best.score[rows]
        never = self.best.minimum.status[rows] == Status.RUNNING
        kept = rows[better | never]
        place = np.arange(len(self.starts))
        place[kept] = len(place) + np.flatnonzero(better | never)
        self.best = take(join(self.best, found), place)

    def attempt(self, rows: np.ndarray, start: Point, stages: tuple[Phase, ...]) -> _Attempt:
        """The grasps `rows` from some starts, through some stages."""
        scene, prepared = self._scene(rows), self.prepared
        everyone = np.arange(len(rows))
        free = GraspProblem(scene, Goal.nothing(len(rows), len(scene.links)), self.config, prepared)
        point = free.project(everyone, start)
        for stage in stages:
            found, goal = self._through(stage, scene, rows, point)
            point = found.point
        known = free.evaluate(everyone, point, None)
        frames, T = Frames(known.T_link, known.axes), known.T_link
        witness = query(
            prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=CONTACTS.cutoff(scene.hand, scene.links)
        )
        score = quality(scene.hand, scene.object, prepared.chain, frames, witness).score
        score += free.other_depth(known) / DEEP
        usable = ~np.isin(found.status, UNUSABLE)
        return _Attempt(found, goal, np.where(usable, score, np.inf))

    def _through(self, stage: Phase, scene: Scene, rows: np.ndarray, start: Point) -> tuple[Minimum, Goal]:
        """The grasps `rows`, which are those of the scene, after a stage, and what should touch in it."""
        config, prepared = self.config, self.prepared
        assert isinstance(config.solver, LevenbergMarquardt)
        wall, cpu = time.perf_counter(), time.process_time()
        now = replace(scene, T_world_root=start.T, q=start.q)
        goal = goal_of(now, stage.touching(config.contact_selection), prepared)
        problem = GraspProblem(scene, goal, replace(config, weights=stage.weights(config.weights)), prepared)
        solver = replace(config.solver, restarts=0, iterations=min(config.solver.iterations, stage.iterations))
        status = np.where(goal.touching.any(axis=1), Status.RUNNING, Status.NO_TARGET)
        # Several starts of a grasp share what it has left.
        left = (config.seconds - self.cpu[rows]) / np.bincount(rows, minlength=len(self.cpu))[rows]
        found = minimise(
            problem,
            start,
            solver,
            config.tolerance,
            status=status,
            width=config.width,
            seconds=left,
            progress=self._tell,
            on_iteration=with_callback(self.on_iteration, goal, stage.name, rows),
        )
        share = 1.0 / max(len(rows), 1)
        np.add.at(self.iterations, rows, found.iterations)
        np.add.at(self.queries, rows, found.queries + goal.queries)
        np.add.at(self.cpu, rows, (time.process_time() - cpu) * share)
        np.add.at(self.wall, rows, (time.perf_counter() - wall) * share)
        return found, goal

    def _tell(self, finished: int, iteration: int, loss: float) -> None:
        """Which grasps are good is known after an attempt only."""
        self.ticks += 1
        if self.progress is not None:
            self.progress(int((self.best.score <= GOOD_QUALITY).sum()), self.ticks, loss)

    def _scene(self, rows: np.ndarray) -> Scene:
        scene = self.scene
        direction = None if scene.direction is None else scene.direction[rows]
        return replace(scene, T_world_root=scene.T_world_root[rows], q=self.q[rows], direction=direction)

    def held(self) -> SearchResult:
        """The best of all attempts, with the account of all; losses are those of the last stage."""
        found, goal = self.best.minimum, self.best.goal
        rows = np.flatnonzero(np.isfinite(self.best.score))
        loss = np.full((len(self.starts), 2), np.nan)
        config = replace(self.config, weights=PHASES[-1].weights(self.config.weights))
        problem = GraspProblem(self._scene(rows), take(goal, rows), config, self.prepared)
        for column, point in enumerate((self.given(rows), take(found.point, rows))):
            loss[rows, column] = problem.evaluate(np.arange(len(rows)), point, None).loss
        minimum = replace(
            found, loss=loss, iterations=self.iterations, queries=self.queries, cpu_s=self.cpu, wall_s=self.wall
        )
        return SearchResult(minimum, goal, self.starts)
