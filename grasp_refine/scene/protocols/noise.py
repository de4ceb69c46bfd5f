"""Random offsets of the object before the hand closes on it."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, inf, radians

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3


@dataclass(frozen=True)
class Noise:
    """Random offsets of the object before the hand closes on it."""

    count: int = 0
    """Number of offsets per grasp."""
    offset: float = 0.005
    """Largest shift in metres; shifts are uniform in the sphere of this radius, or its projection on the table."""
    turn: float = radians(5)
    """Largest rotation about the object's middle, in radians; rotation vectors are uniform in the sphere."""

    def __post_init__(self) -> None:
        """Refuse numbers that are negative or infinite.

        Raises:
            GraspRefineError: names the field.
        """
        check_fields(self)
        for name in ("count", "offset", "turn"):
            value = getattr(self, name)
            if not 0 <= value < inf:
                raise GraspRefineError(f"Noise: {name} must be finite and not negative, got {value:g}")

    @property
    def reach(self) -> str:
        """Largest offset, for people."""
        return f"{self.offset * 1e3:g} mm and {degrees(self.turn):g} degrees"

    def poses(
        self,
        numbers: Int[np.ndarray, " N"],
        *,
        middle: Float[np.ndarray, " 3"],
        upright: Float[np.ndarray, " 3"] | None = None,
        seed: int = 0,
    ) -> Float[np.ndarray, "N count 4 4"]:
        """Return poses (N, count, 4, 4) of the object, in its frame where it should be.

        Args:
            numbers: Number (N,) of each grasp: its offsets depend on this and on the seed only.
            middle: Centre of the rotations (3,), metres.
            upright: Unit normal (3,) of the table, where there is one: objects then stay on it, shifted and turned.
            seed: Seed of the offsets.
        """
        T = np.tile(np.eye(4), (len(numbers), self.count, 1, 1))
        for pose, number in zip(T, numbers, strict=True):
            shift, turn = self._draw(np.random.default_rng([seed, int(number)]))
            if upright is not None:
                shift, turn = shift - np.outer(shift @ upright, upright), np.outer(turn @ upright, upright)
            pose[:, :3, :3] = exp_so3(turn)
            pose[:, :3, 3] = middle - pose[:, :3, :3] @ middle + shift
        return T

    def _draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return shifts and rotation vectors (count, 3) each, uniform in spheres."""
        samples = []
        for radius in (self.offset, self.turn):
            direction = rng.normal(size=(self.count, 3))
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            samples.append(radius * rng.uniform(size=(self.count, 1)) ** (1 / 3) * direction)
        return samples[0], samples[1]
