"""Hands, weights, derivative methods, solvers, protocols and formats: each is complete everywhere."""

from __future__ import annotations

import inspect
import pkgutil
import re
from dataclasses import is_dataclass
from importlib import import_module
from types import ModuleType
from typing import get_args, get_type_hints

import pytest

from grasp_refine import witness
from grasp_refine.assets.manifest import read_manifest
from grasp_refine.hands.files.source import needs_urdf
from grasp_refine.hands.hand import list_hands
from grasp_refine.refinement import solvers
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene import protocols
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.witness.derivative import Derivative
from grasp_refine_apps.bench.align import variants as align_variants
from grasp_refine_apps.bench.grasp import variants as grasp_variants
from grasp_refine_apps.bench.stability import cases
from grasp_refine_apps.commands.settings import Settings
from hands.test_robots import JOINTS, MAKERS, PUBLISHED
from readme import ROOT
from witness.test_every_method import METHODS as TRIED
from witness.test_every_method import NEIGHBORHOODS


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
    assert {*MAKERS, *PUBLISHED} == set(JOINTS) == set(list_hands())


def test_weights_are_options():
    assert get_type_hints(Settings)["weights"] is Weights


# derivative methods

METHODS = [method for method in classes_of(witness, "pull_back") if not method.__name__.endswith("Slip")]


@pytest.mark.parametrize("method", METHODS)
def test_methods_are_frozen_dataclasses(method: type):
    assert is_dataclass(method) and method.__dataclass_params__.frozen
    assert isinstance(method(), Derivative)


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


# solvers

SOLVERS = [
    solver for solver in classes_of(solvers, "iterations") if is_dataclass(solver) and solver.__name__ != "FirstOrder"
]


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_are_frozen_dataclasses(solver: type):
    assert solver.__dataclass_params__.frozen and solver().iterations >= 1


def test_solvers_are_choices():
    assert choices(Settings, "solver") == {dashed(solver.__name__) for solver in SOLVERS}
    for solver in SOLVERS:
        assert issubclass(type(getattr(Settings(), dashed(solver.__name__).replace("-", "_"))), solver)


def test_solvers_are_measured():
    assert set(grasp_variants.SOLVERS.values()) == set(SOLVERS)
    assert set(grasp_variants.SOLVERS) == set(get_args(grasp_variants.SolverName))


def test_protocols_have_a_file_with_their_source():
    for name, protocol in PROTOCOLS.items():
        module = import_module(f"{protocols.__name__}.{name.replace('-', '_')}")
        assert protocol.name == name and protocol in vars(module).values()
        assert module.__doc__ and "\nSource: " in module.__doc__, name


def test_the_guide_lists_all_protocols():
    guide = (ROOT / "docs" / "pages" / "guides" / "validate.md").read_text(encoding="utf-8")
    (table,) = (part for part in guide.split("\n\n") if part.startswith("| Protocol |"))
    assert re.findall(r"^\| `([a-z][a-z-]+)` \| ", table, re.MULTILINE) == list(PROTOCOLS)
