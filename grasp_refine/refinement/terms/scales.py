"""Movements of equal cost."""

from dataclasses import dataclass

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError


@dataclass(frozen=True)
class Scales:
    """Movements of equal cost."""

    translation: float = 0.01
    """Translation of the root, in metres."""
    rotation: float = 0.1
    """Rotation of the root, in radians."""
    joints: float = 0.15
    """Movement of a joint, in radians; of a prismatic joint, 0.1 m per radian."""

    def __post_init__(self) -> None:
        """Refuse scales that are not positive.

        Raises:
            GraspRefineError: a scale is not above 0.
        """
        check_fields(self)
        for name in ("translation", "rotation", "joints"):
            if not getattr(self, name) > 0.0:
                raise GraspRefineError(f"scales: {name} must be above 0, got {getattr(self, name):g}")
