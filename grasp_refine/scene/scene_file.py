"""Scene files: TOML that lists the bodies around an object, and the poses of all in one world frame with z up."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError, did_you_mean, quote_value
from grasp_refine.core.names import exists, expand_user, is_valid
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import matrix_from_quaternion, transform
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.geometry.units import UNITS
from grasp_refine.objects.object import Object, load_object, prepare
from grasp_refine.objects.region_spec import VERBS, check_spec, resolve_spec
from grasp_refine.scene.environment import DEFAULT_MARGIN_M, LIFT_M, Environment, EnvironmentBody
from grasp_refine.scene.furniture import FURNITURE

POSE_KEYS = ("pose", "position", "rpy")
"""Keys of a pose: x y z qw qx qy qz or a 4 x 4 matrix; or a position, and angles about x, y and z in degrees."""

SHAPES = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
"""Shape of a body -> number of its lengths in metres: sides; radius; radius and height; radius and length."""

SOURCES = (*SHAPES, "object", "mesh", "pieces")
"""Keys for the shape of a body, exactly one each."""

COMMON_KEYS = ("name", *POSE_KEYS, "margin", "movable", "mass", "density")
"""Keys of every body."""

BODY_KEYS = (*SOURCES, "scale", "unit", *COMMON_KEYS)
"""Keys of a [[body]]."""

OBJECT_KEYS = ("name", "mesh", "pieces", "scale", "unit", *VERBS, *POSE_KEYS)
"""Keys of [object]."""

TOP_KEYS = ("name", "margin", "lift", "object", "body", *FURNITURE)
"""Keys of a scene file."""

MAX_MAGNITUDE_M = 100.0
"""Largest magnitude of a length or coordinate in metres."""

UNIT_TOLERANCE = 1e-3
"""Largest error of the length of a quaternion, which is then made a unit one."""

SCENES = "scenes"
"""Folder of the scenes that come with the program, among the manifests."""

MAX_BODIES = 10_000
"""Most bodies of a scene."""


def load_scene(
    path: str | Path, *, on_message: Callable[[str], None] | None = None, cache: Path | None | str = "user"
) -> Environment:
    """Return the bodies of a scene around its object; concave meshes are decomposed as objects are.

    Args:
        path: A TOML file, or the name of a scene that comes with the program (`list_scenes`).
        on_message: Called when a decomposition starts and ends.
        cache: Folder of earlier decompositions; "user" is the user's cache folder, None: no cache.

    Raises:
        GraspRefineError: it cannot be read, or a key or value in it is wrong; names file, key, value and choices.
    """
    path, asked = scene_path(path), path
    source = str(path.absolute()) if path == Path(asked) or "~" in str(asked) else str(asked)
    raw, where = _read(path), f"{path}: "
    name = _text(raw.get("name", path.stem), f"{where}name")
    margin = _length(raw.get("margin", DEFAULT_MARGIN_M), f"{where}margin", least=0.0)
    lift = _length(raw.get("lift", LIFT_M), f"{where}lift", least=0.0)
    obj, scale = _grasped_object(raw, path)
    entries = [_Entry.furniture(kind, one, w, margin) for kind in FURNITURE for one, w in _tables(raw, kind, where)]
    loaded: dict[tuple[str, float], Object] = {}
    for one, w in _tables(raw, "body", where):
        entries.append(_Entry.body(one, path.parent, w, margin, loaded, cache))
    if len(entries) > MAX_BODIES:
        raise GraspRefineError(f"{where}has {len(entries)} bodies, of at most {MAX_BODIES}")
    prepare(loaded.values(), progress=on_message)
    taken: set[str] = set()
    bodies = tuple(entry.made(taken, where) for entry in entries)
    try:
        pose, regions = _pose(raw["object"], f"{where}[object] "), _regions(raw["object"], path)
        return Environment(bodies, pose, name, lift, obj, scale, source, **regions)
    except GraspRefineError as error:
        raise GraspRefineError(f"{where}{error}") from None


def scene_object(source: str | Path) -> tuple[str | None, float]:
    """Return the object that is grasped in a scene and the factor of its mesh, without loading any body.

    Raises:
        GraspRefineError: as `load_scene`.
    """
    path = scene_path(source)
    return _grasped_object(_read(path), path)


def _grasped_object(raw: Mapping[str, Any], path: Path) -> tuple[str | None, float]:
    """Return the object, None where there is only its pose, and the factor of its mesh."""
    at, grasped = f"{path}: [object] ", raw.get("object")
    if not isinstance(grasped, Mapping):
        what = "is missing" if grasped is None else f"must be a table, got {quote_value(grasped)}"
        raise GraspRefineError(f'{at}{what}; as in [object] name = "mug", position = [0, 0, 0.7]')
    _check_keys(grasped, OBJECT_KEYS, at)
    sources = [key for key in ("name", "mesh", "pieces") if key in grasped]
    if len(sources) > 1:
        raise GraspRefineError(f"{at}has {' and '.join(sources)}: give one of them")
    obj = None if not sources else _source(grasped[sources[0]], path.parent, f"{at}{sources[0]}")
    return obj, _factor(grasped, at)


def _regions(grasped: Mapping[str, Any], path: Path) -> dict[str, tuple[str, ...]]:
    """Return the regions of the object by the names of their keys, files relative to that of the scene."""
    found = {}
    for key in VERBS:
        regions, where = grasped.get(key, []), f"[object] {key}"
        specs = [_text(one, where) for one in (regions if isinstance(regions, list) else [regions])]
        found[key] = tuple(resolve_spec(spec, path.parent, where) for spec in specs)
        for spec in found[key]:
            check_spec(spec, where)
    return found


def _read(path: Path) -> dict[str, Any]:
    """Return the tables of a scene file."""
    try:
        raw = read_toml(path)
    except FileNotFoundError:
        raise GraspRefineError(f"{path}: no such scene file") from None
    except UNREADABLE as error:
        raise GraspRefineError(f"{path}: cannot be read as TOML ({error})") from None
    _check_keys(raw, TOP_KEYS, f"{path}: ")
    return raw


def list_scenes() -> dict[str, Path]:
    """Return the scenes that come with the program: name -> file."""
    return {path.stem: path for path in sorted((resource_dir("assets_manifest") / SCENES).glob("*.toml"))}


def scene_path(source: str | Path) -> Path:
    """Return the file of a scene, or of one that comes with the program.

    Raises:
        GraspRefineError: there is none; lists the scenes.
    """
    path = expand_user(Path(source))
    if isinstance(source, Path) or path.suffix or len(path.parts) != 1:
        return path
    known = list_scenes()
    if str(source) not in known:
        raise GraspRefineError(
            f"no scene '{source}'{did_you_mean(str(source), known)} there are {', '.join(known)}, or a FILE.toml"
        )
    return known[str(source)]


@dataclass(frozen=True, eq=False)
class _Entry:
    """Entry of a body."""

    name: str
    solid: Object | tuple[Piece, ...]
    """Object, or pieces of shapes."""
    raw: Mapping[str, Any]
    where: str
    margin: float

    @staticmethod
    def furniture(kind: str, raw: Mapping[str, Any], where: str, margin: float) -> _Entry:
        """Return a body that is made of boxes."""
        made = FURNITURE[kind]
        _check_keys(raw, (*made.sizes, *COMMON_KEYS), where)
        sizes: dict[str, Any] = {}
        for key, default in made.sizes.items():
            value = raw.get(key, default)
            if isinstance(default, tuple):
                sizes[key] = _lengths(value, len(default), f"{where}{key}")
            else:
                sizes[key] = _length(value, f"{where}{key}")
        return _Entry(raw.get("name", kind), made.pieces(sizes), raw, where, margin)

    @staticmethod
    def body(
        raw: Mapping[str, Any],
        folder: Path,
        where: str,
        margin: float,
        loaded: dict[tuple[str, float], Object],
        cache: str | Path | None,
    ) -> _Entry:
        """Return a body of a shape, an object or files; objects are `loaded` once, by source and scale."""
        _check_keys(raw, BODY_KEYS, where)
        kinds = [key for key in SOURCES if key in raw]
        if len(kinds) != 1:
            found = f"has {' and '.join(kinds)}" if kinds else "has no shape"
            raise GraspRefineError(f"{where}{found}: give one of {', '.join(SOURCES)}")
        (kind,) = kinds
        if kind in SHAPES:
            if "scale" in raw or "unit" in raw:
                raise GraspRefineError(f"{where}{kind} has lengths in metres; scale and unit are for files and objects")
            value = raw[kind]
            lengths = _lengths([value] if kind == "sphere" else value, SHAPES[kind], f"{where}{kind}")
            return _Entry(raw.get("name", kind), _shape(kind, lengths), raw, where, margin)
        source, scale = _source(raw[kind], folder, f"{where}{kind}"), _factor(raw, where)
        try:
            if (source, scale) not in loaded:
                loaded[source, scale] = load_object(source, scale=scale, unit="m", cache=cache)
        except GraspRefineError as error:
            raise GraspRefineError(f"{where}{kind}: {error}") from None
        obj = loaded[source, scale]
        return _Entry(raw.get("name", obj.name), obj, raw, where, margin)

    def made(self, taken: set[str], file: str) -> EnvironmentBody:
        """Return the body, with a number after a name that was not given and is `taken`."""
        raw, where = self.raw, self.where
        name = _text(self.name, f"{where}name")
        if "name" not in raw:
            base, number = name, 2
            while name in taken:
                name, number = f"{base} {number}", number + 1
        taken.add(name)
        movable = raw.get("movable", False)
        if not isinstance(movable, bool):
            raise GraspRefineError(f"{where}movable must be true or false, got {quote_value(movable)}")
        solid = self.solid
        body = solid.body if isinstance(solid, Object) else build_body(name, solid, candidates=64)
        margin = _length(raw.get("margin", self.margin), f"{where}margin", least=0.0)
        try:
            return EnvironmentBody(name, body, _pose(raw, where), margin, movable, self._mass(body))
        except GraspRefineError as error:
            raise GraspRefineError(f"{file}{error}") from None

    def _mass(self, body: Body) -> float | None:
        """Return the given mass in kg, or that of the given density; None: neither is given."""
        raw, where = self.raw, self.where
        if "mass" in raw and "density" in raw:
            raise GraspRefineError(f"{where}has mass and density: give one of them")
        if "mass" in raw:
            return _positive(raw["mass"], f"{where}mass")
        if "density" not in raw:
            return None
        volume = sum(float(piece.mesh().volume) for piece in body.pieces)
        return _positive(raw["density"], f"{where}density") * volume


def _shape(kind: str, lengths: tuple[float, ...]) -> tuple[Piece, ...]:
    """Return the exact pieces of a shape about its origin; cylinders and capsules are along z."""
    if kind == "box":
        return (box(lengths),)
    if kind == "capsule":
        radius, length = lengths
        return (capsule(radius, (0.0, 0.0, -length / 2.0), (0.0, 0.0, length / 2.0)),)
    from grasp_refine.geometry.shapes import primitive_pieces

    return primitive_pieces(f"{kind}:{','.join(map(repr, lengths))}")


def _pose(raw: Mapping[str, Any], where: str) -> np.ndarray:
    """Return the pose (4, 4) in the world of `POSE_KEYS`; the identity where there are none."""
    if "pose" in raw:
        if len([key for key in POSE_KEYS if key in raw]) > 1:
            raise GraspRefineError(f"{where}has pose beside position or rpy: give one or the other")
        if isinstance(raw["pose"], Sequence) and len(raw["pose"]) == 4:
            return _matrix(raw["pose"], f"{where}pose")
        what = "x, y, z, qw, qx, qy, qz, or the 4 rows of a 4 x 4 matrix"
        values = np.array(_numbers(raw["pose"], 7, f"{where}pose", what))
        length = float(np.linalg.norm(values[3:]))
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            raise GraspRefineError(f"{where}pose: the length of its quaternion qw, qx, qy, qz must be 1, is {length:g}")
        return transform(matrix_from_quaternion(values[3:] / length), values[:3])
    position = _numbers(raw.get("position", [0.0, 0.0, 0.0]), 3, f"{where}position", "x, y, z in metres")
    rpy = _numbers(raw.get("rpy", [0.0, 0.0, 0.0]), 3, f"{where}rpy", "angles about x, y, z in degrees", most=1e6)
    return transform_from_rpy([*position, *rpy])


def _matrix(rows: Sequence[Any], where: str) -> np.ndarray:
    """Return the pose (4, 4) of the rows of a matrix, whose rotation may be rounded."""
    T = np.array([_numbers(row, 4, f"{where}: each row", "as of a 4 x 4 matrix") for row in rows])
    off = float(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max())
    if off > UNIT_TOLERANCE or np.linalg.det(T[:3, :3]) < 0.0 or (T[3] != [0.0, 0.0, 0.0, 1.0]).any():
        raise GraspRefineError(
            f"{where} must be a rotation and a position, with a last row of 0, 0, 0, 1, got {quote_value(T.tolist())}"
        )
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return transform(U @ Vt, T[:3, 3])


def _source(value: Any, folder: Path, where: str) -> str:
    """Return an embedded object, a primitive, or a path relative to the folder."""
    text = _text(value, where)
    if text in EMBEDDED or (":" in text and not exists(folder / text)):
        return text
    if not exists(folder / text):
        raise GraspRefineError(
            f"{where} = '{text}': no such file or folder {folder / text}{did_you_mean(text, EMBEDDED)} embedded "
            f"objects are {', '.join(EMBEDDED)}"
        )
    return str(folder / text)


def _factor(raw: Mapping[str, Any], where: str) -> float:
    """Return the factor that takes a mesh to metres, of its scale and unit."""
    unit = raw.get("unit", "m")
    if not isinstance(unit, str) or unit not in UNITS:
        raise GraspRefineError(f"{where}unit must be among {', '.join(UNITS)}, got {quote_value(unit)}")
    return _positive(raw.get("scale", 1.0), f"{where}scale") * UNITS[unit]


def _check_keys(raw: Mapping[str, Any], valid: Collection[str], where: str) -> None:
    for key in raw:
        if key not in valid:
            raise GraspRefineError(f"{where}no key '{key}'{did_you_mean(key, valid)} there are {', '.join(valid)}")


def _tables(raw: Mapping[str, Any], key: str, where: str) -> list[tuple[Mapping[str, Any], str]]:
    """Return the tables of a key, [key] or each [[key]], with how messages name them."""
    tables = raw.get(key, [])
    if isinstance(tables, Mapping):
        return [(tables, f"{where}[{key}] ")]
    if not isinstance(tables, list) or not all(isinstance(one, Mapping) for one in tables):
        raise GraspRefineError(f"{where}{key} must be a table [{key}] or [[{key}]], got {quote_value(tables)}")
    return [(one, f"{where}[[{key}]] {number} ") for number, one in enumerate(tables, 1)]


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value or not is_valid(value):
        raise GraspRefineError(f"{where} must be a text, got {quote_value(value)}")
    return value


def _number(value: Any, where: str, most: float = MAX_MAGNITUDE_M) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise GraspRefineError(f"{where} must be a number, at most {most:g}, got {quote_value(value)}")
    return float(value)


def _positive(value: Any, where: str) -> float:
    number = _number(value, where, 1e6)
    if not number > 0.0:
        raise GraspRefineError(f"{where} must be above 0, got {number:g}")
    return number


def _length(value: Any, where: str, least: float | None = None) -> float:
    number = _number(value, where)
    if number <= 0.0 if least is None else number < least:
        raise GraspRefineError(
            f"{where} must be {'above 0' if least is None else f'at least {least:g}'}, got {number:g}"
        )
    return number


def _numbers(value: Any, count: int, where: str, what: str, most: float = MAX_MAGNITUDE_M) -> list[float]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != count:
        raise GraspRefineError(f"{where} must be {count} numbers, {what}, got {quote_value(value)}")
    return [_number(one, where, most) for one in value]


def _lengths(value: Any, count: int, where: str) -> tuple[float, ...]:
    numbers = _numbers(value, count, where, "lengths in metres")
    return tuple(_length(one, where) for one in numbers)
