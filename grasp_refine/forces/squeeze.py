"""Squeezes: set points of a hand's position actuators at which its contacts press on the object."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Float
from grasp_refine.forces.contact_points import SLOTS, ContactPoints, LinkPatches
from grasp_refine.forces.squeeze_forces import SqueezeForces
from grasp_refine.forces.torques import MIN_LIMIT, joint_torques, limit_shares, tensions, torque_bounds
from grasp_refine.forces.wrench import RIDGE, ContactForces
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.demand import TOTAL_PRESSURE_N, Demand
from grasp_refine.scene.hand_object import HandObject, face_pairs
from grasp_refine.scene.scene import Scene
from grasp_refine.witness.face_patch import NUM_CORNERS, FacePairs

CONTACTS = ContactSelection(farthest=0.0)
"""Selection of the links with a contact: all within reach, however few."""

MIN_PRESSURE_SHARE = 0.4
"""Least share of the pressure at which a squeeze is planned where set points end: less holds fewer objects."""

SOFT_SHARE = 0.5
"""Share of the pressure that set points should allow: about the most that hands with soft actuators hold with."""

SQUEEZE_RIDGE = 4.0 * RIDGE
"""Weight of the squared forces: larger than for the residual, so that more contacts share the load."""


@dataclass(frozen=True, eq=False)
class Squeeze:
    """Squeezes of N grasps."""

    q: Float[np.ndarray, "N n"]
    """Set points (N, n) of the joints; they may lie beyond the limits."""
    forces: SqueezeForces
    """Forces that they are planned for."""


def squeezed(
    scene: Scene, prepared: HandObject | None = None, *, total: float | None = None
) -> Float[np.ndarray, "N n"]:
    """Return the set points (N, n) of `squeeze`, with its arguments."""
    return squeeze(scene, prepared, total=total).q


def squeeze(scene: Scene, prepared: HandObject | None = None, *, total: float | None = None) -> Squeeze:
    """Return set points of the joints that squeeze the grasps, q + J^T f / kp, and f; the root, or the arm, stays.

    The forces f on the object balance best, with pressures that sum to `total`, or to less where set
    points end before. A position actuator whose link is stopped by the object presses with kp times its position error,
    up to its limit, and the torques J^T f make these forces. The values may lie beyond the limits of the joints, which
    they do not move there: they press all the same. Grasps without contacts, or whose forces are not known, are kept;
    grasps with an invalid pose (`Scene.posed`) become NaN.

    Args:
        scene: Hand, object and grasps. The hand's `actuator` must be the actuator that moves it: for a
            simulation with another (`HandModel.actuator`), give the hand with that actuator.
        prepared: Of this hand and object; None: built here.
        total: Sum of the pressures in newtons; None: `TOTAL_PRESSURE_N`, or what the task demands where that is more
            and no actuator comes to its limit.
    """
    prepared = prepared or HandObject.of(scene)
    hand, chain = scene.hand, prepared.chain
    posed = scene.posed
    T = np.where(posed[:, None, None], scene.T_world_root, np.eye(4))
    q = np.where(posed[:, None], scene.q, 0.0)
    frames = chain(T, q)
    T_link = frames.T_world_link
    T_object = np.broadcast_to(np.eye(4), T_link.shape)
    witness = query(prepared.pairs, T_link, T_object, cutoff=CONTACTS.cutoff(hand, scene.links))
    points = contacts(hand, scene.object, scene.links, witness, T_link, prepared.faces)
    found = grasp_forces(points, scene.object, T[:, :3, :3], ridge=SQUEEZE_RIDGE)
    pressure = np.full(len(q), scene.demand.pressure_n if total is None else total)
    if total is None and scene.demand.pressure_n > TOTAL_PRESSURE_N:
        share = limit_shares(hand, _torques(hand, chain, frames, points, found.force), q).max(axis=1)
        pressure = np.clip(1.0 / np.maximum(share, MIN_LIMIT), TOTAL_PRESSURE_N, pressure)
    torque = _torques(hand, chain, frames, points, pressure[:, None, None] * found.force)
    # Weaker forces hold more objects than partly clipped forces, which do not balance.
    share = np.maximum(pressure_shares(hand, torque, q), MIN_PRESSURE_SHARE)
    known = np.isfinite(points.point).all(axis=-1) & (found.solved & posed)[:, None]
    vector = np.where(known[..., None], (pressure * share)[:, None, None] * found.force, np.nan)
    offsets = set_point_offsets(hand, torque * share[:, None], q)
    return Squeeze(np.where(posed[:, None], q + offsets, np.nan), _padded(scene, points, vector))


def _padded(scene: Scene, points: ContactPoints, vector: Float[np.ndarray, "N K 3"]) -> SqueezeForces:
    """Return forces (N, K, 3) with equally many columns on every object, patches included if the hand has them."""
    wanted = len(scene.links) + (SLOTS * (NUM_CORNERS - 1) if scene.hand.patches else 0)
    more = (0, 0), (0, wanted - points.link.shape[1])
    point, normal, force = (
        np.pad(part, (*more, (0, 0)), constant_values=np.nan) for part in (points.point, points.normal, vector)
    )
    return SqueezeForces(scene.links, np.pad(points.link, more), point, normal, force)


def pressure_shortfall(
    hand: Hand, obj: Object, chain: Chain, frames: Frames, points: ContactPoints, demand: Demand | None = None
) -> Float[np.ndarray, " N"]:
    """Return the share (N,), 0 to 1, of half the pressure with which a hand cannot press, as its set points end.

    Args:
        hand: The hand.
        obj: The object.
        chain: Kinematics of the links.
        frames: Poses of the links.
        points: Contact points.
        demand: Force and friction of the task; None: of `dexgraspbench`.
    """
    if hand.actuator.set_points is None:
        return np.zeros(len(frames.q))
    demand, axes = demand or Demand(), frames.T_world_root[:, :3, :3]
    pressure = SOFT_SHARE * demand.pressure_n
    force = pressure * grasp_forces(points, obj, axes, ridge=SQUEEZE_RIDGE).force
    return 1.0 - pressure_shares(hand, _torques(hand, chain, frames, points, force), frames.q)


def _torques(
    hand: Hand, chain: Chain, frames: Frames, points: ContactPoints, force: Float[np.ndarray, "N K 3"]
) -> Float[np.ndarray, "N n"]:
    """Torques (N, n) that make forces (N, K, 3) at the contact points; 0 at the joints of an arm."""
    torque = np.zeros_like(frames.q)
    for rows, some in points.groups():
        f = force[rows, None, : some.point.shape[1]]
        torque[rows] = joint_torques(chain, take(frames, rows), f, np.nan_to_num(some.point_on_link), some.link)[:, 0]
    return np.where(hand.arm_joints, 0.0, torque)


def pressure_shares(
    hand: Hand, torque: Float[np.ndarray, "N n"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, " N"]:
    """Return the largest shares (N,) of torques (N, n), up to 1, at which no set point ends."""
    if hand.actuator.set_points is None:
        return np.ones(len(q))
    demand = tensions(hand, torque)
    bound = np.where(demand < 0.0, -1.0, 1.0) * np.where(demand < 0.0, *torque_bounds(hand, q))
    # Force limits do not change the other actuators.
    ends = (bound < hand.actuator.force_limit) & (hand.actuator.kp > 0.0)
    most = np.where(ends, np.abs(demand) / np.maximum(bound, MIN_LIMIT), 0.0).max(axis=1, initial=1.0)
    return 1.0 / most


def grasp_forces(
    points: ContactPoints, obj: Object, axes: Float[np.ndarray, "N 3 3"], *, ridge: float = RIDGE
) -> ContactForces:
    """Best contact forces of N grasps, torques taken about the object's centre of mass.

    Args:
        points: Contact points.
        obj: The object.
        axes: Rotations of the hand, to whose axes friction pyramids are aligned.
        ridge: As for `contact_forces`.
    """
    found = points.forces_under(np.zeros((len(axes), 1, 6)), obj.center_of_mass, ridge=ridge, axes=axes)
    return ContactForces(*(getattr(found, field.name)[:, 0] for field in fields(found)))


def contacts(
    hand: Hand,
    obj: Object,
    links: tuple[str, ...],
    witness: Witness,
    T_world_link: Float[np.ndarray, "N L 4 4"],
    faces: FacePairs | None = None,
) -> ContactPoints:
    """Contact points of links near enough, and corners where flat faces meet.

    Args:
        hand: The hand.
        obj: The object, at the origin of the frame of the witness points.
        links: Links with collision geometry; of one listed several times the first counts.
        witness: Witness points (N, L) of links and object.
        T_world_link: Poses of the links.
        faces: Flat faces of links and object; None: found here.
    """
    touching = CONTACTS.choose(hand, links, witness)
    faces = faces or face_pairs(hand, (obj,), links)
    return ContactPoints.of(touching, witness, LinkPatches.of(faces, touching, T_world_link, witness))


def set_point_offsets(
    hand: Hand, torque: Float[np.ndarray, "N n"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, "N n"]:
    """Offsets (N, n) of the joints' set points from q, in rad or m, that make torques (N, n) where nothing moves.

    Each actuator, in series with the linkage that it moves (`Hand.stiffness`), makes as much of them as it can: nothing
    without stiffness, else up to its limit, and to where its set points end (`torques.torque_bounds`). Where it drives
    several joints through a tendon, it makes the nearest torques in the ratio of the joints, which is for equal ratios
    the mean for each. A tendon has the stiffness and the limit of its first joint. Its set point is the sum of
    ratio x set point over its joints, which share it in proportion to their ratios.
    """
    kp = hand.stiffness
    least, greatest = torque_bounds(hand, q)
    give = np.where(kp > 0.0, 1.0 / np.where(kp > 0.0, kp, 1.0), 0.0)
    ahead = np.clip(torque, least, greatest) * give
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        ratio = np.array(group.ratio)
        share, first = ratio / (ratio @ ratio), joints[0]
        tension = np.clip(torque[:, joints] @ share, least[:, first], greatest[:, first])
        ahead[:, joints] = tension[:, None] * share * give[first]
    return ahead
