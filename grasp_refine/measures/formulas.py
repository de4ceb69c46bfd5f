"""Formulas of the measures that `measures` lists: functions of grasps at given poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.forces.quality import CONFIDENCE, Quality, quality
from grasp_refine.forces.squeeze import contacts, grasp_forces
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.hands.palm import palm_poses
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.measures.fidelity import Fidelity
from grasp_refine.measures.geometry import Geometry, Movement, mean_over_links, worst_over_links
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.scene.contact_patches import PatchMisses, patch_misses
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M
from grasp_refine.scene.demand import Demand
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.hand_object import moving_links
from grasp_refine.scene.original import Original
from grasp_refine.scene.surroundings import SceneDepths, scene_depths
from grasp_refine.scene.task import Task

COSTLY_M = (0.0005, 0.0025)
"""Depth in metres of a link in a body of the scene, or distance of a contact from where it may be, up to which it costs
no quality, and from which on it costs all."""


@dataclass(frozen=True, eq=False)
class MeasuredGrasps:
    """N grasps on one object at the world's origin, with the one plain query that all formulas share."""

    hand: Hand
    """The hand."""
    object: Object
    """The object."""
    links: tuple[str, ...]
    """Names of its L links with collision geometry."""
    T_world_root: Float[np.ndarray, "N 4 4"]
    """Poses of the base link in the object's frame (N, 4, 4), metres."""
    q: Float[np.ndarray, "N n"]
    """Joint values (N, n)."""
    geometry: Geometry
    """Distances, witness points and poses of the links."""
    task: Task = Task()
    """Task of the grasps; its regions are made for the object."""
    original: Original | None = None
    """Contacts of the grasps that these were transferred from; None: they were not."""

    @property
    def environment(self) -> Environment | None:
        """Bodies around the object; None: there are none."""
        return self.task.environment

    @cached_property
    def regions(self) -> ContactRegions | None:
        """Regions of the object in which links should touch it; None: everywhere."""
        return self.task.on(self.object).regions

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.q)

    @property
    def known(self) -> Bool[np.ndarray, " N"]:
        """True for grasps (N,) that are finite, and all of whose queries succeeded."""
        return self.geometry.witness.valid.all(axis=1)

    @cached_property
    def quality(self) -> Quality:
        """Shortcomings of the grasps, arbitrary for grasps that are not `known`."""
        known = self.known
        T = np.where(known[:, None, None], self.T_world_root, np.eye(4))
        q = np.where(known[:, None], self.q, 0.0)
        chain = Chain(self.hand, self.links)
        return quality(self.hand, self.object, chain, chain(T, q), self.geometry.witness, demand=self.demand)

    @cached_property
    def demand(self) -> Demand:
        """Force and friction of the task."""
        return Demand.of(self.task, self.object)

    @cached_property
    def table_depths(self) -> Float[np.ndarray, "N L"] | None:
        """Depths (N, L) of the links below the table, metres, -inf for the base of an arm; None: there is no table."""
        table = self.task.plane_under(self.object)
        if table is None:
            return None
        bodies = [self.hand.links_by_name[name].solid for name in self.links]
        depth = -table.heights(bodies, self.geometry.T_world_link)[0]
        moving = moving_links(self.hand, self.links)
        return depth if moving is None else np.where(moving, depth, -np.inf)

    @cached_property
    def scene_depths(self) -> SceneDepths | None:
        """Penetration of the bodies around the object; None: there are none."""
        if self.environment is None:
            return None
        bodies = tuple(self.hand.links_by_name[name].solid for name in self.links)
        return scene_depths(self.environment, bodies, self.geometry.T_world_link, moving_links(self.hand, self.links))

    @cached_property
    def fidelity(self) -> Fidelity | None:
        """Fidelity to the grasps that these were transferred from; None: they were not."""
        if self.original is None:
            return None
        palm = palm_poses(self.hand, self.T_world_root, self.q)
        return Fidelity.of(self.hand, self.links, self.original, self.geometry.witness, palm)

    @cached_property
    def contact_misses(self) -> PatchMisses | None:
        """Distances of contact patches from the regions; None: there are none."""
        if self.regions is None:
            return None
        bodies = [self.hand.links_by_name[name].solid for name in self.links]
        geometry = self.geometry
        return patch_misses(self.regions, bodies, self.object.body, geometry.T_world_link, geometry.witness)


@dataclass(frozen=True, eq=False)
class MeasuredRefinement:
    """Effort and movement of the refinement of N grasps, one number of each kind per grasp."""

    starts: Int[np.ndarray, " N"]
    """Number of starts."""
    iterations: Int[np.ndarray, " N"]
    """Number of iterations of all starts together."""
    queries: Int[np.ndarray, " N"]
    """Number of narrow-phase queries."""
    loss: Float[np.ndarray, " N"]
    """Loss after refinement, m^2."""
    cpu_s: Float[np.ndarray, " N"]
    """CPU time, seconds."""
    wall_s: Float[np.ndarray, " N"]
    """Wall time, seconds."""
    movement: Movement
    """Movement of the base link and the joints."""
    displacement: Float[np.ndarray, " N"]
    """`Displacement` of the hand, metres."""
    contacts_moved: Float[np.ndarray, " N"]
    """Mean distance by which the contacts of kept links moved on the object, metres; NaN without kept links."""
    links_kept: Float[np.ndarray, " N"]
    """Share of the contact links of the input grasp that are kept; NaN where it has none."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.loss)


def self_penetration_depth(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the deepest penetration of links in each other (N,), metres; see `self_penetration`."""
    return self_penetration(grasps.hand, touching_pairs(grasps.hand), grasps.q)


