"""Placement of a hand by inverse kinematics on contacts: its fingers at given points and normals, its palm near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import log_so3, matvec, transform_points
from grasp_refine.hands.chain import Chain, integrate
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.transfers.hand_frame import HandFrame

ITERATIONS, CLEARING = 30, 15
"""Iterations of a placement, and of one that clears the object."""

DEPTH_WEIGHT = 2.0
"""Weight of the depth of links in the object."""

NEAR_M = 0.005
"""Distance in metres within which links are kept out of the object."""

NORMAL_M = 0.01
"""Distance in metres that a contact normal which is off by one radian counts as much as."""

PALM_WEIGHT, PALM_TURN_M, JOINT_M = 0.15, 0.015, 0.0015
"""Weight of the palm's distance from where it should be; distances in metres that a turn of the palm, and a joint value
away from the start, by one radian count as much as."""

PAD_COSINE = 0.2
"""Least cosine between the normal of a finger's surface where it may touch and the direction in which it closes."""

NUM_POINTS = 128
"""Largest number of surface points of each contact link where it may touch."""

MAX_STEP_RAD, MAX_STEP_M = 0.3, 0.05
"""Largest steps of joints, or of slides in their lever, and of the palm."""

DAMPING = 1e-6
"""Damping of steps, m^2."""


@dataclass(frozen=True, eq=False)
class Pads:
    """Surface points of the fingers of a hand where they may touch, P for each of k fingers; link frames."""

    links: tuple[str, ...]
    """Contact links."""
    link: Int[np.ndarray, "k P"]
    """Index (k, P) of the link of each point; points of fingers with few are repeated."""
    point: Float[np.ndarray, "k P 3"]
    """Points (k, P, 3), metres."""
    normal: Float[np.ndarray, "k P 3"]
    """Outward unit normals (k, P, 3)."""

    @staticmethod
    @kept
    def of(hand: Hand) -> Pads:
        """Return the surface of the contact links that looks in the direction in which they close."""
        frame = HandFrame.of(hand)
        links = tuple(dict.fromkeys(contact.link for contact in hand.contacts))
        chain, step = Chain(hand, links), 1e-4 * frame.closure.closing * hand.per_radian
        now, before, after = (
            chain(np.eye(4)[None], (frame.q + sign * step)[None]).T_world_link[0] for sign in (0.0, -1.0, 1.0)
        )
        parts = []
        for finger in frame.fingers:
            of_finger: list[tuple[int, np.ndarray, np.ndarray]] = []
            for contact in hand.contacts:
                if contact.group != finger or contact.link in [links[each[0]] for each in of_finger]:
                    continue
                at = links.index(contact.link)
                surface = hand.links_by_name[contact.link].solid.candidates
                motion = transform_points(after[at], surface.points) - transform_points(before[at], surface.points)
                motion = motion @ now[at][:3, :3]
                cosine = (motion * surface.normals).sum(axis=1) / np.maximum(np.linalg.norm(motion, axis=1), 1e-12)
                pad = np.flatnonzero(cosine >= PAD_COSINE)
                pad = pad[:NUM_POINTS] if len(pad) else np.arange(min(NUM_POINTS, len(cosine)))
                of_finger.append((at, surface.points[pad], surface.normals[pad]))
            parts.append(
                (
                    np.concatenate([np.full(len(points), at) for at, points, _ in of_finger]),
                    np.concatenate([points for _, points, _ in of_finger]),
                    np.concatenate([normals for _, _, normals in of_finger]),
                )
            )
        most = max(len(part[0]) for part in parts)
        link, point, normal = (
            np.stack([np.resize(part[k], (most, *part[k].shape[1:])) for part in parts]) for k in range(3)
        )
        return Pads(links, link, point, normal)

    def points(
        self, hand: Hand, T: Float[np.ndarray, "M 4 4"], q: Float[np.ndarray, "M n"]
    ) -> Float[np.ndarray, "M k P 3"]:
        """Return the points (M, k, P, 3) in the frame of the object."""
        return transform_points(Chain(hand, self.links)(T, q).T_world_link[:, self.link], self.point)


