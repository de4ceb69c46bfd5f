"""A zip from anyone, unpacked into a folder that nothing of it leaves, and of bounded size."""

from __future__ import annotations

import io
import re
import stat
import zipfile
import zlib
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError

MOST_FILES = 2000
"""Files in a zip: a hand has about a hundred, a folder of grasps one per grasp."""
LARGEST_FILE = 2**26
"""Bytes of one unpacked file, 64 MiB: as much as may be uploaded as it is."""
LARGEST_UNPACKED = 2**28
"""Bytes of all of them, 256 MiB: four times what may be uploaded, for meshes as text shrink to a third or a fourth."""
MOST_SHRUNK, FREE = 100, 2**20
"""How many bytes may come of one, where they are more than a MiB. Meshes and arrays shrink to a third or a tenth, what
was made to fill a disk to a thousandth."""
DEEPEST = 12
"""Folders within each other; ROS packages have five."""
LONGEST_NAME = 240
"""Bytes of a file's path in the zip; file systems take 255 for each part."""
KEPT = (".urdf", ".toml", ".obj", ".stl", ".ply", ".glb", ".off", ".dae", ".npz", ".npy", ".pickle", ".pkl")
"""Endings of what is unpacked; nothing here reads other files, such as textures and programs."""
IGNORED = re.compile(r"(^|/)(__MACOSX/|\._)")
"""What macOS adds to its zips: shadows of the files, with the same endings."""

ENTRY = b"PK\x01\x02"
"""What the entry of each file begins with in the list of files at a zip's end."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What all programs pack with; others can ask for gigabytes of memory to unpack a byte."""
KINDS = (0, stat.S_IFREG, stat.S_IFDIR)
"""What an entry may be, in the bits that Unix keeps of it: not said, a file, a folder."""
BLOCK = 2**20
"""Bytes that are unpacked at once."""
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError)
"""How a damaged zip shows."""


class UploadError(GraspRefineError):
    """Something uploaded that is too large, damaged, of no kind that is known, or reaches for other files."""


def unpack(name: str, content: bytes, folder: Path) -> tuple[Path, ...]:
    """The files of a zip that may mean something here, written into an empty folder, sorted by path.

    What a zip says of itself is checked before anything is unpacked, and what comes out while it is.

    Args:
        name: What the user calls the zip, for messages.
        content: The zip.
        folder: An empty folder.

    Raises:
        UploadError: the zip is damaged, or one of the limits above or the folder would be passed.
    """
    if content.count(ENTRY) > MOST_FILES:
        raise UploadError(f"{name}: holds more than {MOST_FILES} files; upload fewer at a time")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = [entry for entry in archive.infolist() if not IGNORED.search(entry.filename)]
            _check_sizes(name, entries, len(content))
            places = [_place(name, entry) for entry in entries]
            _check_distinct(name, places)
            files = []
            for entry, place in zip(entries, places, strict=True):
                if not entry.is_dir() and place.suffix.lower() in KEPT:
                    _write(archive, entry, folder / place)
                    files.append(folder / place)
    except BROKEN as error:
        raise UploadError(f"{name}: is a damaged zip ({' '.join(str(error).split())[:80]}); pack it again") from None
    return tuple(sorted(files))


def _check_sizes(name: str, entries: list[zipfile.ZipInfo], size: int) -> None:
    if len(entries) > MOST_FILES:
        raise UploadError(f"{name}: holds {len(entries)} files, more than {MOST_FILES}; upload fewer at a time")
    for entry in entries:
        if entry.file_size > LARGEST_FILE:
            raise UploadError(
                f"{name}: '{_shown(entry)}' would unpack to {_mib(entry.file_size)}, more than {_mib(LARGEST_FILE)}; "
                "leave it out, or simplify the mesh"
            )
    total = sum(entry.file_size for entry in entries)
    if total > LARGEST_UNPACKED:
        raise UploadError(
            f"{name}: would unpack to {_mib(total)}, more than {_mib(LARGEST_UNPACKED)}; leave out what is not needed"
        )
    if total > max(FREE, MOST_SHRUNK * size):
        raise UploadError(
            f"{name}: would unpack to {total / size:.0f} times its size, as an archive bomb does; at most "
            f"{MOST_SHRUNK} times is unpacked: pack it with less compression"
        )


def _place(name: str, entry: zipfile.ZipInfo) -> Path:
    """Where an entry is to lie, relative to the folder."""
    path, shown = entry.filename, _shown(entry)
    if entry.flag_bits & 1:
        raise UploadError(f"{name}: is encrypted; pack it again without a password")
    if entry.compress_type not in METHODS:
        raise UploadError(
            f"{name}: '{shown}' is packed by method {entry.compress_type}; pack it as plain zip (deflate)"
        )
    if stat.S_IFMT(entry.external_attr >> 16) not in KINDS:
        raise UploadError(f"{name}: '{shown}' is a link or a device, never unpacked; pack the files themselves")
    if not path.isprintable() or entry.orig_filename != path:
        raise UploadError(f"{name}: the name '{shown}' holds letters that no name has; rename the file")
    parts = path.removesuffix("/").split("/")
    outside = path.startswith("/") or ".." in parts or "\\" in path or ":" in path
    if outside or not all(part.strip(". ") for part in parts):
        raise UploadError(
            f"{name}: '{shown}' leads out of the zip, or would on another system; names of files in it are relative, "
            "with / between folders and without .. and :"
        )
    if len(path.encode("utf-8", errors="replace")) > LONGEST_NAME or len(parts) > DEEPEST:
        raise UploadError(
            f"{name}: '{shown}' has {len(parts)} levels and {len(path)} letters; at most {DEEPEST} levels and "
            f"{LONGEST_NAME} letters are unpacked: move the folder up and pack it again"
        )
    return Path(*parts)


def _check_distinct(name: str, places: list[Path]) -> None:
    """Nothing, when no path comes twice, also where capitals do not count."""
    seen = set()
    for place in places:
        key = place.as_posix().lower()
        if key in seen:
            raise UploadError(f"{name}: holds '{place.as_posix()}' twice; pack it again with one of them")
        seen.add(key)


def _write(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    left = entry.file_size
    with archive.open(entry) as source, path.open("xb") as target:
        while block := source.read(BLOCK):
            left -= len(block)
            if left < 0:
                raise zipfile.BadZipFile(f"'{_shown(entry)}' is larger than it says")
            target.write(block)


def _shown(entry: zipfile.ZipInfo) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in entry.orig_filename)[:80]


def _mib(size: int) -> str:
    return f"{size / 2**20:.0f} MiB"
