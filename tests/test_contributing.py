"""What the checklists of CONTRIBUTING.md ask for is so, and each of their items has a test."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_type_hints

import pytest
import test_robots

from grasp_refine import validation, witness
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.grasps.formats.listing import FORMATS, FormatName
from grasp_refine.hands.hand import list_hands
from grasp_refine.hands.source import needs_urdf
from grasp_refine.refinement import losses, solvers
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.losses import Weights
from grasp_refine.validation.metrics import Metrics
from grasp_refine.validation.protocol import SETTINGS, SettingName
from grasp_refine.witness.derivative import Derivative
from grasp_refine_apps.bench.align import variants as align_variants
from grasp_refine_apps.bench.grasp import variants as grasp_variants
from grasp_refine_apps.bench.stability import cases
from grasp_refine_apps.cli import COMMANDS
from grasp_refine_apps.commands.settings import Settings, WeightsOptions
from readme import ROOT, TEXT, section
from witness.test_every_method import METHODS as TRIED
from witness.test_every_method import NEIGHBORHOODS

CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
ITEMS = [" ".join(item.split()) for item in re.findall(r"^- \[ \] (.*(?:\n  .*)*)", CONTRIBUTING, re.MULTILINE)]


def named_tests(text: str) -> list[tuple[str, str]]:
    """File and function of each test that a text names."""
    return re.findall(r"`(tests/[\w/]+\.py)::(test_\w+)`", text)


def functions(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text("utf-8")).body if isinstance(node, ast.FunctionDef)}


def source(path: str) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def classes_of(package: ModuleType, attribute: str) -> list[type]:
    """The classes with an attribute that the modules of a package define, protocols left out."""
    modules = [import_module(f"{package.__name__}.{found.name}") for found in pkgutil.iter_modules(package.__path__)]
    return [
        member
        for module in modules
        for _, member in inspect.getmembers(module, inspect.isclass)
        if member.__module__ == module.__name__
        and hasattr(member, attribute)
        and not getattr(member, "_is_protocol", False)
        and not member.__name__.startswith("_")
        and not inspect.isabstract(member)
    ]


def dashed(name: str) -> str:
    """The option of a class: ContactKinematics -> contact-kinematics."""
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


# the checklists themselves


@pytest.mark.parametrize("item", ITEMS)
def test_every_item_names_tests_that_exist(item: str):
    found = named_tests(item.partition("→")[2])
    assert found, "end the item with → and the test that enforces it"
    for path, test in found:
        assert test in functions(ROOT / path), f"{path} has no {test}"


def test_the_checklists_that_were_promised_are_there():
    assert re.findall(r"^## Add a (.*)$", CONTRIBUTING, re.MULTILINE) == [
        "hand", "loss term", "derivative method", "solver", "validator", "format of grasp files", "command",
    ]  # fmt: skip
    parts = re.split(r"^## ", CONTRIBUTING, flags=re.MULTILINE)[1:]
    assert all(part.count("- [ ]") >= 3 for part in parts) and len(ITEMS) >= 30


def test_the_files_that_are_named_exist():
    paths = set(re.findall(r"`([\w./]+/[\w./]+)`", CONTRIBUTING))
    assert len(paths) >= 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_every_test_of_this_file_belongs_to_an_item_or_to_the_lists():
    own = {test for path, test in named_tests(CONTRIBUTING) if path == "tests/test_contributing.py"}
    about_lists = {name for name in functions(Path(__file__)) if name.startswith(("test_every_item", "test_the_"))}
    written = {name for name in functions(Path(__file__)) if name.startswith("test_")}
    assert written - own - about_lists == {"test_every_test_of_this_file_belongs_to_an_item_or_to_the_lists"}


# hands


@pytest.mark.parametrize("hand", list_hands())
def test_hands_have_their_files(hand: str):
    folder = ROOT / "robots" / hand
    text = (folder / "hand.toml").read_text(encoding="utf-8")
    assert "[[contact]]" in text and "[rest_pose]" in text
    assert all(text.count(f"\n{key} = ") == text.count("[[contact]]") for key in ("link", "point", "normal", "group"))
    if needs_urdf(hand):
        assert hand in read_manifest("hands")
    else:
        assert all((folder / f"example_{name}.npz").is_file() for name in ("mug", "bottle", "rounded_box"))


def test_hands_are_compared_with_the_makers():
    assert set(test_robots.MAKERS) == set(test_robots.JOINTS) == set(list_hands())


@pytest.mark.parametrize("hand", list_hands())
def test_hands_are_told(hand: str):
    told = TEXT.partition("\n### Hands\n")[2].partition("\n### ")[0]
    assert re.search(rf"\b{hand}\b", told, re.IGNORECASE)


# terms of the loss

TERMS = re.findall(r"^\| `(\w+)` \| `([\w.]+)` \| `([\w.]+)` \| (.*) \|$", CONTRIBUTING, re.MULTILINE)


def part(name: str) -> Any:
    """A function or class by its place in the package."""
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(f"grasp_refine.{module}"), attribute)


def imported(path: str) -> set[str]:
    """The names that a file imports from the package and uses."""
    tree = ast.parse(source(path))
    names = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("grasp_refine")
        for alias in node.names
    }
    return names & {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def test_every_weight_has_a_term():
    assert {weight for weight, *_ in TERMS} == {field.name for field in fields(Weights)}
    text = source("grasp_refine/refinement/losses.py")
    for field in fields(Weights):
        (said,) = re.findall(rf'^    {field.name}: float = .*\n    """([^"]*)"""', text, re.MULTILINE)
        assert re.search(r"m\^2|\(metres\)", said), f"the weight {field.name} does not say its unit"


@pytest.mark.parametrize(("weight", "residuals", "derivative", "used"), TERMS)
def test_terms_are_where_the_table_says(weight: str, residuals: str, derivative: str, used: str):
    assert callable(part(residuals)) and callable(part(derivative))
    assert used in ("both", "gradients", "least squares")


@pytest.mark.parametrize(("weight", "residuals", "derivative", "used"), TERMS)
def test_terms_are_used_where_the_table_says(weight: str, residuals: str, derivative: str, used: str):
    least_squares, gradients = "grasp_refine/refinement/grasp_problem.py", "grasp_refine/refinement/objective.py"
    names = {name.rpartition(".")[2] for name in (residuals, derivative)}
    if used != "gradients":
        assert names <= imported(least_squares) and f"weights.{weight}" in source(least_squares)
    if used != "least squares":
        # There autograd differentiates.
        assert residuals.rpartition(".")[2] in imported(gradients) and f"weights.{weight}" in source(gradients)
    assert (used == "gradients") == (f"weights.{weight}" not in source(least_squares))
    assert (used == "least squares") == (f"weights.{weight}" not in source(gradients))


def test_terms_are_tested():
    for _, *names, _ in TERMS:
        for module, _, attribute in (name.rpartition(".") for name in names):
            tests = f"tests/test_{module}.py"
            # The tests of forces ask a whole problem, which has them as an attribute.
            assert attribute in imported(tests) or f".{attribute.lower()}." in source(tests), (tests, attribute)
    # And there is no residual or derivative in the file that the table does not know.
    known = {name.rpartition(".")[2] for _, *names, _ in TERMS for name in names}
    public = {name for name in functions(Path(losses.__file__)) if not name.startswith("_")}
    assert public - known == {"plane_depth"}, "a term without a row; plane_depth is below_plane without its sides"


def test_weights_are_options():
    assert issubclass(WeightsOptions, Weights)
    assert get_type_hints(Settings)["weights"] is WeightsOptions


# derivative methods

METHODS = [method for method in classes_of(witness, "pull_back") if not method.__name__.endswith("Slip")]


@pytest.mark.parametrize("method", METHODS)
def test_methods_are_frozen_dataclasses(method: type):
    assert is_dataclass(method) and method.__dataclass_params__.frozen
    assert isinstance(method(), Derivative)
    assert len(inspect.getdoc(method).splitlines()) >= 3, "say what is exact, what is approximated, what is held fixed"


@pytest.mark.parametrize("method", METHODS)
def test_every_method_passes_the_common_checks(method: type):
    tried = [found for found in TRIED.values() if type(found) is method]
    assert tried, "add it to METHODS of tests/witness/test_every_method.py"
    if hasattr(method(), "neighborhood"):
        wanted = {type(rule) for rule in NEIGHBORHOODS.values()}
        assert {type(found.neighborhood) for found in tried} == wanted
    if hasattr(method(), "coupling"):
        assert {found.coupling for found in tried} == {"coupled", "one-sided"}


def choices(holder: type, name: str) -> set[str]:
    """What an option may be."""
    return set(get_args(get_type_hints(holder)[name]))


def test_methods_are_options():
    assert choices(Settings, "derivative") == {dashed(method.__name__) for method in METHODS}
    for method in METHODS:
        options = type(getattr(Settings(), dashed(method.__name__).replace("-", "_")))
        assert issubclass(options, method)


UNMEASURED = {"rigid": "bench stability: its points do not slip, so that there is nothing that could be unstable"}
"""Methods that a benchmark leaves out, and why."""


def test_methods_are_measured():
    names = {dashed(method.__name__) for method in METHODS}
    assert set(get_args(align_variants.MethodName)) == names
    assert set(cases.METHODS) == names - set(UNMEASURED)


def test_methods_are_told():
    for method in METHODS:
        assert f"| `{method.__module__.removeprefix('grasp_refine.')}.{method.__name__}` |" in section("In Python")


# solvers

SOLVERS = [
    solver for solver in classes_of(solvers, "iterations") if is_dataclass(solver) and "Schedule" != solver.__name__
]


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_are_frozen_dataclasses(solver: type):
    assert solver.__dataclass_params__.frozen and solver().iterations >= 1
    assert Path(inspect.getfile(solver)).stem == dashed(solver.__name__).replace("-", "_")
    assert "GraspRefineError" in inspect.getdoc(solver.__post_init__), "settings that cannot be are refused"


def test_solvers_are_choices():
    assert set(get_args(get_type_hints(Config)["solver"])) == set(SOLVERS)
    assert choices(Settings, "solver") == {dashed(solver.__name__) for solver in SOLVERS}
    for solver in SOLVERS:
        assert issubclass(type(getattr(Settings(), dashed(solver.__name__).replace("-", "_"))), solver)


def test_solvers_are_measured():
    assert set(grasp_variants.SOLVERS.values()) == set(SOLVERS)
    assert set(grasp_variants.SOLVERS) == set(get_args(grasp_variants.SolverName))


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_are_tested(solver: type):
    assert solver.__name__ in imported(f"tests/solvers/test_{Path(inspect.getfile(solver)).name}")


def test_solvers_are_told():
    for solver in SOLVERS:
        assert f"`{solver.__module__.removeprefix('grasp_refine.')}.{solver.__name__}`" in section("In Python")


# validators


FORBIDDEN = ("solvers", "losses", "refine", "holding", "grasp_problem", "objective", "config")
"""What validators do not import, but for the type of a callback."""


def test_validators_do_not_know_how_grasps_were_found():
    for found in pkgutil.iter_modules(validation.__path__):
        tree = ast.parse(source(f"grasp_refine/validation/{found.name}.py"))
        names = {
            (node.module or "", alias.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        known = {
            module.split(".")[1] for module, name in names if module.startswith("grasp_refine.") and name != "Progress"
        }
        assert not known & set(FORBIDDEN), found.name


def test_measures_say_their_unit():
    text = source("grasp_refine/validation/metrics.py")
    for measure in fields(Metrics):
        (said,) = re.findall(rf'^    {measure.name}: .*\n    """([^"]*)"""', text, re.MULTILINE)
        assert "(N,)" in said
        assert measure.name.endswith("_m") or not re.search(r"\bmetres\b", said)
    assert "NaN" in inspect.getdoc(Metrics)


def test_measures_are_written():
    document = source("grasp_refine/results/validation_document.py")
    for measure in fields(Metrics):
        assert f'"{measure.name}": ' in document and f"metrics.{measure.name}[i]" in document


def test_measures_are_tested():
    tests = source("tests/validation/test_metrics.py")
    for measure in fields(Metrics):
        assert f".{measure.name}" in tests, measure.name


def test_settings_of_the_simulation_are_choices():
    assert tuple(SETTINGS) == get_args(SettingName)
    assert all(name == protocol.name for name, protocol in SETTINGS.items())


def test_settings_of_the_simulation_are_told():
    assert all(f"`{name}`" in section("Do they hold?") for name in SETTINGS)


# formats and commands


def test_formats_are_listed():
    assert [known.name for known in FORMATS] == list(get_args(FormatName))
    for known in FORMATS:
        assert Path(inspect.getfile(type(known))).stem == known.name


def test_formats_are_told():
    told = TEXT.partition("\n### Grasps of other programs\n")[2].partition("\n### ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", told, re.MULTILINE)) == set(get_args(FormatName))


def test_commands_are_told():
    assert [name for name in COMMANDS if not re.search(rf"refine-grasp {name}(?![\w-])", TEXT)] == []
