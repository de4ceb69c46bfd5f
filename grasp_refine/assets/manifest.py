"""What `assets_manifest/` says: which hands, objects and grasp sets of others can be fetched, and on what terms."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import AssetError, told
from grasp_refine.core.names import is_valid
from grasp_refine.core.toml_file import UNREADABLE, read_toml

Kind = Literal["hands", "objects", "grasps"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""The manifests, one file each."""

Terms = Literal["open", "non-commercial", "unclear"]
TERMS: tuple[Terms, ...] = get_args(Terms)
"""Whether a licence restricts use, by its own words."""

PATHS = ("path", "folder", "place", "mirror")
"""Keys whose texts are judged as paths."""

_NAME = re.compile(r"[A-Za-z0-9][\w-]*(\.[\w-]+)*", re.ASCII)
_SHA256 = re.compile(r"[0-9a-f]{64}")
_REPOSITORY = re.compile(r"https://github\.com/[\w.-]+/[\w.-]+", re.ASCII)
_COMMIT = re.compile(r"[0-9a-f]{40}")
_PACKAGE = re.compile(r"[A-Za-z0-9][\w.-]*==[\w.+!]+", re.ASCII)
_FORBIDDEN = re.compile(r"[\\:*?\"<>|\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True)
class AssetFile:
    """One file of an asset: what upstream has, and what a mirror has."""

    path: str
    """Place in the upstream folder, or in the Python package that it comes with."""
    package: str | None
    """The Python package, name==version; None: it comes from the asset's repository."""
    sha256: str | None
    """Hash of upstream's file; None where upstream has it only in a form that cannot be used as it is."""
    size: int | None
    """Bytes of upstream's file, where known."""
    place: str
    """Where upstream's file lies in the asset's folder, so that the files find each other."""
    mirror: str
    """Place in a mirror."""
    mirror_place: str
    """Where the mirror's file lies in the asset's folder."""
    mirror_sha256: str
    """Hash of the mirror's file."""
    mirror_size: int
    """Bytes of the mirror's file."""
    changed: str
    """How the mirror's file differs from upstream's; empty: not at all."""


@dataclass(frozen=True)
class Asset:
    """A hand, an object or a grasp set of someone else."""

    kind: Kind
    """Which manifest it is in."""
    name: str
    """Unique name among those of its kind; also a folder name."""
    repository: str | None
    """Where it comes from; None: from a Python package."""
    commit: str | None
    """Its state there, 40 digits."""
    folder: str
    """The upstream folder of its files; empty: the root."""
    files: tuple[AssetFile, ...]
    """All its files."""
    licence: str
    """SPDX identifier, or what the source says."""
    terms: Terms
    """Whether the licence restricts use."""
    citation: str
    """Paper or project to cite."""
    unit: str
    """Unit of the lengths in its files."""
    scale: float
    """Times a length of the files: metres. Where the source has no unit, the result fits a hand."""
    main: AssetFile | None
    """What is loaded: a hand's URDF or MJCF, an object's mesh; None of grasps, which are a folder."""
    hand: str | None
    """The hand of a grasp set, a name in the manifest of hands."""
    format: str | None
    """The file format of a grasp set."""
    note: str
    """Anything else worth knowing."""

    @property
    def full_name(self) -> str:
        """Kind and name, which no other asset has."""
        return f"{self.kind}/{self.name}"

    @property
    def source(self) -> str:
        """Where it comes from, for people."""
        packages = sorted({file.package for file in self.files if file.package is not None})
        if self.repository is None:
            return f"Python package {', '.join(packages)}"
        more = "".join(f", and Python package {package}" for package in packages)
        return f"{self.repository} at {self.commit}{more}"


def read_manifest(kind: Kind, folder: Path | None = None) -> dict[str, Asset]:
    """The assets of a kind by name; `folder` holds the manifests, by default those that come with the program.

    Raises:
        AssetError: the file is missing or malformed, or an entry in it is, or names a path that leaves its folder.
    """
    return _read(kind, resource_dir("assets_manifest") if folder is None else folder)


@cache
def _read(kind: Kind, folder: Path) -> dict[str, Asset]:
    path = folder / f"{kind}.toml"
    try:
        entries = read_toml(path)
    except UNREADABLE as error:
        raise AssetError(f"{path}: cannot be read as a manifest ({error})") from None
    return {name: _asset(kind, name, entry, path) for name, entry in entries.items()}


class _Entry:
    """An entry of a manifest, or a file of one: its values, checked when they are asked for."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self.values, self.where = values, where

    def text(self, key: str, form: re.Pattern[str] | None = None) -> str:
        value = self.values.get(key)
        if not (isinstance(value, str) and value) or (form is not None and not form.fullmatch(value)):
            needed = "a text" if form is None else f"like {form.pattern}"
            raise self.wrong(key, needed)
        if form is None and key not in PATHS and not is_valid(value):
            raise self.wrong(key, "a text of letters that a terminal only shows")
        return value

    def optional(self, key: str, form: re.Pattern[str] | None = None) -> str | None:
        return self.text(key, form) if key in self.values else None

    def relative(self, key: str, default: str | None = None) -> str:
        """A path that stays in its folder."""
        if default is not None and key not in self.values:
            return default
        value = self.text(key)
        parts = value.split("/")
        if _FORBIDDEN.search(value) or {"", ".", ".."} & set(parts) or any(part != part.strip(" ") for part in parts):
            raise self.wrong(key, "a path that stays in its folder: relative, with /, without '..', '\\' and ':'")
        return value

    def size(self, key: str) -> int:
        value = self.values.get(key)
        if type(value) is not int or not 0 <= value < 2**63:
            raise self.wrong(key, "a number of bytes")
        return value

    def wrong(self, key: str, needed: str) -> AssetError:
        return AssetError(f"{self.where}: {key} = {told(self.values.get(key))} must be {needed}")


def _asset(kind: Kind, name: str, values: Any, path: Path) -> Asset:
    where = f"{path}: {kind}/{name}"
    if not _NAME.fullmatch(name):
        raise AssetError(f"{where}: a name must be letters, digits, '_', '-' and single '.'")
    if not isinstance(values, dict):
        raise AssetError(f"{where}: must be a table [{name}]")
    entry = _Entry(values, where)
    if ("repository" in values) == ("package" in values):
        raise AssetError(f"{where}: needs either repository or package")
    repository = entry.optional("repository", _REPOSITORY)
    terms = entry.text("terms")
    if terms not in TERMS:
        raise entry.wrong("terms", f"one of {', '.join(TERMS)}")
    scale = values.get("scale")
    if not (isinstance(scale, float) and 0 < scale < float("inf")):
        raise entry.wrong("scale", "a positive number with a decimal point")
    files = _files(entry, kind, name)
    main = files[0] if kind == "objects" else None
    if kind == "hands":
        main = next((file for file in files if file.path == values.get("main")), None)
        if main is None:
            raise entry.wrong("main", f"the path of one of its files: {', '.join(file.path for file in files)}")
    return Asset(
        kind=kind,
        name=name,
        repository=repository,
        commit=None if repository is None else entry.text("commit", _COMMIT),
        folder=entry.relative("folder", ""),
        files=files,
        licence=entry.text("licence"),
        terms=terms,
        citation=entry.text("citation"),
        unit=entry.text("unit"),
        scale=scale,
        main=main,
        hand=entry.optional("hand"),
        format=entry.optional("format"),
        note=entry.optional("note") or "",
    )


def _files(entry: _Entry, kind: Kind, name: str) -> tuple[AssetFile, ...]:
    listed = entry.values.get("files")
    files: tuple[AssetFile, ...]
    if kind == "objects":
        files = (_object_file(entry, name),)
    elif isinstance(listed, list) and listed and all(isinstance(values, dict) for values in listed):
        files = tuple(_file(_Entry(values, f"{entry.where}: files[{i}]"), entry) for i, values in enumerate(listed))
    else:
        raise AssetError(f"{entry.where}: files must be a list of tables that is not empty")
    for places in ([file.place for file in files], [file.mirror_place for file in files]):
        # Also whatever the case: a folder on Windows or macOS does not tell the two apart.
        twice = next((place for i, place in enumerate(places) if place.lower() in map(str.lower, places[:i])), None)
        if twice is not None:
            raise AssetError(f"{entry.where}: two files are to lie at '{twice}'")
    return files


def _file(file: _Entry, entry: _Entry) -> AssetFile:
    path = file.relative("path")
    place, mirror_place = file.relative("place", path), file.relative("mirror", path)
    return _described(file, entry, path, place, mirror_place, f"{entry.relative('mirror')}/{mirror_place}")


def _object_file(entry: _Entry, name: str) -> AssetFile:
    """The one file of an object, which is called like the object wherever it comes from."""
    path, mirror = entry.relative("path"), entry.relative("mirror")
    place, mirror_place = (name + PurePosixPath(file).suffix.lower() for file in (path, mirror))
    return _described(entry, entry, path, place, mirror_place, mirror)


def _described(file: _Entry, entry: _Entry, path: str, place: str, mirror_place: str, mirror: str) -> AssetFile:
    sha256 = file.optional("sha256", _SHA256)
    size = file.size("bytes") if "bytes" in file.values else None
    changed = file.optional("changed") or ""
    if not changed and (sha256 is None or size is None):
        raise AssetError(f"{file.where}: needs sha256 and bytes, or says in `changed` how the mirror's copy differs")
    return AssetFile(
        path=path,
        package=file.optional("package", _PACKAGE) or entry.optional("package", _PACKAGE),
        sha256=sha256,
        size=size,
        place=place,
        mirror=mirror,
        mirror_place=mirror_place,
        mirror_sha256=file.text("mirror_sha256", _SHA256) if changed else file.text("sha256", _SHA256),
        mirror_size=file.size("mirror_bytes") if changed else file.size("bytes"),
        changed=changed,
    )