def scene_penetration(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the deepest penetration of links in bodies around the object (N,), metres; NaN without a scene."""
    found = grasps.scene_depths
    return np.full(len(grasps.q), np.nan) if found is None else found.depth


def contact_error(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the largest contact error (N,) of a link, metres; NaN where none should touch."""
    return worst_over_links(grasps.geometry.contact_error)


def contact_error_mean(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the mean contact error (N,) of the links that should touch, metres; NaN where none should."""
    return mean_over_links(grasps.geometry.contact_error)


def region_miss(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the largest distance (N,) of a contact patch from where hands may touch, metres; NaN without regions."""
    found = grasps.contact_misses
    return np.full(len(grasps.q), np.nan) if found is None else np.where(grasps.known, found.miss.max(axis=1), np.nan)


def arm_dexterity(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Smallest singular value (N,) of the palm's Jacobian in the arm's joints, m/rad; NaN without an arm."""
    if grasps.hand.arm is None:
        return np.full(len(grasps.q), np.nan)
    return ArmKinematics(grasps.hand).dexterity(grasps.T_world_root, grasps.q)


def wrench_residual(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the wrench (N,) that the best contact forces leave unbalanced, as `ContactForces.residual`."""
    T = np.where(grasps.known[:, None, None], grasps.T_world_root, np.eye(4))
    geometry = grasps.geometry
    points = contacts(grasps.hand, grasps.object, grasps.links, geometry.witness, geometry.T_world_link)
    return grasp_forces(points, grasps.object, T[:, :3, :3]).residual


def room_share(metres: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the quality that is left to grasps with a link so deep, or so far from where it may be.

    Up to `COSTLY_M[0]` that costs nothing, from `COSTLY_M[1]` on all.
    """
    least, most = COSTLY_M
    return np.clip((most - metres) / (most - least), 0.0, 1.0)


def quality_value(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return `Quality.value` (N,), less where links are in a body around the object or touch where they should not.

    See `room_share`; NaN where a grasp is not `known`.
    """
    return np.where(grasps.known, grasps.quality.value, np.nan) * room(grasps)


def likely_quality(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return `quality_value` (N,) on the first completion of a scanned object; NaN for other objects."""
    return quality_value(grasps) if grasps.object.hypotheses else np.full(len(grasps), np.nan)


def contacts_seen(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the links in contact that touch where the scan has points; NaN without contact or scan.

    Links within `CONTACT_DISTANCE_M` count.
    """
    scan, witness = grasps.object.scan, grasps.geometry.witness
    if scan is None:
        return np.full(len(grasps), np.nan)
    touching = witness.valid & (witness.distance <= CONTACT_DISTANCE_M)
    number = touching.sum(axis=1)
    return np.where(number > 0, (touching & scan.seen(witness.point_b)).sum(axis=1) / np.maximum(number, 1), np.nan)


def room(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the quality that is left to grasps in a body of the scene or the table, or elsewhere."""
    wrong = [] if grasps.scene_depths is None else [grasps.scene_depths.depth]
    wrong += [] if grasps.table_depths is None else [grasps.table_depths.max(axis=1)]
    wrong += [] if grasps.regions is None else [region_miss(grasps)]
    return np.prod([np.ones(len(grasps)), *map(room_share, wrong)], axis=0)


def largest_mass(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the largest mass (N,) in kg with which the quality is at least `CONFIDENCE`, 0 where it is with none.

    At most `LOADS[1]` times that of the task; NaN where a grasp is not `known`.
    """
    most = np.where(room(grasps) >= CONFIDENCE, grasps.demand.mass_kg * grasps.quality.largest_load(), 0.0)
    return np.where(grasps.known, most, np.nan)


def contact_distance(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
    """Return the mean distance (N,) of the fingers in metres, NaN for a hand without fingers.

    The distance of a finger is that of its nearest contact link, at least 0.
    """
    distance, fingers = grasps.geometry.distance, dict[str, set[int]]()
    for contact in grasps.hand.contacts:
        fingers.setdefault(contact.group, set()).add(grasps.links.index(contact.link))
    if not fingers:
        return np.full(len(distance), np.nan)
    nearest = np.stack([distance[:, sorted(columns)].min(axis=1) for columns in fingers.values()])
    return np.maximum(nearest, 0.0).mean(axis=0)


def contact_number(grasps: MeasuredGrasps) -> Int[np.ndarray, " N"]:
    """Return the number of links (N,) within `CONTACT_DISTANCE_M` of the object."""
    return (grasps.geometry.distance <= CONTACT_DISTANCE_M).sum(axis=1)


def of_fidelity(name: str) -> Callable[[MeasuredGrasps], Float[np.ndarray, " N"]]:
    """Return the formula of a property of `Fidelity`; NaN for grasps that were not transferred."""

    def formula(grasps: MeasuredGrasps) -> Float[np.ndarray, " N"]:
        return np.full(len(grasps), np.nan) if grasps.fidelity is None else getattr(grasps.fidelity, name)

    return formula
