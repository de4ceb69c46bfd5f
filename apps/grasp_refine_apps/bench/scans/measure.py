"""Measurement of one hand on one object: scans from several views, grasps refined on them, tried on the true object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

import grasp_refine as gr
from grasp_refine.closing.motion import Motion, closing_motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.objects.object import Object
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.refinement.config import Config
from grasp_refine.scans.depth_camera import D435, depth_of, scan_of_depth, views_around, with_mask_errors, with_noise
from grasp_refine.scans.scan import Scan
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.jobs import Progress
from grasp_refine_apps.bench.scans.ways import WAYS, Way, object_for
from grasp_refine_apps.bench.success.assets import HandCase, ObjectCase
from grasp_refine_apps.bench.success.cases import moved_at_random
from grasp_refine_apps.bench.success.trials import HELD, Trial, Tried


@dataclass(frozen=True)
class Case:
    """A hand and an object."""

    hand: HandCase
    object: ObjectCase

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"{self.hand.name} on {self.object.name}"


@dataclass(frozen=True)
class Measurement:
    """Settings of the measurement of each case."""

    trial: Trial
    """Way to try the grasps."""
    ways: tuple[Way, ...] = WAYS
    """Ways to refine them."""
    views: tuple[int, ...] = (1, 2, 4)
    """Numbers of views of the scans."""
    count: int = 16
    """Number of grasps."""
    hypotheses: int = 8
    """Largest number of hypotheses of a scan."""
    offset: float = 0.0
    """Distance, metres, by which the scan is displaced in a random direction."""
    seed: int = 0
    """Seed of grasps, views and noise."""
    threads: int | None = None
    """CPU threads of the simulation."""

    def run(self, case: Case, progress: Progress) -> list[Measured]:
        """Return the results by way and number of views; a way whose scan says too little has no quality.

        Raises:
            GraspRefineError: the hand or the object cannot be loaded, or no grasp can be sampled.
        """
        hand = gr.load_hand(case.hand.hand, urdf=case.hand.urdf, mjcf=case.hand.mjcf)
        true = gr.load_object(case.object.source, scale=case.object.scale, unit="m", name=case.object.name)
        seed = [self.seed, crc32(case.name.encode())]
        grasps = gr.sample_grasps(hand, true, self.count, seed=self.seed)
        T = moved_at_random(hand, transform_from_pose(grasps.hand_pose), seed)
        grasps = replace(grasps, hand_pose=pose_from_transform(T))
        cache, found = InputCache(), []
        steps = [(number, way) for number in self.views for way in self.ways]
        scans = {number: self._scan(true, number, seed) for number in self.views}
        for done, (number, way) in enumerate(steps):
            progress(done / len(steps))
            one = self._refined(hand, true, grasps, scans[number], way)
            if one.motion is not None:
                scene = Scene(hand, true, one.motion.T_world_root[:, 1], one.motion.q[:, 1])
                tried = Tried(scene, one.motion, scene.task)
                verdict = self.trial.run(tried, cache, self.threads, lambda share: None)
                one = replace(one, held=verdict[self.trial.columns[0]] == HELD)
            found.append(replace(one, case=case, views=number, points=len(scans[number].points)))
        return found

    def _scan(self, true: Object, number: int, seed: list[int]) -> Scan:
        """Return a scan of an object from a number of views, with the noise of a depth camera."""
        rng = np.random.default_rng([*seed, number])
        poses = views_around(true.mesh, number, int(rng.integers(2**31)))
        depths = [depth_of(true.mesh, pose) for pose in poses]
        masks = [with_mask_errors(depth > 0, int(rng.integers(2**31))) for depth in depths]
        noisy = [with_noise(depth, int(rng.integers(2**31))) for depth in depths]
        scan = scan_of_depth(noisy, masks, D435, list(poses), true.name)
        away = rng.normal(size=3)
        away *= self.offset / np.linalg.norm(away)
        return replace(scan, points=scan.points + away, origins=scan.origins + away)

    def _refined(self, hand: gr.Hand, true: Object, grasps: gr.GraspSet, scan: Scan, way: Way) -> Measured:
        """Return grasps refined in some way, not tried yet."""
        count = len(grasps)
        began = cpu_seconds()
        nothing = Measured(way, np.full(count, np.nan), np.zeros(count, dtype=bool))
        try:
            obj = object_for(way, true, scan, count=self.hypotheses, seed=self.seed)
        except GraspRefineError as error:
            return replace(nothing, trouble=str(error))
        completed = cpu_seconds()
        nothing = replace(nothing, completion_s=completed - began)
        if way == "unrefined":
            scene = Scene(hand, obj, transform_from_pose(grasps.hand_pose), grasps.q)
            return replace(nothing, motion=closing_motion(scene))
        outcome = gr.refine(hand, obj, replace(grasps, object=np.full(count, obj.name)), Config(seed=self.seed)).outcome
        return Measured(
            way,
            outcome.quality[:, 1],
            nothing.held,
            outcome.motion,
            completion_s=completed - began,
            refinement_s=cpu_seconds() - completed,
        )


@dataclass(frozen=True, eq=False)
class Measured:
    """Results of N grasps of one case, by one way, from one number of views."""

    way: Way
    quality: np.ndarray
    """Quality (N,) that was promised; NaN: none."""
    held: np.ndarray
    """Whether each grasp (N,) held on the true object."""
    motion: Motion | None = None
    """Motion that was tried; None: there is none, and nothing held."""
    trouble: str = ""
    """Error of a scan that says too little; empty: none."""
    completion_s: float = 0.0
    """CPU time from the scan to the object, seconds."""
    refinement_s: float = 0.0
    """CPU time of the refinement, seconds."""
    case: Case | None = None
    views: int = 0
    points: int = 0
    """Number of points of the scan."""