@dataclass(frozen=True, eq=False)
class Placed:
    """M placements of a hand with k fingers."""

    T: Float[np.ndarray, "M 4 4"]
    """Poses (M, 4, 4) of the base link, object frame."""
    q: Float[np.ndarray, "M n"]
    """Joint values (M, n)."""
    cost: Float[np.ndarray, " M"]
    """Sum of the squares (M,) of all misses, m^2."""


@dataclass(frozen=True, eq=False)
class Wishes:
    """Wishes of M placements of a hand with k fingers, object frame."""

    point: Float[np.ndarray, "M k 3"]
    """Points (M, k, 3) on the object where its fingers should touch, metres; NaN: anywhere."""
    normal: Float[np.ndarray, "M k 3"]
    """Outward unit normals (M, k, 3) of the object there."""
    weight: Float[np.ndarray, "M k"]
    """Weights (M, k) of the fingers."""
    T: Float[np.ndarray, "M 4 4"]
    """Poses (M, 4, 4) of the base link."""
    q: Float[np.ndarray, "M n"]
    """Joint values (M, n)."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Objects that the links of M placements keep out of."""

    prepared: HandObject
    """The hand and the objects."""
    number: Int[np.ndarray, " M"]
    """Index (M,) of each placement's object."""


def place(hand: Hand, wishes: Wishes, start: Placed | None = None, obstacle: Obstacle | None = None) -> Placed:
    """Return the placements of a hand that come nearest to wishes, by damped least squares from there on.

    In each iteration, each finger touches with the point of its surface that fits its wish best; normals of finger and
    object should be opposed there. Joint limits hold.

    Args:
        hand: The hand.
        wishes: Where fingers, palm and joints should be.
        start: Placements to begin from; None: the poses and joint values of the wishes.
        obstacle: Objects that links keep out of; None: they may be anywhere.
    """
    iterations = ITERATIONS if obstacle is None else CLEARING
    frame, pads = HandFrame.of(hand), Pads.of(hand)
    chain = Chain(hand, pads.links)
    lower, upper = hand.lower, hand.upper
    T, q = (wishes.T, np.clip(wishes.q, lower, upper)) if start is None else (start.T, start.q)
    wanted = ~np.isnan(wishes.point[..., 0])
    most = np.concatenate([np.full(3, MAX_STEP_M), np.full(3, MAX_STEP_RAD), MAX_STEP_RAD * hand.per_radian])
    metric = np.tile(np.concatenate([np.full(3, 1.0), np.full(3, 1e-2), 1e-2 / hand.per_radian**2]), (len(q), 1))
    damping, axes = np.full(len(q), DAMPING), np.zeros((len(q), 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = wishes.T[:, :3, :3]
    for iteration in range(iterations + 1):
        r, J = _linearized(chain, pads, frame, wishes, wanted, T, q, hand.per_radian)
        unilateral = np.zeros(r.shape, dtype=bool)
        if obstacle is not None:
            depth, slope = _depths(obstacle, T, q)
            r, J = np.concatenate([r, depth], axis=1), np.concatenate([J, slope], axis=1)
            unilateral = np.concatenate([unilateral, np.ones(depth.shape, dtype=bool)], axis=1)
        if iteration == iterations:
            break
        low = np.maximum(np.concatenate([np.full((len(q), 6), -np.inf), lower - q], axis=1), -most)
        high = np.minimum(np.concatenate([np.full((len(q), 6), np.inf), upper - q], axis=1), most)
        # Steps of the palm along its own axes at first, so that bounds turn with the scene.
        J[:, :, :6] = J[:, :, :6] @ axes
        dx, _ = bounded_step(J, r, damping, metric, np.minimum(low, 0.0), np.maximum(high, 0.0), unilateral)
        T, q = integrate(T, matvec(axes, dx[:, :6])), np.clip(q + dx[:, 6:], lower, upper)
    r = np.where(unilateral, np.maximum(r, 0.0), r)
    return Placed(T, q, (r * r).sum(axis=1))


def _depths(
    obstacle: Obstacle, T: Float[np.ndarray, "M 4 4"], q: Float[np.ndarray, "M n"]
) -> tuple[Float[np.ndarray, "M L"], Float[np.ndarray, "M L d"]]:
    """Return weighted depths (M, L) of links in the object, negative outside, and their Jacobians (M, L, 6 + n)."""
    chain = obstacle.prepared.chain
    frames = chain(T, q)
    witness = obstacle.prepared.query(obstacle.number, frames.T_world_link, cutoff=NEAR_M)
    near = witness.valid
    normal, p = (np.where(near[..., None], each, 0.0) for each in (witness.normal, witness.point_a))
    # The normal points into the object.
    covector = DEPTH_WEIGHT * np.concatenate([normal, np.cross(p, normal)], axis=-1)
    J = chain.to_joint_space(frames, covector, np.arange(len(chain.links)))
    return DEPTH_WEIGHT * np.where(near, -witness.distance, -NEAR_M), J


def _linearized(
    chain: Chain,
    pads: Pads,
    frame: HandFrame,
    wishes: Wishes,
    wanted: Bool[np.ndarray, "M k"],
    T: Float[np.ndarray, "M 4 4"],
    q: Float[np.ndarray, "M n"],
    per_radian: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "M r"], Float[np.ndarray, "M r d"]]:
    """Return residuals (M, r) in metres and their Jacobians (M, r, 6 + n)."""
    count, fingers = wanted.shape
    frames = chain(T, q)
    rows, finger = np.arange(count)[:, None], np.arange(fingers)
    goal, outward = np.nan_to_num(wishes.point), np.nan_to_num(wishes.normal)
    # Of each finger, the surface point that fits best.
    T_point = frames.T_world_link[:, pads.link]
    points = transform_points(T_point, pads.point)
    normals = matvec(T_point[..., :3, :3], np.broadcast_to(pads.normal, points.shape))
    off = ((points - goal[:, :, None]) ** 2).sum(axis=-1)
    off += NORMAL_M**2 * ((normals + outward[:, :, None]) ** 2).sum(axis=-1)
    best = off.argmin(axis=2)
    p, n = points[rows, finger, best], normals[rows, finger, best]
    link = pads.link[finger, best]
    weight = np.where(wanted, wishes.weight, 0.0)[..., None]
    misses = [(weight * (p - goal)).reshape(count, -1), (NORMAL_M * weight * (n + outward)).reshape(count, -1)]
    eye = np.broadcast_to(np.eye(3), (count, fingers, 3, 3))
    at = np.concatenate([eye, np.cross(p[..., None, :], eye)], axis=-1) * weight[..., None]
    turn = np.concatenate([np.zeros_like(eye), np.cross(n[..., None, :], eye)], axis=-1) * (
        NORMAL_M * weight[..., None]
    )
    covector = np.concatenate([at.reshape(count, -1, 6), turn.reshape(count, -1, 6)], axis=1)
    J = chain.to_joint_space(frames, covector, np.tile(np.repeat(link, 3, axis=1), (1, 2)))
    # The palm: the root moves by v and turns about its own origin by w.
    arm = matvec(T[:, :3, :3], np.broadcast_to(frame.center, (count, 3)))
    center, wished = T[:, :3, 3] + arm, wishes.T[:, :3, 3] + matvec(wishes.T[:, :3, :3], frame.center)
    turned = log_so3(T[:, :3, :3] @ wishes.T[:, :3, :3].mT)
    misses += [PALM_WEIGHT * (center - wished), PALM_TURN_M * turned, JOINT_M * (q - wishes.q) / per_radian]
    palm = np.zeros((count, 6 + q.shape[1], 6 + q.shape[1]))
    palm[:, :3, :3] = PALM_WEIGHT * np.eye(3)
    palm[:, :3, 3:6] = PALM_WEIGHT * np.cross(np.eye(3), arm[:, None]).mT
    palm[:, 3:6, 3:6] = PALM_TURN_M * np.eye(3)
    palm[:, np.arange(6, palm.shape[1]), np.arange(6, palm.shape[1])] = JOINT_M / per_radian
    return np.concatenate(misses, axis=1), np.concatenate([J, palm], axis=1)
