"""Export of the shown grasp as a file of any format, for the browser to download."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from grasp_refine.closing.motion import Motion, closing_motion, motion_of
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.formats.agreement import DisagreementError, check_agreement
from grasp_refine.grasps.formats.folders import natural, object_folder
from grasp_refine.grasps.formats.format import Format, Load, Part
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.writing import written
from grasp_refine.grasps.grasp_set import OTHER_STAGES, ContactLinks, GraspSet, Stage
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine_apps.viewer.jobs.batches import batches
from grasp_refine_apps.viewer.meters.meter import counted_in
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.pose import Pose, Target, file_targets, file_targets_of, posed_scene
from grasp_refine_apps.viewer.model.work import Work

CANDIDATES_PER_LINK = 16
"""Surface points per link; unused here."""

MAX_STEM_BYTES = 120
"""Maximum bytes of a file's name before its suffix; file systems take 255."""


@dataclass(frozen=True)
class Saved:
    """File for download."""

    name: str
    """Name of the file."""
    content: bytes
    """Content of the file."""
    notes: tuple[str, ...] = ()
    """Notes on what the format could not hold."""


def grasp_set(
    scene: Scene,
    pose: Pose,
    name: str,
    scale: float,
    targets: Sequence[Target] = (),
    prepared: HandObject | None = None,
    counted: Counted | None = None,
) -> GraspSet:
    """Return one grasp with our own pregrasp and squeeze: it may have been edited or refined since it was read.

    Args:
        scene: Hand, object and table.
        pose: Pose of the hand.
        name: Name of the object in the grasp file.
        scale: Factor from the units of the object's mesh to metres.
        targets: Target points of links on the object; empty: none are written.
        prepared: Prepared hand and object; None: built here.
        counted: Contact links, which are recorded; None: none are.

    Raises:
        GraspFileError: the pose or the joint values are not finite.
    """
    if not pose.posed:
        raise GraspFileError("the shown grasp is not finite, so no file can hold it: reset it first")
    motion = closing_motion(posed_scene(scene, pose), prepared)
    opened, grasp, pressing = (
        Stage(pose_from_transform(motion.T_world_root[:, stage]), motion.q[:, stage]) for stage in range(3)
    )
    alone = GraspSet.of(scene.hand, grasp.pose, grasp.q, object=name, scale=float(scale))
    links = _contact_links(scene.hand, [counted])
    return replace(alone, targets=file_targets(targets), pregrasp=opened, squeeze=pressing, contact_links=links)


def grasp_sets(
    collection: Collection,
    works: Mapping[int, Work],
    report: Callable[[float], None] = lambda share: None,
    check: Callable[[], None] = lambda: None,
) -> GraspSet:
    """Return several grasps as they stand, in order, with pregrasps and squeezes.

    They come from the refinement of a grasp, from its file where it was not moved, or are generated.

    Args:
        collection: The grasps as in their files.
        works: Works to return, by number.
        report: Called with the completed share, 0 to 1.
        check: Called often; its exceptions end the work.

    Raises:
        GraspFileError: a pose or joint values are not finite.
    """
    hand = collection.hand
    poses = {number: work.standing for number, work in works.items()}
    bad = [collection.label(number) for number, pose in poses.items() if not pose.posed]
    if bad:
        raise GraspFileError(f"{', '.join(bad[:5])}: not finite, so no file can hold them: reset or leave them out")
    stages = _known_stages(collection, works)
    for batch in batches(collection, {number: work for number, work in works.items() if number not in stages}):
        check()
        report(len(stages) / len(works))
        own = closing_motion(batch.group.scene, HandObject.of(batch.group.scene), lambda *done: check())
        for i, number in enumerate(batch.numbers):
            stages[number] = pose_from_transform(own.T_world_root[i]), own.q[i]
    numbers = list(works)
    pose = pose_from_transform(np.stack([poses[number].T_object_root for number in numbers]))
    all_poses, all_q = (np.stack([stages[number][part] for number in numbers]) for part in (0, 1))
    found = GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.array([collection.group(number).object for number in numbers]),
        scale=np.array([collection.group(number).scale for number in numbers]),
        hand_pose=pose,
        q=np.stack([poses[number].q for number in numbers]),
        targets=file_targets_of([works[number].targets for number in numbers]),
        pregrasp=Stage(all_poses[:, 0], all_q[:, 0]),
        squeeze=Stage(all_poses[:, -1], all_q[:, -1]),
        contact_links=_contact_links(hand, [counted_in(works[number]) for number in numbers]),
    )
    return found


