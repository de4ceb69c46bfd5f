"""Tests nearest to a module: the file of its name, or the folder that mirrors its own; and those that import it."""

from __future__ import annotations

import re
from pathlib import Path

TESTS = Path("tests")
ROOTS = {Path("grasp_refine"): TESTS, Path("apps/grasp_refine_apps"): TESTS / "apps"}
"""Packages -> folders of tests that mirror them."""

FEW = 6
"""Most files of tests that import a module; more of them test something else with it."""


def module_name(path: Path) -> str:
    """Return the dotted name of a source file."""
    parts = path.with_suffix("").parts
    parts = parts[1:] if parts[0] == "apps" else parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def nearest_tests(path: Path) -> list[str]:
    """Return files of tests: the one of the same name, or those of its folder; then importers of the module, if few."""
    root = next(root for root in ROOTS if path.is_relative_to(root))
    mirror = ROOTS[root] / path.relative_to(root).parent
    while not list(mirror.glob("test_*.py")):
        mirror = mirror.parent
    module = module_name(path)
    parent, _, name = module.rpartition(".")
    imports = re.compile(rf"{re.escape(module)}\b|from {re.escape(parent)} import .*\b{name}\b")
    everywhere = sorted(TESTS.rglob("test_*.py"))
    importing = [file for file in everywhere if imports.search(file.read_text(encoding="utf-8"))]
    named = [file for file in mirror.glob("*.py") if file.name == f"test_{path.stem}.py"]
    near = importing if len(importing) <= FEW else [file for file in importing if file.parent == mirror]
    return list(dict.fromkeys(map(str, (*(named or sorted(mirror.glob("test_*.py"))), *near))))
