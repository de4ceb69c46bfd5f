"""Merging of fingers for grippers with two jaws: the fingers that press against the thumb become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.objects.object import Object
from grasp_refine.transfers.nearest_surface import nearest_surface
from grasp_refine.transfers.source_grasps import SourceGrasps

OPPOSED_COSINE = -0.3
"""Largest cosine between the normals at the thumb and at a finger that presses against it."""

MERGED = "fingers"
"""Name of the merged fingers."""


def merged(grasps: SourceGrasps, obj: Object) -> SourceGrasps:
    """Return grasps of two fingers: the thumb, and the point of the object in the middle of the fingers opposed to it.

    Where none is opposed, or the thumb does not touch, all other fingers count.
    """
    cosine = np.einsum("nk,nfk->nf", np.nan_to_num(grasps.normal[:, 0]), np.nan_to_num(grasps.normal))
    others = grasps.touching & (np.arange(len(grasps.fingers)) > 0)
    opposed = others & (cosine <= OPPOSED_COSINE)
    chosen = np.where(opposed.any(axis=1, keepdims=True), opposed, others)
    count = chosen.sum(axis=1)
    middle = np.where(chosen[..., None], grasps.point, 0.0).sum(axis=1) / np.maximum(count, 1)[:, None]
    point, normal, _ = nearest_surface(obj, middle)
    known = (count > 0)[:, None]
    weight = np.where(chosen, grasps.weight, 0.0).max(axis=1)
    return replace(
        grasps,
        fingers=(grasps.fingers[0], MERGED),
        point=np.stack([grasps.point[:, 0], np.where(known, point, np.nan)], axis=1),
        normal=np.stack([grasps.normal[:, 0], np.where(known, normal, np.nan)], axis=1),
        weight=np.stack([grasps.weight[:, 0], weight], axis=1),
    )
