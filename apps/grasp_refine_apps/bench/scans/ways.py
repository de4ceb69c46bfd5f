"""Ways to refine grasps of an object that was seen in part."""

from __future__ import annotations

from typing import Literal, get_args

from grasp_refine.geometry.pieces import hull
from grasp_refine.objects.object import Object, scanned_object
from grasp_refine.scans.completion import complete
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan
from grasp_refine_apps.bench.scans.reconstruction import reconstruct

Way = Literal["unrefined", "hull", "reconstruction", "hypotheses", "mesh"]

WAYS: tuple[Way, ...] = get_args(Way)
"""Not refined; refined on the hull of the scan, on a plain reconstruction, on all hypotheses, on the true mesh."""


def object_for(way: Way, true: Object, scan: Scan, *, count: int, seed: int) -> Object:
    """Return the object on which grasps are refined, or, unrefined, on which the hand is thought to close.

    Args:
        way: One of `WAYS`.
        true: The object that was scanned.
        scan: Its scan.
        count: Largest number of hypotheses.
        seed: Seed of the hypotheses.

    Raises:
        GraspRefineError: the scan says too little.
    """
    if way == "mesh":
        return true
    if way == "hypotheses":
        return scanned_object(true.name, scan, complete(scan, count=count, seed=seed))
    pieces = (hull(scan.points),) if way == "hull" else tuple(reconstruct(scan))
    found = scanned_object(true.name, scan, (Hypothesis(way, pieces, 1.0),))
    # Neither knows that it may be wrong.
    return Object(true.name, found.mesh, found.convex, supplied=pieces)
