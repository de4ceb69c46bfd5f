"""Export of the shown grasp as a file of any format, for the browser to download."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.formats.agreement import DisagreementError, check_agreement
from grasp_refine.grasps.formats.folders import natural, object_folder
from grasp_refine.grasps.formats.format import Format, Load, Part
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.formats.listing import format_named
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.writing import written
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.motion import closing_motion
from grasp_refine_apps.viewer.pose import Pose, Target, file_targets, posed_scene

CANDIDATES_PER_LINK = 16
"""Surface points per link; unused here."""

MAX_STEM_CHARS = 120
"""Maximum characters of a file's name before its suffix; file systems take 255."""


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
) -> GraspSet:
    """Return one grasp with our own pregrasp and squeeze: it may have been edited or refined since it was read.

    Args:
        scene: Hand, object and table.
        pose: Pose of the hand.
        name: Name of the object in the grasp file.
        scale: Factor from the units of the object's mesh to metres.
        targets: Target points of links on the object; empty: none are written.
        prepared: Prepared hand and object; None: built here.

    Raises:
        GraspFileError: the pose or the joint values are not finite.
    """
    if not pose.finite:
        raise GraspFileError("the shown grasp is not finite, so no file can hold it: reset it first")
    motion = closing_motion(posed_scene(scene, pose), prepared)
    opened, grasp, pressing = (
        Stage(pose_from_transform(motion.T_world_root[:, stage]), motion.q[:, stage]) for stage in range(3)
    )
    alone = GraspSet.of(scene.hand, grasp.hand_pose, grasp.q, object=name, scale=float(scale))
    return replace(alone, targets=file_targets(targets), pregrasp=opened, squeeze=pressing)


def grasp_file(hand: Hand, grasps: GraspSet, format_name: str) -> Saved:
    """Return grasps as a file of a format; formats that are folders of files become a .zip.

    The file is read again as a check: its fingertips must be where they were.

    Args:
        hand: The hand of the grasps, below their base link.
        grasps: The grasps.
        format_name: One of `formats.listing.FormatName`.

    Raises:
        GraspFileError: there is no such format, it cannot hold these grasps, or they are read as others.
    """
    to, load = format_named(format_name), _loader(hand)
    parts, notes = to.write(grasps, load)
    with tempfile.TemporaryDirectory(prefix="grasp-refine-") as folder:
        name = _stem(grasps, to)
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


def _stem(grasps: GraspSet, to: Format) -> str:
    """Name of a file without suffix, of hand, object and format; without folders and unusual characters."""
    objects = {*grasps.object.tolist()}
    named = objects.pop() if len(objects) == 1 else f"{len(objects)}_objects"
    stem = object_folder(f"{grasps.hand}_{named}_{to.name}").replace("=", "_")[:MAX_STEM_CHARS]
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
