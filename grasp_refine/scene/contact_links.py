"""Contact links of a grasp: the links that should touch the object, over which its contact error is measured."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Float
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.scene import Scene


def contact_gaps(scene: Scene, witness: Witness, selection: ContactSelection | None = None) -> Float[np.ndarray, "N L"]:
    """Return the gap in metres that each contact link of grasps should keep from the object; NaN for other links.

    The contact links of a grasp are the links that should touch the object. They are

    1. links recorded with the grasp (`Scene.contact_gap`): a refinement records the links that it made touch, with the
       gap that each should keep;
    2. links with a target;
    3. without either, links near the object at the grasp (`ContactSelection`), or with a wanted normal.

    The contact error of a grasp is the largest of |signed distance - gap| over its contact links, and of the misses of
    their targets. An input grasp and its refinement are two grasps, each with its own contact links.

    Args:
        scene: The grasps.
        witness: Witness points (N, L) of the links and the object at the grasps, at least below `selection.cutoff`.
        selection: Selection of links near the object; None: the defaults.
    """
    if scene.target_link is not None and scene.target_object is not None:
        chosen = ~(np.isnan(scene.target_link) | np.isnan(scene.target_object)).any(axis=-1)
        aimed = chosen
    else:
        chosen = (selection or ContactSelection()).choose_within(scene.hand, scene.links, witness, scene.regions)
        aimed = np.zeros_like(chosen)
    if scene.direction is not None:
        chosen = chosen | ~np.isnan(scene.direction[..., 0])
    gap = np.where(chosen, 0.0, np.nan)
    if scene.contact_gap is None:
        return gap
    recorded = ~np.isnan(scene.contact_gap).all(axis=1, keepdims=True)
    return np.where(recorded & ~(aimed & np.isnan(scene.contact_gap)), scene.contact_gap, gap)
