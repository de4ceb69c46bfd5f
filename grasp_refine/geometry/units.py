"""Units of length that meshes come in, and whether a size is one that can have been meant."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.errors import MeshError

Unit = Literal["m", "cm", "mm", "in"]

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Unit -> metres."""

PLAUSIBLE = (0.002, 2.0)
"""Diagonals in metres, from and to, of things that hands grasp: a bead, a long pole."""


def check_size(extents: Float[np.ndarray, " 3"], name: str) -> None:
    """Nothing, when a box of `extents` (3,) metres is of a size that hands grasp, see `PLAUSIBLE`.

    Raises:
        MeshError: it is much larger or smaller, so that its unit has to be asked for; says what each unit would make
            of it.
    """
    low, high = PLAUSIBLE
    if low <= np.linalg.norm(extents) <= high:
        return
    readings = {unit: factor * extents for unit, factor in UNITS.items() if unit != "m"}
    fitting = [unit for unit, size in readings.items() if low <= np.linalg.norm(size) <= high]
    guess = ", ".join(f"--unit {unit} if it is {_words(readings[unit])}" for unit in fitting)
    raise MeshError(
        f"{name}: is {_words(extents)} if its numbers are metres, which is no size for a hand; "
        f"in which unit is it? {guess + ', ' if guess else ''}--unit m if that is right, or another --scale"
    )


def _words(extents: Float[np.ndarray, " 3"]) -> str:
    """Extents as a person says them."""
    largest = float(np.max(extents))
    unit, factor = ("m", 1.0) if largest >= 1 else ("mm", 1e3)
    return f"{' x '.join(f'{value * factor:.3g}' for value in extents)} {unit}"
