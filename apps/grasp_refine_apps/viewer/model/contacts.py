"""Contacts of one grasp for display: witness points, distances, errors and forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import transform_points
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.forces.squeeze import contacts, grasp_forces
from grasp_refine.hands.chain import Frames
from grasp_refine.measures.measures import MEASURES
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.model.pose import Target

DEFAULT_SELECTION = ContactSelection()
"""Contact selection where none is specified."""

CONTACT_TOLERANCE_M = 1e-4
"""Distance in metres: smaller gaps count as touching, larger penetrations as deep."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Best balancing forces of C contacts, per unit of total pressure, in the object's frame."""

    point: Float[np.ndarray, "C 3"]
    """Contact points (C, 3) on the object, metres."""
    normal: Float[np.ndarray, "C 3"]
    """Unit normals (C, 3) from link to object."""
    force: Float[np.ndarray, "C 3"]
    """Force (C, 3) of each link on the object, within the cones of `PLANNING_FRICTION`; 0 where none is known."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Area of k corners in which a flat face of a link is at one of the object, in the object's frame."""

    corners: Float[np.ndarray, "k 3"]
    """Corners (k, 3) on the object, in order around it, metres; of a segment its two ends."""
    gap: Float[np.ndarray, " k"]
    """Signed distances (k,) of the link's face from them, metres."""
    normal: Float[np.ndarray, " 3"]
    """Unit normal (3,) of the face into the object."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """K links of one grasp that touch the object or should, none twice; all in the object's frame, metres."""

    link: tuple[str, ...]
    """Names of the links (K,)."""
    point_link: Float[np.ndarray, "K 3"]
    """Witness points (K, 3) on the links: nearest to the object, or deepest in it."""
    point_object: Float[np.ndarray, "K 3"]
    """Witness points (K, 3) on the object."""
    distance: Float[np.ndarray, " K"]
    """Signed distances (K,); negative where a link penetrates."""
    should: Bool[np.ndarray, " K"]
    """True for links that should touch (K,)."""
    error: Float[np.ndarray, " K"]
    """Largest of gap and target misses (K,), as `validation.geometry` measures it; NaN for links that need not
    touch."""
    target_link: Float[np.ndarray, "G 3"]
    """Present position of the point on the link of each of the G targets; NaN: that link cannot touch."""
    target_object: Float[np.ndarray, "G 3"]
    """Position on the object where it should be."""
    penetration: float
    """Deepest penetration of all links; NaN where the pose is not finite."""
    witness: Witness
    """Witness points (1, L) of all links that were near enough, columns as `prepared.chain.links`."""
    prepared: HandObject
    """The hand and the object."""
    frames: Frames
    """Poses of the links."""

    @property
    def deep(self) -> Bool[np.ndarray, " K"]:
        """True for links (K,) deeper in the object than `CONTACT_TOLERANCE_M`; all such links are included."""
        return self.distance < -CONTACT_TOLERANCE_M

    @property
    def contact_error(self) -> float:
        """The largest error of a link that should touch; NaN where none should or it is not known."""
        known = self.error[~np.isnan(self.error)]
        return float(known.max()) if len(known) else np.nan

    @property
    def forces(self) -> Forces:
        """Best balancing forces of the contacts in `grasp_forces`, not necessarily of links that should touch."""
        points = self._points
        found = grasp_forces(points, self.prepared.object, self.frames.T_world_root[:, :3, :3])
        near = np.isfinite(points.point[0, :, 0])
        return Forces(points.point[0, near], points.normal[0, near], found.force[0, near])

    def reading(self, link: str, pressure_n: float) -> str:
        """Return name, gap or depth, and force of a link in words; a link with a gap has no force.

        Args:
            link: Name of a link of the hand.
            pressure_n: Sum of all normal forces in newtons.
        """
        links = self.prepared.chain.links
        if link not in links or not self.witness.valid[0, links.index(link)]:
            return f"{link}: not near the object"
        at = links.index(link)
        distance = float(self.witness.distance[0, at])
        side = "touches" if abs(distance) <= CONTACT_TOLERANCE_M else "gap" if distance > 0 else "depth"
        text = f"{link}: {side}" + ("" if side == "touches" else f" {1e3 * abs(distance):.2f} mm")
        if side == "gap":
            return text
        points = self._points
        found = grasp_forces(points, self.prepared.object, self.frames.T_world_root[:, :3, :3]).force[0]
        force = np.nansum(found[(points.link[0] == at) & np.isfinite(points.point[0, :, 0])], axis=0)
        newtons = pressure_n * float(np.linalg.norm(force))
        return f"{text}, {newtons:.1f} N" if newtons > 0 else text

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """Patches where flat faces of links and object meet; none for hands and objects without such faces."""
        found = self._points.patches
        if found is None:
            return ()
        parts = zip(*(values[0] for values in (found.faces.count, found.faces.point, found.faces.gap)), strict=True)
        normals = found.faces.normal[0]
        every = [Patch(point[:k], gap[:k], normal) for (k, point, gap), normal in zip(parts, normals, strict=True)]
        return tuple(patch for patch in every if len(patch.corners))

    @cached_property
    def _points(self) -> ContactPoints:
        prepared = self.prepared
        links, T_link = prepared.chain.links, self.frames.T_world_link
        return contacts(prepared.hand, prepared.object, links, self.witness, T_link, prepared.faces)


