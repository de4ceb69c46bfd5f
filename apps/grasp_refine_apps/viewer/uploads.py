"""What browsers send: a mesh, a hand or grasps, checked and laid into a folder that is gone when the viewer ends.

Nothing of it is run, and nothing outside its folder is read because of it. Its ending says what it must be; the readers
of meshes, hands and grasps then say what is wrong with it.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import threading
import weakref
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from grasp_refine.geometry.mesh import SUFFIXES as MESHES
from grasp_refine.hands.source import HAND_TOML
from grasp_refine_apps.viewer.hand_files import check_hand
from grasp_refine_apps.viewer.mesh_bounds import check_mesh_file
from grasp_refine_apps.viewer.unpacking import UploadError, unpack

Kind = Literal["mesh", "hand", "grasps"]

LARGEST_UPLOAD = 2**26
"""Bytes of one upload, 64 MiB: viser keeps all of it in memory. A zip of a hand has 1 to 30 MiB, a scan 5 to 20."""
LARGEST_SESSION = 2**29
"""Bytes of all uploads of a session as they lie on the disk, 512 MiB; the older ones may still be looked at."""
LONGEST_NAME = 100
"""Letters of a file's name that are kept."""

GRASPS = (".npz", ".npy", ".pickle", ".pkl")
"""Endings of grasp files."""
ENDINGS = (*MESHES, ".zip", ".urdf", *GRASPS)
"""Endings of what can be uploaded."""
ZIPS = (b"PK\x03\x04", b"PK\x05\x06")
"""What zips begin with, and .npz files."""
UNUSUAL = re.compile(r"[^\w.+-]+", re.ASCII)
"""What names on the disk do not have."""


@dataclass(frozen=True)
class Upload:
    """Something checked, which lies on the disk."""

    name: str
    """What the user calls it, without what could be mistaken."""
    kind: Kind
    """What it holds."""
    folder: Path
    """The folder that all its files are in, and nothing else."""
    source: Path
    """What its reader is to be given: a file or a folder in it."""
    notes: tuple[str, ...] = ()
    """What of it is not looked at, for the user."""


class Uploads:
    """The uploads of a session, each in a folder of its own below one that is gone at the end; a context manager."""

    def __init__(self) -> None:
        """Make the folder, which nobody else may read; it goes with the process, if nobody closes it."""
        self.path = Path(tempfile.mkdtemp(prefix="grasp-refine-uploads-")).resolve()
        self._delete = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
        self._lock, self._count = threading.Lock(), 0

    def receive(self, name: str, content: bytes) -> Upload:
        """An upload, checked; nothing of one that is refused stays.

        Raises:
            UploadError: it cannot be used, or there were too many.
        """
        with self._lock:
            there = sum(path.stat().st_size for path in self.path.rglob("*") if path.is_file())
            if there + len(content) > LARGEST_SESSION:
                raise UploadError(
                    f"{shown_name(name)}: {(there + len(content)) / 2**20:.0f} MiB would have been uploaded in all, "
                    f"more than {LARGEST_SESSION / 2**20:.0f} MiB; start the viewer again"
                )
            self._count += 1
            folder = self.path / str(self._count)
            folder.mkdir()
            try:
                return received(name, content, folder)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise

    def close(self) -> None:
        """Delete all of it."""
        self._delete()

    def __enter__(self) -> Uploads:
        """Nothing more to do."""
        return self

    def __exit__(self, *_: object) -> None:
        """Delete all of it."""
        self.close()


def received(name: str, content: bytes, folder: Path) -> Upload:
    """An upload, checked and written into an empty folder.

    Args:
        name: What the browser calls the file; it never says where anything is written.
        content: The file.
        folder: An empty folder of its own.

    Raises:
        UploadError: it is empty, too large, of no known kind, damaged, or names files that did not come with it.
    """
    shown, folder = shown_name(name), folder.resolve()
    if len(content) > LARGEST_UPLOAD:
        raise UploadError(too_large(name, len(content)))
    suffix = PurePosixPath(shown).suffix.lower()
    if suffix not in ENDINGS:
        raise UploadError(f"{shown}: cannot be opened here; upload a mesh, hand or grasps: {', '.join(ENDINGS)}")
    if not content:
        raise UploadError(f"{shown}: is empty")
    if (suffix in (".zip", ".npz")) != content.startswith(ZIPS):
        raise UploadError(f"{shown}: its content is not what its ending {suffix} says; name it as what it is")
    if suffix == ".zip":
        # Hands are called like the folder of their hand.toml.
        folder /= PurePosixPath(_name_on_disk(shown)).stem
        folder.mkdir()
        return _of_zip(shown, folder, unpack(shown, content, folder))
    path = folder / _name_on_disk(shown)
    path.write_bytes(content)
    if suffix in MESHES:
        check_mesh_file(path, shown)
        return Upload(shown, "mesh", folder, path)
    if suffix == ".urdf":
        return Upload(shown, "hand", folder, check_hand(shown, folder, [path]))
    return Upload(shown, "grasps", folder, path)


def shown_name(name: str) -> str:
    """What a browser calls a file, without folders and letters that could be mistaken, of bounded length."""
    last = re.split(r"[/\\]", name)[-1]
    kept = "".join(letter if letter.isprintable() else "?" for letter in last).strip()
    path = PurePosixPath(kept)
    return (path.stem[:LONGEST_NAME] + path.suffix[:10]) or "upload"


def too_large(name: str, size: int) -> str:
    """What to say of an upload of so many bytes."""
    return (
        f"{shown_name(name)}: has {size / 2**20:.0f} MiB, more than the {LARGEST_UPLOAD / 2**20:.0f} MiB that can be "
        "uploaded; name it on the command line (refine-grasp view --help), or simplify it"
    )


def _of_zip(name: str, folder: Path, files: tuple[Path, ...]) -> Upload:
    """A zip is a hand where it has a URDF or hand.toml, else grasps, else a mesh."""
    grasps = [path for path in files if path.suffix.lower() in GRASPS]
    meshes = [path for path in files if path.suffix.lower() in MESHES]
    if any(path.suffix.lower() == ".urdf" or path.name == HAND_TOML for path in files):
        notes = (f"{len(grasps)} grasp files in {name} are not opened: upload them after the hand",) if grasps else ()
        return Upload(name, "hand", folder, check_hand(name, folder, files), notes)
    if grasps:
        return Upload(name, "grasps", folder, grasps[0] if len(grasps) == 1 else folder)
    if len(meshes) == 1:
        check_mesh_file(meshes[0], f"{name}: {meshes[0].name}")
        return Upload(name, "mesh", folder, meshes[0])
    listing = ", ".join(path.relative_to(folder).as_posix() for path in meshes)[:200]
    found = f"several meshes ({listing})" if meshes else "neither a URDF, nor grasps, nor a mesh"
    raise UploadError(
        f"{name}: holds {found}; a zip is a hand (.urdf or {HAND_TOML}, and meshes), grasp files "
        f"({', '.join(GRASPS)}), or one mesh"
    )


def _name_on_disk(name: str) -> str:
    """A file's name that no shell, file system or reader takes for anything else; the ending stays."""
    path = PurePosixPath(name)
    return (UNUSUAL.sub("_", path.stem).strip("._-") or "upload") + path.suffix.lower()
