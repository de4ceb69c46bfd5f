"""Self-collision: pairs of a hand's links that can touch each other, and their penetration."""

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import CollisionError, GraspFileError, HandError
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.profiling import stage
from grasp_refine.geometry import cache as disk
from grasp_refine.hands.files.tree import LinkPair, rigid_parts
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from grasp_refine.hands.link_pairs import LinkPairs, link_pairs

SCHEMA = 3
"""Version of the candidates and of their classification; a new one leaves all old cache entries unused."""

MAX_PAIRS = 20_000
"""Most pairs of links that are checked, which takes half a minute: 200 links that all move independently."""

MIN_AVOIDABLE_M = 1e-3
"""Overlap in metres of an ignored pair, beyond its least one, from which it is noted."""

_SCREENING = 0.1
"""Difference from `Sampling.always` at which the share of overlaps in the first configurations is estimated again."""

_SAME_POINT_M = 1e-3
"""Distance in metres below which two joints turn about the same point."""

_ENTRY = ("touching", "least_overlap")
"""Arrays of a cache entry."""

_ROUND_STARTS = (256, 1280)
"""Configurations at which a new round starts: pairs that were near in one round are not queried in the next, which is
cheap for the remaining pairs, mostly far apart; a round costs up to 0.2 s on its own, for preparing its pairs."""


@dataclass(frozen=True)
class Sampling:
    """Sampling of configurations by which `touching_pairs` finds pairs.

    Measured on five hands, against 30000 other configurations: with 3000 extreme configurations no pair was missed that
    can overlap (5 seeds), with 1000 now and then a pair of 9 mm, with 300 several of up to 22 mm. 3000 uniform
    configurations miss far more, up to 19 mm, because links meet where fingers are closed. With a margin of 0 the 3000
    miss about one pair in two runs; from 2 mm on, none.
    """

    uniform: int = 128
    """Number of configurations, uniform within the limits, in which all pairs are looked at."""
    more: int = 512
    """Number of further ones, by which the share of overlaps is estimated for pairs that nearly always overlap."""
    extreme: int = 3000
    """Number of configurations with each joint at one of its limits by even odds, else uniform within them."""
    seed: int = 0
    """Seed of all."""
    margin: float = 0.004
    """Distance in metres that left-out pairs always keep; it allows for the configurations between samples."""
    always: float = 0.98
    """Share of uniform configurations; pairs that overlap in more of them do so by design. On real hands such pairs
    overlap in all of them, and fingers that cross at mid-range in 3 to 25 % (a made-up hand: 95 %)."""

    def __post_init__(self) -> None:
        """Refuse settings out of their range.

        Raises:
            CollisionError: a setting is outside its range.
        """
        if self.uniform < 1 or self.more < 0 or self.extreme < 0 or self.seed < 0:
            raise CollisionError(f"{self}: uniform must be at least 1; more, extreme and seed at least 0")
        if not (0 <= self.margin < np.inf and 0 <= self.always <= 1):
            raise CollisionError(f"{self}: margin must be at least 0 m and finite, always must be between 0 and 1")


@stage("loading")
def touching_pairs(
    hand: Hand, sampling: Sampling = Sampling(), *, cache: Path | Literal["user"] | None = "user"
) -> tuple[LinkPair, ...]:
    """The pairs of links that can touch each other, but do not by design, in the order of `hand.links`.

    Pairs are left out whose links

    - have no bodies, or no joint that can move between them;
    - are neighbours: one hangs from the other, with one movable joint between them, or several with nothing solid
      between these, or several that rotate about one point, such as in a knuckle. Hulls overlap around a joint by
      design;
    - never collide by the file of the hand;
    - overlap in nearly all configurations: so do hulls that cover more than the link, such as a knuckle's
      next but one. The rest pose does not matter: fingers may cross in the middle of their ranges;
    - never come near each other in the sampled configurations.

    These are rules of MoveIt's Setup Assistant (adjacent, always, never in collision). Continuous joints are sampled
    within [-pi, pi], mimic joints follow.

    Args:
        hand: The hand.
        sampling: Number of configurations, and the distance that counts as near.
        cache: Folder of earlier results; "user" is the user's cache folder, None: no cache. An entry is named
            by all that the result depends on: pieces, joints, limits and settings.

    Raises:
        HandError: more than `MAX_PAIRS` pairs have a joint that can move between them.
    """
    candidates, touching, _ = _classes(hand, sampling, cache)
    return tuple(pair for pair, can in zip(candidates, touching.tolist(), strict=True) if can)


