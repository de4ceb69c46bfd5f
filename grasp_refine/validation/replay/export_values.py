"""Formatting of values of a model in its XML file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import mujoco
import numpy as np


def text_of(values: float | np.ndarray, single: bool = False) -> str:
    """Return numbers as text that is read back exactly, as float64 or, where MuJoCo keeps no more, float32."""
    kind = np.float32 if single else np.float64
    # NumPy and Python write the fewest digits that identify a number.
    return " ".join(str(value) for value in np.atleast_1d(values).astype(kind).ravel())


def set_values(node: ET.Element, values: Mapping[str, float | np.ndarray]) -> None:
    """Set attributes of an element to numbers."""
    for key, value in values.items():
        node.set(key, text_of(value))


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of an element of a model, or a made-up one where it has none."""
    return getattr(model, kind)(int(number)).name or f"{kind}_{number}"


def flag_of(value: object) -> str:
    """Return a boolean as text in XML."""
    return "true" if value else "false"