def _contact_links(hand: Hand, counted: Sequence[Counted | None]) -> ContactLinks | None:
    """Return the contact links of grasps for a file, not the links that an iteration closes; None: there are none."""
    links = links_of(hand)
    none = np.full(len(links), np.nan)
    gap = np.stack([none if one is None or one.iteration else one.gap for one in counted])
    return None if np.isnan(gap).all() else ContactLinks.of(links, gap)


def _known_stages(collection: Collection, works: Mapping[int, Work]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Poses (S, 7) and joint values (S, n) of all stages, by number, where refinements or files have them."""
    found = {}
    of_file: dict[int, Motion] = {}
    for number, work in works.items():
        at = int(collection.group_of[number])
        group = collection.problem.groups[at]
        if work.outcome is not None and work.standing is work.pose:
            found[number] = work.outcome.stage_pose[0], work.outcome.stage_q[0]
        elif not work.changed and work.standing is work.pose and len(group.grasps.other_stages) == len(OTHER_STAGES):
            if at not in of_file:
                of_file[at] = motion_of(group.grasps, collection.hand)
            row = collection.member[number]
            found[number] = pose_from_transform(of_file[at].T_world_root[row]), of_file[at].q[row]
    return found


def grasp_file(hand: Hand, grasps: GraspSet, format_name: str, number: str = "") -> Saved:
    """Return grasps as a file of a format; formats that are folders of files become a .zip.

    The file is read again as a check: its fingertips must be where they were.

    Args:
        hand: The hand of the grasps, below their base link.
        grasps: The grasps.
        format_name: Name of a format.
        number: Number of the grasp, for the name of the file; empty: none.

    Raises:
        GraspFileError: there is no such format, it cannot hold these grasps, or they are read as others.
    """
    to, load = FORMATS[format_name], _loader(hand)
    parts, notes = to.write(grasps, load)
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        name = _stem(grasps, to, number)
        if len(parts) == 1 and "/" not in parts[0].path and not to.named_by_path:
            name += Path(parts[0].path).suffix
            with written(Path(folder, name), to, parts):
                pass
            content = Path(folder, name).read_bytes()
            _check(grasps, parts, Path(folder, name), hand, to, load)
        else:
            with written(Path(folder, "there"), to, parts):
                pass
            content = _zip_folder(Path(folder, "there"))
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                archive.extractall(Path(folder, "again"))
            _check(grasps, parts, Path(folder, "again"), hand, to, load)
            name += ".zip"
    return Saved(name, content, tuple(notes))


def _loader(hand: Hand) -> Load:
    """Return a loader of this hand below another base link."""

    @cache
    def load(base_link: str) -> Hand:
        if base_link == hand.base_link:
            return hand
        urdf = None if hand.toml is None else hand.urdf
        return load_hand(hand.toml or hand.urdf, base_link=base_link, urdf=urdf, candidates=CANDIDATES_PER_LINK)

    return load


def _check(grasps: GraspSet, parts: Sequence[Part], path: Path, hand: Hand, to: Format, load: Load) -> None:
    """Check that `path` is read as the same grasps.

    Raises:
        GraspFileError: it is not.
    """
    rows = np.concatenate([part.rows for part in sorted(parts, key=lambda part: natural(part.path))])
    again = reading(path, format=to.name, hand=hand).grasps
    try:
        check_agreement(grasps.select(rows), again, load)
    except DisagreementError as error:
        raise GraspFileError(f"format {to.name}: {error}; nothing is saved") from None


def _stem(grasps: GraspSet, to: Format, number: str) -> str:
    """Name of a file without suffix, of hand, object, number and format; without folders and unusual characters."""
    objects = {*grasps.object.tolist()}
    named = objects.pop() if len(objects) == 1 else f"{len(objects)}_objects"
    parts = [grasps.hand, named, *([number] if number else []), to.name]
    stem = object_folder("_".join(parts)).replace("=", "_").encode()[:MAX_STEM_BYTES].decode(errors="ignore")
    return stem + _scale_suffix(grasps) if isinstance(to, LeapCache) else stem


def _scale_suffix(grasps: GraspSet) -> str:
    """End of the name of a cache of LEAP grasps: the scale, 1.05 as _s105."""
    digits = f"{grasps.scale[0]:.6f}".rstrip("0")
    whole, _, rest = digits.partition(".")
    return f"_s{whole}{rest or '0'}" if len(whole) == 1 else ""


def _zip_folder(folder: Path) -> bytes:
    """Pack the files below a folder into an archive, in natural order, all with the same date."""
    stream = io.BytesIO()
    names = sorted((path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()), key=natural)
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            entry = zipfile.ZipInfo(name)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, (folder / name).read_bytes())
    return stream.getvalue()
