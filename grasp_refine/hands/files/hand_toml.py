"""The file hand.toml: properties of a hand that its URDF or MJCF does not hold. Every key may be left out."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError, HandError, quote_value
from grasp_refine.core.names import is_file, is_valid
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.hands.files.mjcf_xml import MJCF_SUFFIXES

T = TypeVar("T")

HAND_TOML = "hand.toml"
"""Name of the file beside a URDF or MJCF that adds missing information."""

ARM_TOML = "arm.toml"
"""Name of that file where the robot is an arm, on which a hand is mounted; it has the same keys."""

TOML_TYPES: dict[type, str] = {dict: "table", list: "list", str: "text", bool: "boolean, true or false"}
"""TOML's names of the required types."""

KEYS = (
    *("name", "urdf", "base_link", "mjcf", "mjcf_joints", "collision", "patches"),
    *("rest_pose", "contact", "coupled", "actuator", "mount", "flange", "follower_limits"),
)
"""Keys of a hand.toml."""

ACTUATOR = {"kp": 5.0, "force_limit": None, "damping": 0.1, "armature": 2e-4, "frictionloss": 0.01}
"""Keys of [actuator], and defaults for revolute joints; prismatic joints are driven by default as by a lever of 0.1 m
on such a joint. The force limit is the effort of the joint."""

MAX_MAGNITUDE = 1e100
"""Largest magnitude of a number: squares of larger ones overflow."""


@dataclass(frozen=True)
class Contact:
    """A link that is meant to touch the object."""

    link: str
    """Name of the link."""
    group: str
    """Finger that it belongs to."""
    point: tuple[float, float, float] | None = None
    """Contact point in metres, link frame; None: wherever the link comes nearest."""
    normal: tuple[float, float, float] | None = None
    """Unit outward normal there, link frame; None: the surface's own."""


@dataclass(frozen=True)
class Coupled:
    """Joints that one actuator drives through one tendon."""

    joints: tuple[str, ...]
    """Names of the joints, two or more."""
    ratio: tuple[float, ...]
    """Coefficients: the tendon's length is the sum of ratio x joint value, so torques are in this ratio."""


@dataclass(frozen=True)
class HandToml:
    """The contents of a hand.toml: keys, types and numbers are checked; names are not looked up yet."""

    path: Path
    """The file."""
    file: Path | None
    """The URDF that it describes, or the MJCF where there is no URDF; None where there is neither, and the user has to
    give it."""
    base_link: str | None = None
    """Link that the hand starts at; None: it is guessed."""
    name: str | None = None
    """Name of the hand in results and in grasp files; None: that of the folder."""
    mjcf: Path | None = None
    """MJCF file of the same hand, for simulation; None: `file`, where that is one."""
    mjcf_joints: dict[str, str] = field(default_factory=dict)
    """Joint of the hand -> its name in the MJCF; the others are found by their names."""
    collision: Literal["urdf", "mjcf", "visual"] = "urdf"
    """Kind of file that is simulated when a grasp is validated; refinement uses the geometry of `file`. With "visual"
    links of the URDF collide as they look, in both."""
    follower_limits: Literal["own", "leader"] = "own"
    """Limits of mimic joints: their own, or the ones that follow from the joints that they follow."""
    patches: bool | None = None
    """Whether flat faces of its links touch flat faces of objects in patches, not in points; None: with two fingers."""
    rest_pose: dict[str, float] = field(default_factory=dict)
    """Joint values in rad or m; joints that are not named rest in the middle of their range."""
    contacts: tuple[Contact, ...] = ()
    """Contact links; none: they are guessed."""
    coupled: tuple[Coupled, ...] = ()
    """Joints that share an actuator."""
    actuator: dict[str, dict[str, float]] = field(default_factory=dict)
    """Keys of `ACTUATOR` -> joint name, or "default" -> value."""
    mount: str | None = None
    """Link of an arm that hands are mounted on where none is given."""
    T_base_flange: Float[np.ndarray, "4 4"] | None = None
    """Pose (4, 4) of the flange of an arm that carries the hand in the frame of `base_link`; None: that frame."""

    @property
    def joints_with_settings(self) -> set[str]:
        """Names of the joints that the file has settings for."""
        coupled = {name for group in self.coupled for name in group.joints}
        driven = {name for values in self.actuator.values() for name in values} - {"default"}
        return {*self.rest_pose, *coupled, *driven}


