"""Joint draws of the factors: worlds that all grasps share, so that grasps are compared in the same ones."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import log2, pi

import numpy as np

from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3
from grasp_refine.core.short_repr import brief
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.margins.factors import FIELDS, JOINT, PUSH, Factors

MAX_DRAWS = 4096
"""Largest number of draws."""


@dataclass(frozen=True, eq=False)
class Draws(ArrayRecord):
    """K worlds, the same for every grasp; vectors are in the frame of the object."""

    direction: Float[np.ndarray, "K 3"]
    """Unit vector (K, 3) along which the object is pushed with its weight, which is also any direction of gravity."""
    shift: Float[np.ndarray, "K 3"]
    """Shift (K, 3) of the object before the hand closes, metres."""
    turn: Float[np.ndarray, "K 3"]
    """Rotation vector (K, 3) of the object about its centre of mass before the hand closes, radians."""
    friction: Float[np.ndarray, " K"]
    """Sliding friction (K,)."""
    mass: Float[np.ndarray, " K"]
    """Mass of the object (K,), kg."""
    contact_time: Float[np.ndarray, " K"]
    """Factor (K,) of the time constant of contacts."""
    default_contact: Bool[np.ndarray, " K"]
    """True (K,) where the contact is MuJoCo's default."""
    gain: Float[np.ndarray, " K"]
    """Factor (K,) of the stiffness of the servos."""
    force_limit: Float[np.ndarray, " K"]
    """Factor (K,) of the force limits of the servos."""
    thickness: Float[np.ndarray, " K"]
    """Distance (K,) of the object's surface outside of its pieces, metres."""
    other_model: Bool[np.ndarray, " K"]
    """True (K,) where the hand is its other model, if it has one."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of draws."""
        return len(self.mass)

    def only(self, factor: str, protocol: Protocol, mass: float) -> Draws:
        """Return these draws with everything but one factor, and the direction of the push, as in the protocol.

        Args:
            factor: A key of `FIELDS`; `JOINT` for all of them, `PUSH` for none.
            protocol: The protocol.
            mass: Mass that it gives the object, kg.
        """
        if factor == JOINT:
            return self
        kept = () if factor == PUSH else FIELDS[factor]
        others = {name: value for name, value in nominal(len(self), protocol, mass).items() if name not in kept}
        return replace(self, **others)

    def conditions(self, protocol: Protocol, middle: Float[np.ndarray, " 3"]) -> Conditions:
        """Return the conditions of K simulations.

        Args:
            protocol: Protocol, whose acceleration gives the push times the mass.
            middle: Centre of mass (3,) of the object, metres, about which it is turned.
        """
        T = np.tile(np.eye(4), (len(self), 1, 1))
        T[:, :3, :3] = exp_so3(self.turn)
        T[:, :3, 3] = middle - T[:, :3, :3] @ middle + self.shift
        wrench = np.zeros((len(self), 1, 6))
        wrench[:, 0, :3] = (self.mass * protocol.acceleration)[:, None] * self.direction
        return Conditions(
            T,
            self.friction,
            mass=self.mass,
            wrench=wrench,
            gain=self.gain,
            force_limit=self.force_limit,
            contact_time=self.contact_time,
            default_contact=self.default_contact,
            thickness=self.thickness,
        )


def draw(factors: Factors, count: int, seed: int = 0) -> Draws:
    """Return `count` draws, which depend on the factors and the seed alone; fewer are the first ones of more.

    They are the points of a scrambled Sobol sequence (Owen, "Randomly permuted (t,m,s)-nets", 1995), so that each
    factor covers its range evenly. Powers of 2 are best.

    Raises:
        GraspRefineError: no number from 1 to `MAX_DRAWS`.
    """
    from scipy.stats import qmc

    if not 1 <= count <= MAX_DRAWS:
        raise GraspRefineError(f"draws must be from 1 to {MAX_DRAWS}, got {count}")
    sobol = qmc.Sobol(d=16, scramble=True, seed=np.random.default_rng(seed))
    u = sobol.random_base2(int(np.ceil(log2(MAX_DRAWS))))[:count].T
    return Draws(
        direction=_on_sphere(u[0], u[1]),
        shift=factors.offset * _in_sphere(*u[2:5]),
        turn=factors.turn * _in_sphere(*u[5:8]),
        friction=_uniform(u[8], factors.friction),
        mass=_log_uniform(u[9], factors.mass),
        contact_time=_log_uniform(u[10], factors.softness),
        default_contact=u[11] < factors.default_contact,
        gain=_uniform(u[12], factors.gain),
        force_limit=_uniform(u[13], factors.force_limit),
        thickness=_uniform(u[14], factors.thickness),
        other_model=u[15] < factors.other_model,
    )


def nominal(count: int, protocol: Protocol, mass: float) -> dict[str, np.ndarray]:
    """Return the fields of `Draws` but the direction, as the protocol has them, with the mass (kg) of the object."""
    one, no = np.ones(count), np.zeros(count, dtype=bool)
    values = {
        "shift": np.zeros((count, 3)),
        "turn": np.zeros((count, 3)),
        "friction": protocol.friction * one,
        "mass": mass * one,
        "contact_time": one,
        "default_contact": no,
        "gain": one,
        "force_limit": one,
        "thickness": 0.0 * one,
        "other_model": no,
    }
    assert set(values) == {field.name for field in fields(Draws)} - {"direction"}
    return values


def _uniform(u: np.ndarray, between: tuple[float, float]) -> np.ndarray:
    low, high = between
    return low + u * (high - low)


def _log_uniform(u: np.ndarray, between: tuple[float, float]) -> np.ndarray:
    low, high = between
    return low * (high / low) ** u


def _on_sphere(u: np.ndarray, v: np.ndarray) -> Float[np.ndarray, "K 3"]:
    """Return points (K, 3) on the unit sphere, of equal density by Archimedes: z and longitude are uniform."""
    z, angle = 2 * u - 1, 2 * pi * v
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _in_sphere(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> Float[np.ndarray, "K 3"]:
    return np.cbrt(w)[:, None] * _on_sphere(u, v)
