"""Errors of alignment tasks, written down again for tests."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import transform_points
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.tasks import Tasks


def errors_at(
    pair: BodyPair, tasks: Tasks, T_a: np.ndarray, T_b: np.ndarray, margin: float, patch: Patch | None = None
) -> np.ndarray:
    """|x_a - t_a|^2 + |x_b - t_b|^2 + (d - beta)^2 (N,), by plain witness points or those of a patch."""
    pairs = Pairs((pair.a,), (pair.b,))
    found = query(pairs, T_a[:, None], T_b[:, None]).reshape(-1)
    if patch is not None:
        found = patch.refine(pairs, T_a, T_b, found, tasks.target_a, tasks.target_b)
    miss_a = found.point_a - transform_points(T_a, tasks.target_a)
    miss_b = found.point_b - transform_points(T_b, tasks.target_b)
    return (miss_a**2).sum(axis=1) + (miss_b**2).sum(axis=1) + (found.distance - margin) ** 2
