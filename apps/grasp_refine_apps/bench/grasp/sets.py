"""Sets of grasps for the benchmark: one hand, some objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from grasp_refine.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Group:
    """N real grasps on one object at one scale."""

    object: str
    """Name of the object."""
    scale: float
    """Factor that takes the object's mesh to metres."""
    scene: Scene
    """Hand, object and the grasps."""
    index: np.ndarray
    """Numbers of the grasps (N,) among those of their object, for `run --index`."""


@dataclass(frozen=True, eq=False)
class GraspSet:
    """The grasps of a file."""

    name: str
    """Name in rows."""
    groups: tuple[Group, ...]
    """The grasps by object and scale."""

    @property
    def hand(self) -> str:
        """Name of the hand."""
        return self.groups[0].scene.hand.name


@dataclass(frozen=True)
class Place:
    """Paths of the parts of a set in a folder of assets, beside grasps/normalised/NAME.npz and objects/."""

    hand: str
    """Path of the URDF."""
    object: str | None = None
    """Path of the object, if it is not in objects/."""
    sampled: int | None = None
    """Number of sampled grasps; None: those of the file."""


PLACES: Mapping[str, Place] = MappingProxyType(
    {
        "bodex_shadow": Place("hands/shadow/shadow_right.urdf"),
        "dexgraspnet_shadow": Place("hands/shadow/shadow_right.urdf"),
        "frogger_allegro": Place("hands/allegro/allegro_right.urdf"),
        "leap_cube": Place("hands/leap/leap_right.urdf", "box:0.075,0.075,0.075"),
        "sampled_barrett": Place("hands/barrett/barrett.urdf", "rounded_box", 16),
        "sampled_robotiq": Place("hands/robotiq3f/robotiq3f.urdf", "rounded_box", 16),
    }
)
"""Name of a set -> its paths."""
