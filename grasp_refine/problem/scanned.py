"""Refinement on a scanned object: on each solid that it may be, and the grasp that holds most of them is kept."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from grasp_refine.closing.hypotheses import Ends, best_attempt
from grasp_refine.core.array_records import join, take
from grasp_refine.core.array_types import Float
from grasp_refine.measures.measures import LIKELY_QUALITY, QUALITY
from grasp_refine.problem.problem import Group
from grasp_refine.problem.together import sets_of, together
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.iteration_state import IterationCallback
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.iterate import Progress
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.results.verdict import should_hold
from grasp_refine.results.weakness import direction_text
from grasp_refine.scans.scan import Scan
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

EFFORT = ("starts", "iterations", "queries", "cpu_s", "wall_s")
"""Fields of a refinement that add up over the solids."""


def refine_scanned(
    group: Group, config: Config, progress: Progress | None = None, on_iteration: IterationCallback | None = None
) -> Outcome:
    """Refine the grasps of a scanned object on each solid that it may be, and keep the best attempt at each grasp.

    The input grasp is an attempt as well. Each attempt is judged on all solids, where a closing hand ends on them
    (`closing.hypotheses`): the quality of the outcome is the probability that the grasp holds, over all solids.

    Raises:
        GraspRefineError: a link that should touch does not exist.
    """
    scene, obj = group.scene, group.scene.object
    began = time.process_time(), time.perf_counter()
    solids = tuple(HandObject.of(replace(scene, object=solid)) for solid in obj.solids)
    envelope = HandObject.of(replace(scene, object=obj.envelope))
    found = _on_each(group, config, progress, on_iteration)
    attempts = [scene, *(replace(scene, T_world_root=each.T_world_root, q=each.q) for each in found)]
    ends = [Ends.of(attempt, config, solids, envelope) for attempt in attempts]
    best = best_attempt(scene, attempts, ends, obj.weights, config)
    rows = best * len(scene.q) + np.arange(len(scene.q))
    kept = take(join(*ends), rows)
    as_given = replace(found[0], T_world_root=scene.T_world_root, q=scene.q)
    chosen = take(join(as_given, *found), rows)
    after = replace(scene, T_world_root=chosen.T_world_root, q=np.where(scene.posed[:, None], kept.q[:, 0], chosen.q))
    effort = {name: np.sum([getattr(each, name) for each in found], axis=0) for name in EFFORT}
    # Attempts are judged on all grasps together: the time is divided evenly.
    spent = time.process_time() - began[0], time.perf_counter() - began[1]
    for name, total in zip(("cpu_s", "wall_s"), spent, strict=True):
        effort[name] = effort[name] + max(total - effort[name].sum(), 0.0) / max(len(scene.q), 1)
    chosen = replace(chosen, q=after.q, touching=kept.touching[:, 0], **effort)
    outcome = compare(
        scene,
        chosen,
        kept.motion(after, solids, pressure=config.pressure),
        margin=config.margin,
        clearance=clearances(config, scene.hand, solids[0].chain),
        selection=config.contact_selection,
        name=group.object,
        scale=group.scale,
        row=group.rows,
        index=group.index,
    )
    probability = np.stack([each.probability(obj.weights) for each in (ends[0], kept)], axis=1)
    measures = {**outcome.measures, QUALITY.name: np.where(scene.posed[:, None], probability, np.nan)}
    unseen = _not_seen(scene, kept, measures)
    weakness = np.array([new or old for new, old in zip(unseen, outcome.weakness.tolist(), strict=True)], dtype=np.str_)
    return replace(
        outcome,
        measures=measures,
        weakness=weakness,
        labels=group.grasps.labels,
        contact_probability=kept.contact_probability(obj.weights),
    )


def _on_each(
    group: Group, config: Config, progress: Progress | None, on_iteration: IterationCallback | None
) -> list[Refinement]:
    """Return the refinement of the grasps on each solid."""
    found = []
    for some in sets_of([group.on(solid) for solid in group.scene.object.solids], config):
        refined = refine(together([each.scene for each in some]), config, progress, on_iteration)
        count = len(group.rows)
        found += [take(refined, slice(k * count, (k + 1) * count)) for k in range(len(some))]
    return found


def _not_seen(scene: Scene, ends: Ends, measures: dict[str, np.ndarray]) -> list[str]:
    """Return a text on each grasp that would hold the first solid but not enough of the others; else empty."""
    obj = scene.object
    views = None if obj.scan is None else next_views(obj.scan, ends, obj.weights)
    held, likely = measures[QUALITY.name][:, 1], measures[LIKELY_QUALITY.name][:, 1]
    unsure = should_hold(likely) & ~should_hold(held)
    texts = []
    for i in range(len(held)):
        text = f"it holds {int(100 * held[i])} % of what the object may be" if unsure[i] else ""
        if text and views is not None and views[i].any():
            text += f"; another view from {direction_text(views[i])} would show most of its contacts"
        texts.append(text)
    return texts


def next_views(scan: Scan, ends: Ends, weights: Float[np.ndarray, " K"]) -> Float[np.ndarray, "N 3"]:
    """Return the direction (N, 3), out of the object, from which another view would show most contacts of each grasp.

    It is the mean outward normal at the contacts on all solids that lie where nothing was seen; 0 where there are none.
    """
    unseen = ends.touching & ~scan.seen(ends.point)
    share = weights[:, None] * unseen
    total = -(share[..., None] * np.nan_to_num(ends.normal)).sum(axis=(1, 2))
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), 0.0)