def read_hand_toml(path: Path) -> HandToml:
    """The contents of the hand.toml at `path`.

    Raises:
        HandError: not TOML, an unknown key (lists the valid ones), a value of the wrong kind, a missing file.
    """
    try:
        raw = read_toml(path)
    except UNREADABLE as error:
        raise HandError(f"{path}: cannot be read as TOML ({error})") from None
    _check_keys(raw, KEYS, f"{path}")
    collision = raw.get("collision", "urdf")
    if collision not in ("urdf", "mjcf", "visual"):
        raise HandError(f"{path}: collision = {quote_value(collision)}; valid: 'urdf', 'mjcf', 'visual'")
    follower_limits = raw.get("follower_limits", "own")
    if follower_limits not in ("own", "leader"):
        raise HandError(f"{path}: follower_limits = {quote_value(follower_limits)}; valid: 'own', 'leader'")
    base_link, name = raw.get("base_link"), raw.get("name")
    joints = _typed(raw.get("mjcf_joints", {}), dict, f"{path}: [mjcf_joints]")
    rest_pose = _typed(raw.get("rest_pose", {}), dict, f"{path}: [rest_pose]")
    actuator = _typed(raw.get("actuator", {}), dict, f"{path}: [actuator]")
    mjcf = _file(raw["mjcf"], path, "mjcf") if "mjcf" in raw else None
    file = _file(raw["urdf"], path, "urdf") if "urdf" in raw else _beside(path.parent, ".urdf")
    file = file or mjcf or _beside(path.parent, *MJCF_SUFFIXES)
    return HandToml(
        path=path,
        file=file,
        base_link=None if base_link is None else _typed(base_link, str, f"{path}: base_link"),
        name=None if name is None else _typed(name, str, f"{path}: name"),
        mjcf=mjcf,
        mjcf_joints={name: _typed(value, str, f"{path}: [mjcf_joints] {name}") for name, value in joints.items()},
        collision=collision,
        follower_limits=follower_limits,
        patches=None if "patches" not in raw else _typed(raw["patches"], bool, f"{path}: patches"),
        rest_pose={name: _number(value, f"{path}: [rest_pose] {name}") for name, value in rest_pose.items()},
        contacts=tuple(_contact(entry, where) for entry, where in _tables(raw, "contact", path)),
        coupled=tuple(_coupled(entry, where) for entry, where in _tables(raw, "coupled", path)),
        actuator=_actuator(actuator, f"{path}: [actuator]"),
        mount=None if "mount" not in raw else _typed(raw["mount"], str, f"{path}: mount"),
        T_base_flange=None if "flange" not in raw else _pose(raw["flange"], f"{path}: flange"),
    )


def only_file(folder: Path) -> Path:
    """The one .urdf file in `folder`, or the one MJCF, .xml or .mjcf, where there is no .urdf.

    Raises:
        HandError: there is none, or several (lists them).
    """
    found = _beside(folder, ".urdf") or _beside(folder, *MJCF_SUFFIXES)
    if found is None:
        raise HandError(
            f"{folder}: one .urdf, .xml or .mjcf file is needed, or a {HAND_TOML} that names one; here: none"
        )
    return found


def _beside(folder: Path, *suffixes: str) -> Path | None:
    """The only file in a folder with one of the suffixes; None if there is none.

    Raises:
        HandError: there are several (lists them).
    """
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise HandError(
            f"{folder}: one {' or '.join(suffixes)} file is needed, or a {HAND_TOML} that names one; here: {names}"
        )
    return found[0] if found else None


