"""Opening of an upload: another object under the hand, another hand at the object, or other grasps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.geometry.mesh import Holes
from grasp_refine.geometry.shapes import EMBEDDED, primitive_pieces
from grasp_refine.geometry.units import NAMES, UNITS, Unit
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.grasps.rows import choose_rows
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.source import list_hands
from grasp_refine.objects.object import Object, load_object
from grasp_refine.pipeline.problem import Group, Problem
from grasp_refine.pipeline.recorded_objects import check_objects
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.convention_check import convention_notes
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.mesh_bounds import check_faces
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.unpacking import UploadError
from grasp_refine_apps.viewer.uploads import Upload

NUM_SAMPLED_GRASPS = 8
"""Number of grasps sampled for an uploaded hand."""
MAX_GRASPS = 20_000
"""Maximum grasps of an upload; each is listed, and measured unless its file has measures."""
MAX_OBJECTS = 32
"""Maximum objects and scales among them; each is loaded and decomposed into convex pieces."""

HOLE_LABELS: dict[Holes, str] = {"refuse": "refuse", "cap": "cap flat holes", "hull": "use convex hull"}
"""Treatments of holes, and their labels on the page."""


@dataclass(frozen=True)
class MeshOptions:
    """Options for reading a mesh."""

    unit: Unit | None = None
    """Unit of its numbers; None: metres, and an error if that is unlikely."""
    holes: Holes = "refuse"
    """Treatment of a mesh with holes."""


def open_upload(
    upload: Upload,
    scene: Scene,
    pose: Pose,
    *,
    options: MeshOptions | None = None,
    report: Callable[[str], None] = lambda line: None,
    check: Callable[[], None] = lambda: None,
) -> Problem:
    """Open an upload, and return its grasps.

    A mesh replaces the object, and the hand stays where it is; for a hand, grasps are sampled on the present object;
    grasps are opened with the hand and the objects that they name, or with the present ones. The table stays.

    Args:
        upload: The upload.
        scene: The present scene.
        pose: Pose of its hand.
        options: Options for reading a mesh; None: the defaults.
        report: Called with a description of each step.
        check: Called between steps; what it raises ends the opening.

    Raises:
        GraspRefineError: it cannot be read, or does not fit; the message names no folder of this machine.
    """
    try:
        if upload.kind == "mesh":
            return _with_object(upload, scene, pose, options or MeshOptions(), report)
        if upload.kind == "hand":
            return _with_hand(upload, scene, report, check)
        return _with_grasps(upload, scene, report, check)
    except GraspRefineError as error:
        raise UploadError(_for_uploader(str(error), upload)) from None


def _for_uploader(text: str, upload: Upload) -> str:
    """Rewrite a reader's error for the uploader, without folders of this machine and options of commands."""
    for path, name in ((upload.source, upload.name), (upload.folder, "")):
        text = text.replace(str(path) + "/", "").replace(str(path), name)
    if upload.kind == "mesh":
        for unit, words in NAMES.items():
            text = text.replace(f"--unit {unit} ", f'Mesh unit "{words}" ')
        for holes, words in HOLE_LABELS.items():
            text = text.replace(f"--holes {holes}", f'Mesh holes "{words}"')
        text = text.replace(", or another --scale", "")
    return text if text.startswith(upload.name) else f"{upload.name}: {text}"


def _with_object(
    upload: Upload, scene: Scene, pose: Pose, options: MeshOptions, report: Callable[[str], None]
) -> Problem:
    obj = load_object(upload.source, unit=options.unit, holes=options.holes, progress=report)
    check_faces(len(obj.mesh.faces), upload.name)
    scale = UNITS[options.unit or "m"]
    hand = scene.hand
    new = Scene(hand, obj, pose.T_object_root[None], pose.q[None], table=scene.table)
    grasps = GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.array([obj.name]),
        scale=np.array([scale]),
        hand_pose=pose_from_transform(new.T_world_root),
        q=new.q,
    )
    notes = tuple(f"{obj.name}: {note}" for note in obj.notes)
    return _problem(upload, hand, [(obj.name, scale, new, grasps, np.arange(1))], notes, sampled=True)


def _with_hand(upload: Upload, scene: Scene, report: Callable[[str], None], check: Callable[[], None]) -> Problem:
    hand, obj = load_hand(upload.source, progress=report), scene.object
    check()

    def progress(found: int, tried: int) -> None:
        check()
        report(f"sampling grasps: {found} found, of {tried} hands")

    grasps = sample_grasps(hand, obj, NUM_SAMPLED_GRASPS, table=scene.table, progress=progress)
    q, notes = match_joints(grasps, hand)
    new = Scene(hand, obj, transform_from_pose(grasps.hand_pose), q, table=scene.table)
    groups = [(obj.name, 1.0, new, grasps, np.arange(len(grasps)))]
    return _problem(upload, hand, groups, (*hand.notes, *notes), sampled=True)


