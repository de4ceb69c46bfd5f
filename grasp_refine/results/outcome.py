"""Outcome of a refinement: grasps before and after, measured by one plain query each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_records import join, take
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_points
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.squeeze import grasp_forces
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.refinement.refine import Refinement
from grasp_refine.refinement.solvers.status import UNUSABLE
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.geometry import measure, movement
from grasp_refine.validation.metrics import quality_values
from grasp_refine.validation.motion import Motion


@dataclass(frozen=True, eq=False)
class Outcome:
    """N grasps before and after; every array has one row per grasp, and per-link ones a column for each of L links."""

    object: np.ndarray
    """Name of the object (N,)."""
    scale: np.ndarray
    """Factor that takes the object's mesh to metres (N,)."""
    row: np.ndarray
    """Row in the grasp file (N,)."""
    index: np.ndarray
    """Number among the grasps of the object (N,)."""
    hand_pose: np.ndarray
    """Refined poses (N, 7) of the base link, x y z qw qx qy qz, object frame, metres."""
    q: np.ndarray
    """Refined joint values (N, n)."""
    initial_pose: np.ndarray
    """Poses (N, 7) before refinement, as `hand_pose`."""
    initial_q: np.ndarray
    """Joint values (N, n) before refinement."""
    status: np.ndarray
    """A `Status` (N,)."""
    loss: np.ndarray
    """Loss in m^2 before and after (N, 2)."""
    iterations: np.ndarray
    """Iterations (N,), of all starts together."""
    queries: np.ndarray
    """Narrow-phase queries (N,)."""
    wall_s: np.ndarray
    """Share of the wall time of the refinement (N,), seconds."""
    cpu_s: np.ndarray
    """Share of the CPU time of the refinement (N,), seconds."""
    starts: np.ndarray
    """Number of starts from which each grasp was tried (N,)."""
    contact_error: np.ndarray
    """Largest of gap and target misses, before and after (N, 2, L), metres; NaN for links that should not touch."""
    penetration: np.ndarray
    """Deepest penetration over all links, before and after (N, 2), metres."""
    self_penetration: np.ndarray
    """Deepest penetration of links in each other, before and after (N, 2), metres."""
    wrench_residual: np.ndarray
    """Wrench that the best contact forces leave unbalanced, before and after (N, 2), as in `ContactForces.residual`."""
    quality: np.ndarray
    """`Quality.value` before and after (N, 2), from 0 to 1; NaN where a grasp is not finite, or
    has no contacts."""
    limits_violated: np.ndarray
    """Number of refined joint values beyond their limits (N,)."""
    palm_m: np.ndarray
    """Distance that the base link moved (N,), metres."""
    palm_rad: np.ndarray
    """Angle that the base link turned (N,), radians."""
    joints_rad: np.ndarray
    """Largest joint movement (N,), radians (metres for prismatic joints)."""
    touching: np.ndarray
    """Links that should touch (N, L)."""
    target_link: np.ndarray
    """Target points on the links (N, L, 3), link frames, metres; NaN: none."""
    target_object: np.ndarray
    """Target points on the object (N, L, 3), object frame, metres."""
    contact_link: np.ndarray
    """Refined witness points on links that should touch (N, L, 3), link frames, metres; NaN for other links."""
    contact_object: np.ndarray
    """Refined witness points on the object (N, L, 3), object frame, metres."""
    contact_normal: np.ndarray
    """Unit normals from link to object at the witness points (N, L, 3), object frame."""
    contact_distance: np.ndarray
    """Signed distances at the witness points (N, L), metres."""
    stage_pose: np.ndarray
    """Poses (N, 3, 7) of the base link at pregrasp, grasp and squeeze, as `hand_pose`."""
    stage_q: np.ndarray
    """Joint values (N, 3, n) at these stages; those of a squeeze may lie beyond the limits."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.status)

    @property
    def usable(self) -> np.ndarray:
        """True where a grasp (N,) was refined at all: it had links to touch with, and its queries succeeded."""
        return ~np.isin(self.status, UNUSABLE)

    @property
    def aimed(self) -> np.ndarray:
        """True where a grasp (N,) had targets."""
        return ~np.isnan(self.target_link).all(axis=(1, 2))

    @property
    def worst_error(self) -> np.ndarray:
        """Worst contact error before and after (N, 2), metres; NaN for grasps without contacts."""
        return np.where(
            np.isnan(self.contact_error).all(axis=2),
            np.nan,
            np.nan_to_num(self.contact_error, nan=-1.0).max(axis=2),
        )

    @property
    def mean_error(self) -> np.ndarray:
        """Mean contact error over the contacts before and after (N, 2), metres; NaN for grasps without contacts."""
        aimed = ~np.isnan(self.contact_error)
        count = aimed.sum(axis=2)
        total = np.where(aimed, self.contact_error, 0.0).sum(axis=2)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def select(self, rows: np.ndarray) -> Outcome:
        """Return the grasps `rows`, in that order."""
        return take(self, rows)

    @staticmethod
    def join(parts: Sequence[Outcome]) -> Outcome:
        """Return the grasps of all parts, which are of one hand."""
        return join(*parts)


@stage("measuring")
def compare(
    scene: Scene,
    refinement: Refinement,
    motion: Motion,
    *,
    margin: float,
    name: str,
    scale: float,
    row: np.ndarray,
    index: np.ndarray,
) -> Outcome:
    """Return the outcome of refining a scene.

    Args:
        scene: Scene before the refinement.
        refinement: Refined grasps.
        motion: Motion that closes the hand to the refined grasps.
        margin: Gap in metres that contact links should keep.
        name: The object's name in results.
        scale: Factor that took the object's mesh to metres.
        row: Rows of the grasps (N,) in their file.
        index: Numbers of the grasps (N,) among those of the object.
    """
    count = len(scene.q)
    # Invalid poses have no measures.
    before = scene.masked(scene.posed)
    T_after = np.where(scene.posed[:, None, None], refinement.T_world_root, np.nan)
    q_after = np.where(scene.posed[:, None], refinement.q, np.nan)
    T, q = np.concatenate([before.T_world_root, T_after]), np.concatenate([before.q, q_after])
    geometry = measure(
        scene.hand,
        scene.object,
        scene.links,
        T,
        q,
        np.concatenate([refinement.target_link, refinement.target_link]),
        np.concatenate([refinement.target_object, refinement.target_object]),
        margin,
        np.concatenate([refinement.touching, refinement.touching]),
    )
    pairs = touching_pairs(scene.hand)
    own = self_penetration(scene.hand, pairs, q)
    forces = grasp_forces(scene.hand, scene.object, scene.links, geometry.witness)
    quality = quality_values(scene.hand, scene.object, scene.links, T, q, geometry.witness)
    witness = geometry.witness.rows(slice(count, None))
    touching = refinement.touching & witness.valid
    T_link = geometry.T_world_link[count:]
    # As given, also where that is no valid pose.
    with np.errstate(all="ignore"):
        pose_before, pose_after = (pose_from_transform(one.T_world_root) for one in (scene, refinement))
    moved = movement(before.T_world_root, before.q, T_after, q_after)

    def before_after(values: np.ndarray) -> np.ndarray:
        return np.stack([values[:count], values[count:]], axis=1)

    def at_contacts(values: np.ndarray) -> np.ndarray:
        return np.where(touching.reshape(touching.shape + (1,) * (values.ndim - 2)), values, np.nan)

    return Outcome(
        object=np.full(count, name),
        scale=np.full(count, scale),
        row=row,
        index=index,
        hand_pose=pose_after,
        q=refinement.q,
        initial_pose=pose_before,
        initial_q=scene.q,
        status=refinement.status,
        loss=refinement.loss,
        iterations=refinement.iterations,
        queries=refinement.queries,
        wall_s=refinement.wall_s,
        cpu_s=refinement.cpu_s,
        starts=refinement.starts,
        contact_error=before_after(geometry.contact_error),
        penetration=before_after(geometry.penetration),
        self_penetration=before_after(own),
        wrench_residual=before_after(forces.residual),
        quality=before_after(quality),
        limits_violated=geometry.limits_violated[count:],
        palm_m=moved.palm_m,
        palm_rad=moved.palm_rad,
        joints_rad=moved.joints_rad,
        touching=refinement.touching,
        target_link=refinement.target_link,
        target_object=refinement.target_object,
        contact_link=at_contacts(transform_points(inverse(T_link), witness.point_a)),
        contact_object=at_contacts(witness.point_b),
        contact_normal=at_contacts(witness.normal),
        contact_distance=at_contacts(witness.distance),
        stage_pose=pose_from_transform(motion.T_world_root),
        stage_q=motion.q,
    )
