"""Data of a hand and its objects that are independent of the grasps: built once, used by every refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from weakref import WeakValueDictionary

import numpy as np

from grasp_refine.collision.culling import bounding_sphere
from grasp_refine.collision.query import Pairs, Witness, query_items
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from grasp_refine.hands.link_pairs import link_pairs
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.objects.object import Object
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.scene.surroundings import LEAVES_START_M, Surroundings, choose_bodies
from grasp_refine.witness.face_patch import FacePairs
from grasp_refine.witness.pair_curvature import SMALLEST_CURVATURE, PairCurvatures

CLEARANCE, CLEARANCE_OTHERS = 0.008, 0.003
"""Least distances in metres of contact links, and of all other links, from the object when the hand is open."""

_BLOCK_BOXES = 256
"""Bounding boxes that are computed together, which bounds the memory."""

MAX_KEPT = 4
"""Pairs of a hand and an object whose data is kept in memory."""

POINT = 1e-6
"""Radius in metres of the spheres that represent points."""


@dataclass(frozen=True, eq=False)
class HandObject:
    """A hand and an object, or several; each part is built when it is first used, which takes up to a second in all."""

    hand: Hand
    """The hand."""
    object: Object
    """The object, or the first."""
    others: tuple[Object, ...] = field(default=(), kw_only=True)
    """Further objects, of other grasps (`Scene.number`)."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.hand.name} and {', '.join(each.name for each in self.objects)})"

    @staticmethod
    def of(scene: Scene) -> HandObject:
        """Return the hand and objects of a scene; of the last `MAX_KEPT`, what is built already."""
        return _kept(scene.hand, *scene.objects)

    @property
    def objects(self) -> tuple[Object, ...]:
        """All objects."""
        return self.object, *self.others

    @cached_property
    def alone(self) -> tuple[HandObject, ...]:
        """The hand with each of the objects alone."""
        return tuple(_kept(self.hand, each) for each in self.objects) if self.others else (self,)

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies of the L links with collision geometry, contact links first (`Scene.links`)."""
        return tuple(self.hand.links_by_name[name].solid for name in links_of(self.hand))

    @cached_property
    def chain(self) -> Chain:
        """Kinematics of these links."""
        return Chain(self.hand, links_of(self.hand))

    @cached_property
    def pairs(self) -> Pairs:
        """Each of these links and the first object, then each and the second, ..."""
        return self._with_objects(self.bodies)

    def _with_objects(self, links: tuple[Body, ...]) -> Pairs:
        return Pairs(links * len(self.objects), tuple(each.body for each in self.objects for _ in links))

    def pair(self, number: Int[np.ndarray, " M"], columns: np.ndarray | None = None) -> Int[np.ndarray, "M C"]:
        """Return the indices (M, C) in `pairs` of the links `columns`, by default all, and objects `number` (M,)."""
        columns = np.arange(len(self.bodies)) if columns is None else columns
        return number[:, None] * len(self.bodies) + columns

    def query(
        self,
        number: Int[np.ndarray, " M"],
        T_world_link: Float[np.ndarray, "M L 4 4"],
        *,
        cutoff: np.ndarray | float = np.inf,
        previous: Witness | None = None,
    ) -> Witness:
        """Return witness points (M, L) of the links of each grasp and its object, at the world's origin.

        Args:
            number: Index (M,) of each grasp's object.
            T_world_link: Poses of the links.
            cutoff: As for `query_items`.
            previous: As there.
        """
        T_object = np.broadcast_to(np.eye(4), T_world_link.shape)
        return query_items(self.pairs, self.pair(number), T_world_link, T_object, cutoff=cutoff, previous=previous)

    @cached_property
    def faces(self) -> FacePairs:
        """Flat faces of these links and the objects, as of `face_pairs`."""
        return face_pairs(self.hand, self.objects, links_of(self.hand))

    @cached_property
    def curvatures(self) -> PairCurvatures:
        """Curvatures of both surfaces of each of these pairs."""
        return PairCurvatures.of(self.pairs, SMALLEST_CURVATURE)

    @cached_property
    def self_collision_links(self) -> tuple[np.ndarray, np.ndarray]:
        """The links of the S pairs that can touch each other, first and second (S,)."""
        links = links_of(self.hand)
        pairs = touching_pairs(self.hand)
        first, second = (np.array([links.index(pair[side]) for pair in pairs], dtype=np.int64) for side in (0, 1))
        return first, second

    @cached_property
    def self_collision_pairs(self) -> Pairs | None:
        """Pairs of these links; None if there are none."""
        return link_pairs(self.hand, touching_pairs(self.hand)).pairs

    @cached_property
    def bounding_spheres(self) -> np.ndarray:
        """Centre and radius (L, 4) of a bounding sphere of each link, link frames, metres."""
        return self._bare_spheres

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) of the object's bounding box, its own frame."""
        corners = np.stack([piece.bounds for piece in self.object.body.pieces])
        return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)

    def boxes(
        self, number: Int[np.ndarray, " N"], axes: Float[np.ndarray, "N 3 3"]
    ) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
        """Lower and upper corners (N, 3) of the bounding boxes of objects along the columns of rotations (N, 3, 3)."""
        low, high = np.empty((2, len(axes), 3))
        for k, each in enumerate(self.objects):
            vertices, radius = each.body.outline
            at = np.flatnonzero(number == k)
            for rows in np.split(at, range(_BLOCK_BOXES, len(at), _BLOCK_BOXES)):
                along = vertices @ axes[rows]
                low[rows], high[rows] = (along - radius).min(axis=1), (along + radius).max(axis=1)
        return low, high

    @cached_property
    def points(self) -> tuple[Pairs, Pairs]:
        """Each link and a point, and each object and a point, for distances of points from surfaces."""
        point = build_body("point", [sphere(POINT)], candidates=16)
        return Pairs.against(self.bodies, point), Pairs.against([each.body for each in self.objects], point)

    def surroundings(self, scene: Scene) -> Surroundings | None:
        """Return the links with the bodies around the object that grasps may reach in a refinement; None: none."""
        if scene.environment is None:
            return None
        with np.errstate(invalid="ignore"):
            T = self.chain(scene.T_world_root, scene.q).T_world_link
        chosen = choose_bodies(scene.environment, self._bare_spheres, T, LEAVES_START_M, self.box)
        key = scene.environment, chosen.tobytes()
        if len(chosen) and key not in self._surroundings:
            # Grasps of a refinement reach the same bodies, in all its phases.
            self._surroundings[key] = Surroundings(
                self.bodies, self._bare_spheres, scene.environment, chosen, counts=moving_links(self.hand, scene.links)
            )
        return self._surroundings.get(key)

    @cached_property
    def _surroundings(self) -> dict[tuple[Environment, bytes], Surroundings]:
        return {}

    @cached_property
    def _bare_spheres(self) -> np.ndarray:
        """Centre and radius (L, 4) of a bounding sphere of each link without padding."""
        return np.array([bounding_sphere(body) for body in self.bodies])

    @cached_property
    def padded(self) -> PaddedHand:
        """The hand with padding, for opening it."""
        return PaddedHand(self.hand, self.object, self, others=self.others)