def _with_grasps(upload: Upload, scene: Scene, report: Callable[[str], None], check: Callable[[], None]) -> Problem:
    present = scene.hand
    try:
        read = reading(upload.source, within=upload.folder)
    except GraspRefineError:
        # Files without joint names may fit several hands; the present one is assumed then.
        read = reading(upload.source, hand=present, within=upload.folder)
    grasps = read.grasps
    if len(grasps) > MAX_GRASPS:
        raise UploadError(f"{upload.name}: has {len(grasps)} grasps, more than {MAX_GRASPS}; upload a part of them")
    names = list(dict.fromkeys(grasps.object.tolist()))
    sizes = {*zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)}
    if len(sizes) > MAX_OBJECTS:
        raise UploadError(
            f"{upload.name}: has grasps on {len(sizes)} objects and scales, more than {MAX_OBJECTS}; upload a part"
        )
    hand = _hand_of(grasps, present, upload, report)
    check()
    q, notes = match_joints(grasps, hand)
    notes = (*read.notes, *hand.notes, *notes)
    groups = []
    for name in names:
        rows = choose_rows(grasps.object, object_name=name, index=None)
        for scale in np.unique(grasps.scale[rows]):
            check()
            at = rows[grasps.scale[rows] == scale]
            obj, note = _object_of(name, float(scale), scene.object, report)
            notes += (note,) if note else ()
            T = transform_from_pose(grasps.hand_pose[at])
            new = _with_targets(Scene(hand, obj, T, q[at], table=scene.table), grasps, at)
            groups.append((name, float(scale), new, grasps.select(at), at))
    doubts = convention_notes([group[2] for group in groups])
    problem = _problem(upload, hand, groups, (*notes, *doubts))
    objects = {(name, scale): new.object for name, scale, new, *_ in groups}
    others = (_for_uploader(note, upload) for note in check_objects(read.files, objects, other=True))
    files = tuple(dict.fromkeys((upload.source, *read.files)))
    return replace(problem, files=files, notes=(*problem.notes, *others))


def _hand_of(grasps: GraspSet, present: Hand, upload: Upload, report: Callable[[str], None]) -> Hand:
    """Return the hand that grasps name: the present one or an included one; a name is never taken as a path."""
    if grasps.hand == present.name:
        if grasps.base_link == present.base_link:
            return present
        urdf = None if present.toml is None else present.urdf
        return load_hand(present.toml or present.urdf, base_link=grasps.base_link, urdf=urdf, progress=report)
    if grasps.hand in list_hands():
        return load_hand(grasps.hand, base_link=grasps.base_link, progress=report)
    raise UploadError(
        f"{upload.name}: is for hand '{grasps.hand}', which is neither the present one ('{present.name}') nor one of "
        f"those included ({', '.join(list_hands())}): upload that hand first"
    )


def _object_of(name: str, scale: float, present: Object, report: Callable[[str], None]) -> tuple[Object, str]:
    """Return the object that grasps name, if it is included, else the present one; a name is never taken as a path."""
    if name in EMBEDDED or _is_primitive(name):
        return load_object(name, scale=scale, progress=report), ""
    if name == present.name:
        return present, ""
    return present, f"object '{name}' is unknown: its grasps are shown on '{present.name}'; upload its mesh"


def _is_primitive(name: str) -> bool:
    try:
        primitive_pieces(name)
    except MeshError:
        return False
    return True


def _with_targets(scene: Scene, grasps: GraspSet, rows: np.ndarray) -> Scene:
    """Return the scene with the targets of some rows of a file, one column per link of the scene."""
    if grasps.targets is None:
        return scene
    columns, points = list(scene.links), np.full((2, len(rows), len(scene.links), 3), np.nan)
    for k, link in enumerate(grasps.targets.links):
        if link not in columns:
            raise UploadError(f"target link '{link}' has no collision geometry; there are {', '.join(scene.links)}")
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at] = grasps.targets.point_link[rows, k]
        points[1, :, at] = grasps.targets.point_object[rows, k]
    return replace(scene, target_link=points[0], target_object=points[1])


def _problem(
    upload: Upload,
    hand: Hand,
    groups: list[tuple[str, float, Scene, GraspSet, np.ndarray]],
    notes: tuple[str, ...],
    *,
    sampled: bool = False,
) -> Problem:
    if not any(link.body is not None for link in hand.links):
        raise UploadError(f"{upload.name}: no link of hand '{hand.name}' has collision geometry: nothing can touch")
    made: list[Group] = []
    for name, scale, scene, grasps, rows in groups:
        same = np.sort(np.concatenate([entry[4] for entry in groups if entry[0] == name]))
        made.append(Group(name, scale, scene, grasps, rows, np.searchsorted(same, rows), rows))
    all_notes = tuple(dict.fromkeys([*upload.notes, *notes]))
    return Problem(hand, (upload.source,), tuple(made), all_notes, f"upload:{upload.name}" if sampled else "")
