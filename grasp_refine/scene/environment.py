"""Environment of a grasp: bodies at rest around the object, such as a table, walls and other objects."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_fields, check_kind
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.names import is_valid
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import inverse, is_rigid
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, capsule, hull
from grasp_refine.objects.object import Object, load_object
from grasp_refine.objects.region_spec import VERBS, spec_digest

DEFAULT_MARGIN_M = 0.002
"""Gap in metres that links keep from a body where none is given."""

LIFT_M = 0.1
"""Height in metres of a lift where none is given, as in the simulation of scenes."""

HANGS_M = 0.01
"""Height in metres above the origin of the object from which on a piece of a body hangs: links may pass below."""

GRID_M = 1e-9
"""Grid in metres on which geometry is compared: far below any mesh, far above rounding."""


@dataclass(frozen=True, eq=False)
class EnvironmentBody:
    """A body around the object; at rest, unless a simulation pushes it."""

    name: str
    """Name in messages and results."""
    body: Body
    """Convex pieces, in the body's frame."""
    T_world_body: Float[np.ndarray, "4 4"]
    """Pose in the world, whose z axis points up."""
    margin: float = DEFAULT_MARGIN_M
    """Gap in metres that links keep from it."""
    movable: bool = False
    """Whether a simulation may push it; to refinement it is at rest."""
    mass: float | None = None
    """Mass in kg of a movable body; None: its volume times the density of the simulation's protocol."""

    def __post_init__(self) -> None:
        """Refuse invalid values.

        Raises:
            GraspRefineError: names the body, the field and its value.
        """
        check_fields(self)
        where = f"body '{self.name}'"
        if not self.name or not is_valid(self.name) or "/" in self.name:
            raise GraspRefineError(f"{where}: a name has printable characters, and no /")
        object.__setattr__(self, "T_world_body", rigid_pose(f"{where}: T_world_body", self.T_world_body))
        if not 0.0 <= self.margin < inf:
            raise GraspRefineError(f"{where}: margin must be at least 0 and finite, got {self.margin:g}")
        if self.mass is not None and not 0.0 < self.mass < inf:
            raise GraspRefineError(f"{where}: mass must be above 0 and finite, got {self.mass:g}")
        if self.mass is not None and not self.movable:
            raise GraspRefineError(f"{where}: only movable bodies have a mass")


