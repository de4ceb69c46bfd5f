"""Specification of a problem: hand, object and grasps, by names and files."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import read_pose
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import Holes
from grasp_refine.geometry.units import UNITS, Unit
from grasp_refine.hands.files.link_geometry import HULL_LIMIT
from grasp_refine.objects.seen import HYPOTHESES
from grasp_refine.scene.task_spec import TaskSpec

AUTO, NEAREST = "auto", "nearest"
"""Values of `targets`: targets of the grasp file, if any; or the points where links are nearest to the object."""

SAMPLE = "sample:"
"""Prefix of `grasps` for sampled grasps instead of a file, as in sample:32."""

PATHS = ("urdf", "mjcf", "objects", "grasps", "mask", "completions")
"""Fields that are kept as `Path`."""

NAMES_OR_PATHS = (
    *("hand", "transfer_from", "arm", "object", "targets", "task", "protocol", "scene"),
    *("camera", "intrinsics"),
)
"""Fields that are names, or paths if they cannot be names; kept as text."""


@dataclass(frozen=True)
class HandSpec:
    """Reading of a hand: its files, and what is taken of them."""

    urdf: Path | None = None
    """Another URDF for the hand, with the same names of joints and links; needed where a hand comes without one."""
    mjcf: Path | None = None
    """The hand as another MJCF file, or an asset such as shadow_mjcf, which is then simulated."""
    collision: Literal["visual"] | None = None
    """Geometry with which links of a URDF collide: visual, the geometry that they show, where they have no other. By
    default their collision geometry, or what the hand.toml says."""
    follower_limits: Literal["own", "leader"] | None = None
    """Limits of joints that follow others (mimic): their own, or leader, the ones that follow from the other joint, for
    files whose signs contradict the limits. By default what the hand.toml says, else their own."""
    base_link: str | None = None
    """Base link of the hand; joints above it do not move. By default the base of the grasp file or the hand.toml, else
    the palm of a hand on an arm, else the root."""
    hull_limit: float = HULL_LIMIT
    """Largest distance (metres) by which the convex hull of a link's mesh may stand out of it; beyond it the mesh is
    split into its bodies, or cut. inf: hulls only."""


@dataclass(frozen=True)
class ScanSpec:
    """Reading of an object that was only seen: its sensors, and the solids that it may be."""

    seen_from: tuple[str, ...] = ()
    """Position x,y,z (metres) of the sensor that saw a point cloud or an open mesh, in its frame; again for several.
    By default what the file says."""
    camera: str | None = None
    """Pose of the camera in the object's frame: x,y,z,roll,pitch,yaw (metres, degrees), or a file of the matrix (4, 4):
    .npy, .json or text. Its axes are OpenCV's: x right, y down, z forward. By default the object's frame is the frame
    of the cloud, or of the camera of a depth picture."""
    intrinsics: str | None = None
    """Camera of a depth picture: fx,fy,cx,cy (pixels), or a file of them or of the matrix: .json, .yaml, .npy or text.
    By default what the file says."""
    mask: Path | None = None
    """Picture of the size of a depth picture, black where that does not show the object. By default none."""
    hypotheses: int = HYPOTHESES
    """Number of solids that a scanned object may be, over which grasps are refined."""
    completions: Path | None = None
    """Folder of completed meshes of a scan by another program, which replace the hypotheses; weights.toml in it may
    have lines mesh = weight. By default none."""

    def scan_arguments(self) -> dict[str, Any]:
        """Return the arguments that are given here of the function that loads an object."""
        given = {one.name: getattr(self, one.name) for one in fields(ScanSpec)}
        return {name: value for name, value in given.items() if value != getattr(ScanSpec, name)}


@dataclass(frozen=True)
class SourceSpec(ScanSpec, HandSpec, TaskSpec):
    """Hand, objects and task of grasps whose file is given elsewhere."""

    hand: str | None = None
    """Hand: a name that `refine-grasp hands` lists, a folder with a hand.toml or one URDF or MJCF, a URDF or MJCF file,
    an asset such as hands/leap, or robot_descriptions/NAME. By default the hand of the grasp file."""
    transfer_from: str | None = None
    """Hand of the grasp file, named like `hand`, where its grasps are to be transferred to `hand`: its fingers touch
    where the fingers of that hand do, and come from the same side. mano: a human hand, whose file has 21 key points
    (N, 21, 3) or MANO's vertices (N, 778, 3) in the object's frame, metres: an .npy, or an .npz with key_points or
    vertices, and object and scale."""
    arm: str | None = None
    """Arm that carries the hand, and whose base stands still: ur5e, or a URDF, MJCF, folder or asset, as for a hand.
    Where the hand's own file has the arm, `base` alone. By default none: the hand floats."""
    mount: str | None = None
    """Link of the arm that the hand is mounted on. By default the link in its arm.toml, else its last link."""
    mount_pose: str | None = None
    """Pose of the hand's base link in that link: x,y,z,roll,pitch,yaw (metres, degrees). By default the pose in the
    hand's hand.toml (flange), else the same frame."""
    object: str | None = None
    """Object: an embedded one (mug, bottle, bowl, rounded_box), box:x,y,z, sphere:r, cylinder:r,h, a mesh file, a
    folder of convex pieces, an asset such as ycb/011_banana, or a scan: a point cloud (.ply, .pcd, .xyz, .npz) or a
    depth picture (.png, .npy, .npz). By default the object of the grasp file."""
    object_name: str | None = None
    """Name of the object in the grasp file; needed where it holds several."""
    objects: Path | None = None
    """All objects of the grasp file: a folder of meshes, or of folders of pieces, named like them, or a TOML file of
    lines name = "path"."""
    scale: float = 1.0
    """Factor on the scale of the mesh in the grasp file, which is 1 for sampled grasps."""
    unit: Unit | None = None
    """Unit of the object's mesh after scaling. By default metres, asked about where that is unlikely."""
    holes: Holes = "refuse"
    """Treatment of an object's mesh with holes: an error, flat caps on flat holes, or its convex hull."""
    format: str | None = None
    """Format of the grasp file, or of the files in the folder; the help of `refine-grasp convert` describes them. By
    default it is detected."""
    index: tuple[int, ...] = ()
    """Numbers of the grasps of each object; 0 is its first one in the file. By default all."""
    threshold: float = Decomposition.threshold
    """Largest concavity, 0.01 to 1, of the pieces that CoACD cuts a concave object into; lower is finer."""
    other_object: bool = False
    """Whether to accept results that were refined on another object, or on the same one in another size, or in another
    scene."""
    as_is: bool = False
    """Whether to accept grasps that are most likely in other units, quaternions or frames than their format's,
    such as joint values in degrees."""

    def __post_init__(self) -> None:
        """Take names and paths as text or as `Path`, and lists for tuples.

        Raises:
            GraspRefineError: a field of another type.
        """
        for name in PATHS:
            if isinstance(value := getattr(self, name, None), str):
                object.__setattr__(self, name, Path(value))
        for name in NAMES_OR_PATHS:
            if isinstance(value := getattr(self, name, None), Path):
                object.__setattr__(self, name, str(value))
        check_fields(self)

    def check(self) -> None:
        """Refuse an invalid scale, hull limit, pose or task, and fields of an arm that have no meaning alone.

        Raises:
            GraspRefineError: names the field.
        """
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise GraspRefineError(f"`scale` must be positive and finite, got {self.scale:g}")
        check_hull_limit(self.hull_limit)
        self.check_task()
        if self.transfer_from is not None and self.hand is None:
            raise GraspRefineError(
                f"`transfer_from='{self.transfer_from}'`: needs the hand that the grasps are transferred to, `hand`"
            )
        for name, value in (("mount", self.mount), ("mount_pose", self.mount_pose)):
            if value is not None and self.arm is None:
                raise GraspRefineError(f"`{name}='{value}'`: needs the arm that carries the hand, `arm`")
        if self.mount_pose is not None:
            read_pose(self.mount_pose, "`mount_pose`")

    def with_named_task(self) -> Any:
        """Return the specification with the fields of its `task`, as a `SourceSpec` or `ProblemSpec` itself.

        Subclasses with options may have other types of fields.
        """
        kind = ProblemSpec if isinstance(self, ProblemSpec) else SourceSpec
        return TaskSpec.with_named_task(kind(**{one.name: getattr(self, one.name) for one in fields(kind)}))

    @property
    def stands(self) -> bool:
        """Whether the hand's own file has the arm, from whose base on it is read."""
        return self.base is not None and self.arm is None

    @property
    def grasp_hand(self) -> str | None:
        """Hand of the grasp file; None: as the file says."""
        return self.hand if self.transfer_from is None else self.transfer_from

    def of_source(self) -> Any:
        """Return the specification of the grasps that are to be transferred, as of their own hand."""
        own = {name: getattr(HandSpec, name) for name in HandSpec.__dataclass_fields__}
        own |= dict.fromkeys(("transfer_from", "arm", "mount", "mount_pose", "base"))
        return replace(self, **own, hand=self.transfer_from)

    def metres(self, scale: float) -> float:
        """Return the factor that takes a mesh to metres, where `scale` takes it to its unit."""
        return float(scale) * UNITS[self.unit or "m"]

    def of(self, grasps: Path) -> ProblemSpec:
        """Return the specification of the grasps in a file."""
        return ProblemSpec(**{name: getattr(self, name) for name in SourceSpec.__dataclass_fields__}, grasps=grasps)


@dataclass(frozen=True)
class ProblemSpec(SourceSpec):
    """Hand, object and grasps to refine."""

    grasps: Path | None = None
    """Grasp file, or a folder of them: ours (.npz), or of another program (see `format`); hf://OWNER/NAME[/PATH] of
    the Hugging Face Hub; or sample:N, as in sample:32, for N new grasps of `hand` on `object`, which `seed` varies."""
    targets: str = AUTO
    """Target points of links: a grasp file with targets; auto: the targets of `grasps`, else anywhere; or nearest: the
    points where they are nearest to the object at first."""


def check_hull_limit(metres: float) -> None:
    """Refuse a hull limit in metres that is not above 0; infinite: no limit.

    Raises:
        GraspRefineError: it is not above 0.
    """
    if not metres > 0:
        raise GraspRefineError(f"`hull_limit` must be above 0 metres, or inf, got {metres:g}")
