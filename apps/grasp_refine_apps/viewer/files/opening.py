"""Opening of an upload: another object under the hand, another hand at the object, or other grasps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.mesh import SUFFIXES as MESH_SUFFIXES
from grasp_refine.geometry.mesh import Holes
from grasp_refine.geometry.units import NAMES, UNITS, Unit
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.hands.files.source import list_hands
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object, prepare
from grasp_refine.objects.source import needs_no_file
from grasp_refine.problem.problem import Group, Problem, scene_of
from grasp_refine.problem.recorded_objects import Recorded
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.convention_check import convention_notes
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.files.mesh_trial import try_meshes
from grasp_refine_apps.viewer.files.unpacking import UploadError
from grasp_refine_apps.viewer.files.uploads import Upload
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.pose import Pose

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
    scale: float = 1.0
    """Factor on its numbers, besides the unit."""


@dataclass(frozen=True)
class Opened:
    """Grasps of an upload."""

    problem: Problem
    """The grasps."""
    stand_ins: frozenset[str] = frozenset()
    """Names of the objects whose meshes are not known: their grasps are shown on another object."""
    attached: str = ""
    """Name of the object of the open grasps that an uploaded mesh was attached to; empty: none."""


def open_upload(
    upload: Upload,
    scene: Scene,
    pose: Pose,
    control: Control,
    options: MeshOptions | None = None,
    open_now: Opened | None = None,
) -> Opened:
    """Open an upload, and return its grasps.

    A mesh attaches to the open grasps that name it, if their object is not known; otherwise it replaces the object, and
    the hand stays where it is. For a hand, grasps are sampled on the present object. Grasps are opened with the hand
    and the objects that they name, with meshes of the same upload, or with the present ones. The table stays.

    Args:
        upload: The upload.
        scene: The present scene.
        pose: Pose of its hand.
        control: Receives a description of each step, and can stop the opening between steps.
        options: Options for reading a mesh; None: the defaults.
        open_now: The open grasps, to which a mesh may attach.

    Raises:
        GraspRefineError: it cannot be read, or does not fit; the message names no folder of this machine.
        Stopped: the job was stopped.
    """
    try:
        options = options or MeshOptions()
        if upload.kind == "mesh":
            missing = frozenset() if open_now is None else open_now.stand_ins
            name = next((name for name in sorted(missing) if _is_named(upload.source, name)), "")
            if open_now is not None and name:
                return _attached(upload, open_now, name, options, control)
            return Opened(_with_object(upload, scene, pose, options, control))
        if upload.kind == "hand":
            return Opened(_with_hand(upload, scene, control))
        return _with_grasps(upload, scene, options, control)
    except GraspRefineError as error:
        raise UploadError(_for_uploader(str(error), upload)) from None


def _for_uploader(text: str, upload: Upload) -> str:
    """Rewrite a reader's error for the uploader, without folders of this machine, in words of the page."""
    for path, name in ((upload.source, upload.name), (upload.folder, "")):
        text = text.replace(str(path) + "/", "").replace(str(path), name)
    if upload.kind == "mesh":
        for unit, words in NAMES.items():
            text = text.replace(f"`unit='{unit}'` ", f'Mesh unit "{words}" ')
        for holes, words in HOLE_LABELS.items():
            text = text.replace(f"`holes='{holes}'`", f'Mesh holes "{words}"')
        text = text.replace("another `scale`", "another Mesh scale")
        text = text.replace("`seen_from`", "seen-from of the command line")
    return text if text.startswith(upload.name) else f"{upload.name}: {text}"


def _with_object(upload: Upload, scene: Scene, pose: Pose, options: MeshOptions, control: Control) -> Problem:
    """Return the present grasp on an uploaded object."""
    obj = _load_mesh(upload, options.scale, options, control)
    scale = options.scale * UNITS[options.unit or "m"]
    grasps = GraspSet.of(scene.hand, pose.T_object_root[None], pose.q[None], object=obj.name, scale=scale)
    notes = [f"{obj.name}: {note}" for note in obj.notes]
    return _problem(upload, scene, scene.hand, grasps, {(obj.name, scale): obj}, notes, sampled=True)


def _attached(upload: Upload, open_now: Opened, name: str, options: MeshOptions, control: Control) -> Opened:
    """Return the open grasps with an uploaded mesh as the object of grasps that name it."""
    problem, groups, notes = open_now.problem, [], []
    for group in problem.groups:
        if group.object == name:
            scale = group.scale * options.scale
            obj = _load_mesh(upload, scale, options, control)
            notes += [f"{name}: {note}" for note in obj.notes]
            scale *= UNITS[options.unit or "m"]
            group = replace(group.on(obj), scale=scale)
        groups.append(group)
    others = [note for note in problem.notes if not note.startswith(_stand_in_note(name))]
    doubts = [note for note in convention_notes([group.scene for group in groups]) if note not in others]
    changed = replace(problem, groups=tuple(groups), notes=tuple(dict.fromkeys([*others, *notes, *doubts])))
    return Opened(changed, open_now.stand_ins - {name}, name)


def _load_mesh(upload: Upload, scale: float, options: MeshOptions, control: Control) -> Object:
    """Load and decompose the mesh of an upload, `scale` from its unit to metres as grasp files have it."""
    obj = load_object(upload.source, scale=scale, unit=options.unit, holes=options.holes)
    prepare([obj], progress=control.describe)
    return obj


def _is_named(path: Path, name: str) -> bool:
    """Return whether a mesh has the name of an object, apart from case, folders and signs."""
    names = {_plain(name), _plain(PurePosixPath(name).name), _plain(PurePosixPath(name).stem)}
    return bool(names & {_plain(path.stem), _plain(path.parent.name)} - {""})


