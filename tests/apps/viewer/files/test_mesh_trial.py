"""Meshes from anyone: loaded in a child process first, and refused where they are too large."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.mesh import load_mesh
from grasp_refine_apps.viewer.files import mesh_trial
from grasp_refine_apps.viewer.files.mesh_trial import try_meshes
from grasp_refine_apps.viewer.files.unpacking import UploadError
from refusals import refused

BALL = trimesh.creation.icosphere(2, 0.03)


def tried(folder: Path, **files: bytes) -> None:
    """Try meshes out together, each with its suffix after the underscore in its name."""
    paths = []
    for name, content in files.items():
        paths.append(folder / name.replace("_", "."))
        paths[-1].write_bytes(content)
    try_meshes(paths, folder, "upload.zip")


def multiplied(count: int) -> bytes:
    """A GLB of 380 KiB whose one mesh of 20,480 triangles is drawn many times."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.icosphere(5, 0.03), geom_name="ball", node_name="0")
    for k in range(1, count):
        T = np.eye(4)
        T[0, 3] = k
        scene.graph.update(frame_to=str(k), geometry="ball", matrix=T)
    return scene.export(file_type="glb")


@pytest.mark.slow
def test_triangles_of_all_meshes_count_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = BALL.export(file_type="stl")
    monkeypatch.setattr(mesh_trial, "MAX_FACES", 2 * len(BALL.faces))
    tried(tmp_path, a_stl=ball, b_stl=ball)
    with refused(UploadError, "upload.zip", "960 triangles", "640", "Blender", "Decimate"):
        tried(tmp_path, a_stl=ball, b_stl=ball, c_ply=BALL.export(file_type="ply"))
    # One mesh counts as often as it is drawn.
    with refused(UploadError, "upload.zip", "40960 triangles"):
        tried(tmp_path, a_glb=multiplied(2))


@pytest.mark.parametrize(
    ("limit", "value", "named"),
    [
        ("MAX_MEMORY_BYTES", 2**30, "memory"),
        pytest.param("MAX_PROCESSOR_S", 1.0, "1 s", marks=pytest.mark.slow),
    ],
)
def test_memory_and_time_are_bounded(
    limit: str, value: float, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mesh_trial, "MAX_MEMORY_BYTES", 2**31)
    monkeypatch.setattr(mesh_trial, limit, value)
    with refused(UploadError, "upload.zip", named, "Decimate"):
        tried(tmp_path, a_glb=multiplied(400))


@pytest.mark.parametrize("extension", mesh_trial.UNSUPPORTED_EXTENSIONS)
def test_compressed_glbs_are_refused(extension: str, tmp_path: Path) -> None:
    """Their reader would take for zeros what it cannot decompress."""
    with refused(UploadError, "upload.zip", "a.glb", extension):
        tried(tmp_path, a_glb=glb({"extensionsRequired": [extension]}))


def test_damaged_meshes_are_left_to_their_reader(tmp_path: Path) -> None:
    tried(
        tmp_path, a_stl=b"solid nothing", b_glb=b"glTF" + bytes(12), c_ply=b"MZ", d_obj=b"\x7fELF\0\0", e_off=b"OFF\n"
    )


def glb(header: dict[str, object]) -> bytes:
    """A GLB of a header alone."""
    text = json.dumps({"asset": {"version": "2.0"}, **header}).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<II", 2, 20 + len(text)) + struct.pack("<II", len(text), 0x4E4F534A) + text


@pytest.mark.parametrize("uri", ["../../etc/passwd", "/etc/passwd", "file:///etc/passwd", "http://there/passwd"])
def test_a_glb_reads_nothing_outside_its_folder(uri: str, tmp_path: Path) -> None:
    """Its numbers may lie in another file."""
    header = {
        "buffers": [{"uri": uri, "byteLength": 48}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}],
        "accessors": [{"bufferView": 0, "count": 4, "componentType": 5126, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    (tmp_path / "a.glb").write_bytes(glb(header))
    with refused(MeshError, "a.glb", "passwd"):
        load_mesh(tmp_path / "a.glb")
