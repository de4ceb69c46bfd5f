"""Specifications of regions of an object in words, such as box:x0,y0,z0,x1,y1,z1, and regions made of them."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import GraspRefineError, did_you_mean, quote_value
from grasp_refine.core.names import expand_user, is_file
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.file_faces import colored_triangles, numbered_triangles
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import Box, ContactRegions, Faces, HalfSpace, Region

VERBS = ("touch", "avoid")
"""Uses of regions by hands: names of arguments, fields of scenes and jobs, and options."""

KINDS = ("box", "above", "below", "plane", "faces", "color")
"""Kinds of regions, before the colon."""

FILE_KINDS = ("faces", "color")
"""Regions of faces of the mesh file."""

FORMS = (
    "box:x0,y0,z0,x1,y1,z1 (two corners), above:z=0.05, below:z=0.05 (or x, y), plane:x,y,z,nx,ny,nz (the side of a "
    "point to which a normal points), faces:FILE (numbers of faces of the mesh), color:#ff0000 (colour of faces or "
    "vertices of the mesh)"
)
"""Forms of a specification."""

AXES = "xyz"
"""Names of the axes of the object's frame."""

COLOR_TOLERANCE = 8
"""Largest difference of a component of a colour, 0 to 255, that counts as none."""

NUM_LISTED_COLORS = 5
"""Largest number of colours of a mesh that a message lists."""

NUM_POINTS = 8192
"""Points on the surface of an object, searched for points in a region."""

Regions = str | Region | Sequence[str | Region]
"""One or several regions, or their specifications."""


def contact_regions(obj: Object, touch: Regions = (), avoid: Regions = ()) -> ContactRegions | None:
    """Return the regions of an object that hands should touch and avoid; None: there are none.

    Args:
        obj: The object, in whose frame and in metres the regions are.
        touch: Regions that are wanted.
        avoid: Regions that are forbidden.

    Raises:
        GraspRefineError: a specification is wrong, a region holds none of the object's surface, or nothing is left.
    """
    found = ContactRegions(_regions(obj, touch, "`touch`"), _regions(obj, avoid, "`avoid`"))
    if not (found.touch or found.avoid):
        return None
    # Each region alone holds some of the surface.
    if found.avoid and not _holds_any(obj, found.signed_distance(_surface_points(obj))[0]):
        raise GraspRefineError(f"{obj.name}: nothing of it is left to touch: {found.text}")
    return found


def resolve_spec(spec: str, folder: Path, where: str) -> str:
    """Return a specification whose file, relative to a folder, is given by its whole path.

    Raises:
        GraspRefineError: the specification has no such form.
    """
    kind, rest = _split(spec, where)
    if kind != "faces":
        return spec
    return f"{kind}:{(folder / expand_user(Path(rest))).absolute()}"


def spec_digest(spec: str) -> str:
    """Return a specification with the sha256 of its file instead of its name."""
    kind, _, rest = spec.partition(":")
    path = expand_user(Path(rest))
    if kind != "faces" or not is_file(path):
        return spec
    return f"{kind}:{hashlib.sha256(path.read_bytes()).hexdigest()}"


def is_of_file(spec: str) -> bool:
    """Return whether a specification depends on the file of a mesh beyond its surface: on colours or order of faces."""
    return spec.partition(":")[0] in FILE_KINDS


def check_spec(spec: str, option: str) -> None:
    """Refuse a specification that is wrong for any object.

    Raises:
        GraspRefineError: names it and the forms that there are.
    """
    where = f"{option} {spec}"
    kind, rest = _split(spec, where)
    if kind == "faces":
        if not is_file(expand_user(Path(rest))):
            raise GraspRefineError(f"{where}: no such file")
    elif kind == "color":
        _color(rest, where)
    else:
        _space(kind, rest, spec, where)


def check_specs(touch: Iterable[str], avoid: Iterable[str]) -> None:
    """Refuse regions to touch or avoid that are wrong for any object.

    Raises:
        GraspRefineError: names the option.
    """
    for option, specs in (("`touch`", touch), ("`avoid`", avoid)):
        for spec in specs:
            check_spec(spec, option)


