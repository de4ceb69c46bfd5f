"""Units in which fields of the settings are shown and typed: readable units instead of SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

DIGITS = 12
"""Significant digits of shown values, so that factors leave no rounding errors."""


@dataclass(frozen=True)
class FieldUnit:
    """Unit of a field, or of each of its values."""

    symbol: str
    """Symbol after the label."""
    factors: tuple[float, ...] = (1.0,)
    """Factor from SI units to the shown ones, one for all values or one for each."""
    example: tuple[str, str] = ("", "")
    """Example in the hint in SI units, and in the shown ones."""

    def shown(self, value: Any) -> Any:
        """Return a value in shown units; None stays None."""
        return self._scaled(value, lambda number, factor: number * factor)

    def si(self, value: Any) -> Any:
        """Return a shown value in SI units."""
        return self._scaled(value, lambda number, factor: number / factor)

    def hint(self, text: str) -> str:
        """Return a hint in SI units in the shown ones; numbers other than the example stay."""
        if self.factors == (1.0,):
            return text
        text = text.replace(*self.example) if self.example[0] else text
        return text.replace("metres", "mm").replace("radians", "degrees")

    def _scaled(self, value: Any, scale: Callable[[float, float], float]) -> Any:
        if value is None:
            return None
        numbers = value if isinstance(value, tuple) else (value,)
        factors = self.factors if len(self.factors) == len(numbers) else self.factors[:1] * len(numbers)
        found = tuple(float(f"{scale(*pair):.{DIGITS}g}") for pair in zip(numbers, factors, strict=True))
        return found if isinstance(value, tuple) else found[0]


DEGREES = math.degrees(1.0)
MILLIMETRES, ANGLE = FieldUnit("mm", (1e3,)), FieldUnit("degrees", (DEGREES,))
SQUARE_METRES, METRES, RADIANS = FieldUnit("m²"), FieldUnit("m"), FieldUnit("rad")

SETTING_UNITS: Mapping[str, FieldUnit] = {
    "margin": MILLIMETRES,
    "reach": MILLIMETRES,
    "other_link_distance": MILLIMETRES,
    "max_move": FieldUnit("mm, degrees, degrees", (1e3, DEGREES, DEGREES), ("0.01,0.1,0.2", "10, 6, 12")),
    "scales.translation": MILLIMETRES,
    "scales.rotation": ANGLE,
    "scales.joints": ANGLE,
    "tolerance": SQUARE_METRES,
    "levenberg_marquardt.good": SQUARE_METRES,
    "pressure": FieldUnit("N"),
    "seconds": FieldUnit("s"),
    **{f"{solver}.step_translation": METRES for solver in ("descent", "adam")},
    **{f"{solver}.step_{what}": RADIANS for solver in ("descent", "adam") for what in ("rotation", "joints")},
}
"""Name of a field -> its unit; step lengths stay as the paper gives them."""