@lru_cache(maxsize=MAX_KEPT)
def _kept(hand: Hand, *objects: Object) -> HandObject:
    found = _in_use.get((hand, *objects))
    if found is None:
        found = _in_use[hand, *objects] = HandObject(hand, objects[0], others=objects[1:])
    return found


_in_use: WeakValueDictionary[tuple[Hand | Object, ...], HandObject] = WeakValueDictionary()
"""All that is in use somewhere, beside what is kept: nothing is built twice at a time."""


@dataclass(frozen=True, eq=False)
class PaddedHand(HandObject):
    """A hand with padding: where this does not penetrate the object, the links keep their clearances.

    A piece is a core with a sphere swept around it, so that padding enlarges the sphere, and distances stay exact.
    Links meet each other without padding.
    """

    bare: HandObject
    """The hand without padding."""

    @cached_property
    def pairs(self) -> Pairs:
        """Each padded link and each object, in the order of `HandObject.pairs`."""
        return self._with_objects(self._padded)

    @cached_property
    def bounding_spheres(self) -> np.ndarray:
        """Centre and radius (L, 4) of a bounding sphere of each padded link."""
        return np.array([bounding_sphere(body) for body in self._padded])

    def surroundings(self, scene: Scene) -> Surroundings | None:
        """Return what links without padding may reach: bodies have margins of their own."""
        return self.bare.surroundings(scene)

    @cached_property
    def self_collision_pairs(self) -> Pairs | None:
        """Pairs of links without padding."""
        return self.bare.self_collision_pairs

    @cached_property
    def _padded(self) -> tuple[Body, ...]:
        return _padded_links(self.hand)


def moving_links(hand: Hand, links: tuple[str, ...]) -> Bool[np.ndarray, " L"] | None:
    """Return a mask (L,) of links that are not fixed to the base of an arm; None: all, as a hand without arm moves."""
    return None if hand.arm is None else ~np.isin(links, list(hand.arm.standing))


def clearances(hand: Hand, links: tuple[str, ...]) -> Float[np.ndarray, " L"]:
    """Least distance of each link (L,) from the object when the hand is open, in metres."""
    return np.where(np.isin(links, [contact.link for contact in hand.contacts]), CLEARANCE, CLEARANCE_OTHERS)


@kept
def _padded_links(hand: Hand) -> tuple[Body, ...]:
    links = links_of(hand)
    bodies = [hand.links_by_name[name].solid for name in links]
    return tuple(_inflate(body, by) for body, by in zip(bodies, clearances(hand, links), strict=True))


def _inflate(body: Body, by: float) -> Body:
    return replace(body, pieces=tuple(replace(piece, radius=piece.radius + by) for piece in body.pieces))


def face_pairs(hand: Hand, objects: Sequence[Object], links: tuple[str, ...]) -> FacePairs:
    """Return the flat faces of links and objects; none for a hand that touches in points (`Hand.patches`)."""
    bodies = [hand.links_by_name[name].solid for name in links]
    if not hand.patches:
        return FacePairs.none(len(bodies), len(objects))
    return FacePairs.of(bodies, [each.body for each in objects])
