"""Grasp files in a tar archive, read one after the other without unpacking; of bounded number and size.

Nothing is written, so paths that lead out of a folder have no effect. Links, devices and sparse files are skipped.
"""

from __future__ import annotations

import gzip
import tarfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase
from math import inf
from pathlib import Path, PurePosixPath
from typing import IO, cast

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.names import is_file, is_valid

ARCHIVE_SUFFIXES = (".tar", ".tgz", ".gz")
"""Endings of archives."""
MAX_MEMBERS = 1_000_000
"""Most members of an archive, with skipped ones."""
MAX_FILES = 50_000
"""Most grasp files that are read from an archive."""
MAX_READ_BYTES = 2**30
"""Largest size of all grasp files that are read from an archive."""
MAX_UNPACKED_BYTES = 2**33
"""Largest size of a compressed archive, unpacked; one that is not compressed may have any size."""
MAX_AT_ONCE_BYTES = 2**28
"""Largest piece that is read at once: a member, or a name."""
GZIP_MAGIC = b"\x1f\x8b"
"""First bytes of a file that gzip compressed."""
DAMAGED = (tarfile.TarError, EOFError, OSError, zlib.error, ValueError, OverflowError)
"""Errors of a damaged archive."""


def in_archive(path: Path) -> tuple[Path, PurePosixPath] | None:
    """Return the archive that a path is or leads into, and the path in it; None: it is none.

    `grasps.tar/mug` are the files of the folder mug in grasps.tar.
    """
    for archive in (path, *path.parents):
        if is_file(archive):
            below = PurePosixPath(path.relative_to(archive).as_posix())
            return (archive, below) if archive.suffix.lower() in ARCHIVE_SUFFIXES and _is_tar(archive) else None
    return None


def members(archive: Path, below: PurePosixPath, suffixes: tuple[str, ...]) -> Iterator[tuple[Path, bytes]]:
    """Yield path and contents of the files in an archive with one of some endings, in its order.

    Args:
        archive: The archive.
        below: File or folder in it; ".": all.
        suffixes: Endings.

    Raises:
        GraspFileError: it is damaged or too large, or there are no such files.
    """
    count, size = 0, 0
    try:
        with _opened(archive) as (file, tar):
            for number, member in enumerate(iter(tar.next, None)):
                if number >= MAX_MEMBERS:
                    raise GraspFileError(f"{archive}: has more than {MAX_MEMBERS} members")
                tar.members.clear()  # type: ignore[attr-defined]  # which would keep every header
                name = PurePosixPath(*[part for part in PurePosixPath(member.name).parts if part not in ("/", "..")])
                wanted = member.isreg() and not member.issparse() and name.suffix.lower() in suffixes
                if not wanted or not name.is_relative_to(below) or not is_valid(str(name)):
                    continue
                count, size = count + 1, size + member.size
                if count > MAX_FILES or size > MAX_READ_BYTES:
                    raise GraspFileError(
                        f"{archive}: has more than {MAX_FILES} grasp files, or {MAX_READ_BYTES / 2**20:.0f} MiB of "
                        f"them, at {name}: name a folder in it, such as {archive}/{name.parent}"
                    )
                file.seek(member.offset_data)
                data = file.read(member.size)
                if len(data) < member.size:
                    raise EOFError(f"{name} is cut off")
                yield archive / name, data
    except DAMAGED as error:
        reason = " ".join(str(error).split())[:80]
        raise GraspFileError(f"{archive}: is a damaged or cut off archive ({reason})") from None
    if not count:
        where = "" if str(below) == "." else f" below {below}"
        raise GraspFileError(f"{archive}: has no grasp files{where}; they end with {', '.join(suffixes)}")


class _Bounded:
    """A file that reads nothing large at once: a header may state any length of a name."""

    def __init__(self, file: BufferedIOBase, archive: Path, size: float) -> None:
        self.file, self.archive, self.size = file, archive, size

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        if not 0 <= size <= MAX_AT_ONCE_BYTES:
            raise GraspFileError(
                f"{self.archive}: has a member of more than the {MAX_AT_ONCE_BYTES / 2**20:.0f} MiB that are read"
            )
        return self.file.read(size)

    def seek(self, offset: int) -> int:
        """Go to a place."""
        if offset > self.size:
            raise GraspFileError(f"{self.archive}: unpacks to more than {self.size / 2**30:.0f} GiB")
        return self.file.seek(offset)

    def tell(self) -> int:
        """Return the place."""
        return self.file.tell()


@contextmanager
def _opened(path: Path) -> Iterator[tuple[_Bounded, tarfile.TarFile]]:
    """An archive, compressed with gzip or not, and the file of its unpacked bytes."""
    with path.open("rb") as packed:
        is_packed = packed.read(2) == GZIP_MAGIC
        packed.seek(0)
        unpacked = gzip.GzipFile(fileobj=packed) if is_packed else packed
        file = _Bounded(unpacked, path, MAX_UNPACKED_BYTES if is_packed else inf)
        with tarfile.open(fileobj=cast("IO[bytes]", file), mode="r:") as tar:
            yield file, tar


def _is_tar(path: Path) -> bool:
    """Return whether a file begins as a tar archive does, compressed or not."""
    try:
        with _opened(path):
            return True
    except (*DAMAGED, GraspFileError):
        return False
