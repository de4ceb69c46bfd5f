"""Where the files of assets come from: upstream, or a mirror that `GRASP_REFINE_ASSETS` names."""

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
"""Which of the two sets of paths and hashes in the manifests counts."""

VARIABLE = "GRASP_REFINE_ASSETS"
"""Names a mirror: a folder, or the base of http(s) addresses."""

HOW_TO_MIRROR = f"or name a mirror, {VARIABLE}=FOLDER or {VARIABLE}=https://..."
"""What to do where upstream cannot be reached."""


@dataclass(frozen=True)
class Wanted:
    """What a file of an asset has to be, and where it lies in the asset's folder."""

    place: str
    """Path in the asset's folder."""
    sha256: str | None
    """Its hash; None: it cannot be had from here."""
    size: int | None
    """Its bytes, where known."""


@dataclass(frozen=True)
class Upstream:
    """The repositories and Python packages that the manifests name."""

    base: str = "https://raw.githubusercontent.com"
    """Where the files of repositories are served: base/owner/name/commit/path."""
    layout: Literal["upstream"] = "upstream"
    """Which of the two sets of paths and hashes counts."""

    def source(self, asset: Asset, file: AssetFile) -> str | Path:
        """The address of a file, or its path where an installed Python package has it.

        Raises:
            AssetError: it cannot be had upstream as it is needed, or the package is not installed in that version.
        """
        if file.sha256 is None:
            raise AssetError(
                f"{asset.full_name}: upstream has its {file.mirror_place} only as {file.path} ({file.changed}); "
                f"fetch it from a mirror, {VARIABLE}=FOLDER or {VARIABLE}=https://..."
            )
        if file.package is not None:
            return _installed(asset, file, file.package)
        assert asset.repository is not None  # or its files would come from packages
        owner = asset.repository.removeprefix("https://github.com/")
        path = f"{asset.folder}/{file.path}" if asset.folder else file.path
        return f"{self.base}/{owner}/{asset.commit}/{quote(path)}"


@dataclass(frozen=True)
class Mirror:
    """A folder, or a web server, with the files of the manifests under their `mirror` paths."""

    base: str | Path
    """The folder, or what all addresses begin with."""
    layout: Literal["mirror"] = "mirror"
    """Which of the two sets of paths and hashes counts."""

    def source(self, asset: Asset, file: AssetFile) -> str | Path:
        """The address of a file, or its path."""
        if isinstance(self.base, Path):
            return self.base / file.mirror
        return f"{self.base.rstrip('/')}/{quote(file.mirror)}"


Origin = Upstream | Mirror


def chosen_origin() -> Origin:
    """The mirror that `GRASP_REFINE_ASSETS` names, or upstream where it names none.

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
    """An address or a path for people: without a login."""
    parts = urlsplit(str(source))
    if isinstance(source, Path) or "@" not in parts.netloc:
        return str(source)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()


def wanted(file: AssetFile, layout: Layout) -> Wanted:
    """What a file has to be when it comes from upstream, or from a mirror."""
    if layout == "mirror":
        return Wanted(file.mirror_place, file.mirror_sha256, file.mirror_size)
    return Wanted(file.place, file.sha256, file.size)


def total_bytes(asset: Asset, layout: Layout) -> int | None:
    """Bytes of all files of an asset, None where one of them is not known."""
    sizes = [wanted(file, layout).size for file in asset.files]
    known = [size for size in sizes if size is not None]
    return sum(known) if len(known) == len(sizes) else None


def _installed(asset: Asset, file: AssetFile, package: str) -> Path:
    """The path of a file of a Python package."""
    name, _, version = package.partition("==")
    todo = f"pip install --no-deps {package}"
    try:
        found = distribution(name)
    except PackageNotFoundError:
        raise AssetError(
            f"{asset.full_name}: comes with the Python package {name}, not installed here: {todo}, {HOW_TO_MIRROR}"
        ) from None
    if found.version != version:
        raise AssetError(
            f"{asset.full_name}: comes with the Python package {package}, {found.version} is installed here: {todo}, "
            f"{HOW_TO_MIRROR}"
        )
    return Path(str(found.locate_file(file.path)))