@dataclass(frozen=True, eq=False)
class Environment:
    """B bodies around the object, and the pose of the object among them."""

    bodies: tuple[EnvironmentBody, ...]
    """The bodies, whose names differ."""
    T_world_object: Float[np.ndarray, "4 4"]
    """Pose of the object in the world, whose z axis points up."""
    name: str = "scene"
    """Name in messages and results."""
    lift: float = LIFT_M
    """Height in metres by which the object is lifted: links stay clear of bodies above up to there."""
    object: str | None = None
    """Object that is grasped, which `load_object` reads; others are refused. None: any."""
    scale: float = 1.0
    """Factor that takes its mesh to metres."""
    source: str = ""
    """Scene file, or name of a scene that comes with the program; empty: made in memory."""
    touch: tuple[str, ...] = ()
    """Regions in which hands should touch the object, as `contact_regions` takes them; none: everywhere."""
    avoid: tuple[str, ...] = ()
    """Regions in which they should not touch it."""

    def __repr__(self) -> str:
        movable = sum(body.movable for body in self.bodies)
        fixed = count_text(len(self.bodies) - movable, "fixed body", "fixed bodies")
        return f"Environment({self.name}: {fixed}, {movable} movable)"

    def __post_init__(self) -> None:
        """Refuse invalid values; a list of bodies becomes a tuple.

        Raises:
            GraspRefineError: another type, a pose that is not rigid, or two bodies of one name.
        """
        object.__setattr__(self, "bodies", tuple(self.bodies))
        check_kind("Environment: bodies", self.bodies, tuple[EnvironmentBody, ...])
        check_kind("Environment: name", self.name, str)
        pose = rigid_pose("Environment: T_world_object", self.T_world_object)
        object.__setattr__(self, "T_world_object", pose)
        if not 0.0 <= self.lift < inf:
            raise GraspRefineError(f"{self.name}: lift must be at least 0 and finite, got {self.lift:g}")
        names = [body.name for body in self.bodies]
        twice = [name for name in names if names.count(name) > 1] if len(set(names)) < len(names) else []
        if twice:
            raise GraspRefineError(f"{self.name}: two bodies are named '{twice[0]}'")

    def load_object(self) -> Object:
        """Return the object that is grasped in the scene, in its size there.

        Raises:
            GraspRefineError: the scene names none, or it cannot be read.
        """
        if self.object is None:
            raise GraspRefineError(f"scene {self.name} names no object: load one with load_object")
        return load_object(self.object, scale=self.scale, unit="m")

    @cached_property
    def T_object_body(self) -> Float[np.ndarray, "B 4 4"]:
        """Poses (B, 4, 4) of the bodies in the object's frame, in which grasps are."""
        T = np.array([body.T_world_body for body in self.bodies]).reshape(-1, 4, 4)
        return inverse(self.T_world_object) @ T

    @cached_property
    def margins(self) -> Float[np.ndarray, " B"]:
        """Gaps (B,) in metres that links keep from the bodies."""
        return np.array([body.margin for body in self.bodies])

    @cached_property
    def boxes(self) -> Float[np.ndarray, "B 2 3"]:
        """Lower and upper corners (B, 2, 3) of the bodies' bounding boxes along the axes of the object, metres.

        They are as in `cleared`.
        """
        found, down = np.empty((len(self.bodies), 2, 3)), -self.lift * self.up
        for row, (one, T) in enumerate(zip(self.bodies, self.T_object_body, strict=True)):
            corners = np.stack([piece.transformed(T).bounds for piece in one.body.pieces])
            if (hangs := self._hanging(one)).any():
                corners = np.concatenate([corners, corners[hangs] + down])
            found[row] = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        return found

    def cleared(self, index: int) -> Body:
        """Return body `index` with all that links must be out of while the object is lifted straight up.

        A link that rises meets a body exactly where it is in the body's sweep down by as much, and the sweep of a
        convex piece is convex. Only pieces that hang are swept: below the others there is no way through.
        """
        if index not in self._cleared:
            one = self.bodies[index]
            hangs, down = self._hanging(one), -self.lift * one.T_world_body[2, :3]
            pieces = [swept(piece, down) if low else piece for piece, low in zip(one.body.pieces, hangs, strict=True)]
            self._cleared[index] = replace(one.body, pieces=tuple(pieces)) if hangs.any() else one.body
        return self._cleared[index]

    @cached_property
    def _cleared(self) -> dict[int, Body]:
        return {}

    def _hanging(self, one: EnvironmentBody) -> np.ndarray:
        """Return True for the pieces (P,) of a body that hang above the object's origin."""
        if self.lift == 0.0:
            return np.zeros(len(one.body.pieces), dtype=bool)
        along, height = one.T_world_body[2, :3], one.T_world_body[2, 3]
        lowest = [height + (piece.vertices @ along).min() - piece.radius for piece in one.body.pieces]
        return np.array(lowest) > self.T_world_object[2, 3] + HANGS_M

    @property
    def up(self) -> Float[np.ndarray, " 3"]:
        """Unit vector (3,) against gravity, in the object's frame."""
        return self.T_world_object[2, :3]

    @cached_property
    def digest(self) -> str:
        """sha256 of the bodies, where they are around the object, and the regions of it, independent of their order."""
        parts = []
        for one, T in zip(self.bodies, self.T_object_body, strict=True):
            pieces = sorted(_on_grid(piece.vertices) + _on_grid(piece.radius) for piece in one.body.pieces)
            fields = one.name.encode(), bytes([one.movable]), _on_grid(one.margin), _on_grid(one.mass or 0.0)
            parts.append(b"\0".join([*fields, _on_grid(T), *pieces]))
        up = _on_grid(self.up) + _on_grid(self.lift)
        regions = [f"{verb} {spec_digest(spec)}" for verb in VERBS for spec in getattr(self, verb)]
        parts = [*sorted(parts), *(text.encode() for text in sorted(regions))]
        return hashlib.sha256(up + b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def rigid_pose(name: str, T: object) -> Float[np.ndarray, "4 4"]:
    """Return a rigid transform (4, 4) as an array.

    Raises:
        GraspRefineError: another shape, or no rigid transform; names it.
    """
    pose = as_numbers(name, T, 4, 4)
    if not (np.isfinite(pose).all() and is_rigid(pose)):
        raise GraspRefineError(f"{name} must be a rigid transform (4, 4), got {np.asarray(T).tolist()}")
    return pose


def swept(piece: Piece, way: np.ndarray) -> Piece:
    """Return the convex hull of a piece here and moved along `way` (3,); round ones become polyhedra inside of it."""
    if len(piece.vertices) == 1:
        return capsule(piece.radius, piece.vertices[0], piece.vertices[0] + way)
    core = np.asarray(piece.mesh().vertices) if len(piece.vertices) == 2 else piece.vertices
    found = hull(np.concatenate([core, core + way]))
    return found if len(piece.vertices) == 2 else replace(found, radius=piece.radius)


def _on_grid(metres: np.ndarray | float) -> bytes:
    return np.round(np.asarray(metres, dtype=np.float64) / GRID_M).astype("<i8").tobytes()
