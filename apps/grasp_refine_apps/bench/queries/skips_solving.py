"""Skips in the loop of a solver: finished members, derivatives without a cotangent, frames without bodies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch

from grasp_refine.collision.query import query
from grasp_refine.core.array_records import join, take
from grasp_refine.core.se3 import tangents
from grasp_refine.hands.chain import Chain
from grasp_refine.refinement import force_closure_search
from grasp_refine.refinement import refine as refine_module
from grasp_refine.refinement.grasp_problem import SMOOTH, GraspProblem
from grasp_refine.refinement.refine import Refinement
from grasp_refine.refinement.solvers.least_squares import Linear, Minimum, Point, minimise
from grasp_refine.scene.scene import links_of
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.pair_curvature import PairCurvatures
from grasp_refine.witness.scene import WitnessScene
from grasp_refine_apps.bench.queries.skip import Example, Skip, measure_calls, replace_attribute
from grasp_refine_apps.bench.queries.skips_querying import difference

NUM_CONFIGURATIONS, FRAME_REPEATS = 256, 20
"""Number of configurations for derivatives of the torch layer and for frames; number of repetitions of the frames."""


def solving_skips(example: Example, rounds: int) -> Iterator[Skip]:
    """Measure the skips in a refinement of the example."""
    example.warm_up()
    yield finished_skip(example, rounds)
    yield curvature_skip(example)
    yield layer_skip(example, rounds)


def frame_skip(example: Example, rounds: int) -> Skip:
    """Measure the skip of frames of links without bodies."""
    hand = example.scene.hand
    chains = {"with": Chain(hand, links_of(hand)), "without": Chain(hand, [link.name for link in hand.links])}
    counts = {which: len({*chain.links}) + len(chain.joints) for which, chain in chains.items()}
    cpu = measure_calls({which: partial(_many_poses, example, chain) for which, chain in chains.items()}, rounds)
    return Skip(
        "frames of links without bodies", "frames", f"{example.hand}, {FRAME_REPEATS} times batch {NUM_CONFIGURATIONS}",
        counts["without"], counts["with"], cpu["without"][1], cpu["with"][1], "the frames of all links",
    )  # fmt: skip


# finished members


@dataclass(eq=False)
class FullBatchProblem:
    """A problem in which finished members are still evaluated and differentiated, as in a full batch."""

    problem: GraspProblem
    counts: dict[str, int]
    """Members that were evaluated: those that the solver requests, and all."""
    member: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """All members that have started."""
    point: Point | None = None
    known: Any = None

    def evaluate(self, member: np.ndarray, point: Point, previous: Any | None) -> Any:
        """Evaluate all members that have started."""
        if previous is None:
            # Members that start now.
            found = self.problem.evaluate(member, point, None)
            first = self.point is None
            self.member = np.concatenate([self.member, member])
            self.point = point if first else join(self.point, point)
            self.known = found if first else join(self.known, found)
            self._count(member, member)
            return found
        rows = self._rows(member)
        self.point, before = self._with(self.point, rows, point), self._with(self.known, rows, previous)
        # A step that will be rejected is evaluated less closely, which is another skip.
        before.loss[self._others(rows)] = np.inf
        self.known = self.problem.evaluate(self.member, self.point, before)
        self._count(member, self.member)
        return take(self.known, rows)

    def linearize(self, member: np.ndarray, point: Point, known: Any, width: np.ndarray) -> Linear:
        """Differentiate all members that have started, and return the rows that were requested."""
        rows = self._rows(member)
        every = np.ones(len(self.member), dtype=width.dtype)
        every[rows] = width
        points, knowns = self._with(self.point, rows, point), self._with(self.known, rows, known)
        return take(self.problem.linearize(self.member, points, knowns, every), rows)

    def _rows(self, member: np.ndarray) -> np.ndarray:
        order = np.argsort(self.member)
        return order[np.searchsorted(self.member, member, sorter=order)]

    def _others(self, rows: np.ndarray) -> np.ndarray:
        return np.setdiff1d(np.arange(len(self.member)), rows)

    def _with(self, every: Any, rows: np.ndarray, new: Any) -> Any:
        """Copy all rows, with some replaced."""
        place = np.arange(len(self.member))
        place[rows] = len(place) + np.arange(len(rows))
        return take(join(every, new), place)

    def _count(self, member: np.ndarray, every: np.ndarray) -> None:
        self.counts["with"] += len(member)
        self.counts["without"] += len(every)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.problem, name)


def finished_skip(example: Example, rounds: int) -> Skip:
    """Measure the skip of finished grasps, whose places in the batch are taken by others."""
    counts: dict[str, int] = {}

    def kept(problem: GraspProblem, *arguments: Any, **options: Any) -> Minimum:
        return minimise(FullBatchProblem(problem, counts), *arguments, **options)

    def everything() -> Refinement:
        counts.update({"with": 0, "without": 0})
        with (
            replace_attribute(force_closure_search, "minimise", kept),
            replace_attribute(refine_module, "minimise", kept),
        ):
            return example.refined()

    found = measure_calls({"with": example.refined, "without": everything}, rounds)
    (usual, cpu_with), (other, cpu_without) = found["with"], found["without"]
    return Skip(
        "finished grasps leave the batch", "grasp iterations", example.name, counts["without"], counts["with"],
        cpu_without, cpu_with, "they are evaluated and differentiated until the last one is done",
        difference(usual, other),
    )  # fmt: skip


# derivatives


@dataclass(eq=False)
class _Fits:
    """Curvatures of the links that are used, and those of all links at the same poses; both timed."""

    curvatures: PairCurvatures
    counts: dict[str, int] = field(default_factory=lambda: {"with": 0, "without": 0})
    cpu_s: dict[str, float] = field(default_factory=lambda: {"with": 0.0, "without": 0.0})

    def fit(self, pair: np.ndarray, *arguments: Any) -> tuple[np.ndarray, np.ndarray]:
        """Fit the requested curvatures."""
        return self._timed("with", pair, *arguments)

    def fit_all(self, T: np.ndarray, width: np.ndarray) -> None:
        """Fit those of all links at poses T (M, L, 4, 4), whatever their distance."""
        M, L = T.shape[:2]
        w = query(self.curvatures.pairs, T, np.broadcast_to(np.eye(4), T.shape)).reshape(M * L)
        self._timed(
            "without",
            np.tile(np.arange(L), M),
            T.reshape(-1, 4, 4),
            np.broadcast_to(np.eye(4), (M * L, 4, 4)),
            w,
            tangents(np.where(w.valid[:, None], w.normal, [0.0, 0.0, 1.0])),
            np.full((2, M * L), 0.5 * SMOOTH),
            np.repeat(width, L),
        )

    def _timed(self, which: str, pair: np.ndarray, *arguments: Any) -> tuple[np.ndarray, np.ndarray]:
        start = time.process_time()
        found = self.curvatures.fit(pair, *arguments)
        self.cpu_s[which] += time.process_time() - start
        self.counts[which] += len(pair)
        return found


def curvature_skip(example: Example) -> Skip:
    """Measure the skip of curvatures: Levenberg-Marquardt uses those of links that press, or have a target."""
    fits = _Fits(example.prepared.curvatures)
    linearize = GraspProblem.linearize

    def also_all(problem: GraspProblem, member: np.ndarray, point: Point, known: Any, width: np.ndarray) -> Linear:
        if problem.curvatures is not None:
            problem.curvatures = fits  # type: ignore[assignment]  # replaces them
            fits.fit_all(known.T_link, width)
        return linearize(problem, member, point, known, width)

    with replace_attribute(GraspProblem, "linearize", also_all):
        example.refined()
    return Skip(
        "curvatures of links without a loss", "fits", example.name, fits.counts["without"], fits.counts["with"],
        fits.cpu_s["without"], fits.cpu_s["with"], "those of all links, in every iteration in which any are fitted",
    )  # fmt: skip


@dataclass(eq=False)
class _Counted:
    """A derivative method that counts what it differentiates."""

    method: Derivative
    items: int = 0

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Delegate to the method."""
        self.items += scene.witness.distance.size
        return self.method.pull_back(scene, force_a, force_b, force_n)


