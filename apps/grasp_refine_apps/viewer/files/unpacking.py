"""Unpacking of an uploaded zip into one folder, which no file leaves, and with bounded size."""

from __future__ import annotations

import io
import re
import shutil
import stat
import zipfile
import zlib
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.mesh import SUFFIXES as MESH_SUFFIXES
from grasp_refine.grasps.formats.content import SUFFIXES
from grasp_refine.hands.files.mjcf_xml import MJCF_SUFFIXES

MAX_FILES = 2000
"""Maximum files in a zip: a hand has about a hundred, a folder of grasps one per grasp."""
MAX_FILE_BYTES = 2**26
"""Maximum bytes of one unpacked file, 64 MiB: as much as may be uploaded unpacked."""
MAX_UNPACKED_BYTES = 2**28
"""Maximum bytes of all unpacked files, 256 MiB: four uploads, as text meshes shrink to a third or a fourth."""
MAX_COMPRESSION_RATIO, UNLIMITED_RATIO_BYTES = 100, 2**20
"""Maximum ratio of unpacked to packed bytes, and bytes below which any ratio is allowed. Meshes and arrays shrink to a
third or a tenth, archive bombs to a thousandth."""
MAX_LEVELS = 12
"""Maximum levels of a path; ROS packages have five."""
MAX_PATH_BYTES = 240
"""Maximum bytes of a file's path in the zip; file systems take 255 for each part."""
GRASP_SUFFIXES = SUFFIXES
"""Suffixes of grasp files."""
KEPT_SUFFIXES = (".urdf", *MJCF_SUFFIXES, ".toml", ".dae", *MESH_SUFFIXES, *GRASP_SUFFIXES)
"""Suffixes of unpacked files; nothing here reads other files, such as textures and programs."""
IGNORED_PATHS = re.compile(r"(^|/)(__MACOSX/|\._)")
"""Metadata files that macOS adds to its zips, with the same suffixes."""

MAX_SHOWN_CHARS = 80
"""Maximum characters of a text from a file in a message."""
ENTRY_SIGNATURE = b"PK\x01\x02"
"""Signature of each file's entry in the central directory of a zip."""
COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compression methods of all programs; others can need gigabytes of memory to unpack a byte."""
FILE_TYPES = (0, stat.S_IFREG, stat.S_IFDIR)
"""Allowed Unix file types of an entry: not specified, a file, a folder."""
BLOCK_BYTES = 2**20
"""Number of bytes unpacked at once."""
ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError)
"""Exceptions of a damaged zip."""


class UploadError(GraspRefineError):
    """Upload that is too large, damaged, of an unknown kind, or refers to other files."""


def unpack(name: str, content: bytes, folder: Path) -> tuple[Path, ...]:
    """Unpack the supported files of a zip into an empty folder; returns them sorted by path.

    Declared sizes and paths are checked before anything is unpacked, and real sizes during it.

    Args:
        name: Name of the zip, for messages.
        content: The zip.
        folder: An empty folder.

    Raises:
        UploadError: the zip is damaged, exceeds one of the limits above, or would leave the folder.
    """
    if content.count(ENTRY_SIGNATURE) > MAX_FILES:
        raise UploadError(f"{name}: holds more than {MAX_FILES} files; upload fewer at a time")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = [entry for entry in archive.infolist() if not IGNORED_PATHS.search(entry.filename)]
            _check_sizes(name, entries, len(content))
            places = [_place(name, entry) for entry in entries]
            _check_distinct(name, places)
            files = []
            for entry, place in zip(entries, places, strict=True):
                if not entry.is_dir() and place.suffix.lower() in KEPT_SUFFIXES:
                    _write(archive, entry, folder / place)
                    files.append(folder / place)
    except ZIP_ERRORS as error:
        raise UploadError(f"{name}: is a damaged zip ({' '.join(str(error).split())[:80]}); pack it again") from None
    return tuple(sorted(files))


def _check_sizes(name: str, entries: list[zipfile.ZipInfo], size: int) -> None:
    if len(entries) > MAX_FILES:
        raise UploadError(f"{name}: holds {len(entries)} files, more than {MAX_FILES}; upload fewer at a time")
    for entry in entries:
        if entry.file_size > MAX_FILE_BYTES:
            raise UploadError(
                f"{name}: '{printable(entry.orig_filename)}' would unpack to {_mib(entry.file_size)}, more than "
                f"{_mib(MAX_FILE_BYTES)}; leave it out, or simplify the mesh"
            )
    total = sum(entry.file_size for entry in entries)
    if total > MAX_UNPACKED_BYTES:
        raise UploadError(
            f"{name}: would unpack to {_mib(total)}, more than {_mib(MAX_UNPACKED_BYTES)}; leave out unneeded files"
        )
    if total > max(UNLIMITED_RATIO_BYTES, MAX_COMPRESSION_RATIO * size):
        raise UploadError(
            f"{name}: would unpack to {total / size:.0f} times its size, as an archive bomb does; at most "
            f"{MAX_COMPRESSION_RATIO} times is unpacked: pack it with less compression"
        )


def _place(name: str, entry: zipfile.ZipInfo) -> Path:
    """Return the path of an entry, relative to the folder, after checking it."""
    path, shown = entry.filename, printable(entry.orig_filename)
    if entry.flag_bits & 1:
        raise UploadError(f"{name}: is encrypted; pack it again without a password")
    if entry.compress_type not in COMPRESSION_METHODS:
        raise UploadError(
            f"{name}: '{shown}' is packed by method {entry.compress_type}; pack it as plain zip (deflate)"
        )
    if stat.S_IFMT(entry.external_attr >> 16) not in FILE_TYPES:
        raise UploadError(f"{name}: '{shown}' is a link or a device, never unpacked; pack the files themselves")
    if not path.isprintable() or entry.orig_filename != path:
        raise UploadError(f"{name}: the name '{shown}' holds characters that are not printable; rename the file")
    parts = path.removesuffix("/").split("/")
    outside = path.startswith("/") or "\\" in path or ":" in path
    # No part may be empty, or consist of dots.
    if outside or not all(part.strip(". ") for part in parts):
        raise UploadError(
            f"{name}: '{shown}' leads out of the zip, or would on another system; names of files in it are relative, "
            "with / between folders and without .. and :"
        )
    if len(path.encode("utf-8", errors="replace")) > MAX_PATH_BYTES or len(parts) > MAX_LEVELS:
        raise UploadError(
            f"{name}: '{shown}' has {len(parts)} levels and {len(path)} characters; at most {MAX_LEVELS} levels and "
            f"{MAX_PATH_BYTES} characters are unpacked: move the folder up and pack it again"
        )
    return Path(*parts)


def _check_distinct(name: str, places: list[Path]) -> None:
    """Check that no path occurs twice, also where case does not count."""
    seen = set()
    for place in places:
        key = place.as_posix().lower()
        if key in seen:
            raise UploadError(f"{name}: holds '{place.as_posix()}' twice; pack it again with one of them")
        seen.add(key)


def _write(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> None:
    """Unpack a file; zipfile reads no more than the declared bytes, and then compares their checksum."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(entry) as source, path.open("xb") as target:
        shutil.copyfileobj(source, target, BLOCK_BYTES)


def printable(text: str) -> str:
    """Return the beginning of a text from a file, without unprintable characters."""
    return "".join(char if char.isprintable() else "?" for char in text)[:MAX_SHOWN_CHARS]


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB"
