"""Versions of required and of installed packages."""

from __future__ import annotations

import platform
import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from grasp_refine.core.source_version import RELEASE, source_version

NAME = "grasp-refine"

_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*([^;]*?)\s*(?:;\s*(.*))?$")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")


@dataclass(frozen=True)
class Requirement:
    """A package that the program needs."""

    name: str
    """Name of the distribution."""
    range: str
    """Supported versions, such as ">=2.6,<2.14"."""
    extra: str | None = None
    """The extra that requires it; None: it is always needed."""

    @property
    def installed(self) -> str | None:
        """Installed version; None: not installed."""
        try:
            return version(self.name)
        except PackageNotFoundError:
            return None

    @property
    def problem(self) -> str:
        """Fault of the installed version: "missing", "too old", "too new"; empty: none."""
        installed = self.installed
        if installed is None:
            return "missing"
        have = _release(installed)
        for bound in filter(None, self.range.split(",")):
            if bound.startswith(">=") and have < _release(bound[2:]):
                return "too old"
            if bound.startswith("<") and not bound.startswith("<=") and have >= _release(bound[1:]):
                return "too new"
        return ""


def requirements() -> tuple[Requirement, ...]:
    """Packages that the program needs, by pyproject.toml of the checkout that runs, or by its installed metadata."""
    root = _checkout()
    try:
        lines = (requires(NAME) or []) if root is None else _pyproject_requirements(root)
    except PackageNotFoundError:
        lines = []
    found = []
    for line in lines:
        name, bounds, marker = _REQUIREMENT.match(line).groups()  # type: ignore[union-attr]  # ours all match
        extra = _EXTRA.search(marker or "")
        # Metadata sorts the bounds by their text, which puts the upper one first.
        bounds = sorted((bound.strip() for bound in bounds.split(",") if bound.strip()), reverse=True)
        found.append(Requirement(name, ",".join(bounds), extra[1] if extra else None))
    return tuple(found)


@cache
def own_version() -> str:
    """Return the version with the commit of the checkout that runs, or of the installed build: "0.2.0+g1234567".

    Git is asked when the version is first needed, since the commit may have moved after an editable installation.
    """
    root = _checkout()
    try:
        return version(NAME) if root is None else source_version(root)
    except PackageNotFoundError:
        return RELEASE


def versions() -> dict[str, str]:
    """Name -> installed version of Python, the program and its required packages; for results."""
    packages = {need.name: need.installed for need in requirements() if need.extra is None}
    return {
        NAME: own_version(),
        "python": platform.python_version(),
        **{name: installed for name, installed in packages.items() if installed is not None},
    }


def _checkout() -> Path | None:
    """Return the folder of the checkout that runs, installed as an editable or not; None: the files of a wheel run."""
    root = Path(__file__).resolve().parents[2]
    return root if (root / "pyproject.toml").is_file() and (root / "robots").is_dir() else None


def _pyproject_requirements(root: Path) -> list[str]:
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project.get("optional-dependencies", {})
    return project["dependencies"] + [
        f"{line}; extra == '{extra}'" for extra, lines in extras.items() for line in lines
    ]


def _release(text: str) -> tuple[int, ...]:
    """Release numbers of a version, without pre-release and local parts: "2.6.0+cpu" -> (2, 6)."""
    numbers = [int(number) for number in re.match(r"[0-9.]*", text.strip())[0].split(".") if number]  # type: ignore[index]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)
