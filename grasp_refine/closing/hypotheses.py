"""Grasps on a scanned object: how a closing hand ends on each solid that the object may be, and which grasp is best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.closing.pregrasp import open_hand
from grasp_refine.closing.stopped import close_until_stopped, table_obstruction
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.forces.quality import quality
from grasp_refine.forces.squeeze import CONTACTS, squeeze
from grasp_refine.geometry.sphere_points import on_sphere
from grasp_refine.hands.displacement import Displacement
from grasp_refine.measures.formulas import MeasuredGrasps, room
from grasp_refine.measures.geometry import measure
from grasp_refine.refinement.clearance import clearances
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.frozen import Frozen
from grasp_refine.refinement.gap_closing import RELEASE_GAP_M
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

REACH = 2.0
"""Length of the path on which fingers close, from the open hand, over the part up to the grasp."""

POSE_ERROR_M = 0.007
"""Distance in metres by which a solid is displaced to either side: of a pose that is off, or an object that moves when
a finger touches it before the others."""

IN_THE_WAY_M = (0.004, 0.02)
"""Depth in metres of a link in a solid where closing ends, up to which a grasp keeps its quality, and from which on it
has none: the hand pushes the object away by as much."""

DISTRUST = 2.0
"""Exponent of the mean quality over the solids: the object is none of them exactly. Of 96 grasps on six objects, seen
once, 72 % held, where the mean promised 80 % and its square 66 %; `bench scans` checks it on others."""


@dataclass(frozen=True, eq=False)
class Ends:
    """Ends of N closing hands on each of K solids."""

    T_open: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of the base link at which the hand is open beside all solids, object frame, metres."""
    q_open: Float[np.ndarray, "N n"]
    """Joint values (N, n) there."""
    q: Float[np.ndarray, "N K n"]
    """Joint values (N, K, n) at which each solid stops the fingers."""
    value: Float[np.ndarray, "N K"]
    """Probability (N, K) that the hand holds the object if it is this solid: mean quality over small displacements."""
    touching: Bool[np.ndarray, "N K L"]
    """Links (N, K, L) that touch there."""
    point: Float[np.ndarray, "N K L 3"]
    """Witness points (N, K, L, 3) on the solid, object frame, metres."""
    normal: Float[np.ndarray, "N K L 3"]
    """Unit normals (N, K, L, 3) from link to object."""
    room: Float[np.ndarray, " N"]
    """Share (N,) of the probability that surroundings and regions leave on the first solid, as of `formulas.room`."""

    @staticmethod
    def of(scene: Scene, config: Config, solids: tuple[HandObject, ...], envelope: HandObject) -> Ends:
        """Close the hands of a scene on each solid.

        The hand opens until it is clear of all solids; from there each finger closes towards the grasp and as far
        beyond it, until the solid or the table stops it.

        Args:
            scene: Grasps on the first solid; any may be in it, or away from it.
            config: Settings of the refinement.
            solids: The hand with each solid.
            envelope: The hand with the union of all solids.
        """
        hand, posed = scene.hand, scene.posed
        T_open, q_open = open_hand(replace(scene, object=envelope.object), envelope)
        T = np.where(posed[:, None, None], scene.T_world_root, np.eye(4))
        q_open = np.where(posed[:, None], q_open, 0.0)
        q = np.where(posed[:, None], scene.q, 0.0)
        fixed = hand.arm_joints | Frozen.of(hand, config.freeze).joints
        q_open = np.where(fixed, q, q_open)
        q_end = np.where(fixed, q, np.clip(q_open + REACH * (q - q_open), hand.lower, hand.upper))
        shifts = POSE_ERROR_M * on_sphere(2 * len(solids)).reshape(-1, 2, 3)[:, 0]
        gap = clearances(config, hand, solids[0].chain)
        found = []
        for prepared, shift in zip(solids, shifts, strict=True):
            chain, links = prepared.chain, prepared.chain.links
            # At the pose that is meant, and with the solid displaced to either side.
            T_each = np.concatenate([T, T, T])
            T_each[len(T) :, :3, 3] += np.repeat([shift, -shift], len(T), axis=0)
            from_open, to_end = np.tile(q_open, (3, 1)), np.tile(q_end, (3, 1))
            obstruction = None
            if scene.table is not None:
                # The table does not move with the solid.
                raised = (T_each - np.tile(T, (3, 1, 1)))[:, :3, 3] @ scene.table.normal
                obstruction = table_obstruction(prepared, scene.table, T_each, from_open, raised)
            share = close_until_stopped(prepared, T_each, from_open, to_end, obstruction=obstruction)
            closed = from_open + share * (to_end - from_open)
            frames = chain(T_each, closed)
            cutoff = CONTACTS.cutoff(hand, links)
            witness = prepared.query(np.zeros(len(T_each), dtype=np.int64), frames.T_world_link, cutoff=cutoff)
            known = hand, prepared.object, chain, frames, witness, gap, prepared.faces
            value = np.nan_to_num(quality(*known, demand=scene.demand).value)
            depth = np.where(witness.valid, -witness.distance, 0.0).max(axis=1, initial=0.0)
            value *= np.interp(depth, IN_THE_WAY_M, (1.0, 0.0))
            near = CONTACTS.choose(hand, links, witness) & (witness.distance <= RELEASE_GAP_M)
            mean = np.where(posed, value.reshape(3, -1).mean(axis=0), 0.0)
            at, witness = slice(len(T)), witness.rows(slice(len(T)))
            found.append((closed[at], mean, near[at], witness.point_b, witness.normal))
        q, value, touching, point, normal = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))
        links = solids[0].chain.links
        none = np.full((len(T), len(links), 3), np.nan)
        geometry = measure(solids[0], T, q[:, 0], none, none)
        grasps = MeasuredGrasps(hand, scene.object, links, T, q[:, 0], geometry, scene.task)
        free = np.where(posed, room(grasps), 1.0)
        return Ends(T_open, q_open, q, value, touching, point, normal, free)

    def probability(self, weights: Float[np.ndarray, " K"]) -> Float[np.ndarray, " N"]:
        """Return the probability (N,) that the hand holds the object, given the probability of each solid (K,)."""
        return (self.value @ weights) ** DISTRUST * self.room

    def contact_probability(self, weights: Float[np.ndarray, " K"]) -> Float[np.ndarray, "N L"]:
        """Return the probability (N, L) that each link touches the object, given the probability of each solid (K,)."""
        return np.einsum("nkl,k->nl", self.touching, weights)

    def motion(self, scene: Scene, solids: tuple[HandObject, ...], *, pressure: float | None = None) -> Motion:
        """Return the motion that closes the hands: to where the first solid stops them, and beyond.

        The squeeze presses on all solids: the thinnest decides how far each joint closes.

        Args:
            scene: Grasps on the first solid, as the hands end there.
            solids: The hand with each solid.
            pressure: As for `squeeze`.
        """
        each = [
            squeeze(replace(scene, object=solid.object, q=self.q[:, k]), solid, total=pressure)
            for k, solid in enumerate(solids)
        ]
        pressing, way = each[0], np.sign(scene.q - self.q_open)
        farthest = (way * np.stack([one.q for one in each])).max(axis=0)
        q = np.where(way != 0.0, way * farthest, pressing.q)
        T = np.stack([self.T_open, scene.T_world_root, scene.T_world_root], axis=1)
        return Motion(T, np.stack([self.q_open, scene.q, q], axis=1), pressing.forces)


def best_attempt(
    scene: Scene, attempts: list[Scene], ends: list[Ends], weights: Float[np.ndarray, " K"], config: Config
) -> np.ndarray:
    """Return the index (N,) of the attempt at each grasp to keep, by the probability that it holds over all solids.

    As `Config.prefer` says, it is the attempt nearest to the input grasp among the good enough, or the most probable.

    Args:
        scene: The input grasps.
        attempts: Attempts at all of them.
        ends: Ends of each attempt.
        weights: Probability of each solid.
        config: Settings of the refinement.
    """
    probability = np.stack([each.probability(weights) for each in ends])
    choice = np.round(probability, 6).argmax(axis=0)
    if config.prefer == "strongest":
        return choice
    measure = Displacement.of(scene.hand)
    T, q = scene.T_world_root, scene.q
    with np.errstate(invalid="ignore"):
        away = np.stack([measure.between(T, q, each.T_world_root, each.q) for each in attempts])
    enough = probability >= config.confidence
    nearest = np.where(enough, away, np.inf).argmin(axis=0)
    return np.where(enough.any(axis=0), nearest, choice)