def is_spec(spec: object) -> bool:
    """Return whether this is a specification that can be used, its file there."""
    try:
        check_spec(spec if isinstance(spec, str) else "", "")
    except GraspRefineError:
        return False
    return True


def _regions(obj: Object, regions: Regions, option: str) -> tuple[Region, ...]:
    """Return regions; specifications are made for an object."""
    several = (regions,) if isinstance(regions, str | Region) else regions
    if not isinstance(several, Iterable):
        raise GraspRefineError(f"{option}: must be regions, or their specifications, got {quote_value(regions)}")
    found: list[Region] = []
    for one in several:
        if not isinstance(one, str | Region):
            raise GraspRefineError(f"{option}: a region is a text or a Region, got {quote_value(one)}")
        found.append(one if isinstance(one, Region) else _region(obj, one, f"{option} {one}"))
    points = _surface_points(obj) if found else np.zeros((0, 3))
    for region in found:
        if not _holds_any(obj, region.signed_distance(points)[0]):
            raise GraspRefineError(
                f"{option} {region.spec}: holds none of the surface of {obj.name}, which is at {_extent(obj)} "
                "in its own frame, in metres"
            )
    return tuple(found)


def _region(obj: Object, spec: str, where: str) -> Region:
    kind, rest = _split(spec, where)
    if kind == "faces":
        return _numbered(obj, spec, expand_user(Path(rest)), where)
    if kind == "color":
        return _colored(obj, spec, _color(rest, where), where)
    return _space(kind, rest, spec, where)


def _split(spec: str, where: str) -> tuple[str, str]:
    """Return the kind of a region, and the rest of its specification."""
    kind, colon, rest = spec.partition(":")
    if not colon or kind not in KINDS or not rest:
        meant = f"no region{did_you_mean(kind, KINDS)}" if kind not in KINDS else "is not complete;"
        raise GraspRefineError(f"{where}: {meant} there are {FORMS}")
    return kind, rest


def _space(kind: str, rest: str, spec: str, where: str) -> Region:
    """Return a box, or one side of a plane."""
    if kind in ("above", "below"):
        axis, equals, height = rest.partition("=")
        if axis not in tuple(AXES) or not equals:
            raise GraspRefineError(f"{where}: must be as in {kind}:z=0.05, with x, y or z")
        sign = 1.0 if kind == "above" else -1.0
        (offset,) = _numbers(height, 1, where)
        return HalfSpace(spec, sign * np.eye(3)[AXES.index(axis)], sign * offset)
    first, second = np.array(_numbers(rest, 6, where)).reshape(2, 3)
    if kind == "plane":
        with np.errstate(over="ignore", under="ignore"):
            length = np.linalg.norm(second)
        if not 0 < length < np.inf:
            raise GraspRefineError(f"{where}: its normal nx, ny, nz must be neither 0 nor beyond all numbers")
        return HalfSpace(spec, second / length, float(first @ second / length))
    if not (first < second).all():
        axis = AXES[int((first >= second).argmax())]
        raise GraspRefineError(f"{where}: the second corner must be above the first in x, y and z; it is not in {axis}")
    return Box(spec, first, second)