@stage("loading")
def overlapping_pairs(
    hand: Hand, sampling: Sampling = Sampling(), *, cache: Path | Literal["user"] | None = "user"
) -> dict[LinkPair, float]:
    """Return the pairs that `touching_pairs` ignores since they nearly always overlap, with their least overlap.

    The least overlap in metres, over the sampled configurations, is what the design of the hand explains.
    """
    candidates, _, least = _classes(hand, sampling, cache)
    return {pair: depth for pair, depth in zip(candidates, least.tolist(), strict=True) if not np.isnan(depth)}


def ignored_overlaps(hand: Hand, q: Float[np.ndarray, "batch n"]) -> str:
    """Return a note on pairs of `overlapping_pairs` that overlap deeper at `q` than their design explains; else "".

    Deeper by more than `MIN_AVOIDABLE_M` than their least overlap, which no configuration avoids.
    """
    least = overlapping_pairs(hand)
    depth = np.maximum(-link_pairs(hand, tuple(least)).distances(q, 0.0), 0.0)
    deepest = np.where(np.isnan(depth), 0.0, depth).max(axis=0, initial=0.0)
    named = [
        f"{a} and {b} ({there * 1e3:.1f} mm, everywhere at least {own * 1e3:.1f})"
        for ((a, b), own), there in zip(least.items(), deepest.tolist(), strict=True)
        if there > own + MIN_AVOIDABLE_M
    ]
    if not named:
        return ""
    return f"not kept apart, because they overlap in nearly all configurations of {hand.name}: {', '.join(named)}"


@dataclass(frozen=True)
class PairClasses:
    """Classification of the pairs of solid links that move relative to each other."""

    neighbours: int
    """Number of pairs connected by one joint, or by several that turn about one point: not checked."""
    checked: tuple[LinkPair, ...]
    """Pairs that can touch, as `touching_pairs` returns them."""
    at_rest: tuple[LinkPair, ...]
    """Pairs of `checked` that overlap at the rest pose."""
    nearly_always: tuple[LinkPair, ...]
    """Pairs that overlap in nearly all configurations: taken for hulls that cover more than the link, and ignored."""
    never: int
    """Number of other pairs, which never come near each other."""


def classify_pairs(
    hand: Hand, sampling: Sampling = Sampling(), *, cache: Path | Literal["user"] | None = "user"
) -> PairClasses:
    """Classification of all pairs: `touching_pairs`, and the reasons for excluding the others."""
    (candidates, neighbours), checked = _candidates(hand), touching_pairs(hand, sampling, cache=cache)
    always = tuple(overlapping_pairs(hand, sampling, cache=cache))
    resting = link_pairs(hand, checked).distances(hand.rest[None], 0.0)[0] < 0
    at_rest = tuple(pair for pair, overlaps in zip(checked, resting.tolist(), strict=True) if overlaps)
    return PairClasses(neighbours, checked, at_rest, always, len(candidates) - len(checked) - len(always))


def self_penetration(
    hand: Hand, pairs: Sequence[LinkPair], q: Float[np.ndarray, "batch n"]
) -> Float[np.ndarray, " batch"]:
    """Deepest penetration (batch,) in metres over `pairs` of links, 0 where none overlap.

    NaN where `q` is not finite, or a query has no result.

    Args:
        hand: The hand.
        pairs: Names of links with bodies, such as `touching_pairs` returns; may be empty.
        q: Independent joint values (batch, n) in `hand.joint_names` order.

    Raises:
        HandError: the hand has no such link, or it has no body.
    """
    depth = np.maximum(-link_pairs(hand, tuple(pairs)).distances(q, 0.0), 0.0).max(axis=1, initial=0.0)
    return np.where(np.isfinite(q).all(axis=1), depth, np.nan)


