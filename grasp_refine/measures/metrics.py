"""Measures of grasps by geometry and statics alone, at the given poses, without any motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Float
from grasp_refine.core.plurals import count_text
from grasp_refine.core.short_repr import spread
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.formulas import MeasuredGrasps
from grasp_refine.measures.geometry import contact_errors, measure
from grasp_refine.measures.measures import VALIDATED, Measure
from grasp_refine.objects.object import Object
from grasp_refine.scene.contact_links import contact_gaps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import as_task


@dataclass(frozen=True, eq=False, repr=False)
class Metrics(ArrayRecord):
    """Measures `VALIDATED` of N grasps, as attributes; NaN where a grasp is not finite, or a query failed.

    Attributes have the names of the measures, with their unit: `quality`, `penetration_m`, `contact_number`.
    """

    values: Mapping[str, Float[np.ndarray, " N"]]
    """Name of a measure -> its values (N,), SI units."""

    def __getattr__(self, name: str) -> np.ndarray:
        """Return the values of a measure (N,).

        Raises:
            AttributeError: there is no such measure.
        """
        known = self.__dict__.get("values", {})
        if name not in known:
            raise AttributeError(f"no measure {name!r}, only {', '.join(known)}")
        return known[name]

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Measures of `VALIDATED` that have values."""
        return tuple(one for one in VALIDATED if one.name in self.values)

    def __repr__(self) -> str:
        quality, depth = spread(self.quality), spread(self.penetration_m)
        return f"Metrics({count_text(len(self), 'grasp')}: quality {quality}, penetration {depth} m, ...)"

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.quality)


def metrics(
    hand: Hand,
    obj: Object,
    T_world_root: np.ndarray,
    q: np.ndarray,
    task: Task | str | Path | None = None,
) -> Metrics:
    """Measure penetration, gaps, contacts, limits, wrench residual and quality of grasps on one object at the origin.

    Args:
        hand: The hand.
        obj: The object.
        T_world_root: Poses (N, 4, 4) of the base link in the object's frame; otherwise as in `Scene`.
        q: Joint values (N, n).
        task: What the grasps must do, and where, as of `load_task`.

    Returns:
        Measures, NaN for invalid poses (`Scene.posed`).

    Raises:
        GraspRefineError: an argument of another type or shape.
    """
    return metrics_of(Scene(hand, obj, T_world_root, q, task=as_task(task)))


def metrics_of(scene: Scene) -> Metrics:
    """Measure the grasps of a scene as `metrics`, contact errors with its targets and recorded contact links."""
    scene = scene.masked(scene.posed)
    hand, obj, T, q, links = scene.hand, scene.object, scene.T_world_root, scene.q, scene.links
    target_link, target_object = (
        np.full((len(q), len(links), 3), np.nan) if one is None else one
        for one in (scene.target_link, scene.target_object)
    )
    geometry = measure(HandObject.of(scene), T, q, target_link, target_object)
    gap, where = contact_gaps(scene, geometry.witness), (geometry.distance, geometry.witness, geometry.T_world_link)
    errors = contact_errors(*where, gap, target_link, target_object)
    # A link with several contact points appears several times, and counts once in all other measures.
    first = [column for column, link in enumerate(links) if links.index(link) == column]
    geometry = replace(geometry.columns(first), contact_error=errors)
    names = tuple(links[column] for column in first)
    grasps = MeasuredGrasps(hand, obj, names, T, q, geometry, scene.task)

    return Metrics({one.name: np.where(grasps.known, one.values(grasps), np.nan) for one in VALIDATED})
