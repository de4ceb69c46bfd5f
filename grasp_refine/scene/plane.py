"""A plane that nothing may go through, such as a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import UNIT, matvec, transform_points
from grasp_refine.geometry.body import Body


@dataclass(frozen=True)
class Plane:
    """The half space n . p >= offset is free."""

    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit normal n, object frame, towards the free side."""
    offset: float = 0.0
    """Signed distance of the plane from the object's origin along the normal, in metres."""

    def __post_init__(self) -> None:
        """Refuse an invalid plane; an array becomes a tuple.

        Raises:
            GraspRefineError: a normal that is not of unit length, or an offset that is not a number.
        """
        normal = as_numbers("Plane: normal", self.normal, 3)
        object.__setattr__(self, "normal", tuple(normal.tolist()))
        check_kind("Plane: offset", self.offset, float)
        if not abs(np.linalg.norm(normal) - 1.0) <= UNIT:
            raise GraspRefineError(f"Plane: normal must be of unit length, got {self.normal}")

    @property
    def point_and_normal(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Nearest point to the object's origin, metres, and the normal."""
        return tuple(self.offset * part for part in self.normal), self.normal

    def heights(self, bodies: Sequence[Body], T_world_body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances (M, L) of bodies from the plane in metres, and where (M, L, 3) they are least, object frame.

        Arguments are as in `lowest`.
        """
        point = transform_points(T_world_body, self.lowest(bodies, T_world_body))
        return point @ np.asarray(self.normal) - self.offset, point

    def lowest(self, bodies: Sequence[Body], T_world_body: np.ndarray) -> np.ndarray:
        """The point of each body that is farthest below the plane (M, L, 3), body frames, metres.

        Args:
            bodies: L bodies.
            T_world_body: Their poses (M, L, 4, 4) in the object's frame; where one is not finite, any point is.
        """
        down = -matvec(np.nan_to_num(T_world_body[..., :3, :3]).mT, np.asarray(self.normal))
        lowest = np.empty(down.shape)
        for column, body in enumerate(bodies):
            along = down[:, column]
            # Each piece is a core with a sphere around each of its vertices.
            best = np.full(len(along), -np.inf)
            for piece in body.pieces:
                reach = along @ piece.vertices.T
                vertex = reach.argmax(axis=1)
                reach = reach[np.arange(len(along)), vertex] + piece.radius
                point = piece.vertices[vertex] + piece.radius * along
                lowest[:, column] = np.where((reach > best)[:, None], point, lowest[:, column])
                best = np.maximum(best, reach)
        return lowest
