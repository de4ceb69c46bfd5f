"""Results for tests: of grasps that are refined, and made up in a moment, as outcomes, trials, margins and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, match_joints
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.change import Change
from grasp_refine.measures.measures import COUNT, RECORDED
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.results.result_files import fingerprint, save_results
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.validation.margins.limits import Limits
from grasp_refine.validation.margins.margins import Margins
from grasp_refine.validation.trials import Reason, Trials

CHANGES = (Change.KEPT, Change.MOVED, Change.LINKS)
"""What the refinement of grasp i changed: entry i modulo 3."""

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
    before, half the quality, 1 mm more error and 2 mm more penetration. Status and change of grasp i are entries i of
    `STATUSES` and `CHANGES`.
    """
    count, number = len(grasps), np.arange(len(grasps))
    quality, error, penetration = 7 * number % count / count, number * 1e-6, number / count * 1e-3
    before = grasps.hand_pose.copy()
    before[:, :3] += np.random.default_rng(0).uniform(-0.01, 0.01, (count, 3))
    outcome = plain_outcome(
        count,
        links=len(links_of(hand)),
        pose=grasps.hand_pose,
        q=q,
        quality=np.stack([quality / 2, quality], axis=1),
        contact_error_m=np.stack([error + 1e-3, error], axis=1),
        penetration_m=np.stack([penetration + 2e-3, penetration], axis=1),
        self_penetration_m=(1e-3, 0.0),
        scene_penetration_m=np.nan,
        region_miss_m=np.nan,
        wrench_residual=np.stack([np.full(count, 0.2), 0.1 * (1 - quality)], axis=1),
        loss_m2=1e-9,
        iterations=number + 10,
        queries=number + 20,
        moved_palm_m=0.01,
        moved_joints_rad=0.1,
        moved_slides_m=np.nan,
        starts=1,
        cpu_s=1.0,
        wall_s=1.0,
    )
    return replace(
        outcome,
        object=grasps.object,
        scale=grasps.scale,
        hand_pose_before=before,
        q_before=np.clip(q - 0.1, hand.lower, hand.upper),
        status=np.resize(np.array(STATUSES), count),
        change=np.resize(np.array(CHANGES), count),
    )


def plain_outcome(
    count: int, *, links: int = 3, pose: np.ndarray | None = None, q: np.ndarray | None = None, **measures: Any
) -> Outcome:
    """An outcome of N converged grasps on a mug that did not move and touches at the origin with all links.

    Args:
        count: Number of grasps N.
        links: Number of links.
        pose: Poses (N, 7) of the hand; by default the identity.
        q: Joint values (N, n); by default 0 of two joints.
        measures: Name -> values of a measure that is not 0, which are broadcast to all grasps.
    """
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (count, 1)) if pose is None else pose
    q = np.zeros((count, 2)) if q is None else q
    values = {
        one.name: np.array(
            np.broadcast_to(
                measures.pop(one.name, 0 if one.unit is COUNT else 0.0), (count, 2) if one.compared else (count,)
            )
        )
        for one in RECORDED
    }
    assert not measures
    nowhere, points = np.full((count, links, 3), np.nan), np.zeros((count, links, 3))
    return Outcome(
        object=np.full(count, "mug"),
        scale=np.ones(count),
        row=np.arange(count),
        index=np.arange(count),
        hand_pose=pose,
        q=q,
        hand_pose_before=pose,
        q_before=q,
        status=np.full(count, Status.CONVERGED),
        change=np.full(count, Change.KEPT.value),
        fidelity=np.full(count, ""),
        fingers=np.full(count, ""),
        measures=values,
        contact_gap=np.zeros((count, links)),
        target_point_link=nowhere,
        target_point_object=nowhere,
        contact_point_link=points,
        contact_point_object=points,
        contact_normal=points,
        contact_distance=np.zeros((count, links)),
        contact_probability=np.full((count, links), np.nan),
        stage_pose=np.repeat(pose[:, None], 3, axis=1),
        stage_q=np.repeat(q[:, None], 3, axis=1),
        gap=np.full(count, ""),
        weakness=np.full(count, ""),
    )


