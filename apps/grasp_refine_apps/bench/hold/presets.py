"""Named experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

STARTS = (1, 6)
"""Default numbers of starts."""


@dataclass(frozen=True)
class Preset:
    """An experiment."""

    starts: tuple[int, ...] = STARTS
    """Numbers of starts."""
    count: int | None = None
    """Largest number of grasps on each object at each scale; None: all."""


PRESETS: Mapping[str, Preset] = MappingProxyType({"smoke": Preset(starts=(1, 2), count=2)})
"""Name -> experiment."""
