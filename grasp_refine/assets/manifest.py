"""Manifests in `assets_manifest/`: third-party hands, objects and grasp sets that can be fetched, and their terms."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Literal, get_args

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import AssetError, quote_value
from grasp_refine.core.names import is_valid
from grasp_refine.core.toml_file import UNREADABLE, read_toml

Kind = Literal["hands", "objects", "grasps"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Kinds of assets; each has a manifest file."""

Terms = Literal["open", "non-commercial", "unclear"]
TERMS: tuple[Terms, ...] = get_args(Terms)
"""Terms of a licence: open, restricted to non-commercial use, or unclear."""

PATH_KEYS = ("path", "folder", "place", "mirror")
"""Keys whose values are checked as paths."""

_NAME = re.compile(r"[A-Za-z0-9][\w-]*(\.[\w-]+)*", re.ASCII)
_SHA256 = re.compile(r"[0-9a-f]{64}")
_REPOSITORY = re.compile(r"https://github\.com/[\w.-]+/[\w.-]+", re.ASCII)
_COMMIT = re.compile(r"[0-9a-f]{40}")
_PACKAGE = re.compile(r"[A-Za-z0-9][\w.-]*==[\w.+!]+", re.ASCII)
_FORBIDDEN = re.compile(r"[\\:*?\"<>|\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


@dataclass(frozen=True)
class AssetFile:
    """One file of an asset, upstream and in a mirror."""

    path: str
    """Path in the upstream folder, or in the Python package that provides it."""
    package: str | None
    """The Python package, name==version; None: it comes from the asset's repository."""
    sha256: str | None
    """Hash of upstream's file; None where upstream has it only in a form that cannot be used directly."""
    size: int | None
    """Bytes of upstream's file, where known."""
    place: str
    """Path of upstream's file in the asset's folder, such that references between files resolve."""
    mirror: str
    """Path in a mirror."""
    mirror_place: str
    """Path of the mirror's file in the asset's folder."""
    mirror_sha256: str
    """Hash of the mirror's file."""
    mirror_size: int
    """Bytes of the mirror's file."""
    changed: str
    """Difference of the mirror's file from upstream's; empty: none."""


@dataclass(frozen=True)
class Asset:
    """A third-party hand, object or grasp set."""

    kind: Kind
    """Kind of asset, which names its manifest."""
    name: str
    """Unique name within its kind; also a folder name."""
    repository: str | None
    """Repository of its files; None: they come from a Python package."""
    commit: str | None
    """Commit in the repository, 40 hexadecimal digits."""
    folder: str
    """The upstream folder of its files; empty: the root."""
    files: tuple[AssetFile, ...]
    """All its files."""
    licence: str
    """SPDX identifier, or the source's own wording."""
    terms: Terms
    """Terms of the licence."""
    citation: str
    """Paper or project to cite."""
    unit: str
    """Unit of the lengths in its files."""
    scale: float
    """Factor from lengths in the files to metres; chosen to fit a hand where the source has no unit."""
    main: AssetFile | None
    """File to load: a hand's URDF or MJCF, an object's mesh; None for grasps, which are a folder."""
    hand: str | None
    """The hand of a grasp set, a name in the manifest of hands."""
    format: str | None
    """The file format of a grasp set."""
    note: str
    """Further remarks."""

    @property
    def full_name(self) -> str:
        """Unique name: kind/name."""
        return f"{self.kind}/{self.name}"

    @property
    def source(self) -> str:
        """Description of the source, for people."""
        packages = sorted({file.package for file in self.files if file.package is not None})
        if self.repository is None:
            return f"Python package {', '.join(packages)}"
        more = "".join(f", and Python package {package}" for package in packages)
        return f"{self.repository} at {self.commit}{more}"


def read_manifest(kind: Kind, folder: Path | None = None) -> dict[str, Asset]:
    """Return the assets of a kind by name; `folder` contains the manifests, by default of the program.

    Raises:
        AssetError: the file or an entry is missing or malformed, or names a path that leaves its folder.
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
    """An entry of a manifest, or a file of one; its values are checked when they are read."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self.values, self.where = values, where

    def text(self, key: str, form: re.Pattern[str] | None = None) -> str:
        value = self.values.get(key)
        if not (isinstance(value, str) and value) or (form is not None and not form.fullmatch(value)):
            needed = "a text" if form is None else f"like {form.pattern}"
            raise self.wrong(key, needed)
        if form is None and key not in PATH_KEYS and not is_valid(value):
            raise self.wrong(key, "a text of printable characters")
        return value

    def optional(self, key: str, form: re.Pattern[str] | None = None) -> str | None:
        return self.text(key, form) if key in self.values else None

    def relative(self, key: str, default: str | None = None) -> str:
        """Return a path that stays in its folder."""
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
        return AssetError(f"{self.where}: {key} = {quote_value(self.values.get(key))} must be {needed}")


def _asset(kind: Kind, name: str, values: Any, path: Path) -> Asset:
    where = f"{path}: {kind}/{name}"
    if not _NAME.fullmatch(name):
        raise AssetError(f"{where}: a name must consist of letters, digits, '_', '-' and single '.'")
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
        # Case does not count: folders on Windows and macOS ignore it.
        twice = next((place for i, place in enumerate(places) if place.lower() in map(str.lower, places[:i])), None)
        if twice is not None:
            raise AssetError(f"{entry.where}: two files have the same path '{twice}'")
    return files


def _file(file: _Entry, entry: _Entry) -> AssetFile:
    path = file.relative("path")
    place, mirror_place = file.relative("place", path), file.relative("mirror", path)
    return _asset_file(file, entry, path, place, mirror_place, f"{entry.relative('mirror')}/{mirror_place}")


def _object_file(entry: _Entry, name: str) -> AssetFile:
    """Return the single file of an object, named after the object whatever its origin."""
    path, mirror = entry.relative("path"), entry.relative("mirror")
    place, mirror_place = (name + PurePosixPath(file).suffix.lower() for file in (path, mirror))
    return _asset_file(entry, entry, path, place, mirror_place, mirror)


def _asset_file(file: _Entry, entry: _Entry, path: str, place: str, mirror_place: str, mirror: str) -> AssetFile:
    sha256 = file.optional("sha256", _SHA256)
    size = file.size("bytes") if "bytes" in file.values else None
    changed = file.optional("changed") or ""
    if not changed and (sha256 is None or size is None):
        raise AssetError(f"{file.where}: needs sha256 and bytes, or changed, the difference of the mirror's copy")
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
