"""Options are made of the fields of the library: in groups, those of a method where it is chosen."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import get_type_hints

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.spec import ProblemSpec, SourceSpec
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.inputs import Inputs, Sources
from grasp_refine_apps.commands.options import parse
from grasp_refine_apps.commands.run import Run
from grasp_refine_apps.commands.settings import Settings


def shown(capsys: pytest.CaptureFixture[str], *words: str) -> set[str]:
    """The options that the help of a command line shows."""
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    return set(re.findall(r"^. (--[a-z][\w.-]*)", capsys.readouterr().out, re.MULTILINE))


def test_options_of_a_method_appear_where_it_is_chosen(capsys: pytest.CaptureFixture[str]):
    few = shown(capsys, "run")
    assert few & {"--derivative", "--device", "--weights.contact"} == set()
    more = shown(capsys, "run", "--solver", "adam", "--derivative=distance")
    assert few < more and more - few >= {
        *("--derivative", "--device", "--weights.contact", "--scales.rotation"),
        *("--adam.first", "--distance.coupling"),
    }
    # They have an option of their own, for all solvers and derivatives.
    assert not {"--adam.iterations", "--distance.seed", "--weights.direction"} & more
    assert not [option for option in more if option.startswith("--descent.")]


@pytest.mark.parametrize(("kind", "library"), [(Inputs, ProblemSpec), (Sources, SourceSpec), (Settings, None)])
def test_every_field_has_a_group(kind: type[Inputs | Sources | Settings], library: type | None):
    """Whoever adds a field to the library decides where the help shows it."""
    grouped = [name for group in kind.groups for name in group.names]
    methods = {name for name, hint in get_type_hints(kind).items() if is_dataclass(hint)}
    assert len(grouped) == len(set(grouped))
    assert set(grouped) | methods == {one.name for one in fields(library or kind)} | methods


def test_an_option_without_a_value_of_its_own_takes_only_values():
    with pytest.raises(GraspRefineError, match="--unit"):
        parse(Run, "run", ["--unit", "None"])
    run = parse(Run, "run", ["--touch", "above:z=0", "--touch", "box:0,0,0,1,1,1", "--no-view", "--adam.first=0.5"])
    assert run.inputs.touch == ("above:z=0", "box:0,0,0,1,1,1") and run.settings.adam == Adam(first=0.5)
    assert (run.inputs.unit, run.inputs.table, run.inputs.index) == (None, None, ())


def test_numbers_that_a_method_refuses_are_named_as_its_options():
    with pytest.raises(GraspRefineError, match="--scales.rotation.*0"):
        parse(Run, "run", ["--scales.rotation", "0"])
