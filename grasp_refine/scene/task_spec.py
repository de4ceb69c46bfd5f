"""Specification of a task by names, files and numbers: keys of options and jobs, one for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.objects.region import Region
from grasp_refine.objects.region_spec import check_specs
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.registry import default_protocol
from grasp_refine.scene.scene_file import load_scene, scene_object
from grasp_refine.scene.task import FIELDS, Task
from grasp_refine.scene.task_file import task_fields

NO_SCENE = "none"
"""Value of `scene` for no scene."""


@dataclass(frozen=True)
class TaskSpec:
    """A task by names, files and numbers; what is said of `task` counts where nothing else is."""

    task: str | Task | None = None
    """Task of the grasps: a protocol, a scene, a TOML file of protocol, table, scene, base, touch and
    avoid, or a result file, for whose task its grasps were refined. All of it can be changed by the options below."""
    protocol: str | Protocol | None = None
    """Test in simulation, or a TOML file of your own."""
    friction: float | None = None
    """Coefficient of sliding friction in simulation; torsional friction is scaled in proportion."""
    mass: float | None = None
    """Mass of the object in simulation, kg."""
    table: float | Plane | None = None
    """Height (metres) of a table in the object's frame, z up, that no link may go through."""
    scene: str | Environment | None = None
    """Scene in which the object is grasped: a name that `refine-grasp scenes` lists, or a TOML file; none: the object
    alone, also for results that were refined in a scene."""
    base: str | tuple[float, ...] | tuple[tuple[float, ...], ...] | None = None
    """Pose of the arm's base link in the object's frame, or in the world of `scene`: x,y,z,roll,pitch,yaw (metres,
    degrees)."""
    touch: tuple[str | Region, ...] = ()
    """Region of the object that links should touch, in its frame and metres; again for several: box:x0,y0,z0,x1,y1,z1,
    above:z=0.05, below:z=0.05, plane:x,y,z,nx,ny,nz (the side to which the normal points), faces:FILE (numbers of faces
    of the mesh), color:#ff0000 (of its faces or vertices). By default that of the scene, else everywhere."""
    avoid: tuple[str | Region, ...] = ()
    """Region of the object that no link should touch, as `touch`."""

    def with_named_task(self) -> Any:
        """Return the specification with the fields of its `task` where it has none itself, and no `task`.

        Raises:
            GraspRefineError: there is no such task.
        """
        if self.task is None:
            return self
        known = task_fields(self.task) if isinstance(self.task, str) else vars(self.task)
        said = {name: value for name in FIELDS if (value := known.get(name)) is not None}
        if self.table is not None or self.in_scene:
            # A table replaces a scene, and a scene a table.
            said = {name: value for name, value in said.items() if name not in ("table", "scene")}
        return replace(self, task=None, **{n: value for n, value in said.items() if getattr(self, n) in (None, ())})

    def check_task(self) -> None:
        """Refuse fields that are wrong for any object.

        Raises:
            GraspRefineError: names the field.
        """
        if isinstance(self.table, float | int) and not -inf < self.table < inf:
            raise GraspRefineError(f"`table` must be a height in metres, got {self.table:g}")
        if self.table is not None and self.scene not in (None, NO_SCENE):
            raise GraspRefineError("`table` and `scene` exclude each other: a scene has its own tables")
        for name in ("friction", "mass"):
            value = getattr(self, name)
            if value is not None and not 0 < value < inf:
                raise GraspRefineError(f"`{name}` must be above 0, got {value:g}")
        if isinstance(self.base, str):
            read_pose(self.base, "`base`")
        check_specs(*([one for one in several if isinstance(one, str)] for several in (self.touch, self.avoid)))

    @property
    def in_scene(self) -> bool:
        """Whether there are bodies around the object."""
        return self.scene not in (None, NO_SCENE)

    def chosen_protocol(self, *, in_scene: bool) -> Protocol | None:
        """Return the protocol, with its changes; None: neither a protocol nor a change of one is named."""
        named = load_protocol(self.protocol) if isinstance(self.protocol, str) else self.protocol
        if named is None and self.friction is None and self.mass is None:
            return None
        chosen = named or default_protocol(in_scene=in_scene)
        return chosen.with_friction(self.friction).with_mass(self.mass)

    def read_task(self, load: Callable[[str], Environment] = load_scene) -> Task:
        """Return the task.

        Args:
            load: Returns the scene of a name or file.

        Raises:
            GraspRefineError: something of it cannot be read or used.
        """
        spec: TaskSpec = self.with_named_task()
        spec.check_task()
        around = None if not spec.in_scene else spec.scene
        return Task(
            protocol=spec.chosen_protocol(in_scene=spec.in_scene),
            table=spec.table,
            scene=load(around) if isinstance(around, str) else around,
            base=read_pose(spec.base, "`base`") if isinstance(spec.base, str) else spec.base,
            touch=spec.touch or None,
            avoid=spec.avoid or None,
        )

    def scene_object(self) -> tuple[str | None, float]:
        """Return the object that is grasped in the scene and the factor of its mesh; no body is loaded."""
        if not self.in_scene or self.scene is None:
            return None, 1.0
        return (
            (self.scene.object, self.scene.scale) if isinstance(self.scene, Environment) else scene_object(self.scene)
        )
