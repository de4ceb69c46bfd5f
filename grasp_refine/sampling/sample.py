"""Grasps out of nothing: hands come to an object from many sides, more or less open, and close until they touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import join, take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import matvec, pose_from_transform, transform_points
from grasp_refine.forces.squeeze import grasp_forces
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.chain import Frames
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.sampling.closure_frame import ClosureFrame, closure_frame
from grasp_refine.sampling.placement import Placed, opposed, placed, places_on
from grasp_refine.scene.contact_selection import link_groups
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import links_of

MOST = 10_000
"""Most grasps that can be asked for."""

BATCH, SPARE = 256, 8
"""Hands that are placed at once, and how many good ones are looked for per wanted grasp, to choose from."""

TRIES, AT_LEAST = 32, 1024
"""Most hands that are placed per wanted grasp, but in all at least so many where grasps are rare."""

CLEAR, STOP, HOLDS, DEEP = 2e-3, 1e-3, 2e-3, 2e-3
"""In metres: how far open hands are from anything at least, how near a link stops, how near it counts as touching, and
how deep none may be in anything."""

NEAR = 0.03
"""Distance in metres up to which it matters how far links are from the object."""

STEPS, LEAST, LARGEST = 40, 5e-3, 0.2
"""Most steps in which fingers close; the smallest that is worth another, and the largest, in radians."""

SPEED, SLIDE = (0.4, 1.0), 0.1
"""Joints close at speeds between these, so that fingers curl in many ways. A radian of a slide is so many metres."""

FEW = 0.1
"""What it counts in a score to be held by one group of links only; by several, their share of it."""

ALIKE, HALVINGS = 0.02, 6
"""Distance in metres below which grasps are alike, and how often it may be halved where there are too few others."""


def sample_grasps(
    hand: Hand,
    obj: Object,
    count: int,
    *,
    seed: int | tuple[int, ...] = 0,
    table: Plane | None = None,
    prepared: HandObject | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GraspSet:
    """Up to `count` grasps of a hand on an object, none like another, the most promising first; at scale 1.

    Half of the hands come so that their fingers close on two places that face away from each other, the others along
    the normal of a place. Each backs off until it is clear and closes: a joint stops when a link that it moves touches,
    those beyond go on; a finger that meets nothing stays where it was nearest. What is then held by fewer than two
    groups of links (fingers, palm), or penetrates anything, is no grasp. The others count by how well their contacts
    can balance each other. There are fewer than `count` where no more are found among `TRIES` hands for each.

    Args:
        hand: Any hand whose joints move contact links; its shapes are around the rest pose.
        obj: The object.
        count: Number of grasps, 1 to `MOST`.
        seed: The same seed gives the same grasps.
        table: A plane that no link goes through, and no hand comes from below.
        prepared: Of this hand and object; None: built here.
        progress: Is told after each batch how many grasps were found, of how many hands.

    Raises:
        GraspRefineError: an argument of another kind, a count out of range, a hand that cannot grip, or no grasp was
            found at all.
    """
    check_kind("hand", hand, Hand)
    check_kind("obj", obj, Object)
    check_kind("count", count, int)
    check_kind("seed", seed, int | tuple[int, ...])
    check_kind("table", table, Plane | None)
    check_kind("prepared", prepared, HandObject | None)
    if np.min(seed, initial=0) < 0:
        raise GraspRefineError(f"seeds must be at least 0, got {seed}")
    if not 1 <= count <= MOST:
        raise GraspRefineError(f"1 to {MOST} grasps can be sampled, got {count}")
    closure, rng = closure_frame(hand), np.random.default_rng(seed)
    closing = _Closing(prepared or HandObject(hand, obj), closure, table)
    pairs = opposed(obj, closure.opening)
    found, total, tried = [], 0, 0
    while total < SPARE * count and tried < max(AT_LEAST, TRIES * count):
        places = places_on(obj, pairs, BATCH, rng)
        found.append(_good(closing, closing.closed(closing.clear(placed(hand, closure, places, table, rng)), rng)))
        total, tried = total + len(found[-1].q), tried + BATCH
        if progress is not None:
            progress(total, tried)
    if not total:
        low, high = closing.prepared.box
        raise GraspRefineError(
            f"no grasp of hand '{hand.name}' on object '{obj.name}' was found in {tried} tries: the object is "
            f"{' x '.join(f'{side:.2g}' for side in high - low)} m large, the hand opens {closure.opening:.2g} m wide"
        )
    best = _different(join(*found), closure, count)
    return GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.full(len(best.q), obj.name),
        scale=np.ones(len(best.q)),
        hand_pose=pose_from_transform(best.T),
        q=best.q,
    )


@dataclass(frozen=True, eq=False)
class _Scored(Placed):
    """Hands that grasp."""

    score: Float[np.ndarray, " M"]
    """How promising they are; lower is better."""


def _good(closing: _Closing, hands: Placed) -> _Scored:
    """The hands that grasp, with their scores."""
    prepared, links = closing.prepared, links_of(closing.prepared.hand)
    look = closing.look(hands, NEAR)
    deepest = look.gap.min(axis=1)
    if prepared.self_collision_pairs is not None:
        T, (first, second) = look.frames.T_world_link, prepared.self_collision_links
        own = query(prepared.self_collision_pairs, T[:, first], T[:, second], cutoff=0.0)
        deepest = np.minimum(deepest, own.distance.min(axis=1))
    group = np.array(link_groups(prepared.hand, links))
    touching = look.witness.distance <= HOLDS
    groups = np.stack([touching[:, group == name].any(axis=1) for name in dict.fromkeys(group)]).sum(axis=0)
    good = np.flatnonzero((groups >= 2) & (deepest >= -DEEP))
    forces = grasp_forces(prepared.hand, prepared.object, links, look.witness.rows(good))
    hands = _Scored(hands.T[good], hands.q[good], hands.way[good], forces.residual + FEW / groups[good])
    return take(hands, forces.solved)


def _different(hands: _Scored, closure: ClosureFrame, count: int) -> _Scored:
    """The best `count` hands that are not alike, of the better ones, best first."""
    hands = take(hands, np.argsort(hands.score, kind="stable")[: 2 * count])
    # Where the centre of the grip is, and three points around it: their distances count moves and turns together.
    points = closure.center + closure.radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    place = transform_points(hands.T[:, None], points).reshape(-1, 12) / 2.0
    chosen: list[int] = []
    for apart in ALIKE * 0.5 ** np.arange(HALVINGS + 1):
        for row in range(len(place)):
            if len(chosen) < count and (np.linalg.norm(place[chosen] - place[row], axis=1) >= apart).all():
                chosen.append(row)
    return take(hands, np.sort(chosen))


@dataclass(frozen=True, eq=False)
class _Look:
    """Where the L links of M hands are, and how near to anything."""

    frames: Frames
    """Poses of the links."""
    witness: Witness
    """Links and object (M, L)."""
    table: Float[np.ndarray, "M L"]
    """How far the links are above the table, in metres; inf without one."""

    @property
    def gap(self) -> Float[np.ndarray, "M L"]:
        """How far the links are from the object or the table, whichever is nearer, in metres."""
        return np.minimum(self.witness.distance, self.table)


@dataclass(frozen=True, eq=False)
class _Closing:
    """How hands close on an object."""

    prepared: HandObject
    closure: ClosureFrame
    table: Plane | None

    def clear(self, hands: Placed) -> Placed:
        """Those that are clear of everything, back along the way where they were not."""
        hands, gone = replace(hands, T=hands.T.copy()), np.zeros(len(hands.q))
        above, busy = np.zeros(len(gone)), np.arange(len(gone))
        while len(busy):
            look, way = self.look(take(hands, busy), CLEAR), hands.way[busy]
            above[busy] = look.table.min(axis=1)
            lack = np.where(look.witness.valid, np.maximum(CLEAR - look.witness.distance, 0.0), 0.0)
            # Where a surface lies along the way, the step is short of what it takes: it may end sooner than it seems.
            back = (lack / np.maximum((look.witness.normal * way[:, None]).sum(axis=-1), 0.3)).max(axis=1)
            back = np.where(back > 0, np.maximum(back, 1e-3), 0.0)
            hands.T[busy, :3, 3] -= back[:, None] * way
            gone[busy] += back
            busy = busy[(back > 0) & (gone[busy] < self.closure.opening)]
        return take(hands, (gone < self.closure.opening) & (above > CLEAR))

    def closed(self, hands: Placed, rng: np.random.Generator) -> Placed:
        """The same with their fingers closed, all of them at once."""
        closure, hand = self.closure, self.prepared.hand
        slides = np.array([hand.joints_by_name[name].kind == "prismatic" for name in hand.joint_names], dtype=bool)
        unit = np.where(slides, SLIDE, 1.0)
        speed = rng.uniform(*SPEED, hands.q.shape) * unit * np.abs(closure.closing)
        end = np.where(closure.closing > 0, closure.upper, closure.lower)
        hands, nearest = replace(hands, q=hands.q.copy()), hands.q.copy()
        least = np.full((len(nearest), len(self._fingers)), np.inf)
        busy, witness = np.arange(len(nearest)), None
        for _ in range(STEPS):
            if not len(busy):
                break
            look = self.look(take(hands, busy), NEAR, witness)
            q, gap = hands.q[busy], look.gap
            for k, (links, joints) in enumerate(self._fingers):
                now = look.witness.distance[:, links].min(axis=1)
                nearer = now < least[busy, k]
                least[busy[nearer], k] = now[nearer]
                nearest[np.ix_(busy[nearer], joints)] = q[np.ix_(nearer, joints)]
            stopped = (self._moves & (gap <= STOP)[..., None]).any(axis=1) | (q == end)
            rate = np.where(stopped, 0.0, speed[busy])
            # No point of a link moves faster than this, so that no step takes it into anything.
            fastest = matvec(self._speeds(look.frames), rate)
            time = (gap - 0.5 * STOP) / np.maximum(fastest, 1e-9)
            step = rate * np.where(self._moves, time[..., None], LARGEST).min(axis=1).clip(0.0, LARGEST)
            hands.q[busy] = np.clip(q + closure.closing * step, closure.lower, closure.upper)
            more = (step > LEAST * unit).any(axis=1)
            busy, witness = busy[more], look.witness.rows(more)
        for k, (_, joints) in enumerate(self._fingers):
            missed = np.flatnonzero(least[:, k] > STOP)
            hands.q[np.ix_(missed, joints)] = nearest[np.ix_(missed, joints)]
        return hands

    def look(self, hands: Placed, cutoff: float, previous: Witness | None = None) -> _Look:
        """Where the links are and how near to anything, to the object only up to a cutoff in metres."""
        prepared = self.prepared
        frames = prepared.chain(hands.T, hands.q)
        T = frames.T_world_link
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff, previous=previous)
        if self.table is None:
            return _Look(frames, witness, np.full(T.shape[:2], np.inf))
        lowest = transform_points(T, self.table.lowest(prepared.bodies, T))
        return _Look(frames, witness, lowest @ np.asarray(self.table.normal) - self.table.offset)

    def _speeds(self, frames: Frames) -> np.ndarray:
        """How fast (M, L, n) each joint moves any point of each link at most, in m/rad, or m/m."""
        prepared, (M, L) = self.prepared, frames.T_world_link.shape[:2]
        center = transform_points(frames.T_world_link, prepared.bounding_spheres[:, :3])
        axes = np.broadcast_to(np.eye(3), (M, L, 3, 3))
        velocity = np.concatenate([axes, np.cross(center[..., None, :], axes)], axis=-1)
        turning = np.concatenate([np.zeros_like(axes), axes], axis=-1)
        covectors = np.concatenate([velocity, turning], axis=2).reshape(M, 6 * L, 6)
        pulled = prepared.chain.to_joint_space(frames, covectors, np.repeat(np.arange(L), 6))[..., 6:]
        linear, angular = np.moveaxis(np.linalg.norm(pulled.reshape(M, L, 2, 3, -1), axis=-2), 2, 0)
        return linear + prepared.bounding_spheres[:, 3, None] * angular

    @cached_property
    def _moves(self) -> Bool[np.ndarray, "L n"]:
        """Which links each joint moves."""
        return self._speeds(self.prepared.chain(np.eye(4)[None], self.prepared.hand.rest[None]))[0] > 1e-9

    @cached_property
    def _fingers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Links and closing joints, as numbers, of each finger: joints that move a link in common are of the same."""
        moves = self._moves & (self.closure.closing != 0)
        together = moves.T @ moves
        for _ in together:
            together = together @ together
        fingers = [np.flatnonzero(row) for row in np.unique(together, axis=0) if row.any()]
        return [(np.flatnonzero(moves[:, joints].any(axis=1)), joints) for joints in fingers]
