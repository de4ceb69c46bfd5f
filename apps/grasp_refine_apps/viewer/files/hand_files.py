"""Checks of an uploaded hand before it is read: its URDF, MJCF and hand.toml may name only files of the upload."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from grasp_refine.core.errors import HandError
from grasp_refine.core.names import is_file
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.geometry.mesh import SUFFIXES as MESH_SUFFIXES
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.files.mesh_files import resolve_mesh
from grasp_refine.hands.files.mjcf_xml import MJCF_SUFFIXES, is_mjcf
from grasp_refine_apps.viewer.files.mesh_trial import try_meshes
from grasp_refine_apps.viewer.files.unpacking import UploadError

MAX_URDF_BYTES = 2**22
"""Maximum bytes of a URDF, MJCF or hand.toml; hands have up to 60,000."""
MAX_LINKS = 256
"""Maximum number of links, and of joints; a hand on an arm has 40. Any two links may collide, and each is drawn."""

_ENCODING = re.compile(rb"""^\s*<\?xml[^>]*encoding\s*=\s*["']([^"']*)["']""")
"""Pattern of the declared encoding of an XML file; MuJoCo reads all as UTF-8."""


def check_hand(name: str, folder: Path, files: Sequence[Path]) -> Path:
    """Check an uploaded hand, and return its source for `load_hand`: folder of the only hand.toml, or the only file.

    Args:
        name: Name of the upload, for messages.
        folder: Folder of the unpacked upload; nothing outside of it may be read.
        files: The unpacked files.

    Raises:
        UploadError: there is not exactly one hand, it names files outside the upload, or it is too large.
    """
    tomls = [path for path in files if path.name == HAND_TOML]
    urdfs = [path for path in files if path.suffix.lower() == ".urdf"]
    texts = [path for path in files if path.suffix.lower() in MJCF_SUFFIXES]
    for path in (*tomls, *urdfs, *texts):
        if (size := path.stat().st_size) > MAX_URDF_BYTES:
            raise UploadError(f"{name}: {path.name} has {size >> 10} KiB, more than {MAX_URDF_BYTES >> 10} KiB")
    mjcfs = [path for path in texts if is_mjcf(path)]
    inner = {file for path in mjcfs for file in _named_by_mjcf(name, folder, path) if file != path}
    hands = tomls or urdfs or [path for path in mjcfs if path not in inner]
    if len(hands) != 1:
        found = ", ".join(path.relative_to(folder).as_posix() for path in hands) or "none"
        what = f"one {HAND_TOML}" if tomls else "one .urdf file, or one MJCF"
        raise UploadError(f"{name}: must hold {what}; it holds {found[:200]}: upload the hands one by one")
    described = _named_by_toml(name, folder, tomls[0]) if tomls else hands
    source = tomls[0].parent if tomls else hands[0]
    meshes = sorted({mesh for path in described for mesh in _meshes(name, folder, path)})
    for mesh in meshes:
        if mesh.suffix.lower() == ".dae":
            safe_xml(mesh.read_bytes(), f"{name}: {mesh.relative_to(folder).as_posix()}")
    try_meshes(meshes, folder, name)
    return source


def _named_by_toml(name: str, folder: Path, toml: Path) -> list[Path]:
    """Return the URDF and the MJCF that a hand.toml refers to, at least one of them."""
    try:
        raw = read_toml(toml)
    except UNREADABLE as error:
        reason = " ".join(str(error).split())[:80]
        raise UploadError(f"{name}: {HAND_TOML} cannot be read as TOML ({reason})") from None
    found = [
        _inside(name, folder, toml.parent, str(raw[key]), f"{key} = '{raw[key]}' in {HAND_TOML}")
        for key in ("urdf", "mjcf")
        if key in raw
    ]
    if "urdf" in raw:
        return found
    for suffixes in ((".urdf",),) if "mjcf" in raw else ((".urdf",), MJCF_SUFFIXES):
        beside = [path for path in sorted(toml.parent.iterdir()) if path.suffix.lower() in suffixes]
        if len(beside) > 1:
            listing = ", ".join(path.name for path in beside)
            raise UploadError(f"{name}: {HAND_TOML} must name a URDF, or lie beside a single one; beside it: {listing}")
        if beside:
            return [*found, *beside]
    if not found:
        raise UploadError(f"{name}: {HAND_TOML} must name a URDF or an MJCF, or lie beside a single one; there is none")
    return found


def _meshes(name: str, folder: Path, path: Path) -> set[Path]:
    """Return the meshes of the upload that a URDF or MJCF names, for collision and for display."""
    if not is_file(path):
        raise UploadError(f"{name}: names '{path.name}', which is not in it; pack the URDF or MJCF, too")
    if is_mjcf(path):
        return {file for file in _named_by_mjcf(name, folder, path) if file.suffix.lower() not in MJCF_SUFFIXES}
    return _meshes_of_urdf(name, folder, path)


def _named_by_mjcf(name: str, folder: Path, path: Path) -> list[Path]:
    """Return an MJCF and the files of the upload that it names: includes and meshes."""
    files, meshes, places = [path], [], {""}
    for file in files:
        data = file.read_bytes()
        if (declared := _ENCODING.search(data)) and declared[1].lower() not in (b"utf-8", b"us-ascii", b"ascii"):
            raise UploadError(f"{name}: {file.name} must be in UTF-8")
        root = safe_xml(data, f"{name}: {file.name}")
        if (count := sum(1 for _ in root.iter("body"))) > MAX_LINKS:
            raise UploadError(f"{name}: {file.name} has {count} bodies, more than {MAX_LINKS}: is it one hand?")
        for element in root.iter():
            if element.tag == "compiler":
                places |= {element.get(key, "") for key in ("meshdir", "assetdir", "texturedir")}
            if element.tag == "model":
                raise UploadError(
                    f"{name}: {file.name} names another model with <model>, which is not read; include it"
                )
            if (named := element.get("file")) is None:
                continue
            what = f"file '{named[:120]}' in {file.name}"
            if element.tag != "include":
                meshes.append((named, what))
            elif is_file(inner := _inside(name, folder, path.parent, named, what)) and inner not in files:
                files.append(inner)
    found = {_inside(name, folder, path.parent / place, named, what) for named, what in meshes for place in places}
    # MuJoCo reports a missing mesh; textures are not read.
    return [*files, *sorted(file for file in found if is_file(file) and file.suffix.lower() in MESH_SUFFIXES)]


def _meshes_of_urdf(name: str, folder: Path, urdf: Path) -> set[Path]:
    """Return the meshes of the upload that a URDF names, for collision and for display."""
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


def safe_xml(data: bytes, name: str) -> Any:
    """Return the root element of an XML text without declarations: entities can grow or name other files.

    Raises:
        UploadError: it is no XML, too deep, or declares a document type.
    """
    from lxml import etree

    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True, remove_pis=True
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise UploadError(f"{name}: is no XML ({' '.join(str(error.msg).split())[:80]})") from None
    if root.getroottree().docinfo.doctype:
        raise UploadError(f"{name}: declares a DOCTYPE, which can grow without bound or name other files; remove it")
    return root