def layer_skip(example: Example, rounds: int) -> Skip:
    """Measure the skip of pairs without a cotangent: here all but the contact links, which have targets."""
    prepared, hand = example.prepared, example.scene.hand
    T = _poses(example, prepared.chain)
    T_object = torch.eye(4, dtype=torch.float64).expand(T.shape)
    counted = _Counted(ContactKinematics())
    T_link = torch.from_numpy(T).requires_grad_()
    found = WitnessLayer(prepared.pairs, counted)(T_link, T_object)

    def differentiated(columns: int) -> int:
        loss = found.point_a[:, :columns].square().sum() + found.point_b[:, :columns].square().sum()
        counted.items = 0
        torch.autograd.grad(loss, T_link, retain_graph=True)
        return counted.items

    columns = {"with": len(hand.contacts), "without": len(prepared.bodies)}
    both = measure_calls({which: partial(differentiated, count) for which, count in columns.items()}, rounds + 1)
    return Skip(
        "derivatives of witness points without a loss", "derivatives", f"{example.name}, batch {len(T)}",
        both["without"][0], both["with"][0], both["without"][1], both["with"][1], "a loss on all links",
    )  # fmt: skip


def _many_poses(example: Example, chain: Chain) -> None:
    for _ in range(FRAME_REPEATS):
        _poses(example, chain)


def _poses(example: Example, chain: Chain) -> np.ndarray:
    """Poses of the links of a chain in the given grasps, repeated until there are `NUM_CONFIGURATIONS` of them."""
    rows = np.arange(NUM_CONFIGURATIONS) % len(example.scene.q)
    return chain(example.scene.T_world_root[rows], example.scene.q[rows]).T_world_link
