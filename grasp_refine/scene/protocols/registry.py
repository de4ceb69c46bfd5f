"""Named protocols."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.get_a_grip import GET_A_GRIP
from grasp_refine.scene.protocols.graspqp import GRASPQP
from grasp_refine.scene.protocols.hugs import HUGS
from grasp_refine.scene.protocols.isaacgym import ISAACGYM
from grasp_refine.scene.protocols.mujoco_default import MUJOCO_DEFAULT
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {
        protocol.name: protocol
        for protocol in (DEXGRASPBENCH, STRICT, MUJOCO_DEFAULT, TABLETOP, SCENE, HUGS, GRASPQP, ISAACGYM, GET_A_GRIP)
    }
)
"""Name -> protocol."""

DEFAULT = DEXGRASPBENCH.name
"""Name of the protocol where none is given."""


def default_protocol(*, in_scene: bool) -> Protocol:
    """Return the protocol where none is given: in a scene, the object is lifted out of it."""
    return SCENE if in_scene else PROTOCOLS[DEFAULT]
