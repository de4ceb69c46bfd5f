"""The way of the data runs one direction: a file imports only from stages before its own."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = "grasp_refine"
ROOT = Path(__file__).resolve().parents[1] / PACKAGE

ORDER = (
    "errors",
    "arguments",
    "brief",
    "names",
    "counts",
    "toml_file",
    "versions",
    "cores",
    "interruption",
    "stopwatch",
    "se3",
    "batch",
    "assets",
    "atomic",
    "geometry.units",
    "geometry.holes",
    "geometry.mesh",
    "geometry.cache",
    "geometry.decomposition",
    "geometry.rings",
    "geometry.pieces",
    "geometry.nearest_triangle",
    "geometry.over_cover",
    "geometry.covering",
    "geometry.sampling",
    "geometry.body",
    "geometry.shapes",
    "asset_library",
    "description",
    "hand_source",
    "hand",
    "kinematics",
    "chain",
    "object_folders",
    "objects",
    "npz",
    "grasps",
    "rebase",
    "plane",
    "scene",
    "formats",
    "collision",
    "self_collision",
    "witness",
    "losses",
    "wrench",
    "equilibrium",
    "targets",
    "hand_object",
    "convention_check",
    "squeeze",
    "quality",
    "goal",
    "solvers",
    "glimpse",
    "max_move",
    "config",
    "grasp_problem",
    "objective",
    "holding",
    "refine",
    "pregrasp",
    "grip",
    "placement",
    "grasp_sampling",
    "validation",
    "replay",
    "problem",
    "report",
    "apps",
    "commands",
    "cli",
)
"""Files and folders of the package, each after what it may import; inside a folder there is only no cycle."""

LIGHT = (
    "errors",
    "arguments",
    "brief",
    "names",
    "toml_file",
    "versions",
    "se3",
    "assets",
    "asset_library",
    "geometry",
    "description",
    "hand",
    "object_folders",
    "objects",
    "atomic",
    "npz",
    "grasps",
    "cli",
)
"""What must answer before torch is loaded: listing hands, `--help`, reading files."""

HEAVY = {"torch", "coal", "coacd", "pytorch_kinematics"}

COAL = ("collision.asking", "collision.narrowphase", "grasp_refine_apps.bench.queries.peers")
"""The only file that talks to coal, and the benchmark that measures plain coal as its peer."""


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(path, ROOT): path for path in sorted(ROOT.rglob("*.py"))}
# Installed, apps/ lies in the package.
FILES |= {module_name(path, ROOT.parent): path for path in sorted((ROOT.parent / "apps").rglob("*.py"))}


def resolve(module: str, node: ast.AST) -> Iterator[str]:
    """The full names of the modules that an import statement in `module` may load."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            package = [PACKAGE, *module.split(".")] if module else [PACKAGE]
            if FILES[module].name != "__init__.py":
                package = package[:-1]
            package = package[: len(package) - node.level + 1]
            base = ".".join([*package, base] if base else package)
        for alias in node.names:
            inner = f"{base}.{alias.name}"
            yield inner if inner.removeprefix(f"{PACKAGE}.") in FILES else base


def imports(module: str) -> set[str]:
    """All modules that `module` names in an import anywhere, also for type checking only."""
    tree = ast.parse(FILES[module].read_text(encoding="utf-8"))
    return {name for node in ast.walk(tree) for name in resolve(module, node)}


def imports_on_load(module: str) -> set[str]:
    """The modules that are loaded together with `module`: not those inside functions or for type checking."""

    def visit(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        yield from resolve(module, node)
        for child in ast.iter_child_nodes(node):
            yield from visit(child)

    return set(visit(ast.parse(FILES[module].read_text(encoding="utf-8"))))


def inside(names: set[str]) -> set[str]:
    """Those of `names` that are of our package, without its name; "" is the package itself."""
    return {name.removeprefix(PACKAGE).removeprefix(".") for name in names if name.split(".")[0] == PACKAGE}


def stage(module: str) -> int | None:
    """The place of a module in ORDER; a package counts as its last file, None when it is not listed."""
    hits = [
        i
        for i, name in enumerate(ORDER)
        if module == name or module.startswith(f"{name}.") or name.startswith(f"{module}.")
    ]
    return hits[-1] if hits else None


def test_the_package_itself_imports_nothing_of_ours():
    assert not inside(imports(""))


@pytest.mark.parametrize("module", [name for name in FILES if name])
def test_imports_run_one_way(module: str):
    own = stage(module)
    assert own is not None, f"{FILES[module]} has no place in ORDER: add it after what it imports"
    for other in inside(imports(module)) - {"", module}:
        there = stage(other)
        assert there is not None, f"{module} imports {other}, which does not exist or has no place in ORDER"
        assert there <= own, f"{module} imports {other}, which comes after it"


def test_no_cycle_inside_a_folder():
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, f"imports run in a circle: {' -> '.join([*path, module])}"
        if module not in done:
            for other in inside(imports(module)) & set(FILES) - {"", module}:
                visit(other, (*path, module))
            done.add(module)

    for module in FILES:
        visit(module, ())


@pytest.mark.parametrize("module", [name for name in FILES if name.split(".")[0] in LIGHT])
def test_light_files_load_nothing_heavy(module: str):
    """Neither themselves nor through what they import when loaded."""
    seen: set[str] = set()
    waiting = [module]
    while waiting:
        current = waiting.pop()
        if current in seen or current not in FILES:
            continue
        seen.add(current)
        loaded = imports_on_load(current)
        heavy = {name.split(".")[0] for name in loaded} & HEAVY
        assert not heavy, f"{module} loads {', '.join(sorted(heavy))} through {current or PACKAGE}"
        waiting.extend(inside(loaded))
        # Loading a.b loads the package a first.
        waiting.extend(name.rpartition(".")[0] for name in inside(loaded))


@pytest.mark.parametrize("module", [name for name in FILES if name not in COAL])
def test_only_the_narrow_phase_talks_to_coal(module: str):
    assert "coal" not in {name.split(".")[0] for name in imports(module)}
