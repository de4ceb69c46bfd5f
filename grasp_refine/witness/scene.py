"""Input of a derivative method: the poses, the witness points there, and their targets."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.se3 import transform_points
from grasp_refine.core.short_repr import brief
from grasp_refine.witness.neighborhood import Neighborhood, Neighbors, Surfaces, choose, draw_offset
from grasp_refine.witness.rings import Neighbor, choose_rings


@dataclass(frozen=True, eq=False)
class WitnessScene:
    """Poses of a batch of body pairs with their witness points; all arrays float64."""

    pairs: Pairs
    """The body pairs."""
    surfaces: Surfaces
    """Candidates of all first bodies, then of all second bodies: S = 2 P."""
    T_world_a: np.ndarray
    """Poses of the first bodies (batch, pair, 4, 4)."""
    T_world_b: np.ndarray
    """Poses of the second bodies."""
    witness: Witness
    """Witness points at these poses."""
    target_a: np.ndarray | None
    """Target points (batch, pair, 3) of the first bodies, body frames, metres; NaN: no target."""
    target_b: np.ndarray | None
    """Target points (batch, pair, 3) of the second bodies, body frames, metres; NaN: no target."""
    key: int
    """Iteration number: methods that draw samples draw others at another key."""

    __repr__ = brief

    @property
    def length(self) -> np.ndarray:
        """Mean bounding-box diagonal (P,) of the two bodies of each pair, in metres."""
        return self.surfaces.diagonal.reshape(2, -1).mean(axis=0)

    def sides(self) -> "Sides":
        """Return each pair in the frames of both its bodies: first all a, then all b (S = 2 P)."""
        w = self.witness
        T = _stacked(self.T_world_a, self.T_world_b)
        R, p = T[..., :3, :3], T[..., :3, 3]
        world = np.stack(
            [
                _stacked(w.point_a, w.point_b) - p,
                _stacked(w.point_b, w.point_a) - p,
                _stacked(w.normal, -w.normal),
            ],
            axis=2,
        )
        local = world @ R  # rows times R: each vector times R^T
        return Sides(R, local[:, :, 0], local[:, :, 1], local[:, :, 2], self._targets())

    def targets_world(self) -> np.ndarray | None:
        """Return the targets (S, batch, 3) of first all a, then all b, in the world frame; NaN, None: no target."""
        targets = self._targets()
        return None if targets is None else transform_points(_stacked(self.T_world_a, self.T_world_b), targets)

    def _targets(self) -> np.ndarray | None:
        if self.target_a is None and self.target_b is None:
            return None
        none = np.full_like(self.witness.point_a, np.nan)
        return _stacked(*(none if side is None else side for side in (self.target_a, self.target_b)))

    def neighbors(self, rule: Neighborhood | Neighbor, seed: int) -> tuple["Sides", Neighbors]:
        """Return each pair in the frames of both its bodies, and the surface samples near its witness points."""
        sides = self.sides()
        offset = draw_offset(seed, self.key)
        if isinstance(rule, Neighbor):
            pieces, winner = self.pairs.piece_pairs, self.witness.winner
            return sides, choose_rings(rule, *pieces, winner, sides.point, offset, self.surfaces.floor)
        return sides, choose(rule, self.surfaces, sides.point, sides.normal, sides.target, offset)


@dataclass(frozen=True, eq=False)
class Sides:
    """One body of each pair with its witness, in the body's frame; shapes (S, batch, ...)."""

    rotation: np.ndarray
    """Rotation (S, batch, 3, 3) of the body in the world."""
    point: np.ndarray
    """Witness point (S, batch, 3) of the body, metres."""
    other: np.ndarray
    """Witness point (S, batch, 3) of the other body, in this body's frame, metres."""
    normal: np.ndarray
    """Outward contact normal (S, batch, 3)."""
    target: np.ndarray | None
    """Target point (S, batch, 3), metres; NaN: no target."""


def _stacked(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Stack two arrays (batch, P, ...) to (2 P, batch, ...)."""
    return np.concatenate([first, second], axis=1).swapaxes(0, 1)
