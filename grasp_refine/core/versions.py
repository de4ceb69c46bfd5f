"""Versions of the packages that the program needs, and of those installed."""

from __future__ import annotations

import platform
import re
import tomllib
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

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
    """Packages that the program needs, by its installed metadata or, in a checkout not installed, by pyproject.toml."""
    try:
        lines = requires(NAME) or []
    except PackageNotFoundError:
        lines = _checkout_requirements()
    found = []
    for line in lines:
        name, bounds, marker = _REQUIREMENT.match(line).groups()  # type: ignore[union-attr]  # ours all match
        extra = _EXTRA.search(marker or "")
        # Metadata sorts the bounds by their text, which puts the upper one first.
        bounds = sorted((bound.strip() for bound in bounds.split(",") if bound.strip()), reverse=True)
        found.append(Requirement(name, ",".join(bounds), extra[1] if extra else None))
    return tuple(found)


def own_version() -> str:
    """Return the version of the program from its installed metadata."""
    try:
        return version(NAME)
    except PackageNotFoundError:
        return "0+not.installed"


def versions() -> dict[str, str]:
    """Name -> installed version of Python, the program and its required packages; for results."""
    packages = {need.name: need.installed for need in requirements() if need.extra is None}
    return {
        NAME: own_version(),
        "python": platform.python_version(),
        **{name: installed for name, installed in packages.items() if installed is not None},
    }


def _checkout_requirements() -> list[str]:
    file = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if not file.is_file():
        return []
    project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
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
