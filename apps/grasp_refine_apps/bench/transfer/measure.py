"""Measurement of one transfer: grasps of one hand on one object, brought to another hand in several ways, and tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from grasp_refine.core.array_records import join
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.fidelity import Fidelity
from grasp_refine.measures.formulas import MeasuredGrasps
from grasp_refine.measures.geometry import measure
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.transferred import transferred
from grasp_refine.refinement.config import Config
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.transfers.transfer import copied_grasps
from grasp_refine_apps.bench.jobs import Progress
from grasp_refine_apps.bench.success.cases import Case, load_case
from grasp_refine_apps.bench.success.trials import HELD, Trial, Tried

Way = Literal["joint copy", "kinematics", "transfer"]

WAYS: tuple[Way, ...] = get_args(Way)
"""Joints copied finger by finger with the palm where it was; contacts by inverse kinematics; these, and refined."""


@dataclass(frozen=True, eq=False)
class Measured:
    """N grasps of one source, brought to a hand in one way."""

    way: Way
    source: str
    """Source of the grasps."""
    hand: str
    """Name of the hand."""
    held: np.ndarray
    """Whether each grasp (N,) held in simulation."""
    pinch_m: np.ndarray
    """Distance (N,) of thumb and opposing finger from the contacts of the original, metres; NaN: one does not touch."""
    fidelity: np.ndarray
    """`Likeness` (N,) as text."""
    palm_m: np.ndarray
    """Distance (N,) of the base link from where it is with the palm laid over the original's, metres."""
    fits: np.ndarray
    """False for grasps (N,) whose opposing fingers are farther apart than the jaws of the hand open."""
    cpu_s: float
    """CPU time from the grasps of the source to these, seconds."""


@dataclass(frozen=True)
class Measurement:
    """Settings of the measurement of each case."""

    trial: Trial
    """Way to try the grasps."""
    seed: int = 0
    """Seed of the refinement."""
    threads: int | None = None
    """CPU threads of the simulation."""

    def run(self, case: Case, to: str, progress: Progress) -> list[Measured]:
        """Return the results by way.

        Raises:
            GraspRefineError: a hand or the grasps cannot be used.
        """
        cache, (problem, _), hand = InputCache(), load_case(case, self.seed, InputCache()), load_hand(to)
        steps: dict[Way, Callable[[Problem], Problem]] = {
            "joint copy": lambda source: transferred(source, hand, place=copied_grasps),
            "kinematics": lambda source: transferred(source, hand),
            "transfer": lambda source: refine_problem(transferred(source, hand), Config(seed=self.seed)).as_problem(),
        }
        jaws = jaw_frame(hand, closure_frame(hand))
        most = np.inf if jaws is None else jaws.width.max()
        found: list[Measured] = []
        laid: np.ndarray | None = None
        for done, (way, bring) in enumerate(steps.items()):
            progress(done / len(steps))
            began = cpu_seconds()
            brought = bring(problem)
            spent = cpu_seconds() - began
            root = np.concatenate([group.scene.T_world_root[:, :3, 3] for group in brought.groups])
            laid = root if laid is None else laid
            likeness = join(*(_fidelity(group) for group in brought.groups))
            held = [self._held(hand, group, cache) for group in brought.groups]
            moved = np.linalg.norm(root - laid, axis=1)
            originals = [original for group in brought.groups if (original := group.scene.original) is not None]
            span = np.nan_to_num(join(*originals).span)
            found.append(
                Measured(
                    way,
                    case.source,
                    hand.name,
                    np.concatenate(held),
                    likeness.original_pinch_shift,
                    likeness.likeness,
                    moved,
                    span <= most,
                    spent,
                )
            )
        return found

    def _held(self, hand: Hand, group: Group, cache: InputCache) -> np.ndarray:
        """Return whether grasps hold in simulation."""
        tried = Tried(group.scene, group.motion(), group.scene.task)
        return self.trial.run(tried, cache, self.threads, lambda share: None)[self.trial.columns[0]] == HELD


def _fidelity(group: Group) -> Fidelity:
    """Return the fidelity of transferred grasps."""
    scene = group.scene
    T, q, links = scene.T_world_root, scene.q, scene.links
    nothing = np.full((len(q), len(links), 3), np.nan)
    geometry = measure(HandObject.of(scene), T, q, nothing, nothing)
    found = MeasuredGrasps(scene.hand, scene.object, links, T, q, geometry, scene.task, scene.original).fidelity
    assert found is not None  # transferred grasps have an original
    return found