def _contact(raw: dict[str, Any], where: str) -> Contact:
    _check_keys(raw, ("link", "group", "point", "normal"), where)
    link = _typed(raw.get("link"), str, f"{where} link")
    point = _vector(raw["point"], f"{where} point") if "point" in raw else None
    normal = None
    if "normal" in raw:
        direction = np.array(_vector(raw["normal"], f"{where} normal"))
        if np.linalg.norm(direction) < 1e-9:
            raise HandError(f"{where} normal has no direction")
        normal = tuple((direction / np.linalg.norm(direction)).tolist())
    return Contact(link, _typed(raw.get("group", link), str, f"{where} group"), point, normal)


def _coupled(raw: dict[str, Any], where: str) -> Coupled:
    _check_keys(raw, ("joints", "ratio"), where)
    joints = _typed(raw.get("joints"), list, f"{where} joints")
    names = tuple(_typed(name, str, f"{where} joints") for name in joints)
    ratios = _typed(raw.get("ratio", [1.0] * len(names)), list, f"{where} ratio")
    ratio = tuple(_number(value, f"{where} ratio") for value in ratios)
    if len(names) < 2 or len(set(names)) < len(names) or len(ratio) != len(names) or 0.0 in ratio:
        raise HandError(f"{where} needs two or more different joints, and for each a ratio other than 0")
    return Coupled(names, ratio)


def _actuator(raw: dict[str, Any], where: str) -> dict[str, dict[str, float]]:
    _check_keys(raw, ACTUATOR, where)
    values = {}
    for key, setting in raw.items():
        per_joint = setting if isinstance(setting, dict) else {"default": setting}
        values[key] = {name: _number(value, f"{where} {key} {name}") for name, value in per_joint.items()}
        if any(value < 0 for value in values[key].values()):
            raise HandError(f"{where} {key}: must not be negative, got {min(values[key].values()):g}")
    return values


def _check_keys(raw: dict[str, Any], valid: Collection[str], where: str) -> None:
    unknown = [key for key in raw if key not in valid]
    if unknown:
        raise HandError(f"{where}: unknown key '{unknown[0]}'; valid: {', '.join(valid)}")


def _tables(raw: dict[str, Any], key: str, path: Path) -> list[tuple[dict[str, Any], str]]:
    entries = _typed(raw.get(key, []), list, f"{path}: [[{key}]]")
    named = [(entry, f"{path}: [[{key}]] {number}") for number, entry in enumerate(entries, 1)]
    return [(_typed(entry, dict, where), where) for entry, where in named]


def _file(value: Any, path: Path, key: str) -> Path:
    file = path.parent / _typed(value, str, f"{path}: {key}")
    if not is_file(file):
        raise HandError(f"{path}: {key} = '{value}': no such file {file}")
    return file


def _typed(value: Any, kind: type[T], where: str) -> T:
    if not isinstance(value, kind) or value == "":
        raise HandError(f"{where} must be a {TOML_TYPES[kind]}, got {quote_value(value)}")
    if isinstance(value, str) and not is_valid(value):
        raise HandError(f"{where} holds characters that no name may have: {value}")
    return value


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= MAX_MAGNITUDE:
        raise HandError(f"{where} must be a number, at most {MAX_MAGNITUDE:g}, got {quote_value(value)}")
    return float(value)


def _pose(value: Any, where: str) -> Float[np.ndarray, "4 4"]:
    try:
        return transform_from_rpy([_number(number, where) for number in _typed(value, list, where)])
    except HandError:
        raise
    except GraspRefineError as error:
        raise HandError(f"{where}: {error}") from None


def _vector(value: Any, where: str) -> tuple[float, float, float]:
    numbers = [_number(number, where) for number in _typed(value, list, where)]
    if len(numbers) != 3:
        raise HandError(f"{where} must hold 3 numbers, got {len(numbers)}")
    return numbers[0], numbers[1], numbers[2]
