"""Regions in which hands should touch an object: given ones, else the regions of its scene."""

from __future__ import annotations

from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.objects.region_spec import Regions, contact_regions
from grasp_refine.scene.environment import Environment


def regions_of(obj: Object, touch: Regions, avoid: Regions, environment: Environment | None) -> ContactRegions | None:
    """Return the regions in which hands should touch an object or not, each kind of the scene where none are given.

    Raises:
        GraspRefineError: as of `contact_regions`.
    """
    if environment is not None:
        touch, avoid = touch or environment.touch, avoid or environment.avoid
    return contact_regions(obj, touch, avoid)
