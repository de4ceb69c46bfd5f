"""Contact points of grasps: witness points of the links that touch, and corners where flat faces meet.

The first L columns belong to the links. Where the flat faces of a link and of the object meet, the corners of the
patch (`witness.face_patch`) stand for the witness point: the first in the column of the link, the others in `SLOTS`
groups of columns behind the links' columns, which hands or objects without flat faces do not have. Grasps without
patches are computed without these columns, so that they do not depend on the other grasps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.profiling import stage
from grasp_refine.forces.wrench import PLANNING_FRICTION, RIDGE, ContactForces, contact_forces
from grasp_refine.witness.face_patch import NUM_CORNERS, FacePairs, FacePatches

SLOTS = 4
"""Largest number of patches of a grasp; further links keep their witness points."""


@dataclass(frozen=True, eq=False)
class LinkPatches:
    """Patches of N grasps, at most `SLOTS` each."""

    link: Int[np.ndarray, "N S"]
    """Index (N, 4) of the link of each patch; -1: there is none."""
    faces: FacePatches
    """Patches (N, 4)."""

    @staticmethod
    @stage("derivative")
    def of(
        faces: FacePairs,
        touching: Bool[np.ndarray, "N L"],
        T_world_link: Float[np.ndarray, "N L 4 4"],
        witness: Witness,
        number: Int[np.ndarray, " N"] | None = None,
    ) -> LinkPatches | None:
        """Find the patches of the links that touch (N, L); None where no link can have any.

        `number` (N,) is the index of each grasp's object; None: the first.
        """
        if not faces.flat.any():
            return None
        number = np.zeros(len(touching), dtype=np.int64) if number is None else number
        row, link = np.nonzero(touching & witness.valid & faces.flat[number])
        at = link, number[row], T_world_link[row, link], witness.rows((row, link))
        found = faces.patches(*at, np.ones(len(row), dtype=bool))
        some = np.flatnonzero(found.count)
        row, link = row[some], link[some]
        slot = np.arange(len(row)) - np.searchsorted(row, row)
        kept = slot < SLOTS
        row, link, slot, some = row[kept], link[kept], slot[kept], some[kept]
        of_slot = np.full((len(touching), SLOTS), -1)
        of_slot[row, slot] = link

        def placed(values: np.ndarray) -> np.ndarray:
            every = np.zeros((len(touching), SLOTS, *values.shape[1:]), dtype=values.dtype)
            every[row, slot] = values[some]
            return every

        return LinkPatches(of_slot, FacePatches(*(placed(getattr(found, field.name)) for field in fields(found))))

    def first(self, number: int) -> LinkPatches:
        """Return the first patches of each grasp."""
        faces = FacePatches(*(getattr(self.faces, field.name)[:, :number] for field in fields(FacePatches)))
        return LinkPatches(self.link[:, :number], faces)

    def restricted(self, touching: Bool[np.ndarray, "N L"]) -> LinkPatches:
        """Return the patches of the links that touch (N, L)."""
        kept = (self.link >= 0) & touching[np.arange(len(touching))[:, None], np.maximum(self.link, 0)]
        return replace(self, faces=replace(self.faces, count=np.where(kept, self.faces.count, 0)))


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """K contact points of each of N grasps of L links."""

    point: Float[np.ndarray, "N K 3"]
    """Points (N, K, 3) on the object, in metres; NaN: no contact."""
    normal: Float[np.ndarray, "N K 3"]
    """Unit normals (N, K, 3) into the object; NaN: no contact."""
    gap: Float[np.ndarray, "N K"]
    """Signed distances (N, K) of link and object there, in metres; 0: no contact."""
    link: Int[np.ndarray, "N K"]
    """Index (N, K) of the link of each point."""
    patches: LinkPatches | None
    """Patches; None where no link can have any."""

    @staticmethod
    def of(touching: Bool[np.ndarray, "N L"], witness: Witness, patches: LinkPatches | None = None) -> ContactPoints:
        """Return the contact points of the links that touch.

        Args:
            touching: Mask (N, L) of the links.
            witness: Witness points (N, L) of links and object.
            patches: Patches of these links.
        """
        N, L = touching.shape
        there = (touching & witness.valid)[..., None]
        point, normal = (np.where(there, side, np.nan) for side in (witness.point_b, witness.normal))
        gap = np.where(there[..., 0], witness.distance, 0.0)
        link = np.broadcast_to(np.arange(L), (N, L))
        if patches is None:
            return ContactPoints(point, normal, gap, link, None)
        faces, extra = patches.faces, SLOTS * (NUM_CORNERS - 1)
        point, normal = (np.pad(part, ((0, 0), (0, extra), (0, 0)), constant_values=np.nan) for part in (point, normal))
        gap = np.pad(gap, ((0, 0), (0, extra)))
        link = np.concatenate([link, np.repeat(np.maximum(patches.link, 0), NUM_CORNERS - 1, axis=1)], axis=1)
        row, slot, corner, column = patches_columns(patches, L)
        point[row, column] = faces.point[row, slot, corner]
        normal[row, column] = faces.normal[row, slot]
        gap[row, column] = faces.gap[row, slot, corner]
        return ContactPoints(point, normal, gap, link, patches)

    @property
    def num_links(self) -> int:
        """Number L of links."""
        return self.point.shape[1] - (0 if self.patches is None else SLOTS * (NUM_CORNERS - 1))

    @property
    def point_on_link(self) -> Float[np.ndarray, "N K 3"]:
        """Points (N, K, 3) of the links opposite to the points on the object, in metres."""
        return self.point - self.gap[..., None] * self.normal

    @property
    def patched(self) -> Bool[np.ndarray, " N"]:
        """True for the grasps (N,) that have a patch."""
        if self.patches is None:
            return np.zeros(len(self.point), dtype=bool)
        return np.any(self.patches.faces.count, axis=1)

    def groups(self) -> Iterator[tuple[np.ndarray | slice, ContactPoints]]:
        """Yield the rows of the grasps without patches with their points, L columns, then the rows with patches."""
        patched = self.patched
        if not (patched.any() and patched.all()):
            rows = np.flatnonzero(~patched) if patched.any() else slice(None)
            point, normal, gap, link = (
                part[rows, : self.num_links] for part in (self.point, self.normal, self.gap, self.link)
            )
            yield rows, ContactPoints(point, normal, gap, link, None)
        if patched.any():
            rows = np.flatnonzero(patched)
            yield rows, take(self, rows)

    def forces_under(
        self,
        loads: Float[np.ndarray, "N P 6"],
        center: Float[np.ndarray, "*#N 3"],
        *,
        axes: Float[np.ndarray, "N 3 3"],
        friction: float = PLANNING_FRICTION,
        ridge: float = RIDGE,
        forms: Callable[[np.ndarray | slice, ContactPoints], np.ndarray | None] | None = None,
        start: Float[np.ndarray, "N P K 3"] | None = None,
    ) -> ContactForces:
        """Return the best forces at these points, see `wrench.contact_forces`.

        Args:
            loads: As there.
            center: As there.
            axes: As there.
            friction: As there.
            ridge: As there.
            forms: Returns the forms of grasps, given their rows and points.
            start: As there.
        """
        parts = []
        center = np.broadcast_to(center, (len(self.point), 3))
        for rows, points in self.groups():
            K = points.point.shape[1]
            found = contact_forces(
                loads[rows],
                points.point,
                points.normal,
                center[rows],
                friction=friction,
                ridge=ridge,
                forms=None if forms is None else forms(rows, points),
                axes=axes[rows],
                start=None if start is None else np.ascontiguousarray(start[rows, :, :K]),
                link=None if points.patches is None else points.link,
            )
            parts.append((rows, found))
        return self._joined(parts)

    def _joined(self, parts: list[tuple[np.ndarray | slice, ContactForces]]) -> ContactForces:
        """Forces of all grasps, 0 where there is no contact."""
        K = self.point.shape[1]
        if len(parts) == 1 and parts[0][1].pressure.shape[-1] == K:
            return parts[0][1]
        values = {}
        for field in fields(ContactForces):
            first = getattr(parts[0][1], field.name)
            shape = list(first.shape)
            shape[0] = len(self.point)
            if field.name in ("force", "pressure", "local"):
                shape[2] = K
            values[field.name] = np.zeros(shape, dtype=first.dtype)
            for rows, found in parts:
                part = getattr(found, field.name)
                if field.name in ("force", "pressure", "local"):
                    values[field.name][rows, :, : part.shape[2]] = part
                else:
                    values[field.name][rows] = part
        return ContactForces(**values)


def patches_columns(patches: LinkPatches, num_links: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return grasp, slot, number and column of each corner of patches; columns as in `ContactPoints`."""
    row, slot, corner = np.nonzero(patches.faces.there)
    behind = num_links + (NUM_CORNERS - 1) * slot + corner - 1
    return row, slot, corner, np.where(corner == 0, patches.link[row, slot], behind)
