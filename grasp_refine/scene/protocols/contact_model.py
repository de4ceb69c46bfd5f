"""Friction of contacts in MuJoCo: cone, impedance ratio and iterations against slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from grasp_refine.core.arguments import check_positive
from grasp_refine.core.errors import GraspRefineError

Cone = Literal["elliptic", "pyramidal"]
"""Friction cones of MuJoCo: elliptic, or the pyramid inscribed in it."""


@dataclass(frozen=True)
class ContactModel:
    """Approximation of dry friction in MuJoCo; the more softly, the faster loaded contacts creep."""

    cone: Cone = "elliptic"
    """Friction cone."""
    impratio: float = 10.0
    """Ratio of the impedance along tangents to that along the normal: the higher, the less contacts creep."""
    noslip_iterations: int = 2
    """Iterations of the solver that removes slip after the main one."""

    def __post_init__(self) -> None:
        """Refuse what MuJoCo cannot simulate.

        Raises:
            GraspRefineError: names the field.
        """
        check_positive(self, "impratio")
        if self.noslip_iterations < 0:
            raise GraspRefineError(f"ContactModel: noslip_iterations must be at least 0, got {self.noslip_iterations}")


DEXGRASPBENCH_CONTACT = ContactModel()
"""Contacts of DexGraspBench."""

MUJOCO_CONTACT = ContactModel("pyramidal", impratio=1.0, noslip_iterations=0)
"""Contacts of a model that says nothing about them."""
