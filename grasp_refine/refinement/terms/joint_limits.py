"""Joint limits: joints stay within them. Least squares keeps them exactly, as bounds of its steps."""

from __future__ import annotations

from typing import ClassVar

from grasp_refine.core.se3 import Array, array_namespace
from grasp_refine.refinement.terms.term import State, Term


class JointLimits(Term):
    """Distances of joint values beyond their limits, in radians, or metres for prismatic joints."""

    least_squares: ClassVar[bool] = False

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the distances (M, n)."""
        hand = self.setup.scene.hand
        return (beyond_limits(state.q, state.like(hand.lower), state.like(hand.upper)),)


def beyond_limits(q: Array, lower: Array, upper: Array) -> Array:
    """Return the distances of joint values (..., n) beyond their limits (n,), in their own unit (rad or m)."""
    xp = array_namespace(q)
    zero = xp.zeros_like(q)
    return xp.maximum(q - upper, zero) + xp.maximum(lower - q, zero)
