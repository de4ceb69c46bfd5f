"""Hands of the Python package robot_descriptions, which clones the repositories of their makers into its cache.

Each description is a module with the paths of its files: `URDF_PATH` or `MJCF_PATH`, and variants such as
`URDF_PATH_LEFT`. Only modules of the installed package are imported, and of what they clone only the named file, and
its meshes, are read.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from grasp_refine.core.errors import AssetError

PREFIX = "robot_descriptions/"
"""Beginning of the names of hands that the package describes."""

PACKAGE = "robot_descriptions"
"""Name of the package, on PyPI and to import."""

ENDINGS = ("", "_description", "_mj_description")
"""Endings of the names of its modules that may be left out; a URDF is preferred."""

_NAME = re.compile(r"[a-z0-9_+]+")

_PATH = re.compile(r"(?:URDF|MJCF)_PATH(?:_(\w+))?")


def described(name: str, on_message: Callable[[str], None]) -> tuple[str, Path]:
    """Return the full name and the file of a hand, cloned by the package where it is not in its cache.

    Args:
        name: robot_descriptions/NAME, NAME with or without its ending _description or _mj_description; and /VARIANT,
            such as /left, where there are several.
        on_message: Called with a line before something may be cloned.

    Raises:
        AssetError: the package is not installed, has no such description or variant, or cannot clone it.
    """
    base, _, variant = name.removeprefix(PREFIX).partition("/")
    module = next((base + end for end in ENDINGS if _is_module(base + end)), None)
    if module is None:
        raise AssetError(f"{name}: {_missing(base)}")
    on_message(f"{PREFIX}{module}: its files are taken from the cache of {PACKAGE}, or cloned by it")
    paths = _paths(_imported(module, name))
    wanted = variant.lower()
    if wanted not in paths:
        known = ", ".join(filter(None, sorted(paths))) or "none"
        raise AssetError(f"{name}: has no URDF or MJCF '{variant}'; variants: {known} (xacro files are not read)")
    path = Path(paths[wanted])
    if not path.is_file():
        raise AssetError(f"{name}: its file {path} is missing in the cache of {PACKAGE}: delete that clone")
    return f"{PREFIX}{module}{f'/{wanted}' if wanted else ''}", path


def _is_module(module: str) -> bool:
    """Return True if it is a description of the installed package, not of a folder of that name."""
    if not (_NAME.fullmatch(module) and module.endswith("_description")):
        return False
    found = find_spec(PACKAGE)
    try:
        installed = distribution(PACKAGE)
    except PackageNotFoundError:
        return False
    folder = Path(str(installed.locate_file(PACKAGE)))
    if found is None or found.origin is None or Path(found.origin).resolve().parent != folder.resolve():
        return False
    return (folder / f"{module}.py").is_file()


def _missing(base: str) -> str:
    try:
        version = distribution(PACKAGE).version
    except PackageNotFoundError:
        return (
            f"needs the Python package {PACKAGE}, which is not installed: pip install 'grasp-refine[{PACKAGE}]'; it "
            "clones the repositories of hands from the network"
        )
    return f"{PACKAGE} {version} has no description '{base}'; the command {PACKAGE} list, and its page, name them"


def _imported(module: str, name: str) -> ModuleType:
    try:
        # It prints its progress to standard output, which is ours.
        with redirect_stdout(sys.stderr):
            return import_module(f"{PACKAGE}.{module}")
    # Importing runs git, whose errors are of any type.
    except Exception as error:
        reason = " ".join(str(error).split())[:300]
        raise AssetError(
            f"{name}: {PACKAGE} cannot get its repository ({type(error).__name__}: {reason}); with a network, run "
            f"python -c 'import {PACKAGE}.{module}' once: then its cache (ROBOT_DESCRIPTIONS_CACHE, by default "
            "~/.cache/robot_descriptions) has it, and can be copied to where there is none"
        ) from None


def _paths(module: ModuleType) -> dict[str, str]:
    """Return the variants of a description, in lower case, "" for the default, and their files."""
    found = {}
    for attribute, value in vars(module).items():
        match = _PATH.fullmatch(attribute)
        if match and isinstance(value, str):
            found[(match[1] or "").lower()] = value
    return found
