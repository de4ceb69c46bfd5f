"""Meshes from anyone: counted before they are built, and refused where they are too large or reach for other files."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import pytest
import trimesh

from grasp_refine_apps.viewer.files import mesh_bounds
from grasp_refine_apps.viewer.files.mesh_bounds import check_mesh_file
from grasp_refine_apps.viewer.files.unpacking import UploadError
from refusals import refused

BOX = trimesh.creation.box((0.04, 0.05, 0.06))
BALL = trimesh.creation.icosphere(2, 0.03)


def glb(header: dict[str, Any], body: bytes = b"") -> bytes:
    """A GLB of a header and numbers."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(body), 0x004E4942) + body if body else b""
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def checked(folder: Path, name: str, content: bytes) -> int:
    (folder / name).write_bytes(content)
    return check_mesh_file(folder / name, name)


def refusal(folder: Path, name: str, content: bytes, *named: object) -> str:
    """The message with which a file is refused: it begins with the name of the file, and names more."""
    with refused(UploadError, *named) as raised:
        checked(folder, name, content)
    assert str(raised.value).startswith(f"{name}: ")
    return str(raised.value)


@pytest.mark.parametrize("ending", ["obj", "stl", "ply", "glb", "off", "stl_ascii", "ply_ascii"])
@pytest.mark.parametrize("mesh", [BOX, BALL], ids=["box", "ball"])
def test_the_count_is_that_of_the_reader(mesh: trimesh.Trimesh, ending: str, tmp_path: Path):
    if ending == "ply_ascii":
        content = mesh.export(file_type="ply", encoding="ascii")
    else:
        content = mesh.export(file_type=ending)
    content = content.encode() if isinstance(content, str) else content
    assert checked(tmp_path, f"mesh.{ending.split('_')[0]}", content) == len(mesh.faces)


def test_polygons_count_as_the_triangles_that_they_become(tmp_path: Path):
    corners = "".join(f"v {i} {i * i} 0\n" for i in range(6))
    assert checked(tmp_path, "a.obj", f"{corners}f 1 2 3 4 5 6\nf 1/1/1 2/2/2 3/3/3\n".encode()) == 5
    assert checked(tmp_path, "b.obj", f"{corners}f 1 2 3 \\\n4 5 6\n".encode()) == 4
    rows = "".join(f"{i} {i * i} 0\n" for i in range(6))
    assert checked(tmp_path, "a.off", f"OFF # a comment\n6 1 0\n{rows}6 0 1 2 3 4 5\n".encode()) == 4


def test_collada_is_counted_as_often_as_it_is_drawn(shared_assets: Path, tmp_path: Path):
    content = BALL.export(file_type="dae")
    faces = checked(tmp_path, "ball.dae", content)
    assert faces == len(BALL.faces)
    node = content[content.index(b"<instance_geometry") : content.index(b"</node>")]
    assert checked(tmp_path, "twice.dae", content.replace(node, node + node)) == 2 * faces


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", b"v 0 0 0\n" + b"f 1 1 1\n" * 51),
        ("a.off", b"OFF\n1 51 0\n0 0 0\n" + b"3 0 0 0\n" * 51),
        ("a.stl", bytes(80) + struct.pack("<I", 51) + bytes(51 * 50)),
        ("b.stl", b"solid\n" + b"vertex 0 0 0\nVERTEX 0 0 0\nvertex 0 0 0\n" * 51 + b"endsolid"),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement face 51\nproperty list uchar int a\nend_header\n"),
        ("b.ply", b"ply\nformat ascii 1.0\nelement face 51\nend_header\n" + b"3 0 0 0\n" * 51),
    ],
)
def test_too_many_triangles_say_how_to_have_fewer(
    name: str, content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(mesh_bounds, "MAX_FACES", 50)
    refusal(tmp_path, name, content, "51 triangles", "50", "Blender", "Decimate")


def test_text_is_bounded_in_lines_letters_and_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(mesh_bounds, "MAX_LINES", 100)
    monkeypatch.setattr(mesh_bounds, "MAX_LINE_BYTES", 1000)
    monkeypatch.setattr(mesh_bounds, "MAX_PARTS", 20)
    refusal(tmp_path, "a.obj", b"\n" * 101, "101 lines", "100")
    refusal(tmp_path, "a.off", b"OFF" + b"\r" * 101, "101 lines", "100")
    header = b"ply\nformat ascii 1.0\nelement vertex 1\nelement face 1\nend_header"
    refusal(tmp_path, "a.ply", header + b"\n" * 200, "200 lines", "100")
    refusal(tmp_path, "b.obj", b"f" + b" 1" * 500, "1001", "1000")
    refusal(tmp_path, "c.obj", b"f" + b" 12345678901\\\n" * 99, "line", "1000")
    refusal(tmp_path, "d.obj", b"".join(b"usemtl m%d\n" % i for i in range(21)), "21 ", "20")
    refusal(tmp_path, "a.stl", b"solid a endsolid a " * 30, "30 ", "20")
    refusal(tmp_path, "b.ply", b"ply\nformat ascii 1.0\nelement vertex 101\nend_header\n", "101 elements")


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.stl", BOX.export(file_type="glb"), ("STL",)),
        ("a.glb", BOX.export(file_type="stl"), ("glTF",)),
        ("a.ply", b"MZ\x90", ("PLY",)),
        ("a.off", b"#!/bin/sh\n", ("OFF",)),
        ("a.obj", b"\x7fELF\0\0\0", ("bytes",)),
        ("a.dae", b"PK\x03\x04", ("XML",)),
        ("a.dae", b"<COLLADA", ("XML",)),
        ("a.exe", b"MZ", ("'.exe'", ".obj")),
        ("a.off", b"OFF\n", ("damaged", " .off ")),
        ("a.glb", b"glTF" + bytes(12), ("damaged", " .glb ")),
        ("a.glb", glb({"meshes": 3}), ("damaged", " .glb ")),
        (
            "a.glb",
            b"glTF" + struct.pack("<III", 2, 99, 2**21) + b"JSON" + b"[" * 2**20,
            ("damaged", " .glb "),
        ),
    ],
)
def test_what_is_not_what_its_ending_says(name: str, content: bytes, named: tuple[str, ...], tmp_path: Path):
    refusal(tmp_path, name, content, *named)