def _numbers(text: str, count: int, where: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise GraspRefineError(f"{where}: needs {count_text(count, 'number')} in metres, got {quote_value(text)}")
    return numbers


def _color(text: str, where: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of #rrggbb."""
    digits = text.removeprefix("#")
    try:
        red, green, blue = bytes.fromhex(digits)
    except ValueError:
        raise GraspRefineError(f"{where}: a colour is as in #ff0000, got {quote_value(text)}") from None
    return red, green, blue


def _numbered(obj: Object, spec: str, path: Path, where: str) -> Faces:
    """Return the faces whose numbers a file has."""
    triangles, face = numbered_faces(obj)
    numbers = _face_numbers(path, where)
    if not len(numbers):
        raise GraspRefineError(f"{where}: has no numbers of faces")
    count = int(face.max(initial=-1)) + 1
    if numbers.dtype == bool:
        if len(numbers) != count:
            raise GraspRefineError(f"{where}: has {len(numbers)} booleans for the {count} faces of {obj.name}")
        numbers = np.flatnonzero(numbers)
        if not len(numbers):
            raise GraspRefineError(f"{where}: is true for no face")
    outside = (numbers < 0) | (numbers >= count)
    if outside.any():
        raise GraspRefineError(
            f"{where}: face {numbers[outside][0]} is none of the {count} of {obj.name}, which are numbered from 0 in "
            "the order of its file"
        )
    return Faces(spec, triangles, np.isin(face, numbers))


def _face_numbers(path: Path, where: str) -> np.ndarray:
    """Return the numbers in a file, or booleans for all faces: text with spaces, commas or lines between, or .npy."""
    if not is_file(path):
        raise GraspRefineError(f"{where}: no such file")
    try:
        if path.suffix.lower() == ".npy":
            values = np.load(path)
            if not isinstance(values, np.ndarray):
                raise ValueError("it is an archive of several arrays")
            if values.dtype == bool and values.ndim == 1:
                return values
            if values.dtype.kind not in "iu":
                raise ValueError(f"its numbers are {values.dtype}")
            return values.astype(np.int64).ravel()
        words = path.read_text(encoding="utf-8").replace(",", " ").split()
        return np.array([int(word) for word in words], dtype=np.int64)
    except (OSError, ValueError, OverflowError, EOFError) as error:
        raise GraspRefineError(
            f"{where}: must be integers with spaces, commas or lines between them, or .npy of integers ({error})"
        ) from None


def _colored(obj: Object, spec: str, color: tuple[int, int, int], where: str) -> Faces:
    """Return the faces of a colour: all their corners have it."""
    triangles, corners = np.zeros((0, 3, 3)), np.zeros((0, 3, 3), dtype=np.int64)
    if obj.file is not None:
        triangles, corners = colored_triangles(*obj.file)
    if not (corners >= 0).any():
        raise GraspRefineError(
            f"{where}: {obj.name} has no colours{'' if obj.file is None else f' in {obj.file[0]}'}: paint its faces or "
            "vertices (PLY, OBJ, GLB), or give a box or faces:FILE"
        )
    chosen = (np.abs(corners - np.array(color)) <= COLOR_TOLERANCE).all(axis=(1, 2))
    if not chosen.any():
        even = corners[(corners == corners[:, :1]).all(axis=(1, 2)) & (corners >= 0).all(axis=(1, 2))][:, 0]
        found = Counter("#{:02x}{:02x}{:02x}".format(*each) for each in even.tolist())
        listing = ", ".join(f"{name} ({count_text(n, 'face')})" for name, n in found.most_common(NUM_LISTED_COLORS))
        raise GraspRefineError(f"{where}: no face of {obj.name} has this colour; there are {listing or 'mixed ones'}")
    return Faces(spec, triangles, chosen)


def numbered_faces(obj: Object) -> tuple[Float[np.ndarray, "F 3 3"], Int[np.ndarray, " F"]]:
    """Return the triangles (F, 3, 3) of an object, its frame, and the numbers (F,) of their faces.

    Numbers count in its file; without one, in its mesh.

    Raises:
        MeshError: the file cannot be read.
    """
    if obj.file is not None:
        return numbered_triangles(*obj.file)
    return np.asarray(obj.mesh.triangles), np.arange(len(obj.mesh.faces))


def _surface_points(obj: Object) -> Float[np.ndarray, "P 3"]:
    """Return points on the surface of an object, the same every time."""
    from trimesh.sample import sample_surface

    points, _ = sample_surface(obj.mesh, NUM_POINTS, seed=0)
    return np.concatenate([obj.mesh.vertices, np.asarray(points)])


def _holds_any(obj: Object, distance: Float[np.ndarray, " P"]) -> bool:
    """Return whether a region holds any of these points on the surface, or may hold some between them."""
    spacing = np.sqrt(obj.mesh.area / NUM_POINTS)
    inside: Bool[np.ndarray, " P"] = distance <= 0.0
    return bool(inside.any() or np.nanmin(distance) < spacing)


def _extent(obj: Object) -> str:
    low, high = obj.mesh.bounds
    return ", ".join(f"{axis} {a:.3g} to {b:.3g}" for axis, a, b in zip(AXES, low, high, strict=True))
