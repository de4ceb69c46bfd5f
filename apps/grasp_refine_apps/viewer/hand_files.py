"""Checks of an uploaded hand before it is read: its URDF and hand.toml may name only files of the upload."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from grasp_refine.core.errors import HandError
from grasp_refine.core.names import is_file
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.hands.hand_toml import HAND_TOML
from grasp_refine.hands.mesh_files import resolve_mesh
from grasp_refine_apps.viewer.mesh_bounds import check_faces, check_mesh_file, safe_xml
from grasp_refine_apps.viewer.unpacking import UploadError

MAX_URDF_BYTES = 2**22
"""Maximum bytes of a URDF or hand.toml; hands have up to 60,000."""
MAX_LINKS = 256
"""Maximum number of links, and of joints; a hand on an arm has 40. Any two links may collide, and each is drawn."""


def check_hand(name: str, folder: Path, files: Sequence[Path]) -> Path:
    """Check an uploaded hand, and return its source for `load_hand`: folder of the only hand.toml, or the only URDF.

    Args:
        name: Name of the upload, for messages.
        folder: Folder of the unpacked upload; nothing outside of it may be read.
        files: The unpacked files.

    Raises:
        UploadError: there is not exactly one hand, it names files outside the upload, or it is too large.
    """
    tomls = [path for path in files if path.name == HAND_TOML]
    urdfs = [path for path in files if path.suffix.lower() == ".urdf"]
    for path in (*tomls, *urdfs):
        if (size := path.stat().st_size) > MAX_URDF_BYTES:
            raise UploadError(f"{name}: {path.name} has {size >> 10} KiB, more than {MAX_URDF_BYTES >> 10} KiB")
    if len(tomls) > 1 or (not tomls and len(urdfs) != 1):
        found = ", ".join(path.relative_to(folder).as_posix() for path in (tomls or urdfs)) or "none"
        what = f"one {HAND_TOML}" if tomls else "one .urdf file"
        raise UploadError(f"{name}: must hold {what}; it holds {found[:200]}: upload the hands one by one")
    source = tomls[0].parent if tomls else urdfs[0]
    if tomls:
        urdfs = [_named_urdf(name, folder, tomls[0])]
    faces = 0
    for mesh in sorted({mesh for urdf in urdfs for mesh in _meshes(name, folder, urdf)}):
        faces += check_mesh_file(mesh, f"{name}: {mesh.relative_to(folder).as_posix()}")
    check_faces(faces, name)
    return source


def _named_urdf(name: str, folder: Path, toml: Path) -> Path:
    """Return the URDF that a hand.toml refers to."""
    try:
        raw = read_toml(toml)
    except UNREADABLE as error:
        reason = " ".join(str(error).split())[:80]
        raise UploadError(f"{name}: {HAND_TOML} cannot be read as TOML ({reason})") from None
    if "mjcf" in raw:
        raise UploadError(
            f"{name}: {HAND_TOML} names an MJCF file, which is not read from uploads because it can name any other "
            f"file: remove the line mjcf, or open the hand with refine-grasp view --hand FOLDER"
        )
    if "urdf" in raw:
        return _inside(name, folder, toml.parent, str(raw["urdf"]), f"urdf = '{raw['urdf']}' in {HAND_TOML}")
    beside = [path for path in sorted(toml.parent.iterdir()) if path.suffix.lower() == ".urdf"]
    if len(beside) != 1:
        found = ", ".join(path.name for path in beside) or "none"
        raise UploadError(f"{name}: {HAND_TOML} must name a URDF, or lie beside a single one; beside it: {found}")
    return beside[0]


def _meshes(name: str, folder: Path, urdf: Path) -> set[Path]:
    """Return the meshes of the upload that a URDF names, for collision and for display."""
    if not is_file(urdf):
        raise UploadError(f"{name}: names the URDF '{urdf.name}', which is not in it; pack it, too")
    root = safe_xml(urdf.read_bytes(), f"{name}: {urdf.name}")
    for tag in ("link", "joint"):
        if (count := sum(1 for _ in root.iter(tag))) > MAX_LINKS:
            raise UploadError(f"{name}: {urdf.name} has {count} {tag}s, more than {MAX_LINKS}: is it one hand?")
    found = set()
    for mesh in root.iter("{*}mesh"):
        filename = mesh.get("filename")
        if filename:
            scheme, _, rest = filename.rpartition("://")
            what = f"mesh '{filename[:120]}' in {urdf.name}"
            if scheme not in ("", "file", "package"):
                raise UploadError(f"{name}: {what} is an address, which is not fetched; pack the mesh itself")
            place = urdf.parent if scheme != "package" else folder
            _inside(name, folder, place, unquote(rest) if scheme == "file" else rest, what)
            try:
                path = resolve_mesh(filename, urdf)
            except HandError:
                # A visual mesh may be missing; the reader of hands reports a missing collision mesh.
                continue
            # Packages are searched in the parent folders, too.
            if not path.resolve().is_relative_to(folder.resolve()):
                raise UploadError(f"{name}: {what} is not in the upload; pack the mesh, too")
            found.add(path)
    return found


def _inside(name: str, folder: Path, place: Path, path: str, what: str) -> Path:
    """Return the file `path` of the folder `place`, which must lie in `folder`."""
    found = Path(os.path.normpath(place / path))
    if "\0" in path or not found.is_relative_to(folder):
        raise UploadError(f"{name}: {what} lies outside of the upload; pack it, and name it relative to that file")
    return found
