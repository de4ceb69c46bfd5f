"""Units of length that meshes come in, and whether a size is one that can have been meant."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.core.errors import MeshError

Unit = Literal["m", "cm", "mm", "in"]

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Unit -> metres."""

NAMES: Mapping[Unit, str] = MappingProxyType({"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches"})
"""Unit -> what it is called."""

PLAUSIBLE = (0.002, 2.0)
"""Diagonals in metres, from and to, of things that hands grasp: a bead, a long pole."""


def check_size(extents: Float[np.ndarray, " 3"], unit: Unit | None, name: str) -> None:
    """Nothing, when a box of `extents` (3,) in `unit` is of a size that hands grasp, see `PLAUSIBLE`.

    Metres are believed where they are said. None is metres that nobody has said.

    Raises:
        MeshError: it is much larger or smaller, so that its unit has to be asked for; says what each unit would make
            of it.
    """
    if unit == "m":
        return
    low, high = PLAUSIBLE
    readings = {known: factor * extents for known, factor in UNITS.items()}
    fitting = [known for known, size in readings.items() if low <= np.linalg.norm(size) <= high]
    here = unit or "m"
    if here in fitting:
        return
    guess = "".join(f"--unit {known} if it is {_words(readings[known])}, " for known in fitting)
    right = "--unit m if that is right, or another --scale" if unit is None else "or another --scale"
    raise MeshError(
        f"{name}: is {_words(readings[here])} if its numbers are {NAMES[here]}, which is no size for a hand; "
        f"in which unit is it? {guess}{right} (in Python: unit, scale)"
    )


def _words(extents: Float[np.ndarray, " 3"]) -> str:
    """Extents as a person says them."""
    largest = float(np.max(extents))
    unit, factor = ("m", 1.0) if largest >= 1 else ("mm", 1e3)
    return f"{' x '.join(f'{value * factor:.3g}' for value in extents)} {unit}"