@pytest.mark.parametrize(
    "uri", ["../../etc/passwd", "/etc/passwd", "file:///etc/passwd", "http://there/a.bin", "a.bin"]
)
def test_a_glb_keeps_its_numbers_in_itself(uri: str, tmp_path: Path):
    refusal(tmp_path, "a.glb", glb({"buffers": [{"uri": uri, "byteLength": 8}]}), f"'{uri}'", "GLB")


def test_a_glb_that_would_fill_the_memory_is_refused(tmp_path: Path):
    rows = [{"count": 10**9, "componentType": 5126, "type": "VEC3"}]
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    refusal(tmp_path, "a.glb", glb({"accessors": rows}), "1000000000 rows")
    # One mesh of 100,000 triangles, drawn by 1000 nodes.
    rows = [{"count": 300_000}]
    header = {"accessors": rows, "meshes": [mesh], "nodes": [{"mesh": 0}] * 1000, "scenes": [{"nodes": [*range(1000)]}]}
    refusal(tmp_path, "b.glb", glb(header), " 100000000 triangles")
    # The same by one node that is named often.
    header |= {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0] * 1000}]}
    refusal(tmp_path, "c.glb", glb(header), " 100000000 triangles")
    header |= {"scenes": [{"nodes": [0] * 10**4}]}
    refusal(tmp_path, "d.glb", glb(header), "10000 ", "nodes")
    refusal(tmp_path, "e.glb", b"glTF" + struct.pack("<III", 2, 99, 5_000_000), "5000000 bytes")


@pytest.mark.parametrize("extension", mesh_bounds.UNSUPPORTED_EXTENSIONS)
def test_packed_glbs_are_refused(extension: str, tmp_path: Path):
    """Their reader would take what it cannot unpack for zeros."""
    refusal(tmp_path, "a.glb", glb({"extensionsRequired": [extension]}), extension)


LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10 if i else "lol"}">' for i in range(12))


@pytest.mark.parametrize(
    "text",
    [
        f"<!DOCTYPE COLLADA [{LAUGHS}]><COLLADA>&l11;</COLLADA>",
        f'<!DOCTYPE COLLADA [{LAUGHS}]><COLLADA a="&l11;"/>',
        '<!DOCTYPE COLLADA [<!ENTITY x SYSTEM "file:///etc/passwd">]><COLLADA>&x;</COLLADA>',
        '<!DOCTYPE COLLADA SYSTEM "http://there/a.dtd"><COLLADA/>',
    ],
)
def test_declarations_in_xml_are_refused(text: str, tmp_path: Path):
    said = refusal(tmp_path, "a.dae", text.encode())
    assert "DOCTYPE" in said or "XML" in said


def test_nodes_of_collada_that_multiply_are_refused(tmp_path: Path):
    nodes = "<instance_node url='#a'/>" * 17
    refusal(tmp_path, "a.dae", f"<COLLADA>{nodes}</COLLADA>".encode(), "17", "16")
