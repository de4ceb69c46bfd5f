"""Units of length of meshes, and a check that a size is plausible."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import MeshError

Unit = Literal["m", "cm", "mm", "in"]

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Unit -> metres."""

NAMES: Mapping[Unit, str] = MappingProxyType({"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches"})
"""Unit -> name."""

PLAUSIBLE_DIAGONALS_M = (0.002, 2.0)
"""Smallest and largest diagonal in metres of objects that hands grasp: a bead, a long pole."""


def check_size(extents: Float[np.ndarray, " 3"], unit: Unit | None, name: str) -> None:
    """Refuse a box of `extents` (3,) in `unit` whose size no hand grasps, see `PLAUSIBLE_DIAGONALS_M`.

    Explicit metres are not checked. None means metres by default, not specified by the user.

    Raises:
        MeshError: the box is much larger or smaller, so that its unit is in doubt; names its size in each plausible
            unit.
    """
    if unit == "m":
        return
    low, high = PLAUSIBLE_DIAGONALS_M
    readings = {known: factor * extents for known, factor in UNITS.items()}
    fitting = [known for known, size in readings.items() if low <= np.linalg.norm(size) <= high]
    here = unit or "m"
    if here in fitting:
        return
    guess = "".join(f"`unit='{known}'` if it is {size_text(readings[known])}, " for known in fitting)
    right = "`unit='m'` if that is right, or another `scale`" if unit is None else "or another `scale`"
    raise MeshError(
        f"{name}: is {size_text(readings[here])} if its numbers are {NAMES[here]}, which is no size for a hand; "
        f"in which unit is it? {guess}{right}"
    )


def size_text(extents: Float[np.ndarray, " 3"]) -> str:
    """Return extents (3,) in metres as text for people."""
    largest = float(np.max(extents))
    unit, factor = ("m", 1.0) if largest >= 1 else ("mm", 1e3)
    return f"{' x '.join(f'{value * factor:.3g}' for value in extents)} {unit}"