def error_in_millimetres(count: int, objects: tuple[str, ...] = ("mug",)) -> Outcome:
    """Grasp i has a contact error of i mm after and 10 i mm before, and converged; all else is the same for all.

    There are no targets, and with so much quality all should hold.
    """
    outcome = plain_outcome(
        count,
        starts=2,
        iterations=123,
        quality=(0.4, 0.97),
        wrench_residual=(0.2, 0.05),
        penetration_m=(2e-3, 1e-4),
        self_penetration_m=(1e-3, 0.0),
        scene_penetration_m=np.nan,
        region_miss_m=np.nan,
        displacement_m=7e-3,
        contacts_moved_m=1e-3,
        links_kept=1.0,
        moved_palm_m=4e-3,
        moved_palm_rad=np.radians(5.0),
        moved_joints_rad=np.radians(6.0),
        moved_slides_m=np.nan,
        wall_s=0.25,
    )
    error = np.arange(count)[:, None] * (1e-2, 1e-3)
    outcome = replace(outcome, object=np.resize(np.array(objects), count), row=np.arange(count) + 100)
    return with_measures(outcome, contact_error_m=error, contact_error_mean_m=error / 2)


def with_status(outcome: Outcome, **grasps: Status) -> Outcome:
    """The outcome with the status of grasps changed, such as g3=Status.STALLED."""
    status = outcome.status.copy()
    for name, value in grasps.items():
        status[int(name[1:])] = value
    return replace(outcome, status=status)


def with_measures(outcome: Outcome, **values: Any) -> Outcome:
    """The outcome with other values of measures: name -> values as in `Outcome.measures`."""
    return replace(outcome, measures={**outcome.measures, **values})


def made_trials(reason: np.ndarray, directions: tuple[str, ...] = ("+x", "-x"), **changes: Any) -> Trials:
    """Trials (N, D) that failed or not for some reasons, with 0 in all other fields; `changes` are other values.

    A grasp is held if it is in all directions.
    """
    count, links = len(reason), ("palm", "tip")
    zeros, nothing = np.zeros(reason.shape), np.zeros((count, len(links)), dtype=bool)
    fields = dict.fromkeys(("time_s", "displacement_m", "angle_rad", "peak_m", "peak_rad"), zeros)
    fields |= dict.fromkeys(("closing_m", "closing_rad", "penetration_m"), np.zeros(count))
    fields |= dict.fromkeys(("contacts_grasp", "contacts_squeeze"), nothing)
    fields |= {"contacts": np.zeros((*reason.shape, len(links)), dtype=bool)}
    fields |= {"success": (reason == Reason.HELD).all(axis=1), **changes}
    return Trials(directions=directions[: reason.shape[1]], links=links, reason=reason, **fields)


def made_margins(better: int = 0) -> Margins:
    """Three grasps in 8 draws, of each factor alone in 4; with `better`, so many more draws are held by all."""

    def held(counts: list[int], of: int) -> np.ndarray:
        return np.arange(of) < np.minimum(np.array(counts) + better, of)[:, None]

    return Margins(
        held={
            "all": held([2, 6, 8], 8),
            "push": held([3, 4, 4], 4),
            "friction": held([2, 4, 4], 4),
            "mass": held([3, 1, 4], 4),
        },
        limits=Limits(
            friction=np.array([np.nan, 0.4, 0.1]), force=np.array([0.0, 2.0, 5.0]), torque=np.array([0.0, 0.1, 0.3])
        ),
        cpu_s=np.array([1.0, 2.0, 3.0]),
    )


def refined(name: str, rows: slice = slice(None)) -> Outcome:
    """Some example grasps of the Allegro-type hand on an embedded object, their geometry refined."""
    hand = load_hand("allegro")
    grasps = load_grasps(resource_dir("robots") / "allegro" / f"example_{name}.npz")
    grasps = grasps.select(np.arange(len(grasps))[rows])
    q, _ = match_joints(grasps, hand)
    scene = Scene(hand, load_object(name), transform_from_pose(grasps.hand_pose), q)
    config = Config()
    config = replace(config, weights=replace(config.weights, wrench=0.0))
    result = refine(scene, config)
    after = replace(scene, T_world_root=result.T_world_root, q=result.q)
    row = np.arange(len(grasps)) + (rows.start or 0)
    return compare(scene, result, closing_motion(after), margin=0.0, name=name, scale=1.0, row=row, index=row)


def save_refined(path: Path, outcome: Outcome, **batch: Any) -> None:
    """Write what a shard of such grasps comes to."""
    hand = load_hand("allegro")
    provenance = {"source": {"path": "example.npz", "sha256": "0"}, "batch": {"job": "examples", **batch}}
    save_results(path, hand, links_of(hand), outcome, provenance)
