"""Scene of a refinement: one hand, an object, and grasps; or several objects, each with some of the grasps."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind, check_shape, shape_error
from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import SKEWED, is_rigid, transform_from_pose
from grasp_refine.grasps.poses import unit_poses, without_zero_quaternions
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.scene.demand import Demand
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.original import Original
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.task import Task

MAX_MAGNITUDE = 1e6
"""Largest magnitude of poses, joint values and targets, in metres or radians: no grasp is beyond, where squares
overflow in the end."""

TARGET_FIELDS = ("target_link", "target_object", "direction")
"""Fields of a scene with contact points and contact normals of links, (N, L, 3)."""

GRASP_FIELDS = ("T_world_root", "q", *TARGET_FIELDS, "contact_gap")
"""Fields of a scene with numbers of each grasp, (N, ...)."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One hand, one object at the world's origin, and N grasps to refine.

    Grasps on several objects are refined together, where all have the same task. Each hand meets its own object alone.

    Arrays may be given as lists, as torch tensors, and for one grasp without their batch dimension; poses may be
    (x, y, z, qw, qx, qy, qz) (N, 7) too. They are kept as float64 NumPy arrays of the shapes below.
    """

    hand: Hand
    """Hand that grasps."""
    object: Object
    """Object that is grasped; its pose is the identity."""
    T_world_root: np.ndarray
    """Initial poses (N, 4, 4) of the hand's base link in the object's frame, metres."""
    q: np.ndarray
    """Initial joint values (N, n) in `hand.joint_names` order."""
    target_link: np.ndarray | None = None
    """Contact points on links (N, L, 3), link frames, metres, a column per link of `links`; NaN: none. None: auto."""
    target_object: np.ndarray | None = None
    """Contact points on the object (N, L, 3), object frame, metres."""
    direction: np.ndarray | None = None
    """Wanted contact normals from link to object (N, L, 3), object frame, unit length; NaN: any."""
    contact_gap: np.ndarray | None = None
    """Recorded contact links: the gap (N, L) in metres that each should keep from the object; NaN for other links, and
    for all links of grasps without a record. None: no grasp has one; see `contact_links`."""
    task: Task = Task()
    """Task of the grasps; its regions are made for the object."""
    original: Original | None = None
    """Contacts of the grasps of another hand that these were transferred from; None: they were not."""
    others: tuple[Object, ...] = ()
    """Further objects, of some of the grasps."""
    of_object: np.ndarray | None = None
    """Index (N,) of each grasp's object: 0 is `object`, 1 the first of the `others`. None: 0 for all."""

    def __repr__(self) -> str:
        optional = [
            name for name in (*TARGET_FIELDS, "table", "environment", "regions") if getattr(self, name) is not None
        ]
        more = f", with {', '.join(optional)}" if optional else ""
        on = self.object.name if not self.others else count_text(len(self.objects), "object")
        return f"Scene({self.hand.name} on {on}: {count_text(len(self.q), 'grasp')}{more})"

    def __post_init__(self) -> None:
        """Check the arguments, once for all uses of the scene.

        Raises:
            GraspRefineError: no hand or object, arrays of other shapes or without numbers, quaternions that are not of
                unit length, targets on the link or on the object only, or several objects with regions, with a
                scene, or of different demands.
        """
        check_kind("hand", self.hand, Hand)
        check_kind("object", self.object, Object)
        check_kind("task", self.task, Task)
        if not self.task.is_on_object:
            object.__setattr__(self, "task", self.task.on(self.object))
        arrays: dict[str, np.ndarray] = {}
        arrays["T_world_root"], arrays["q"] = grasp_arrays(self.hand, self.T_world_root, self.q)
        count, links = len(arrays["q"]), len(self.links)
        for name in TARGET_FIELDS:
            value = getattr(self, name)
            if value is not None:
                value = as_numbers(name, value)
                value = value[None] if value.ndim == 2 else value
                if value.shape != (count, links, 3):
                    why = f"one row for each grasp, one column for each of scene.links of hand '{self.hand.name}'"
                    raise shape_error(name, value, (count, links, 3), why)
                arrays[name] = value
        if self.contact_gap is not None:
            gap = as_numbers("contact_gap", self.contact_gap)
            check_shape("contact_gap", gap, count, links)
            arrays["contact_gap"] = gap
        if (self.target_link is None) != (self.target_object is None):
            raise GraspRefineError("targets need target_link and target_object together, got one of them")
        if self.of_object is not None:
            check_shape("of_object", self.of_object, count)
            if not np.isin(self.of_object, np.arange(len(self.objects))).all():
                raise GraspRefineError(f"of_object must be indices below {len(self.objects)}, the number of objects")
        for name, value in arrays.items():
            object.__setattr__(self, name, value)
        if self.others and not all(self.fits(other) for other in self.others):
            raise GraspRefineError(
                "grasps on several objects need a task that is the same for all: without regions, without a scene, and "
                "with one mass and one table"
            )

    @cached_property
    def number(self) -> Int[np.ndarray, " N"]:
        """Index (N,) of each grasp's object in `objects`."""
        return np.zeros(len(self.q), dtype=np.int64) if self.of_object is None else self.of_object

    @property
    def objects(self) -> tuple[Object, ...]:
        """All objects."""
        return self.object, *self.others

    def centers(self, rows: np.ndarray) -> Float[np.ndarray, "M 3"]:
        """Return the centres of mass (M, 3) of the objects of some grasps, metres."""
        return np.stack([each.center_of_mass for each in self.objects])[self.number[rows]]

    def fits(self, obj: Object) -> bool:
        """Return whether grasps on another object can be in the scene: the task is the same there."""
        check_kind("others", obj, Object)
        anywhere = self.environment is None and self.regions is None
        same = Demand.of(self.task, obj) == self.demand and self.task.plane_under(obj) == self.table
        return anywhere and same

    @cached_property
    def table(self) -> Plane | None:
        """A plane that no link may go through."""
        return self.task.plane_under(self.object)

    @cached_property
    def demand(self) -> Demand:
        """Force and friction that the contacts should withstand."""
        return Demand.of(self.task, self.object)

    @property
    def environment(self) -> Environment | None:
        """Bodies around the object that no link may go into."""
        return self.task.environment

    @property
    def regions(self) -> ContactRegions | None:
        """Regions of the object in which links should touch it, or should not."""
        return self.task.regions

    @property
    def links(self) -> tuple[str, ...]:
        """Links with collision geometry, the columns of every per-link array."""
        return links_of(self.hand)

    @property
    def finite(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps whose poses and joint values are finite."""
        return np.isfinite(self.T_world_root).all(axis=(1, 2)) & np.isfinite(self.q).all(axis=1)

    @property
    def out_of_reach(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps that the arm does not reach: only joint values of the arm are not finite."""
        return is_out_of_reach(self.hand, self.T_world_root, self.q)

    @property
    def posed(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps with a valid pose: poses are rigid, and poses and joint values within `MAX_MAGNITUDE`."""
        return is_posed(self.T_world_root, self.q)

    @property
    def valid(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps that can be refined: targets within `MAX_MAGNITUDE` too, and unit wanted normals."""
        sound = self.posed
        for target in (self.target_link, self.target_object):
            if target is not None:
                sound &= ~(np.abs(target) > MAX_MAGNITUDE).any(axis=(1, 2))
        if self.direction is not None:
            squared = (np.clip(self.direction, -2.0, 2.0) ** 2).sum(axis=-1)
            sound &= ((np.abs(squared - 1.0) <= SKEWED) | np.isnan(self.direction).all(axis=-1)).all(axis=1)
        return sound

    def select(self, rows: np.ndarray | slice) -> "Scene":
        """Return the scene with the grasps `rows`, in that order."""
        names = (*GRASP_FIELDS, "of_object")
        arrays: dict[str, Any] = {
            name: None if (array := getattr(self, name)) is None else array[rows] for name in names
        }
        return replace(self, **arrays, original=take(self.original, rows))

    def masked(self, rows: Bool[np.ndarray, " N"]) -> "Scene":
        """Return the scene with NaN for all numbers of the grasps where `rows` (N,) is False."""
        if rows.all():
            return self

        def kept(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else np.where(rows.reshape(-1, *(1,) * (values.ndim - 1)), values, np.nan)

        arrays: dict[str, Any] = {name: kept(getattr(self, name)) for name in GRASP_FIELDS}
        return replace(self, **arrays)


def is_posed(T_world_root: np.ndarray, q: np.ndarray) -> Bool[np.ndarray, " N"]:
    """Return a mask (N,) of valid poses (N, 4, 4) and joint values (N, n): rigid, and within `MAX_MAGNITUDE`."""
    near = (np.abs(T_world_root) <= MAX_MAGNITUDE).all(axis=(1, 2)) & (np.abs(q) <= MAX_MAGNITUDE).all(axis=1)
    return near & is_rigid(T_world_root)


def is_out_of_reach(hand: Hand, T_world_root: np.ndarray, q: np.ndarray) -> Bool[np.ndarray, " N"]:
    """Return a mask (N,) of poses (N, 4, 4) and joint values (N, n) that are finite except for the arm's joints."""
    arm = hand.arm_joints
    rest = np.isfinite(T_world_root).all(axis=(1, 2)) & np.isfinite(q[:, ~arm]).all(axis=1)
    return rest & ~np.isfinite(q[:, arm]).all(axis=1)


def grasp_arrays(hand: Hand, T_world_root: Any, q: Any) -> tuple[np.ndarray, np.ndarray]:
    """Transforms (N, 4, 4) and joint values (N, n) of given grasps of a hand, float64.

    Args:
        hand: The hand.
        T_world_root: Transforms (N, 4, 4) or poses (x, y, z, qw, qx, qy, qz) (N, 7) of its base link, or one of them.
        q: Joint values (N, n) in `hand.joint_names` order, or (n,) of one grasp.

    Raises:
        GraspRefineError: not numbers, other shapes, or a quaternion that is not of unit length.
    """
    T, q = as_numbers("T_world_root", T_world_root), as_numbers("q", q)
    if T.shape[-1:] == (7,) and T.ndim <= 2:
        poses = without_zero_quaternions(T.reshape(-1, 7))
        T = transform_from_pose(unit_poses(poses, "T_world_root", GraspRefineError))
    T, q = T[None] if T.ndim == 2 else T, q[None] if q.ndim == 1 else q
    if T.shape[1:] != (4, 4):
        raise shape_error("T_world_root", T, ("N", 4, 4), "transforms, or poses x y z qw qx qy qz (N, 7)")
    joints = len(hand.joint_names)
    if q.shape != (len(T), joints):
        why = f"one row for each pose, one column for each of the {joints} joints in joint_names of hand '{hand.name}'"
        raise shape_error("q", q, (len(T), joints), why)
    return T, q


def links_of(hand: Hand) -> tuple[str, ...]:
    """Links of a hand with collision geometry; contact links come first, as often as they have contact points."""
    first = [contact.link for contact in hand.contacts]
    return (
        *first,
        *(link.name for link in hand.links if link.body is not None and link.name not in first),
    )