def candidate_pairs(hand: Hand) -> tuple[LinkPair, ...]:
    """The pairs of links that `touching_pairs` checks: with bodies, not rigidly connected, and no neighbours."""
    return tuple(_candidates(hand)[0])


def _candidates(hand: Hand) -> tuple[list[LinkPair], int]:
    """All pairs of solid links that neither are rigidly connected nor neighbours, and the number of neighbours.

    Raises:
        HandError: there are more than `MAX_PAIRS` pairs.
    """
    matrix, _, movable = hand.mimic_map()
    lower, upper = finite_limits(hand)
    moving = {name for name, travel in zip(movable, np.abs(matrix) @ (upper - lower), strict=True) if travel > 0}
    part = {hand.base_link: hand.base_link} | rigid_parts(hand.joints, moving)
    carrier: dict[str, str] = {}  # the part that each part hangs from
    place = {hand.base_link: np.eye(4)}  # of each link in its part, whose frame is at its joint
    meeting: set[str] = set()  # parts that rotate about the same point as their parents
    for joint in hand.joints:  # parents before children
        T = place[joint.parent] @ joint.T_parent_child
        if joint.name in moving:
            place[joint.child] = np.eye(4)
            carrier[joint.child] = part[joint.parent]
            if joint.kind != "prismatic" and np.linalg.norm(T[:3, 3]) < _SAME_POINT_M and part[joint.parent] in carrier:
                meeting.add(joint.child)
        else:
            place[joint.child] = T
    names = [link.name for link in hand.links if link.body is not None]
    solid = {part[name] for name in names}
    left_out = {(own, own) for own in solid}
    for own in solid & carrier.keys():
        other = carrier[own]
        while other not in solid and other in carrier:
            other = carrier[other]
        left_out |= {(own, other), (other, own)}
        inner = own
        while inner in meeting:
            inner = carrier[inner]
            left_out |= {(own, carrier[inner]), (carrier[inner], own)}
    parts = np.array(list(Counter(part[name] for name in names).values()))
    count = (len(names) ** 2 - int((parts**2).sum())) // 2
    if count > MAX_PAIRS:
        raise HandError(
            f"hand {hand.name}: {len(names)} links have collision geometry; {count} pairs of them move against each "
            f"other, more than the {MAX_PAIRS} that are checked; leave the collision geometry of some links out"
        )
    apart = [(a, b) for a, b in combinations(names, 2) if part[a] != part[b]]
    excluded = {frozenset(pair) for pair in hand.excluded or ()}
    near = [(a, b) for a, b in apart if (part[a], part[b]) in left_out]
    pairs = [(a, b) for a, b in apart if (part[a], part[b]) not in left_out and frozenset((a, b)) not in excluded]
    return pairs, len(near)


_Classes = tuple[list[LinkPair], Bool[np.ndarray, " pairs"], Float[np.ndarray, " pairs"]]
"""Candidates, a mask of the ones that can touch, and the least overlap of the ones that nearly always overlap, else
NaN."""


def _classes(hand: Hand, sampling: Sampling, cache: Path | Literal["user"] | None) -> _Classes:
    """Classes of the candidates; with the user's cache kept in memory, too."""
    return _users_classes(hand, sampling) if cache == "user" else _cached_classes(hand, sampling, cache)


@kept
def _users_classes(hand: Hand, sampling: Sampling) -> _Classes:
    return _cached_classes(hand, sampling, disk.default_cache("touching"))


