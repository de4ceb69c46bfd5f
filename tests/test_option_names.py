"""The library speaks of its fields, in backticks; the command prints them as its options."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from command_line import refused
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.cli import main
from grasp_refine_apps.report.command_line import in_options
from grasp_refine_apps.report.screen import screen

OPTION = r"--[a-z][\w-]*(?:\.[\w-]+)*"

LIBRARY = Path(__file__).resolve().parents[1] / "grasp_refine"


def texts(path: Path) -> Iterator[tuple[str, bool]]:
    """Each text in a file, with {} for values in it, and whether it is documentation, which messages are not."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values), False
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            yield node.value, id(node) in documentation


@pytest.fixture(scope="module")
def options() -> set[str]:
    """The options of the commands that read hands, objects and grasps, as their help shows them."""
    found: set[str] = set()
    for command in ("run", "batch", "validate", "view", "convert", "hands", "assets fetch"):
        with pytest.MonkeyPatch.context() as patch:
            printed: list[str] = []
            patch.setattr("sys.stdout.write", printed.append)
            with pytest.raises(SystemExit):
                main([*command.split(), "--help"])
        for line in re.findall(r"^. (?:-h, )?(--.*)", "".join(printed), re.MULTILINE):
            found |= set(re.findall(OPTION, line))
    return found - {"--help"}


def test_the_library_names_no_option_of_the_command(options: set[str]):
    named = {
        f"{path.name}: {option}"
        for path in LIBRARY.rglob("*.py")
        for text, _ in texts(path)
        for option in set(re.findall(OPTION, text)) & options
    }
    assert not named


@pytest.mark.slow
def test_each_field_in_a_message_of_the_library_is_an_option(options: set[str]):
    """Also those in the help of fields; a name that is no option would be printed as one."""
    named = {
        f"{path.name}: {text}"
        for path in LIBRARY.rglob("*.py")
        for text, documentation in texts(path)
        if not documentation or path.name == "spec.py"
        for option in re.findall(OPTION, in_options(text))
        if option not in options and in_options(text) != text
    }
    assert not named


@pytest.mark.slow
def test_a_field_of_the_library_is_printed_as_the_option(capfd: pytest.CaptureFixture[str]):
    with pytest.raises(GraspRefineError, match="`scale` .*0"):
        ProblemSpec(scale=0).check()
    assert refused(capfd, "run", "--scale", "0").startswith("--scale ")


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("raise `max_move`", "raise --max-move"),
        ("`unit='mm'` or `scale`", "--unit mm or --scale"),
        ("`urdf=FILE`, or `hand='my hand'`", "--urdf FILE, or --hand my hand"),
        ("a `GraspSet`, as `refine-grasp hands` has it", "a `GraspSet`, as `refine-grasp hands` has it"),
    ],
)
def test_names_and_values_of_fields(text: str, printed: str, capsys: pytest.CaptureFixture[str]):
    assert in_options(text) == printed
    screen().print(text, soft_wrap=True)
    assert capsys.readouterr().out == f"{printed}\n"
