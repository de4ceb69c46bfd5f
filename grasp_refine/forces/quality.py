"""Quality of grasps: the probability that they hold, from contact points and normals alone, without simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.calibration import CALIBRATION
from grasp_refine.forces.equilibrium import PUSH_SHARE, Equilibrium
from grasp_refine.forces.infeasible_torques import mode_shares
from grasp_refine.forces.squeeze import contacts
from grasp_refine.forces.stiffness import object_motion
from grasp_refine.forces.torques import GIVE_RAD, joint_torques, limit_shares
from grasp_refine.forces.wrench import PLANNING_FRICTION, turn_loads
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.demand import TOTAL_PRESSURE_N, Demand
from grasp_refine.witness.face_patch import FacePairs

LOW_FRICTION = 0.1
"""Friction with which the forces should still balance in `dexgraspbench`: less than the planning friction."""

DEEP = 0.01
"""Penetration, or gaps of contacts, in metres that count as much as forces that do not balance at all."""

EJECTING = (1.0, 2.0)
"""Depths over `DEEP` between which the probability falls to 0, beyond what the calibration says, which saw few such
grasps: of hands pushed into objects, those with 0.95 or more held in 91 % of cases at 10 to 12 mm, in 80 % to 15, in
40 % to 20, and deeper in none."""

PUSHES = PUSH_SHARE * np.concatenate([np.eye(3, 6), -np.eye(3, 6)])
"""Outer forces (6, 6) that the contacts should balance too, as loads of `contact_forces` in the axes of the hand."""

HOLDING_PRESSURE_N = 3.5
"""Sum of the pressures, in newtons, at which torques must be within their limits in `dexgraspbench`: hands that cannot
make so much begin to lose the object, whichever hand it is."""

YIELDING_RAD_N = 0.01
"""Angle in rad by which the object may turn for each newton of a push of 1 N, or for the same share of another force:
contacts well apart hold it by less."""

MOST_YIELDING = 9.0
"""Largest excess over `YIELDING_RAD_N`, as a share of it; unstable grasps get it."""

YIELDING_SHARE = 0.02
"""Share of that excess in the score: with more, no more of the chosen attempts hold."""

CONFIDENCE = 0.95
"""Quality from which a grasp is good enough."""

LOADS = (1e-2, 1e2)
"""Smallest and largest load, over that of the task, that are tried for the largest one."""

LOAD_BISECTIONS = 20
"""Bisections of the largest load: it is known to a hundred thousandth."""

SHORTCOMINGS = ("slippery", "pushed", "deep", "open", "strained", "yielding")
"""Fields of `Quality` that its score and its probability are made of."""


@dataclass(frozen=True, eq=False)
class Quality:
    """Shortcomings of each of N grasps, all without unit and 0 at best; NaN where a grasp has no forces."""

    slippery: Float[np.ndarray, " N"]
    """Wrench residual (N,) with friction `LOW_FRICTION`, or as little for the task."""
    pushed: Float[np.ndarray, " N"]
    """Mean wrench residual (N,) under `PUSHES`, with the planning friction of the task; joints that share an actuator
    make torques in its ratio, as nearly as balance allows."""
    deep: Float[np.ndarray, " N"]
    """Deepest penetration of hand and object (N,), over `DEEP`."""
    open: Float[np.ndarray, " N"]
    """Mean gap of the contacts (N,), each counted by its pressure, over `DEEP`."""
    torque_share: Float[np.ndarray, " N"]
    """Largest torque (N,) of any joint under `PUSHES`, with pressures that sum to `HOLDING_PRESSURE_N`, as a share of
    its limit; 0 where the actuators can make all torques. Where set points end, and in modes in which a linkage yields,
    the limit is the torque that is made after the joint gave way by `GIVE_RAD`."""
    turn_share: Float[np.ndarray, " N"]
    """Angle (N,) by which the object turns for each newton of the pushes, their mean, as a share of `YIELDING_RAD_N`
    (see `stiffness`)."""
    weakest_push: Float[np.ndarray, "N 3"]
    """Direction (N, 3) of the push of `PUSHES` that leaves the largest residual, in the frame of the witness points."""
    deepest_link: Int[np.ndarray, " N"]
    """Index (N,) of the link that is deepest in the object."""
    farthest_contact: Int[np.ndarray, " N"]
    """Index (N,) of the link whose gap, weighted by its pressure, is largest."""
    strained_joint: Int[np.ndarray, " N"]
    """Index (N,) of the independent joint whose torque is the largest share of its limit; behind the joints come the
    modes in which linkages yield (`Hand.modes`)."""

    __repr__ = brief

    @property
    def strained(self) -> Float[np.ndarray, " N"]:
        """Excess (N,) of `torque_share` over 1: 0 where the actuators can make all torques."""
        return np.maximum(self.torque_share - 1.0, 0.0)

    @property
    def yielding(self) -> Float[np.ndarray, " N"]:
        """Excess (N,) of `turn_share` over 1: 0 where contacts are far enough apart; `MOST_YIELDING` if unstable."""
        return np.clip(self.turn_share - 1.0, 0.0, MOST_YIELDING)

    def under(self, load: Float[np.ndarray, "*#N"] | float) -> Quality:
        """Return the quality under forces on the object that are `load` times as large."""
        return replace(self, torque_share=self.torque_share * load, turn_share=self.turn_share * load)

    def largest_load(self, confidence: float = CONFIDENCE) -> Float[np.ndarray, " N"]:
        """Return the largest multiples (N,) of the load, from `LOADS[0]` to `LOADS[1]`, with a quality of `confidence`.

        0 where the smallest has less, and where a grasp has no forces; the largest where that has it.
        """
        low, high = (np.full(len(self.slippery), np.log(end)) for end in LOADS)
        for _ in range(LOAD_BISECTIONS):
            middle = 0.5 * (low + high)
            enough = self.under(np.exp(middle)).value >= confidence
            low, high = np.where(enough, middle, low), np.where(enough, high, middle)
        least, most = (self.under(end).value >= confidence for end in LOADS)
        return np.where(most, LOADS[1], np.where(least, np.exp(low), 0.0))

    @property
    def shortcomings(self) -> Float[np.ndarray, "N 6"]:
        """The fields `SHORTCOMINGS` (N, 6)."""
        return np.stack([getattr(self, name) for name in SHORTCOMINGS], axis=1)

    @property
    def score(self) -> Float[np.ndarray, " N"]:
        """Sum of the shortcomings (N,), `yielding` by `YIELDING_SHARE`; infinite where a grasp has no forces."""
        total = self.slippery + self.pushed + self.deep + self.open + self.strained + YIELDING_SHARE * self.yielding
        return np.where(np.isnan(total), np.inf, total)

    @property
    def value(self) -> Float[np.ndarray, " N"]:
        """Probability (N,) that a grasp holds, see `calibration`; NaN where a grasp has no forces."""
        low, high = EJECTING
        return CALIBRATION.probability(self.shortcomings) * np.clip((high - self.deep) / (high - low), 0.0, 1.0)


def quality(
    hand: Hand,
    obj: Object,
    chain: Chain,
    frames: Frames,
    witness: Witness,
    clearance: Float[np.ndarray, " L"] | float = 0.0,
    faces: FacePairs | None = None,
    *,
    demand: Demand | None = None,
) -> Quality:
    """Quality of N grasps: their shortcomings, and the probability that they hold, from contact points and normals.

    Friction, pressures and forces are of the task: they change in proportion to it. Where flat faces meet, the contact
    is their patch, with forces at its corners (`contact_points`).

    Args:
        hand: The hand.
        obj: The object, at the origin of the frame in which the witness points are.
        chain: Kinematics of the L links; of a link listed several times the first counts.
        frames: Poses of the links.
        witness: Witness points (N, L) of links and object, at least of links near enough to be contacts.
        clearance: Gap (L,) in metres that links have on purpose, which is no shortcoming.
        faces: Flat faces of links and object; None: found here.
        demand: Force and friction of the task; None: of `dexgraspbench`.
    """
    check_kind("demand", demand, Demand | None)
    check_kind("hand", hand, Hand)
    check_kind("obj", obj, Object)
    check_kind("chain", chain, Chain)
    check_kind("frames", frames, Frames)
    check_kind("witness", witness, Witness)
    points = contacts(hand, obj, chain.links, witness, frames.T_world_link, faces)
    center = obj.center_of_mass
    demand = demand or Demand()
    equilibrium = Equilibrium.of(hand, chain, PLANNING_FRICTION * demand.grip)
    axes = frames.T_world_root[:, :3, :3]
    pushes = turn_loads(PUSHES, axes)
    forms, none = equilibrium.forms_at(frames), np.zeros((len(pushes), 1, 6))
    pushed = points.forces_under(pushes, center, friction=equilibrium.friction, forms=forms, axes=axes)
    slippery = points.forces_under(none, center, friction=LOW_FRICTION * demand.grip, axes=axes)
    torque = np.zeros((len(pushes), pushes.shape[1], len(hand.joint_names)))
    in_modes = np.zeros((*torque.shape[:2], len(hand.modes)))
    for rows, some in points.groups():
        force = HOLDING_PRESSURE_N * demand.effort * pushed.force[rows, :, : some.point.shape[1]]
        made = chain, take(frames, rows), force, np.nan_to_num(some.point_on_link), some.link
        torque[rows], in_modes[rows] = joint_torques(*made), mode_shares(hand, *made, give=GIVE_RAD)
    share = np.concatenate([limit_shares(hand, torque, frames.q[:, None]), in_modes], axis=-1).max(axis=1)
    force = TOTAL_PRESSURE_N * np.nan_to_num(pushed.force.mean(axis=1))
    motion = object_motion(hand, chain, frames, points, force, center, pushes / PUSH_SHARE)
    turn = demand.load * np.linalg.norm(motion[..., 3:], axis=-1).mean(axis=1)
    turn = np.where(pushed.solved.all(axis=1), turn, np.nan)
    distance, L = np.where(witness.valid, witness.distance, 0.0), len(chain.links)
    wanted = np.take_along_axis(np.broadcast_to(clearance, distance.shape), points.link, axis=1)
    depth, gap = np.maximum(-distance, 0.0), slippery.pressure[:, 0] * np.maximum(points.gap - wanted, 0.0)
    # The columns of corners follow the columns of links.
    total = gap[:, :L].sum(axis=1) + gap[:, L:].sum(axis=1)
    farthest = np.nan_to_num(gap).argmax(axis=1)
    return Quality(
        slippery=slippery.residual[:, 0],
        pushed=pushed.residual.mean(axis=1),
        deep=depth.max(axis=1, initial=0.0) / DEEP,
        open=total / DEEP,
        torque_share=share.max(axis=1, initial=0.0),
        turn_share=turn / YIELDING_RAD_N,
        weakest_push=pushes[np.arange(len(pushes)), np.nan_to_num(pushed.residual).argmax(axis=1), :3] / PUSH_SHARE,
        deepest_link=depth.argmax(axis=1),
        farthest_contact=points.link[np.arange(len(gap)), farthest],
        strained_joint=share.argmax(axis=1) if share.shape[1] else np.zeros(len(share), dtype=np.int64),
    )
