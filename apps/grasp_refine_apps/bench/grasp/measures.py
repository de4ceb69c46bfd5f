"""Measures of grasps by a plain query, independent of the solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.measures.geometry import measure
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Measures:
    """Measures of N grasps; L links."""

    contact_error: np.ndarray
    """gap^2 + |x_a - t_a|^2 + |x_b - t_b|^2 (N, L) in square metres; NaN for links without a target."""
    distance: np.ndarray
    """Signed distance (N, L) in metres of each link to the object."""
    penetration: np.ndarray
    """Deepest penetration (N,) of any link in the object, in metres."""
    self_penetration: np.ndarray
    """Deepest penetration (N,) of links in each other, in metres."""
    limits_violated: np.ndarray
    """Number of joints (N,) beyond their limits."""
    point_link: np.ndarray
    """Witness points (N, L, 3) on the links, link frames, metres."""
    point_object: np.ndarray
    """Witness points (N, L, 3) on the object, object frame, metres."""


def measure_grasps(scene: Scene, T_world_root: np.ndarray, q: np.ndarray) -> Measures:
    """Measure the grasps of a scene at root poses (N, 4, 4) and joint values (N, n)."""
    hand, links = scene.hand, scene.links
    invalid = np.full((len(q), len(links), 3), np.nan)
    target_link, target_object = (
        invalid if target is None else target for target in (scene.target_link, scene.target_object)
    )
    geometry = measure(HandObject.of(scene), T_world_root, q, target_link, target_object)
    T_link, witness = geometry.T_world_link, geometry.witness
    misses = witness.point_a - transform_points(T_link, target_link), witness.point_b - target_object
    return Measures(
        contact_error=geometry.distance**2 + sum((miss**2).sum(axis=-1) for miss in misses),
        distance=geometry.distance,
        penetration=geometry.penetration,
        self_penetration=self_penetration(hand, touching_pairs(hand), q),
        limits_violated=geometry.limits_violated,
        point_link=((witness.point_a - T_link[..., :3, 3])[..., None, :] @ T_link[..., :3, :3])[..., 0, :],
        point_object=witness.point_b,
    )
