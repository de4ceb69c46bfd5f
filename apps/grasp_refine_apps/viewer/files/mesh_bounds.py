"""Checks of an uploaded mesh before a reader builds it: its size, and references to other files.

The readers build whatever a file declares: a number in a header, a million empty lines or a node that is drawn a
million times can fill the memory. Here only the bytes are inspected, and counts are upper bounds of what a reader
builds.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from pathlib import Path
from typing import Any

from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine_apps.viewer.files.unpacking import UploadError, printable

MAX_FACES = 300_000
"""Maximum triangles of a mesh, and of all meshes of a hand; scans have 16,000 to 262,000. Convex decomposition of a
concave one takes minutes on two cores, 1 to 3 ms per triangle, and cannot be interrupted."""
MAX_LINES = 2_000_000
"""Maximum lines of a text mesh: `MAX_FACES` faces with vertices, normals and texture have 1.2 million."""
MAX_LINE_BYTES = 2**16
"""Maximum bytes of a line: a polygon with five thousand corners."""
MAX_PARTS = 2000
"""Maximum number of bodies, materials or nodes: readers compare each name with all others."""
MAX_HEADER_BYTES = 2**22
"""Maximum bytes of the header of a GLB or PLY file."""
MAX_ARRAY_ROWS = 6 * MAX_FACES
"""Maximum rows of all arrays of a GLB: faces, vertices, normals, colours and texture."""
MAX_NODE_REFERENCES = 16
"""Maximum references to further nodes in a Collada file, which multiply when nested."""

UNSUPPORTED_EXTENSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
"""Unsupported compressions of meshes in a GLB."""
ADVICE = "simplify it first (Blender: Decimate; MeshLab: Quadric Edge Collapse Decimation)"


def check_mesh_file(path: Path, name: str) -> int:
    """Return an upper bound of the number of triangles that a reader would find in a mesh file.

    Args:
        path: The file; its suffix gives the format.
        name: Name of the file, for messages.

    Raises:
        UploadError: a limit is exceeded, the content does not match the suffix, or it refers to other files.
    """
    suffix, data = path.suffix.lower(), path.read_bytes()
    known = {".stl": _stl, ".glb": _glb, ".ply": _ply, ".dae": _dae, ".obj": _obj, ".off": _off}
    if suffix not in known:
        raise UploadError(f"{name}: '{suffix}' is no supported mesh format; use one of {', '.join(SUFFIXES)}")
    try:
        faces = known[suffix](data, name)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError, struct.error) as error:
        reason = " ".join(str(error).split())[:80]
        raise UploadError(f"{name}: is a damaged {suffix} file ({type(error).__name__}: {reason})") from None
    check_faces(faces, name)
    return faces


def check_faces(faces: int, name: str) -> None:
    """Check the number of triangles of a mesh.

    Raises:
        UploadError: it exceeds the limit.
    """
    if faces > MAX_FACES:
        raise UploadError(f"{name}: has up to {faces} triangles, more than {MAX_FACES}: {ADVICE}")


def _lines(data: bytes, name: str) -> list[bytes]:
    """Split a text of bounded size into lines."""
    if b"\0" in data:
        raise UploadError(f"{name}: holds NUL bytes, so it is no text file as its suffix says")
    # Readers accept any kind of line end.
    count = data.count(b"\n") + data.count(b"\r") + data.count(b"\v") + data.count(b"\f")
    if count > MAX_LINES:
        raise UploadError(f"{name}: has {count} lines, more than {MAX_LINES}: {ADVICE}")
    lines = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines()
    longest = max(map(len, lines), default=0)
    if longest > MAX_LINE_BYTES:
        raise UploadError(
            f"{name}: has a line of {longest} characters, more than {MAX_LINE_BYTES}; export the mesh again"
        )
    return lines


def _check_parts(parts: int, name: str) -> None:
    if parts > MAX_PARTS:
        raise UploadError(f"{name}: has {parts} bodies, materials or nodes, more than {MAX_PARTS}; join them first")


def _obj(data: bytes, name: str) -> int:
    faces = parts = 0
    for line in _lines(data, name):
        line = line.lstrip()
        if line[:1] == b"f":
            faces += max(len(line.split()) - 3, 0)
        elif line[:1] in (b"o", b"u", b"g"):
            parts += 1
    _check_parts(parts, name)
    return faces


def _off(data: bytes, name: str) -> int:
    rows = [row for line in _lines(data, name) if (row := line.split(b"#")[0].split())]
    if not rows or b"OFF" not in rows[0][0].upper():
        raise UploadError(f"{name}: does not begin with OFF, so it is no OFF file")
    # The numbers may follow in the same line.
    counts = rows[0][1:] or (rows[1] if len(rows) > 1 else [])
    vertices = int(counts[0])
    return sum(max(len(row) - 3, 0) for row in rows[max(vertices, 0) + 1 :])


def _stl(data: bytes, name: str) -> int:
    if len(data) >= 84 and len(data) == 84 + 50 * (count := struct.unpack("<I", data[80:84])[0]):
        return count
    if not data.lstrip()[:5].lower() == b"solid":
        raise UploadError(f"{name}: is neither a binary STL of the declared size nor a text STL, so it is no STL file")
    text = b"\n".join(_lines(data, name)).lower()
    _check_parts(text.count(b"solid") // 2, name)
    return text.count(b"vertex") // 3


def _ply(data: bytes, name: str) -> int:
    head, end, body = data[:MAX_HEADER_BYTES].partition(b"end_header")
    if data[:3].lower() != b"ply" or not end:
        raise UploadError(f"{name}: does not begin as PLY files do, so it is no PLY file")
    counts: Counter[str] = Counter()
    lines = head.decode("utf-8").splitlines()
    _check_parts(len(lines), name)
    for line in lines:
        if line.startswith("element"):
            _, element, count = line.split()
            counts[element] += int(count)
    if sum(counts.values()) > MAX_LINES or min(counts.values(), default=0) < 0:
        raise UploadError(f"{name}: declares {sum(counts.values())} elements, more than {MAX_LINES}: {ADVICE}")
    if "ascii" not in lines[1].lower():
        # All polygons of a binary file have as many corners as the first, and the file is as long as all of them.
        return max(counts["face"], counts["tristrips"])
    rows = _lines(data[len(head) :], name)[1 + counts["vertex"] :]
    return sum(max(len(row.split()) - 3, 0) for row in rows[: counts["face"]])


def _glb(data: bytes, name: str) -> int:
    if data[:4] != b"glTF":
        raise UploadError(f"{name}: does not begin with glTF, so it is no GLB file")
    size = struct.unpack("<I", data[12:16])[0]
    if size > MAX_HEADER_BYTES:
        raise UploadError(f"{name}: has a header of {size} bytes, more than {MAX_HEADER_BYTES}; export it again")
    header = json.loads(data[20 : 20 + size])
    used = {*header.get("extensionsUsed", []), *header.get("extensionsRequired", [])}
    if packed := sorted(used & {*UNSUPPORTED_EXTENSIONS}):
        raise UploadError(
            f"{name}: is compressed with {packed[0]}, which is not supported; export it without compression"
        )
    for buffer in header.get("buffers", []):
        # As in its reader: a URI without embedded data names another file.
        if "base64," not in buffer.get("uri", "base64,"):
            raise UploadError(
                f"{name}: keeps its data in another file, '{printable(str(buffer['uri']))}'; export it as one GLB file"
            )
    nodes, meshes, rows = header.get("nodes", []), header.get("meshes", []), header.get("accessors", [])
    _check_parts(max(len(nodes), len(meshes), sum(len(mesh["primitives"]) for mesh in meshes)), name)
    if (count := sum(abs(row["count"]) for row in rows)) > MAX_ARRAY_ROWS:
        raise UploadError(f"{name}: declares arrays of {count} rows, more than {MAX_ARRAY_ROWS}: {ADVICE}")
    used_by = [child for node in nodes for child in node.get("children", [])]
    used_by += [root for scene in header.get("scenes", []) for root in scene.get("nodes", [])]
    _check_parts(len(used_by), name)
    faces = [sum(_primitive_faces(part, rows) for part in mesh["primitives"]) for mesh in meshes]
    # A mesh is drawn once for each node that holds it, and a node once for each reference to it.
    return sum(faces[nodes[child]["mesh"]] for child in used_by if "mesh" in nodes[child])


def _primitive_faces(part: dict[str, Any], rows: list[dict[str, Any]]) -> int:
    """Number of triangles of a part of a mesh in a GLB: strips have nearly as many as corners, others a third."""
    corners = rows[part.get("indices", part["attributes"].get("POSITION"))]["count"]
    return corners if part.get("mode", 4) == 5 else corners // 3


def _dae(data: bytes, name: str) -> int:
    from lxml import etree

    if b"\0" in data or not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        raise UploadError(f"{name}: is no XML, so it is no Collada file (compressed ones are not supported)")
    root = safe_xml(data, name)
    shapes: Counter[str] = Counter()
    for geometry in root.iter("{*}geometry"):
        for part in geometry.iter("{*}triangles", "{*}polylist", "{*}polygons", "{*}tristrips", "{*}trifans"):
            offsets = [int(entry.get("offset", 0)) for entry in part.iter("{*}input")]
            numbers = sum(len((p.text or "").split()) for p in part.iter("{*}p"))
            corners = numbers // (max(offsets, default=0) + 1)
            shapes[geometry.get("id", "")] += corners // 3 if etree.QName(part).localname == "triangles" else corners
    further = sum(1 for _ in root.iter("{*}instance_node"))
    drawn = [(entry.get("url") or "").removeprefix("#") for entry in root.iter("{*}instance_geometry")]
    if further > MAX_NODE_REFERENCES:
        raise UploadError(
            f"{name}: refers to nodes {further} times, more than {MAX_NODE_REFERENCES}; export it as STL or OBJ"
        )
    _check_parts(len(drawn) + len(shapes), name)
    return sum(shapes[key] for key in drawn) * max(1, further**2)


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
