"""Uploads of meshes, hands and grasps, checked and stored in a folder that is deleted when the viewer ends.

No upload is executed, and none makes a reader leave its folder. The suffix gives the expected kind; the readers of
meshes, hands and grasps then report what is wrong with it.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import threading
import unicodedata
import weakref
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from grasp_refine.geometry.mesh import SUFFIXES as MESH_SUFFIXES
from grasp_refine.grasps.formats.reading import holds_grasps, may_be_other
from grasp_refine.hands.files.hand_toml import HAND_TOML
from grasp_refine.hands.files.mjcf_xml import MJCF_SUFFIXES, is_mjcf
from grasp_refine_apps.viewer.files.hand_files import check_hand
from grasp_refine_apps.viewer.files.mesh_trial import try_meshes
from grasp_refine_apps.viewer.files.unpacking import GRASP_SUFFIXES, UploadError, unpack
from grasp_refine_apps.viewer.model.names import MAX_FILE_BYTES

Kind = Literal["mesh", "hand", "grasps"]

MAX_UPLOAD_BYTES = 2**26
"""Maximum bytes of one upload, 64 MiB: viser keeps it in memory. A zip of a hand has 1 to 30 MiB, a scan 5 to 20."""
MAX_SESSION_BYTES = 2**29
"""Maximum bytes on disk of all uploads of a session, 512 MiB; older ones may still be in use."""
MAX_NAME_CHARS = 100
"""Maximum characters of a file's name that are kept."""

UPLOAD_SUFFIXES = (*MESH_SUFFIXES, ".zip", ".urdf", *MJCF_SUFFIXES, *GRASP_SUFFIXES)
"""Suffixes of files that can be uploaded."""
ZIP_SIGNATURES = (b"PK\x03\x04", b"PK\x05\x06")
"""Signatures of zips and .npz files."""
UNSAFE_CHARACTERS = re.compile(r"[^\w.+-]+")
"""Characters that are replaced in names on disk: letters of any script stay."""


@dataclass(frozen=True)
class Upload:
    """Checked upload on disk."""

    name: str
    """Name for the user, without unprintable characters."""
    kind: Kind
    """Kind of the content."""
    folder: Path
    """Folder of all its files, and nothing else."""
    source: Path
    """Source for the reader: a file or a folder in `folder`."""
    notes: tuple[str, ...] = ()
    """Notes for the user on ignored content."""


class Uploads:
    """Uploads of a session, each in its own folder below one that is deleted at the end."""

    def __init__(self) -> None:
        """Make the folder, readable by this user alone; it is deleted with the process at the latest."""
        self.path = Path(tempfile.mkdtemp(prefix="grasp-refine-uploads-")).resolve()
        self._delete = weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
        self._lock, self._count = threading.Lock(), 0

    def receive(self, name: str, content: bytes) -> Upload:
        """Check and store an upload; nothing of a refused one stays.

        Raises:
            UploadError: it cannot be used, or the session has too many.
        """
        with self._lock:
            there = sum(path.stat().st_size for path in self.path.rglob("*") if path.is_file())
            if there + len(content) > MAX_SESSION_BYTES:
                raise UploadError(
                    f"{shown_name(name)}: {(there + len(content)) / 2**20:.0f} MiB would have been uploaded in all, "
                    f"more than {MAX_SESSION_BYTES / 2**20:.0f} MiB; start the viewer again"
                )
            self._count += 1
            folder = self.path / str(self._count)
            folder.mkdir()
            try:
                return store_upload(name, content, folder)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise

    def close(self) -> None:
        """Delete all of it."""
        self._delete()


