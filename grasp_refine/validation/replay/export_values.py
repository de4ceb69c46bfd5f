"""How values of a model are written in its XML file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mujoco
import numpy as np


def text_of(values: float | np.ndarray, single: bool = False) -> str:
    """Numbers as text that is read back exactly, as float64 or, where MuJoCo keeps no more, float32."""
    kind = np.float32 if single else np.float64
    # NumPy and Python write the fewest digits that identify a number.
    return " ".join(str(value) for value in np.atleast_1d(values).astype(kind).ravel())


def set_values(node: ET.Element, values: Mapping[str, float | np.ndarray]) -> None:
    """Give an element attributes that hold numbers."""
    for key, value in values.items():
        node.set(key, text_of(value))


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Name of a thing, made up where it has none."""
    return getattr(model, kind)(int(number)).name or f"{kind}_{number}"


def flag_of(value: object) -> str:
    """A truth, as XML says it."""
    return "true" if value else "false"