def distances_text(contact_error: float, penetration: float, title: str = MEASURES["contact_error_m"].title) -> str:
    """Return text on the contact error and the penetration of a grasp, metres; a NaN error: nothing should touch."""
    measures = (title, "contact_error_m", contact_error), ("penetration", "penetration_m", penetration)
    error, depth = (
        f"{text} {MEASURES[name].text(value)} {MEASURES[name].unit.symbol}" for text, name, value in measures
    )
    return f"{'nothing near enough to touch' if np.isnan(contact_error) else error}, {depth}"


def contacts_of(
    prepared: HandObject,
    T_object_root: Float[np.ndarray, "4 4"],
    q: Float[np.ndarray, " n"],
    *,
    gap: Float[np.ndarray, " L"] | None = None,
    targets: Sequence[Target] = (),
) -> Contacts:
    """Return the contacts of a grasp.

    Args:
        prepared: The hand and the object.
        T_object_root: Pose of the hand's base link in the object's frame.
        q: Joint values.
        gap: Target gap in metres of links that should touch, besides links with a target, columns as
            `Scene.links`; NaN for other links. None: without targets, links that `ContactSelection` takes.
        targets: Target points of links on the object.
    """
    hand, links = prepared.hand, prepared.chain.links
    first = np.array([links.index(link) for link in links])
    frames = prepared.chain(T_object_root[None], q[None])
    T_link = frames.T_world_link
    target_columns = np.array(
        [links.index(target.link) if target.link in links else -1 for target in targets], dtype=np.int64
    )
    should: np.ndarray | None = None
    wanted = np.zeros(len(links))
    if gap is not None or targets:
        known = np.zeros(len(links), dtype=bool) if gap is None else ~np.isnan(gap)
        should = np.zeros(len(links), dtype=bool)
        should[target_columns[target_columns >= 0]] = True
        should[first[known]] = True
        wanted[first[known]] = 0.0 if gap is None else gap[known]
    cutoff = np.where(first == np.arange(len(links)), DEFAULT_SELECTION.cutoff(hand, links), -np.inf)
    if should is not None:
        cutoff[should] = np.inf
    cutoff[target_columns[target_columns >= 0]] = np.inf
    witness = query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape), cutoff=cutoff)
    if should is None:
        should = DEFAULT_SELECTION.choose(hand, links, witness)[0]
    valid, distance = witness.valid[0], np.where(witness.valid[0], witness.distance[0], np.inf)
    target_link, target_object, miss = _targets(targets, target_columns, T_link[0], witness)
    error = np.maximum(np.abs(distance - wanted), miss)
    shown = np.flatnonzero(valid & (should | (distance < CONTACT_TOLERANCE_M)) & (first == np.arange(len(links))))
    return Contacts(
        link=tuple(links[column] for column in shown),
        point_link=witness.point_a[0, shown],
        point_object=witness.point_b[0, shown],
        distance=distance[shown],
        should=should[shown],
        error=np.where(should, error, np.nan)[shown],
        target_link=target_link,
        target_object=target_object,
        penetration=max(0.0, -float(distance.min())) if np.isfinite(T_link).all() else np.nan,
        witness=witness,
        prepared=prepared,
        frames=frames,
    )


def _targets(
    targets: Sequence[Target],
    target_columns: np.ndarray,
    T_object_link: Float[np.ndarray, "L 4 4"],
    witness: Witness,
) -> tuple[Float[np.ndarray, "G 3"], Float[np.ndarray, "G 3"], Float[np.ndarray, " L"]]:
    """Points of targets on the links and on the object, object frame, and the largest miss of each link (L,)."""
    on_link = np.full((len(targets), 3), np.nan)
    on_object = np.array([target.point_object for target in targets], dtype=np.float64).reshape(-1, 3)
    miss = np.zeros(len(T_object_link))
    for number, (target, column) in enumerate(zip(targets, target_columns, strict=True)):
        if column >= 0:
            on_link[number] = transform_points(T_object_link[column], np.asarray(target.point_link, dtype=np.float64))
            ends = ((witness.point_a, on_link), (witness.point_b, on_object))
            misses = [np.linalg.norm(found[0, column] - wanted[number]) for found, wanted in ends]
            miss[column] = max(miss[column], *misses)
    return on_link, on_object, miss
