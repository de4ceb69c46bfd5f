"""Data runs one way: a folder imports only from folders below its own, and the library nothing of the application."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARY, APPLICATION = "grasp_refine", "grasp_refine_apps"

ORDER = (
    "grasp_refine.core",
    "grasp_refine.geometry",
    "grasp_refine.assets",
    "grasp_refine.collision",
    "grasp_refine.witness",
    "grasp_refine.hands.files",
    "grasp_refine.hands.linkages",
    "grasp_refine.hands",
    "grasp_refine.scans",
    "grasp_refine.objects",
    "grasp_refine.grasps",
    "grasp_refine.grasps.formats",
    "grasp_refine.scene.protocols",
    "grasp_refine.scene",
    "grasp_refine.forces",
    "grasp_refine.measures",
    "grasp_refine.sampling",
    "grasp_refine.refinement.solvers",
    "grasp_refine.refinement.terms",
    "grasp_refine.refinement",
    "grasp_refine.transfers",
    "grasp_refine.closing",
    "grasp_refine.validation.engines",
    "grasp_refine.validation.engines.mujoco",
    "grasp_refine.validation.engines.drake",
    "grasp_refine.validation.engines.physx",
    "grasp_refine.validation",
    "grasp_refine.validation.margins",
    "grasp_refine.validation.replay",
    "grasp_refine.motion",
    "grasp_refine.results",
    "grasp_refine.export",
    "grasp_refine.problem",
    "grasp_refine",
    "grasp_refine_apps.report",
    "grasp_refine_apps.margins",
    "grasp_refine_apps.authoring",
    "grasp_refine_apps.processes",
    "grasp_refine_apps.batch",
    "grasp_refine_apps.grasp_page",
    "grasp_refine_apps.bench",
    "grasp_refine_apps.bench.align",
    "grasp_refine_apps.bench.grasp",
    "grasp_refine_apps.bench.queries",
    "grasp_refine_apps.bench.stability",
    "grasp_refine_apps.bench.success",
    "grasp_refine_apps.bench.scans",
    "grasp_refine_apps.bench.transfer",
    "grasp_refine_apps.bench.gate",
    "grasp_refine_apps.viewer",
    "grasp_refine_apps.viewer.model",
    "grasp_refine_apps.viewer.meters",
    "grasp_refine_apps.viewer.jobs",
    "grasp_refine_apps.viewer.drawing",
    "grasp_refine_apps.viewer.server",
    "grasp_refine_apps.viewer.files",
    "grasp_refine_apps.viewer.panels",
    "grasp_refine_apps.commands",
    "grasp_refine_apps",
)
"""Folders, each after those that it imports."""

LIGHT = (
    "grasp_refine",
    "grasp_refine.core",
    "grasp_refine.geometry",
    "grasp_refine.assets",
    "grasp_refine.hands.hand",
    "grasp_refine.objects.object",
    "grasp_refine.grasps.grasp_set",
    "grasp_refine_apps.cli",
)
"""Modules and folders that load none of HEAVY: `--help`, reading files and listing hands are instant."""

HEAVY = {"torch", "coal", "coacd", "pytorch_kinematics", "mujoco", "viser"}

SELDOM = {"scipy", "trimesh", "networkx", "jaxtyping", "array_api_compat", "manifold3d", "lxml"}
"""Packages that the library loads only where it uses them: each delays every command that does not, too."""

ARRAY_TYPES = "grasp_refine.core.array_types"
"""Module that takes its types from jaxtyping where that is loaded already."""

COAL = (
    "grasp_refine.collision.certified_distance",
    "grasp_refine_apps.bench.queries.peers",
)
"""Modules that call coal: the narrow phase, and the benchmark that measures plain coal as its peer."""


def module_name(path: Path) -> str:
    """The full name of the module in a file below the source folders."""
    source = ROOT / "apps" if path.is_relative_to(ROOT / "apps") else ROOT
    parts = path.relative_to(source).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {
    module_name(path): path
    for folder in (ROOT / LIBRARY, ROOT / "apps" / APPLICATION)
    for path in sorted(folder.rglob("*.py"))
}


def folder_of(module: str) -> str:
    """The folder that a module lies in."""
    return module if FILES[module].name == "__init__.py" else module.rpartition(".")[0]


def resolve(module: str, node: ast.AST) -> Iterator[str]:
    """The full names of the modules that an import statement in `module` may load."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            package = folder_of(module).split(".")
            base = ".".join([*package[: len(package) - node.level + 1], *([base] if base else [])])
        for alias in node.names:
            inner = f"{base}.{alias.name}"
            yield inner if inner in FILES else base


@cache
def imports(module: str, *, on_load: bool = False) -> frozenset[str]:
    """Modules that `module` imports anywhere; `on_load`: not inside functions, and not for type checking only."""

    def visit(node: ast.AST) -> Iterator[str]:
        if on_load and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            return
        if on_load and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        yield from resolve(module, node)
        for child in ast.iter_child_nodes(node):
            yield from visit(child)

    return frozenset(visit(ast.parse(FILES[module].read_text(encoding="utf-8"))))


def ours(names: frozenset[str]) -> frozenset[str]:
    """Those of `names` that are modules of the library or the application."""
    return names & FILES.keys()


def test_every_folder_has_a_place():
    assert {folder_of(module) for module in FILES} == set(ORDER)


def test_no_file_is_loose():
    loose = {path.name for folder in (ROOT / LIBRARY, ROOT / "apps") for path in folder.glob("*.py")}
    assert loose == {"__init__.py"}


def test_imports_run_one_way():
    place = {module: ORDER.index(folder_of(module)) for module in FILES}
    above = {
        f"{module} imports {other} from above its folder"
        for module in FILES
        for other in ours(imports(module))
        if place[other] > place[module]
    }
    assert not above


def test_the_library_knows_nothing_of_the_application():
    """Neither an import nor a name in a string, which would be an import by another way."""
    library = [path for module, path in FILES.items() if module.split(".")[0] == LIBRARY]
    assert not [path for path in library if APPLICATION in path.read_text(encoding="utf-8")]


def test_no_circle_of_files():
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, f"imports run in a circle: {' -> '.join([*path, module])}"
        if module not in done:
            for other in ours(imports(module)) - {LIBRARY, module}:
                visit(other, (*path, module))
            done.add(module)

    for module in FILES:
        visit(module, ())


def test_light_modules_load_nothing_heavy():
    """Neither themselves nor through what they import when loaded."""
    seen: set[str] = set()
    waiting = [module for module in FILES if module in LIGHT or folder_of(module) in LIGHT]
    assert len(waiting) > len(LIGHT)
    while waiting:
        current = waiting.pop()
        if current in seen:
            continue
        seen.add(current)
        loaded = imports(current, on_load=True)
        heavy = {name.split(".")[0] for name in loaded} & HEAVY
        assert not heavy, f"{current}, which a light module loads, loads {', '.join(sorted(heavy))}"
        waiting.extend(ours(loaded))
        # Loading a.b loads the package a first.
        waiting.extend(name.rpartition(".")[0] for name in ours(loaded) if "." in name)


def test_the_library_loads_what_is_seldom_used_where_it_is_used():
    library = [module for module in FILES if module.split(".")[0] == LIBRARY and module != ARRAY_TYPES]
    loaded = {
        f"{module} loads {package}"
        for module in library
        for package in {name.split(".")[0] for name in imports(module, on_load=True)} & SELDOM
    }
    assert not loaded


def test_only_the_narrow_phase_talks_to_coal():
    callers = {module for module in FILES if "coal" in {name.split(".")[0] for name in imports(module)}}
    assert callers == set(COAL)
