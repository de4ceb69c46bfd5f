"""Nodes of a scan: points that were seen, and the edges of the other solids that the object may be."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from grasp_refine.objects.object import Object
from grasp_refine_apps.viewer.drawing.scene_nodes import Meshes
from grasp_refine_apps.viewer.drawing.shapes import pieces_shape

SEEN_COLOR, MAYBE_COLOR = (25, 110, 190), (150, 110, 190)
"""Colours of the points that were seen, and of the edges of the other solids."""

POINT_M = 0.0012
"""Size of a drawn point, metres."""

MAX_POINTS = 4000
"""Largest number of points that are drawn."""

LEAST_OPACITY, MOST_OPACITY = 0.08, 0.5
"""Opacities of the edges of an improbable solid, and of one as probable as the one that is drawn."""


class ScanNodes:
    """Points and other solids of one scanned object; none of an object that is known."""

    def __init__(self, scene: viser.SceneApi, name: str, obj: Object) -> None:
        """Make the nodes below `name`, which is in the object's frame."""
        self.points: Any = None
        """Points that were seen; None: the object is no scan."""
        self.others: list[Meshes] = []
        """Edges of each other solid that it may be."""
        if obj.scan is None:
            return
        seen = obj.scan.points[:: max(len(obj.scan.points) // MAX_POINTS, 1)]
        self.points = scene.add_point_cloud(
            f"{name}/seen", seen.astype(np.float32), colors=SEEN_COLOR, point_size=POINT_M, point_shape="circle"
        )
        for number, other in enumerate(obj.hypotheses[1:]):
            share = min(other.weight / obj.hypotheses[0].weight, 1.0)
            self.others.append(
                Meshes(
                    scene,
                    f"{name}/maybe{number}",
                    [pieces_shape(other.pieces, MAYBE_COLOR)],
                    opacity=LEAST_OPACITY + share * (MOST_OPACITY - LEAST_OPACITY),
                    wireframe=True,
                    shadow=False,
                )
            )
