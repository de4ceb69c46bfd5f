"""Sampling of grasps: hands approach an object from many sides, more or less open, and close until they touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import join, take
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import matvec, pose_from_transform, transform_points
from grasp_refine.forces.squeeze import contacts, grasp_forces
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.chain import Frames
from grasp_refine.hands.clear_rest import clear_rest
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.solid_links import check_collides
from grasp_refine.objects.object import Object, as_object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.sampling.antipodal import antipodal_pairs, close_jaws, place_jaws
from grasp_refine.sampling.closure_frame import ClosureFrame, closure_frame
from grasp_refine.sampling.jaw_frame import JawFrame, jaw_frame
from grasp_refine.sampling.placement import Placed, opposed_pairs, place_hands, sample_places
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M, contact_misses, link_groups
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import links_of
from grasp_refine.scene.scene_check import check_object
from grasp_refine.scene.surroundings import Surroundings
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import as_task

if TYPE_CHECKING:
    from grasp_refine.objects.object import Mesh

MAX_GRASPS = 10_000
"""Most grasps that can be sampled."""

BATCH_SIZE, CANDIDATES_PER_GRASP = 256, 8
"""Hands that are placed at once, and good ones that are searched per wanted grasp, to choose from."""

TRIES_PER_GRASP, MIN_TRIES = 32, 1024
"""Most hands that are placed per wanted grasp, and least in all, where grasps are rare."""

CLEARANCE_M, STOP_DISTANCE_M, MAX_DEPTH_M = 2e-3, 1e-3, 2e-3
"""In metres: least distance of open hands from anything, distance at which a link stops, and largest penetration."""

JAW_STOP_DISTANCE_M = 1e-4
"""Distance in metres at which a jaw stops: stiff servos would lose much of their force over a larger one."""

CUTOFF_M = 0.03
"""Cutoff in metres of the distances between links and object."""

MAX_STEPS, MIN_STEP_RAD, MAX_STEP_RAD = 40, 5e-3, 0.2
"""Most steps in which fingers close; smallest step after which another follows, and largest step, in radians."""

TRIES_AMONG_BODIES = 8
"""Factor of the most hands that are placed where bodies around the object may be in their way."""

SAME_DISTANCE_M = 1e-7
"""Difference of distances in metres that does not count, so that no last bit chooses where a hand or finger stays."""

SPEED_RANGE = (0.4, 1.0)
"""Range of the closing speeds of joints, so that fingers curl in many shapes."""

SINGLE_GROUP_PENALTY = 0.1
"""Penalty in a score of being held by one group of links only; for several groups it is divided by their number."""

MISS_SCALE_M, TRIES_IN_REGIONS, MIN_SEEDS = 0.01, 4, 16
"""Distance in metres of a contact from where it should be that costs a score of 1; factor of the most hands that are
placed where only some of the object should be touched, and least number of surface points there, else the nearest."""

SCORE_DECIMALS = 8
"""Decimals of a score that decide the order of hands: scores of other processors differ by less."""

MIN_SPACING_M, MAX_HALVINGS = 0.02, 6
"""Distance in metres below which grasps are alike, and most halvings of it where there are too few others."""


def sample_grasps(
    hand: Hand,
    obj: Object | Mesh,
    count: int,
    *,
    task: Task | str | Path | None = None,
    seed: int | tuple[int, ...] = 0,
    prepared: HandObject | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> GraspSet:
    """Up to `count` distinct grasps of a hand on an object, the most promising first; at scale 1.

    Half of the hands approach so that their fingers close on two points that face away from each other, the others
    along the normal of a point. Each backs off until it is clear and closes: a joint stops when a link that it moves
    touches, the links beyond continue; a finger that touches nothing stays where it was nearest. Grippers with two jaws
    (`jaw_frame`) are placed at pairs of points that are antipodal (`antipodal_pairs`), as far as there are any, from
    any side, and move along their line until both jaws touch. Hands that hold the object
    with fewer than two groups of links (fingers, palm), or penetrate anything, are rejected. The others are scored by
    how well their contacts can balance each other. There are fewer than `count` where no more are found among
    `TRIES_PER_GRASP` hands for each.

    Args:
        hand: Any hand whose joints move contact links; sampled joint values are around the rest pose, or `clear_rest`.
        obj: The object, or its mesh as for `load_object`.
        count: Number of grasps, 1 to `MAX_GRASPS`.
        task: What the grasps must do, and where, as of `load_task`. No link goes through the table, and no hand
            approaches from below it. Hands that are nearer to a body of the scene than its margin, open or closed, are
            drawn anew, and up to `TRIES_AMONG_BODIES` times as many are tried. Hands are placed at the regions to
            touch, and two groups of links at least touch in them.
        seed: The same seed gives the same grasps.
        prepared: Data of this hand and object; None: built here.
        progress: Called after each batch with the number of grasps found and that of hands tried.

    Raises:
        GraspRefineError: an argument of another kind, a count out of range, surroundings that cannot be
            (`check_object`), a hand that cannot grip, or no grasp was found at all.
    """
    check_kind("hand", hand, Hand)
    obj = as_object("obj", obj)
    check_kind("count", count, int)
    check_kind("seed", seed, int | tuple[int, ...])
    task = as_task(task)
    task = task if task.is_on_object else task.on(obj)
    table, environment = task.plane_under(obj), task.environment
    check_kind("prepared", prepared, HandObject | None)
    if np.min(seed, initial=0) < 0:
        raise GraspRefineError(f"seeds must be at least 0, got {seed}")
    if not 1 <= count <= MAX_GRASPS:
        raise GraspRefineError(f"1 to {MAX_GRASPS} grasps can be sampled, got {count}")
    check_object(obj, table, environment)
    check_collides(hand)
    hand = replace(hand, rest=clear_rest(hand))
    closure, rng = closure_frame(hand), np.random.default_rng(seed)
    prepared = prepared or HandObject(hand, obj)
    around = None if environment is None else _around(prepared, environment)
    closing = _Closing(prepared, closure, table, around, task.regions)
    draw = _drawing(closing, hand, jaw_frame(hand, closure), rng)
    found, total, tried = [], 0, 0
    most = max(MIN_TRIES, TRIES_PER_GRASP * count) * (1 if closing.around is None else TRIES_AMONG_BODIES)
    most *= 1 if closing.regions is None else TRIES_IN_REGIONS
    while total < CANDIDATES_PER_GRASP * count and tried < most:
        found.append(_score(closing, draw()))
        total, tried = total + len(found[-1].q), tried + BATCH_SIZE
        if progress is not None:
            progress(total, tried)
    if not total:
        low, high = closing.prepared.box
        among = "" if environment is None else f" in scene '{environment.name}'"
        among += "" if closing.regions is None else f" ({closing.regions.text})"
        raise GraspRefineError(
            f"no grasp of hand '{hand.name}' on object '{obj.name}'{among} was found in {tried} tries: the object is "
            f"{' x '.join(f'{side:.2g}' for side in high - low)} m large, the hand opens {closure.opening:.2g} m wide"
            f"{_why_none(closing, draw())}"
        )
    best = _choose_distinct(join(*found), closure, count)
    return GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.full(len(best.q), obj.name),
        scale=np.ones(len(best.q)),
        hand_pose=pose_from_transform(best.T),
        q=best.q,
    )


def _drawing(closing: _Closing, hand: Hand, jaws: JawFrame | None, rng: np.random.Generator) -> Callable[[], Placed]:
    """Function that draws `BATCH_SIZE` hands, closes them, and returns hands without collision while open."""
    obj, closure, table = closing.prepared.object, closing.closure, closing.table
    if jaws is not None:
        antipodal = closing.within(antipodal_pairs(obj, (jaws.width[-1], jaws.width[0] - 2.0 * CLEARANCE_M)))
        if len(antipodal):
            return lambda: closing.draw_jaws(jaws, antipodal, rng)
    pairs = closing.within(opposed_pairs(obj, closure.opening))

    def draw() -> Placed:
        places = sample_places(obj, pairs, closing.seeds, BATCH_SIZE, rng)
        placed = place_hands(hand, closure, places, table, rng)
        return closing.close(closing.back_off(placed, closure.opening), rng)

    return draw


def _around(prepared: HandObject, environment: Environment) -> Surroundings:
    """All bodies around the object, with the links of the hand."""
    every = np.arange(len(environment.bodies))
    return Surroundings(prepared.bodies, prepared.bounding_spheres, environment, every)


@dataclass(frozen=True, eq=False)
class _Scored(Placed):
    """Hands that grasp."""

    score: Float[np.ndarray, " M"]
    """Score (M,) without unit; lower is better."""


def _why_none(closing: _Closing, hands: Placed) -> str:
    """Shares of closed hands that hold with too few fingers, or overlap themselves; "" where all hands do neither."""
    if not len(hands.q):
        return "; open hands find no place beside it without collision"
    _, groups, own, _ = _closed(closing, hands)
    few, in_itself = (groups < 2).mean(), (own < -MAX_DEPTH_M).mean()
    reasons = [f"{few:.0%} of closed hands touch it with fewer than two fingers"] * bool(few)
    reasons += [f"links overlap each other in {in_itself:.0%}"] * bool(in_itself)
    help_ = "; an open rest pose, and contact links, may be named in a hand.toml"
    return "".join(f"; {reason}" for reason in reasons) + help_ * bool(reasons)


def _closed(
    closing: _Closing, hands: Placed
) -> tuple[_Proximity, Int[np.ndarray, " M"], Float[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """Distances of hands from all; groups of links that touch; least distance (m) of links; largest miss (m)."""
    prepared, links = closing.prepared, links_of(closing.prepared.hand)
    proximity = closing.proximity(hands, CUTOFF_M)
    own = np.full(len(hands.q), np.inf)
    if prepared.self_collision_pairs is not None:
        T, (first, second) = proximity.frames.T_world_link, prepared.self_collision_links
        own = query(prepared.self_collision_pairs, T[:, first], T[:, second], cutoff=0.0).distance.min(axis=1)
    group = np.array(link_groups(prepared.hand, links))
    touching = proximity.witness.distance <= CONTACT_DISTANCE_M
    worst = np.zeros(len(touching))
    if closing.regions is not None:
        miss = contact_misses(closing.regions, proximity.witness)
        touching, worst = touching & (miss == 0.0), miss.max(axis=1)
    groups = np.stack([touching[:, group == name].any(axis=1) for name in dict.fromkeys(group)]).sum(axis=0)
    return proximity, groups, own, worst


def _score(closing: _Closing, hands: Placed) -> _Scored:
    """The hands that grasp, with their scores."""
    prepared, links = closing.prepared, links_of(closing.prepared.hand)
    proximity, groups, own, worst = _closed(closing, hands)
    deepest = np.minimum(proximity.gap.min(axis=1), own)
    good = np.flatnonzero((groups >= 2) & (deepest >= -MAX_DEPTH_M))
    good = good[closing.is_free(proximity.frames.T_world_link[good])]
    geometry = proximity.witness.rows(good), proximity.frames.T_world_link[good], prepared.faces
    points = contacts(prepared.hand, prepared.object, links, *geometry)
    forces = grasp_forces(points, prepared.object, hands.T[good, :3, :3])
    score = forces.residual + SINGLE_GROUP_PENALTY / groups[good] + worst[good] / MISS_SCALE_M
    hands = _Scored(hands.T[good], hands.q[good], hands.way[good], score)
    return take(hands, forces.solved)


def _choose_distinct(hands: _Scored, closure: ClosureFrame, count: int) -> _Scored:
    """The best `count` hands that are not alike, of the better ones, best first."""
    # Many hands balance their contacts equally well: their order must not hang on a last bit.
    hands = take(hands, np.argsort(hands.score.round(SCORE_DECIMALS), kind="stable")[: 2 * count])
    # The centre of the closure frame and three points around it: their distances combine translation and rotation.
    points = closure.center + closure.radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    place = transform_points(hands.T[:, None], points).reshape(-1, 12) / 2.0
    chosen: list[int] = []
    for apart in MIN_SPACING_M * 0.5 ** np.arange(MAX_HALVINGS + 1):
        for row in range(len(place)):
            if len(chosen) < count and (np.linalg.norm(place[chosen] - place[row], axis=1) >= apart).all():
                chosen.append(row)
    return take(hands, np.sort(chosen))


@dataclass(frozen=True, eq=False)
class _Proximity:
    """Poses of the L links of M hands, and their distances from object and table."""

    frames: Frames
    """Poses of the links."""
    witness: Witness
    """Links and object (M, L)."""
    table: Float[np.ndarray, "M L"]
    """Distances of the links from the table, in metres; inf without one."""

    @property
    def gap(self) -> Float[np.ndarray, "M L"]:
        """Distances of the links from the object or the table, whichever is nearer, in metres."""
        return np.minimum(self.witness.distance, self.table)


@dataclass(frozen=True, eq=False)
class _Closing:
    """Closing motion of hands on an object."""

    prepared: HandObject
    closure: ClosureFrame
    table: Plane | None
    around: Surroundings | None = None
    regions: ContactRegions | None = None

    @cached_property
    def seeds(self) -> Int[np.ndarray, " S"]:
        """Indices (S,) of the surface points where hands may touch; of the nearest ones where there are few."""
        x = self.prepared.object.body.candidates.points
        if self.regions is None:
            return np.arange(len(x))
        miss = self.regions.miss(x)
        inside = np.flatnonzero(miss == 0.0)
        return inside if len(inside) >= MIN_SEEDS else np.argsort(miss, kind="stable")[:MIN_SEEDS]

    def within(self, pairs: Int[np.ndarray, "P 2"]) -> Int[np.ndarray, "Q 2"]:
        """Pairs of surface points that hands may touch."""
        return pairs if self.regions is None else pairs[np.isin(pairs, self.seeds).all(axis=1)]

    def draw_jaws(self, jaws: JawFrame, pairs: Int[np.ndarray, "P 2"], rng: np.random.Generator) -> Placed:
        """Jaws that closed on antipodal pairs, without collision while open."""
        hands, axis, width = place_jaws(jaws, self.prepared.object, pairs, BATCH_SIZE, CLEARANCE_M, self.table, rng)
        proximity = self.proximity(hands, CLEARANCE_M)
        clear = np.flatnonzero(proximity.gap.min(axis=1) >= CLEARANCE_M)
        clear = clear[self.is_free(proximity.frames.T_world_link[clear])]
        group = np.array(link_groups(self.prepared.hand, links_of(self.prepared.hand)))
        first, second = (group == name for name in jaws.groups)
        return close_jaws(
            jaws,
            take(hands, clear),
            axis[clear],
            width[clear],
            lambda placed: self.proximity(placed, np.inf).gap,
            (first, second),
            JAW_STOP_DISTANCE_M,
        )

    def back_off(self, hands: Placed, farthest: float) -> Placed:
        """Hands moved back along their approach until they are free of collision; hands that never are, are dropped.

        Args:
            hands: Hands at any depth.
            farthest: Largest distance in metres by which they move.
        """
        hands, gone = replace(hands, T=hands.T.copy()), np.zeros(len(hands.q))
        above, busy = np.zeros(len(gone)), np.arange(len(gone))
        while len(busy):
            proximity, way = self.proximity(take(hands, busy), CLEARANCE_M), hands.way[busy]
            above[busy] = proximity.table.min(axis=1)
            lack = np.where(proximity.witness.valid, CLEARANCE_M - proximity.witness.distance, 0.0)
            # A little farther than required, so that no last bit says whether it is clear, or touches.
            lack = np.where(lack > 0.0, lack + SAME_DISTANCE_M, 0.0)
            # Where a surface lies along the path, the step is shorter than required: the surface may end sooner.
            back = (lack / np.maximum((proximity.witness.normal * way[:, None]).sum(axis=-1), 0.3)).max(axis=1)
            back = np.where(back > 0, np.maximum(back, 1e-3), 0.0)
            hands.T[busy, :3, 3] -= back[:, None] * way
            gone[busy] += back
            busy = busy[(back > 0) & (gone[busy] < farthest)]
        hands = take(hands, (gone < farthest) & (above > CLEARANCE_M))
        return (
            hands
            if self.around is None
            else take(hands, self.is_free(self.prepared.chain(hands.T, hands.q).T_world_link))
        )

    def is_free(self, T_link: Float[np.ndarray, "M L 4 4"]) -> Bool[np.ndarray, " M"]:
        """Mask (M,) of hands that keep the margins of all bodies around the object."""
        if self.around is None or not len(T_link):
            return np.ones(len(T_link), dtype=bool)
        found = self.around.near(T_link, 0.0, most=1)
        return (found.column < 0).all(axis=1) & ~found.failed

    def close(self, hands: Placed, rng: np.random.Generator) -> Placed:
        """The hands with their fingers close, all of them at once."""
        closure, hand = self.closure, self.prepared.hand
        unit = hand.per_radian
        speed = rng.uniform(*SPEED_RANGE, hands.q.shape) * unit * np.abs(closure.closing)
        end = np.where(closure.closing > 0, closure.upper, closure.lower)
        hands, nearest = replace(hands, q=hands.q.copy()), hands.q.copy()
        least = np.full((len(nearest), len(self._fingers)), np.inf)
        busy, witness = np.arange(len(nearest)), None
        moves = self.prepared.chain.moves
        for _ in range(MAX_STEPS):
            if not len(busy):
                break
            proximity = self.proximity(take(hands, busy), CUTOFF_M, witness)
            q, gap = hands.q[busy], proximity.gap
            for k, (links, joints) in enumerate(self._fingers):
                now = proximity.witness.distance[:, links].min(axis=1)
                nearer = now < least[busy, k] - SAME_DISTANCE_M
                least[busy[nearer], k] = now[nearer]
                nearest[np.ix_(busy[nearer], joints)] = q[np.ix_(nearer, joints)]
            stopped = (moves & (gap <= STOP_DISTANCE_M)[..., None]).any(axis=1) | (q == end)
            rate = np.where(stopped, 0.0, speed[busy])
            # No point of a link moves faster than this, so that no step takes it into anything.
            fastest = matvec(self._speeds(proximity.frames), rate)
            time = (gap - 0.5 * STOP_DISTANCE_M) / np.maximum(fastest, 1e-9)
            step = rate * np.where(moves, time[..., None], MAX_STEP_RAD).min(axis=1).clip(0.0, MAX_STEP_RAD)
            hands.q[busy] = np.clip(q + closure.closing * step, closure.lower, closure.upper)
            more = (step > MIN_STEP_RAD * unit).any(axis=1)
            busy, witness = busy[more], proximity.witness.rows(more)
        for k, (_, joints) in enumerate(self._fingers):
            missed = np.flatnonzero(least[:, k] > STOP_DISTANCE_M)
            hands.q[np.ix_(missed, joints)] = nearest[np.ix_(missed, joints)]
        return hands

    def proximity(self, hands: Placed, cutoff: float, previous: Witness | None = None) -> _Proximity:
        """Poses and distances of the links; distances from the object up to a cutoff in metres."""
        prepared = self.prepared
        frames = prepared.chain(hands.T, hands.q)
        T = frames.T_world_link
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff, previous=previous)
        if self.table is None:
            return _Proximity(frames, witness, np.full(T.shape[:2], np.inf))
        return _Proximity(frames, witness, self.table.heights(prepared.bodies, T)[0])

    def _speeds(self, frames: Frames) -> np.ndarray:
        """Greatest speed (M, L, n) of any point of each link per joint speed, in m/rad, or m/m."""
        prepared, (M, L) = self.prepared, frames.T_world_link.shape[:2]
        center = transform_points(frames.T_world_link, prepared.bounding_spheres[:, :3])
        axes = np.broadcast_to(np.eye(3), (M, L, 3, 3))
        velocity = np.concatenate([axes, np.cross(center[..., None, :], axes)], axis=-1)
        turning = np.concatenate([np.zeros_like(axes), axes], axis=-1)
        covectors = np.concatenate([velocity, turning], axis=2).reshape(M, 6 * L, 6)
        joint_covectors = prepared.chain.to_joint_space(frames, covectors, np.repeat(np.arange(L), 6))[..., 6:]
        linear, angular = np.moveaxis(np.linalg.norm(joint_covectors.reshape(M, L, 2, 3, -1), axis=-2), 2, 0)
        return linear + prepared.bounding_spheres[:, 3, None] * angular

    @cached_property
    def _fingers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Indices of the links and closing joints of each finger: joints that move a common link are of one finger."""
        moves = self.prepared.chain.moves & (self.closure.closing != 0)
        together = moves.T @ moves
        for _ in together:
            together = together @ together
        fingers = [np.flatnonzero(row) for row in np.unique(together, axis=0) if row.any()]
        return [(np.flatnonzero(moves[:, joints].any(axis=1)), joints) for joints in fingers]