def _cached_classes(hand: Hand, sampling: Sampling, folder: Path | None) -> _Classes:
    candidates, _ = _candidates(hand)
    if not candidates:
        return candidates, np.zeros(0, dtype=bool), np.zeros(0)
    entry = folder / _entry_name(hand, sampling) if folder is not None else None
    known = _load(entry, len(candidates)) if entry is not None else None
    if known is None:
        known = _sampled_classes(hand, candidates, sampling)
        if entry is not None:
            with suppress(GraspFileError):  # it takes about a second the next time, too
                save_npz(entry, dict(zip(_ENTRY, known, strict=True)))
    return candidates, *known


def _sampled_classes(
    hand: Hand, candidates: list[LinkPair], sampling: Sampling
) -> tuple[Bool[np.ndarray, " pairs"], Float[np.ndarray, " pairs"]]:
    """Mask and least overlaps of `_classes`, by sampling."""
    lower, upper = finite_limits(hand)
    rng = np.random.default_rng(sampling.seed)
    first = rng.uniform(lower, upper, (sampling.uniform, len(lower)))
    end, within = rng.choice([True, False], (2, sampling.extreme, len(lower)))
    extreme = np.where(within, rng.uniform(lower, upper, end.shape), np.where(end, upper, lower))
    distance = LinkPairs.of(hand, candidates).distances(first, sampling.margin)
    near = np.any(distance < sampling.margin, axis=0)
    least = np.full(len(candidates), np.nan)
    # Only pairs that overlap in most of the first configurations are worth the others.
    likely = np.flatnonzero((distance < 0).mean(axis=0) > sampling.always - _SCREENING)
    more = rng.uniform(lower, upper, (sampling.more, len(lower)))
    for p, column in zip(
        likely, LinkPairs.of(hand, [candidates[p] for p in likely]).distances(more, 0.0).T, strict=True
    ):
        uniform = np.concatenate([distance[:, p], column])
        if (uniform < 0).mean() > sampling.always:
            least[p] = max(-uniform.max(), 0.0)
    for q in np.split(extreme, _ROUND_STARTS):
        left = np.flatnonzero(~near)
        distance = LinkPairs.of(hand, [candidates[p] for p in left]).distances(q, sampling.margin)
        near[left] = (distance < sampling.margin).any(axis=0)
    return near & np.isnan(least), least


def finite_limits(hand: Hand) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Lower and upper limits (n,), one turn where a joint is continuous."""
    return np.where(np.isinf(hand.lower), -np.pi, hand.lower), np.where(np.isinf(hand.upper), np.pi, hand.upper)


def _entry_name(hand: Hand, sampling: Sampling) -> str:
    """File name of the cache entry: links and joints count by their index, so that renaming them changes nothing."""
    bodies = [link.body.pieces if link.body is not None else () for link in hand.links]
    pieces = [piece for body in bodies for piece in body]
    place = {link.name: i for i, link in enumerate(hand.links)}
    matrix, offset, _ = hand.mimic_map()
    settings = {
        "schema": SCHEMA,
        "sampling": asdict(sampling),
        "pieces": [[(len(piece.vertices), len(piece.faces), piece.radius) for piece in body] for body in bodies],
        "joints": [
            (joint.kind, place[joint.parent], place[joint.child], joint.T_parent_child.tolist(), joint.axis.tolist())
            for joint in hand.joints
        ],
        "values": [array.tolist() for array in (matrix, offset, hand.lower, hand.upper)],
    }
    if hand.excluded is not None:
        settings["never"] = [(place[a], place[b]) for a, b in hand.excluded]
    vertices, faces = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("vertices", "faces"))
    return disk.entry_name(vertices, faces, json.dumps(settings))


def _load(entry: Path, count: int) -> tuple[Bool[np.ndarray, " pairs"], Float[np.ndarray, " pairs"]] | None:
    """The cached arrays of `_classes` of `count` candidates; None when there is no such entry, or it is broken."""
    arrays = disk.load_arrays(entry, *_ENTRY)
    if arrays is None or any(array.shape != (count,) for array in arrays):
        return None
    touching, least = arrays
    return (touching, least) if touching.dtype == bool and least.dtype == np.float64 else None
