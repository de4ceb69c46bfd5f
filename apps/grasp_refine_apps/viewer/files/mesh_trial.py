"""Loading of uploaded meshes in a child process first, bounded in time and memory: a short file can demand anything."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from grasp_refine.core.child import limit_child, run_module
from grasp_refine.core.errors import MeshError
from grasp_refine_apps.viewer.files.unpacking import UploadError, printable

MAX_FACES = 300_000
"""Maximum triangles of a mesh, and of all meshes of a hand; scans have 16,000 to 262,000. Convex decomposition of a
concave one takes minutes on two cores, 1 to 3 ms per triangle, and cannot be interrupted."""
MAX_PROCESSOR_S = 30.0
"""Maximum processor time in seconds; 300,000 triangles take up to 5."""
MAX_MEMORY_BYTES = 2**31
"""Maximum address space, 2 GiB; 300,000 triangles take 0.8 GiB."""
UNSUPPORTED_EXTENSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
"""Compressions of meshes in a GLB; readers take for zeros what they cannot decompress."""
ADVICE = "simplify it first (Blender: Decimate; MeshLab: Quadric Edge Collapse Decimation)"

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment of the child process: each thread reserves address space."""

_REFUSED = 3


def try_meshes(meshes: Sequence[Path], folder: Path, name: str) -> None:
    """Load the meshes of an upload in a child process.

    Faults that a reader reports are left to be reported when the upload is opened; readers leave no folder of a mesh.

    Args:
        meshes: The files; empty: nothing is done.
        folder: Folder of the upload.
        name: Name of the upload, for messages.

    Raises:
        UploadError: loading takes too long or too much memory, or crashes; or the meshes have more than `MAX_FACES`
            triangles together.
    """
    if not meshes:
        return
    end = run_module(
        __name__,
        *(str(folder), str(MAX_FACES), *map(str, meshes)),
        processor_s=MAX_PROCESSOR_S,
        memory_bytes=MAX_MEMORY_BYTES,
        environment=ONE_THREAD,
    )
    if end.code == _REFUSED:
        raise UploadError(f"{name}: {end.errors.strip().splitlines()[-1]}")
    if end.out_of_time:
        raise UploadError(f"{name}: takes more than {MAX_PROCESSOR_S:g} s to read: {ADVICE}")
    if end.code:
        raise UploadError(f"{name}: reading it takes too much memory, or crashes ({end.fault}): {ADVICE}")


def _main(limits: str, folder: str, max_faces: str, *meshes: str) -> int:
    """Run the child process."""
    limit_child(limits)
    from grasp_refine.hands.files.mesh_files import read_mesh

    faces = 0
    for mesh in meshes:
        path, shown = Path(mesh), printable(Path(mesh).relative_to(folder).as_posix())
        if packed := _compression(path):
            return _refuse(f"{shown} is compressed with {packed}, which is not supported; export it uncompressed")
        try:
            faces += len(read_mesh(path).faces)
        except (MemoryError, MeshError) as error:
            if isinstance(error, MemoryError) or isinstance(error.__cause__, MemoryError):
                return _refuse(f"{shown} takes too much memory to read: {ADVICE}")
    if faces > int(max_faces):
        return _refuse(f"has {faces} triangles, more than {max_faces}: {ADVICE}")
    return 0


def _refuse(reason: str) -> int:
    print(reason, file=sys.stderr)
    return _REFUSED


def _compression(path: Path) -> str:
    """Name of the unsupported compression of a GLB; empty: none."""
    data = path.read_bytes() if path.suffix.lower() == ".glb" else b""
    return next((name for name in UNSUPPORTED_EXTENSIONS if f'"{name}"'.encode() in data), "")


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
