"""Task of grasps: what they must do, and where; refinement, simulation and all that follows take it whole."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import inverse, is_rigid
from grasp_refine.objects.region import ContactRegions, Region
from grasp_refine.objects.region_spec import Regions, contact_regions
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.registry import default_protocol
from grasp_refine.scene.scene_file import load_scene

if TYPE_CHECKING:
    from grasp_refine.objects.object import Object


@dataclass(frozen=True)
class Task:
    """Task of grasps: requirements and surroundings.

    Fields may be given by name: `Task("strict", table=0.0)`, `Task(scene="mug-on-table")`.
    """

    protocol: Protocol | str | Path | None = None
    """Test in simulation: pushes or a lift, mass or density, friction, contacts, noise; or its name or TOML file. None:
    `scene` in a scene, else `dexgraspbench`."""
    table: Plane | float | None = None
    """Plane that no link may go through; a number is its height in metres in the object's frame, z up. In a scene, the
    object is lifted off the bodies of the scene instead."""
    scene: Environment | str | Path | None = None
    """Bodies around the object that no link may go into; or the name or TOML file of a scene."""
    base: ArrayLike | None = None
    """Pose of the base of a hand's arm in the object's frame, or in the world of the scene: (4, 4), or x, y, z in
    metres, or x, y, z, roll, pitch, yaw with angles in degrees. Kept as a tuple."""
    touch: Regions | None = None
    """Regions of the object in which links should touch it, or their specifications. None: the scene's."""
    avoid: Regions | None = None
    """Regions of the object in which links should not touch it. None: the scene's."""

    def __post_init__(self) -> None:
        """Load names, and refuse invalid values.

        Raises:
            GraspRefineError: names the field.
        """
        found: dict[str, Any] = {}
        if isinstance(self.protocol, str | Path):
            found["protocol"] = load_protocol(str(self.protocol))
        if isinstance(self.scene, str | Path):
            found["scene"] = load_scene(self.scene)
        if isinstance(self.table, int | float | np.number) and not isinstance(self.table, bool):
            if not np.isfinite(self.table):
                raise GraspRefineError(f"Task: table must be a finite height in metres, got {self.table:g}")
            found["table"] = Plane(offset=float(self.table))
        if self.base is not None:
            pose = as_numbers("Task: base", self.base)
            _base_transform(pose)
            found["base"] = tuple(map(tuple, pose.tolist())) if pose.ndim == 2 else tuple(pose.tolist())
        for name in ("touch", "avoid"):
            regions = getattr(self, name)
            if regions is not None:
                found[name] = (regions,) if isinstance(regions, str | Region) else tuple(regions)
                check_kind(f"Task: {name}", found[name], tuple[str | Region, ...])
        for name, value in found.items():
            object.__setattr__(self, name, value)
        check_kind("Task: protocol", self.protocol, Protocol | None)
        check_kind("Task: table", self.table, Plane | None)
        check_kind("Task: scene", self.scene, Environment | None)

    @property
    def plane(self) -> Plane | None:
        """Plane of the table; None: there is none."""
        assert not isinstance(self.table, int | float)
        return self.table

    def plane_under(self, obj: Object) -> Plane | None:
        """Return the plane of the table; where an object is lifted off a table at no given height, the plane below it.

        The latter touches the object from below, z up in its frame.
        """
        lifted = self.environment is None and self.test(patches=False).tabletop
        if self.plane is not None or not lifted:
            return self.plane
        return Plane(offset=float(min(piece.bounds[0, 2] for piece in obj.body.pieces)))

    @property
    def environment(self) -> Environment | None:
        """Bodies around the object; None: there are none."""
        assert not isinstance(self.scene, str | Path)
        return self.scene

    @property
    def named_protocol(self) -> Protocol | None:
        """Protocol that the task names; None: it names none."""
        assert not isinstance(self.protocol, str | Path)
        return self.protocol

    def test(self, *, patches: bool) -> Protocol:
        """Return the protocol of the simulation for a hand that touches in patches, or in points."""
        return (self.named_protocol or default_protocol(in_scene=self.scene is not None)).for_contacts(patches)

    @cached_property
    def T_object_base(self) -> Float[np.ndarray, "4 4"]:
        """Pose (4, 4) of the base of an arm in the object's frame; where none is given, at the origin that it is in."""
        T = np.eye(4) if self.base is None else _base_transform(np.array(self.base))
        return T if self.environment is None else inverse(self.environment.T_world_object) @ T

    @cached_property
    def regions(self) -> ContactRegions | None:
        """Regions of a task that is `on` an object; None: links may touch it everywhere."""
        assert self.is_on_object, "the regions of a task must be made for an object: task.on(obj)"
        return ContactRegions(self.touch, self.avoid) if self.touch or self.avoid else None  # type: ignore[arg-type]

    @property
    def is_on_object(self) -> bool:
        """Whether the regions are made for an object, including the scene's: no specifications."""
        regions = self.touch, self.avoid
        return all(isinstance(some, tuple) and all(isinstance(one, Region) for one in some) for some in regions)

    def on(self, obj: Object) -> Task:
        """Return the task with its regions made for an object, and with the scene's where it names none.

        Without a table and a scene, the table that a scan of the object shows is that of the task.

        Raises:
            GraspRefineError: a region cannot be used, or holds none of the object's surface.
        """
        around = self.environment
        touch, avoid = (
            own if own is not None else () if around is None else getattr(around, name)
            for name, own in (("touch", self.touch), ("avoid", self.avoid))
        )
        found = contact_regions(obj, touch, avoid) or ContactRegions()
        seen = obj.scan.table if obj.scan is not None and self.table is None and around is None else None
        table = self.table if seen is None else Plane(tuple(seen[1].tolist()), float(seen[0] @ seen[1]))
        return replace(self, table=table, touch=found.touch, avoid=found.avoid)

    @property
    def for_simulation(self) -> Task:
        """The task with the fields that a simulated world depends on, and no others."""
        return replace(self, base=None, touch=(), avoid=())

    def over(self, other: Task) -> Task:
        """Return the fields that this task names, and the fields of another task where it names none."""
        values = {name: getattr(self, name) for name in FIELDS}
        if values["table"] is not None or values["scene"] is not None:
            # A table replaces a scene, and a scene a table.
            other = replace(other, table=None, scene=None)
        return replace(other, **{name: value for name, value in values.items() if value is not None})

    def __repr__(self) -> str:
        parts = [] if self.named_protocol is None else [self.named_protocol.label]
        parts += [] if self.plane is None else [f"table at {self.plane.offset:g} m"]
        parts += [] if self.environment is None else [repr(self.environment)]
        parts += [] if self.base is None else ["with the base of an arm"]
        for name, regions in (("touch", self.touch), ("avoid", self.avoid)):
            specs = [one if isinstance(one, str) else one.spec for one in regions or ()]  # type: ignore[union-attr]
            parts += [f"{name} {', '.join(specs)}"] if specs else []
        return f"Task({'; '.join(parts)})"


FIELDS = tuple(one.name for one in fields(Task))
"""Names of the fields of a task."""


def _base_transform(pose: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """Return the pose (4, 4) of a base that is a transform, or x, y, z (m), roll, pitch, yaw (degrees).

    Raises:
        GraspRefineError: it is neither.
    """
    if pose.shape == (4, 4) and is_rigid(pose):
        return pose
    if pose.shape not in ((3,), (6,)):
        raise GraspRefineError("base must be a rigid transform (4, 4), or x, y, z (m), roll, pitch, yaw (degrees)")
    return transform_from_rpy(pose.tolist())
