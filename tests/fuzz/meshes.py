"""Triangle meshes: loaded, closed, measured and made convex, as objects and links are."""

from __future__ import annotations

import json
import struct
from collections.abc import Hashable
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
import trimesh

from fuzz.mutations import NUMBERS, VALUES, changed_value
from fuzz.reader import Reader, plain
from fuzz.urdfs import CUBE
from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.mesh import check_solid, convex_bodies, is_convex, load_groups, load_mesh, watertight
from grasp_refine.geometry.pieces import hull
from grasp_refine.hands.files.mesh_files import read_mesh

COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
 <asset><unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis></asset>
 <library_geometries><geometry id="g" name="g"><mesh>
  <source id="p"><float_array id="pa" count="12">0 0 0 20 0 0 0 20 0 0 0 20</float_array><technique_common>
   <accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
   <param name="Z" type="float"/></accessor></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
  <triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 1 2 3 0 3 2</p></triangles>
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="s"><node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix>
  <instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
 <scene><instance_visual_scene url="#s"/></scene>
</COLLADA>"""

OBJ = f"mtllib secret.mtl\no cube\nusemtl red\n{CUBE}o second\nv 1 0 0\nv 1.1 0 0\nv 1 .1 0\nv 1 0 .1\n" + (
    "vn 0 0 1\nvt 0 0\nf 9/1/1 11/1/1 10/1/1\nf -4//1 -3//1 -1//1\nf 10 11 12\nf 9 12 11\n"
)
WORDS = tuple(
    b"v vn vt f o g usemtl mtllib ../outside/secret.mtl OFF COFF ply format ascii binary_little_endian element vertex "
    b"face property list uchar int float double end_header comment TextureFile solid facet endloop endsolid vertex "
    b"glTF JSON BIN <triangles> <polylist> <library_images> <init_from>../outside/secret.png</init_from>".split()
)
GLTF = ("../outside/secret.bin", "data:application/octet-stream;base64,AAAA", "data:;base64,****", 5120, 5126, "VEC3")
GLTF += ("SCALAR", "MAT4", "BINF", 10**9, 10**13, -5, "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", None)
GLTF += (0, 1, 2, 4, 5, 6)


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """A body in each format, as text and as bytes; open ones and ones of several bodies too."""
    ball, box = trimesh.creation.icosphere(subdivisions=1, radius=0.03), trimesh.creation.box((0.1, 0.05, 0.02))
    cup = trimesh.Trimesh(box.vertices, box.faces[2:], process=False)
    two = trimesh.util.concatenate([ball, box.copy().apply_translation((0.2, 0, 0))])
    scene = trimesh.Scene([ball, box.copy().apply_translation((0, 0.2, 0))])
    found = [("two.obj", OBJ.encode()), ("tetra.dae", COLLADA.encode())]
    for name, mesh in (("ball", ball), ("cup", cup), ("two", two), ("scene", scene)):
        for kind, suffix in (("stl", "stl"), ("stl_ascii", "stl"), ("ply", "ply"), ("off", "off"), ("glb", "glb")):
            if name == "scene" and kind != "glb":
                continue
            data = mesh.export(file_type=kind)
            found.append((f"{name}.{suffix}", data.encode() if isinstance(data, str) else bytes(data)))
    found.append(("ball.ply", bytes(ball.export(file_type="ply", encoding="ascii"))))
    return tuple(found)


def change(random: Random, name: str, content: bytes) -> bytes:
    """A header, a count, an index or a line that says something else."""
    if name.endswith(".glb"):
        return _changed_glb(random, content)
    if name.endswith(".stl") and not content.startswith(b"solid") and len(content) > 84:
        count = random.choice((0, 1, 2**16, 2**24, 2**31, 2**32 - 1, struct.unpack("<I", content[80:84])[0] + 1))
        return content[:80] + struct.pack("<I", count) + content[84:]
    lines = content.split(b"\n")
    for _ in range(random.choice((1, 1, 2, 5))):
        at = random.randrange(min(len(lines), 40) if random.random() < 0.5 else len(lines))
        words = lines[at].split(b" ")
        kind = random.randrange(5)
        if kind < 2:
            words[random.randrange(len(words))] = random.choice(NUMBERS)
        elif kind == 2:
            words[random.randrange(len(words))] = random.choice(WORDS)
        elif kind == 3:
            words += words[-1:] * random.choice((1, 3, 1000))
        else:
            words = words[:-1]
        lines[at] = b" ".join(words)
    return b"\n".join(lines)


def _changed_glb(random: Random, content: bytes) -> bytes:
    if len(content) < 20:
        return content
    size = struct.unpack("<I", content[12:16])[0]
    try:
        header = json.loads(content[20 : 20 + size])
    except (ValueError, RecursionError):
        return content
    text = json.dumps(changed_value(random, header, (*VALUES, *GLTF, *GLTF, *GLTF)))
    if random.random() < 0.02:
        text = '{"nodes":' + "[" * random.choice((500, 20000))
    data = text.encode(errors="replace")
    data += b" " * (-len(data) % 4)
    rest = content[20 + size :]
    length = 20 + len(data) + len(rest)
    return content[:8] + struct.pack("<II", length, len(data)) + content[16:20] + data + rest


def read(path: Path) -> Hashable:
    """The mesh, closed in one of three ways, its bodies and hull; a link's too."""
    endings: list[Hashable] = []
    link = read_mesh(path)
    assert np.isfinite(link.vertices[link.faces]).all()
    if path.suffix == ".dae":
        return len(link.faces) > 4
    mesh = load_mesh(path, 0.5)
    assert len(mesh.faces) and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    check_solid(mesh.vertices, "what came out")
    if path.suffix == ".obj":
        endings.append(len(load_groups(path)))
    piece = hull(mesh.vertices, name=path.name)
    assert np.isfinite(piece.vertices).all() and piece.planes[0].any()
    for holes in ("refuse", "cap", "hull"):
        try:
            closed, notes = watertight(mesh, path.name, holes)
        except MeshError as error:
            plain(str(error))
            endings.append(holes)
            continue
        assert np.isfinite(closed.vertices).all() and _volume(closed) > 0, holes
        endings += [is_convex(closed), len(convex_bodies(closed)) > 1, len(notes)]
    return tuple(endings)


def _volume(mesh: trimesh.Trimesh) -> float:
    """Of a closed mesh, where that of trimesh is 0 for small ones."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces] - mesh.vertices.mean(0), 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)))


READER = Reader("mesh", seeds, read, change, WORDS)