def _plain(name: str) -> str:
    """Return the letters and digits of a name."""
    return "".join(char for char in name.casefold() if char.isalnum())


def _with_hand(upload: Upload, scene: Scene, control: Control) -> Problem:
    """Return sampled grasps of an uploaded hand on the present object."""
    hand, obj = load_hand(upload.source, progress=control.describe), scene.object
    control.check()

    def progress(found: int, tried: int) -> None:
        control.check()
        control.describe(f"sampling grasps: {found} found, of {tried} hands")

    grasps = sample_grasps(hand, obj, NUM_SAMPLED_GRASPS, task=scene.task, progress=progress)
    grasps = replace(grasps, object=np.full(len(grasps), obj.name), scale=np.ones(len(grasps)))
    return _problem(upload, scene, hand, grasps, {(obj.name, 1.0): obj}, hand.notes, sampled=True)


def _with_grasps(upload: Upload, scene: Scene, options: MeshOptions, control: Control) -> Opened:
    """Return uploaded grasps of the hand and on the objects that they name."""
    try:
        read = reading(upload.source, within=upload.folder)
    except GraspRefineError:
        # Files without joint names may fit several hands; the present one is assumed then.
        read = reading(upload.source, hand=scene.hand, within=upload.folder)
    grasps = read.grasps
    if len(grasps) > MAX_GRASPS:
        raise UploadError(f"{upload.name}: has {len(grasps)} grasps, more than {MAX_GRASPS}; upload a part of them")
    named = list(dict.fromkeys(grasps.object.tolist()))
    keys = sorted({*zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)}, key=lambda key: key[1])
    if len(keys) > MAX_OBJECTS:
        raise UploadError(
            f"{upload.name}: has grasps on {len(keys)} objects and scales, more than {MAX_OBJECTS}; upload a part"
        )
    hand = _hand_of(grasps, scene.hand, upload, control)
    notes, stand_ins = [*read.notes, *hand.notes], set()
    objects: dict[tuple[str, float], Object] = {}
    first = grasps.object[0], grasps.scale[0]
    meshes = [path for path in sorted(upload.folder.rglob("*")) if path.suffix.lower() in MESH_SUFFIXES]
    for name, scale in sorted(keys, key=lambda key: named.index(key[0])):
        control.check()
        mesh = next((path for path in meshes if _is_named(path, name)), None)
        if needs_no_file(name):
            objects[name, scale] = load_object(name, scale=scale)
        elif mesh is not None:
            try_meshes([mesh], upload.folder, upload.name)
            known = load_object(mesh, scale=scale, unit=options.unit, holes=options.holes)
            objects[name, scale] = known.as_hull() if (name, scale) != first and known.takes_long else known
        else:
            # A name is never taken as a path.
            objects[name, scale] = scene.object
            if name != scene.object.name:
                stand_ins.add(name)
                notes.append(f"{_stand_in_note(name)} '{scene.object.name}'; upload its mesh")
    prepare(objects.values(), progress=control.describe)
    problem = _problem(upload, scene, hand, grasps, objects, notes)
    doubts = convention_notes([group.scene for group in problem.groups])
    others = (_for_uploader(note, upload) for note in Recorded.of(read.files).check_objects(problem.groups, other=True))
    files = tuple(dict.fromkeys((upload.source, *read.files)))
    found = replace(problem, files=files, notes=tuple(dict.fromkeys((*problem.notes, *doubts, *others))))
    return Opened(found, frozenset(stand_ins))


def _stand_in_note(name: str) -> str:
    """Beginning of the note on an object that is not known."""
    return f"object '{name}' is unknown: its grasps are shown on"


def _hand_of(grasps: GraspSet, present: Hand, upload: Upload, control: Control) -> Hand:
    """Return the hand that grasps name: the present one or an included one; a name is never taken as a path."""
    if grasps.hand == present.name:
        if grasps.base_link == present.base_link:
            return present
        urdf = None if present.toml is None else present.urdf
        return load_hand(present.toml or present.urdf, base_link=grasps.base_link, urdf=urdf, progress=control.describe)
    if grasps.hand in list_hands():
        return load_hand(grasps.hand, base_link=grasps.base_link, progress=control.describe)
    raise UploadError(
        f"{upload.name}: is for hand '{grasps.hand}', which is neither the present one ('{present.name}') nor one of "
        f"the included ones ({', '.join(list_hands())}): upload that hand first"
    )


def _problem(
    upload: Upload,
    scene: Scene,
    hand: Hand,
    grasps: GraspSet,
    objects: Mapping[tuple[str, float], Object],
    notes: Sequence[str],
    *,
    sampled: bool = False,
) -> Problem:
    """Return grasps with the objects of their names and scales, in the surroundings of the present scene."""
    if not any(link.body is not None for link in hand.links):
        raise UploadError(f"{upload.name}: no link of hand '{hand.name}' has collision geometry: nothing can touch")
    q, joint_notes = match_joints(grasps, hand)
    groups = []
    for (name, scale), obj in objects.items():
        of_object = np.flatnonzero(grasps.object == name)
        rows = of_object[grasps.scale[of_object] == scale]
        some = grasps.select(rows)
        task = scene.task if obj is scene.object else replace(scene.task, touch=(), avoid=())
        new = scene_of(hand, obj, some, q[rows], task)
        groups.append(Group(name, scale, new, some, rows, np.searchsorted(of_object, rows), rows))
    all_notes = tuple(dict.fromkeys([*upload.notes, *notes, *joint_notes]))
    return Problem(hand, (upload.source,), tuple(groups), all_notes, f"upload:{upload.name}" if sampled else "")