def store_upload(name: str, content: bytes, folder: Path) -> Upload:
    """Check an upload, and write it into an empty folder.

    Args:
        name: File name from the browser; it never determines where anything is written.
        content: The file.
        folder: An empty folder of its own.

    Raises:
        UploadError: it is empty, too large, of no known kind, damaged, or names files outside the upload.
    """
    shown, folder = shown_name(name), folder.resolve()
    if len(content) > MAX_UPLOAD_BYTES:
        raise UploadError(too_large(name, len(content)))
    suffix = PurePosixPath(shown).suffix.lower()
    if suffix not in UPLOAD_SUFFIXES:
        raise UploadError(
            f"{shown}: cannot be opened here; upload a mesh, hand or grasps: {', '.join(UPLOAD_SUFFIXES)}"
        )
    if not content:
        raise UploadError(f"{shown}: is empty")
    if (suffix in (".zip", ".npz", ".pt", ".pth")) != content.startswith(ZIP_SIGNATURES):
        raise UploadError(f"{shown}: its content does not match its suffix {suffix}; rename it")
    if suffix == ".zip":
        # Hands are named after the folder of their hand.toml.
        folder /= PurePosixPath(_name_on_disk(shown)).stem
        folder.mkdir()
        return _of_zip(shown, folder, unpack(shown, content, folder))
    path = folder / _name_on_disk(shown)
    path.write_bytes(content)
    if suffix in MESH_SUFFIXES:
        try_meshes([path], folder, shown)
        return Upload(shown, "mesh", folder, path)
    if suffix in (".urdf", *MJCF_SUFFIXES):
        return Upload(shown, "hand", folder, check_hand(shown, folder, [path]))
    return Upload(shown, "grasps", folder, path)


def shown_name(name: str) -> str:
    """Name of a browser's file without folders and unprintable characters, of bounded length."""
    last = re.split(r"[/\\]", name)[-1]
    kept = "".join(char if char.isprintable() else "?" for char in last).strip()
    path = PurePosixPath(kept)
    return (path.stem[:MAX_NAME_CHARS] + path.suffix[:10]) or "upload"


def too_large(name: str, size: int) -> str:
    """Message on an upload of `size` bytes, which is too large."""
    return (
        f"{shown_name(name)}: has {size / 2**20:.0f} MiB, more than the {MAX_UPLOAD_BYTES / 2**20:.0f} MiB that can be "
        "uploaded; name it on the command line (refine-grasp view --help), or simplify it"
    )


def _may_hold_grasps(path: Path) -> bool:
    """Return False for what lies beside grasps, hands and meshes, such as settings."""
    return not may_be_other(path) or holds_grasps(path)


def _of_zip(name: str, folder: Path, files: tuple[Path, ...]) -> Upload:
    """Classify a zip: a hand where it has a URDF, an MJCF or a hand.toml, else grasps, else a mesh."""
    grasps = [path for path in files if path.suffix.lower() in GRASP_SUFFIXES and _may_hold_grasps(path)]
    meshes = [path for path in files if path.suffix.lower() in MESH_SUFFIXES]
    if any(path.suffix.lower() == ".urdf" or path.name == HAND_TOML or is_mjcf(path) for path in files):
        notes = (f"{len(grasps)} grasp files in {name} are not opened: upload them after the hand",) if grasps else ()
        return Upload(name, "hand", folder, check_hand(name, folder, files), notes)
    if grasps:
        return Upload(name, "grasps", folder, grasps[0] if len(grasps) == 1 else folder)
    if len(meshes) == 1:
        try_meshes(meshes, folder, name)
        return Upload(name, "mesh", folder, meshes[0])
    listing = ", ".join(path.relative_to(folder).as_posix() for path in meshes)[:200]
    found = f"several meshes ({listing})" if meshes else "neither a URDF or MJCF, nor grasps, nor a mesh"
    raise UploadError(
        f"{name}: holds {found}; a zip is a hand (.urdf, MJCF or {HAND_TOML}, and meshes), grasp files "
        f"({', '.join(GRASP_SUFFIXES)}), or one mesh"
    )


def _name_on_disk(name: str) -> str:
    """Return a file name that is safe for shells, file systems and readers; the suffix stays."""
    path = PurePosixPath(unicodedata.normalize("NFC", name))
    stem = UNSAFE_CHARACTERS.sub("_", path.stem).encode()[:MAX_FILE_BYTES].decode(errors="ignore").strip("._-")
    return (stem or "upload") + path.suffix.lower()
