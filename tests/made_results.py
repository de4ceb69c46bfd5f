"""Result files with many grasps, made in a moment: the grasps of an example, varied, with measures that are made up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, match_joints
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome
from grasp_refine.results.result_files import fingerprint, save_results
from grasp_refine.scene.scene import links_of

STATUSES = (Status.CONVERGED, Status.CONVERGED, Status.STALLED, Status.BUDGET)
"""How grasp i ended: entry i modulo 4."""


def save_example_results(path: Path, count: int, name: str = "mug") -> Path:
    """Write a result file with `count` grasps of the Allegro-type hand on one of its example objects; see `made_up`."""
    grasps = load_grasps(resource_dir("robots") / "allegro" / f"example_{name}.npz")
    return save_made_up(path, load_hand("allegro"), grasps, count)


def save_made_up(path: Path, hand: Hand, grasps: GraspSet, count: int) -> Path:
    """Write a result file with `count` grasps: those of a set, over and over."""
    rows = np.resize(np.arange(len(grasps)), count)
    q, _ = match_joints(grasps, hand)
    outcome = made_up(grasps.select(rows), hand, q[rows])
    provenance = {"source": {"path": "made up"}, "urdf": fingerprint(hand.urdf)}
    save_results(path, hand, links_of(hand), outcome, provenance)
    return path


def made_up(grasps: GraspSet, hand: Hand, q: np.ndarray) -> Outcome:
    """An outcome of N grasps, each moved by up to 1 cm from where it came from.

    After refinement, grasp i of N has the quality (7 i mod N)/N, a contact error of i um and a penetration of i/N mm;
    before, half the quality, 1 mm more error and 2 mm more penetration. The status of grasp i is entry i of `STATUSES`.
    """
    count, links = len(grasps), len(links_of(hand))
    random = np.random.default_rng(0)
    number, ones = np.arange(count), np.ones(count)
    quality = 7 * number % count / count
    error, penetration = number * 1e-6, number / count * 1e-3
    before = grasps.hand_pose.copy()
    before[:, :3] += random.uniform(-0.01, 0.01, (count, 3))
    nowhere, points = np.full((count, links, 3), np.nan), np.zeros((count, links, 3))
    contact_error = np.full((count, 2, links), np.nan)
    contact_error[:, 0, 0], contact_error[:, 1, 0] = error + 1e-3, error
    return Outcome(
        object=grasps.object,
        scale=grasps.scale,
        row=number,
        index=number,
        hand_pose=grasps.hand_pose,
        q=q,
        initial_pose=before,
        initial_q=np.clip(q - 0.1, hand.lower, hand.upper),
        status=np.resize(np.array(STATUSES), count),
        loss=np.stack([1e-4 * ones, 1e-9 * ones], axis=1),
        iterations=number + 10,
        queries=number + 20,
        wall_s=ones,
        cpu_s=ones,
        starts=ones.astype(int),
        contact_error=contact_error,
        penetration=np.stack([penetration + 2e-3, penetration], axis=1),
        self_penetration=np.stack([1e-3 * ones, 0 * ones], axis=1),
        wrench_residual=np.stack([0.2 * ones, 0.1 * (1 - quality)], axis=1),
        quality=np.stack([quality / 2, quality], axis=1),
        limits_violated=np.zeros(count, dtype=int),
        palm_m=0.01 * ones,
        palm_rad=0 * ones,
        joints_rad=0.1 * ones,
        touching=np.arange(links) < 2 * np.ones((count, 1)),
        target_link=nowhere,
        target_object=nowhere,
        contact_link=points,
        contact_object=points,
        contact_normal=points,
        contact_distance=np.zeros((count, links)),
        stage_pose=np.repeat(grasps.hand_pose[:, None], 3, axis=1),
        stage_q=np.repeat(q[:, None], 3, axis=1),
    )
