"""How fields of a dataclass become widgets."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Annotated, Literal

import pytest
from tyro.conf import Suppress, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.losses import Scales, Weights
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.entries import Entry, Section, as_text, docs_of, parts_of, plain, value_of, with_value
from refusals import refused


def entries(parts: tuple[Entry | Section, ...]) -> dict[str, Entry]:
    found = {}
    for part in parts:
        found |= entries(part.parts) if isinstance(part, Section) else {part.name: part}
    return found


SETTINGS = entries(parts_of(Settings))
SECTIONS = {part.name: part for part in parts_of(Settings) if isinstance(part, Section)}


def test_the_settings_of_the_command_line_have_a_widget_each():
    shown = {name: SETTINGS[name].widget for name in ("solver", "geometry_only", "starts", "margin", "iterations")}
    assert shown == {
        "solver": "choice",
        "geometry_only": "tick",
        "starts": "number",
        "margin": "text",
        "iterations": "text",
    }
    assert SETTINGS["solver"].choices == ("levenberg-marquardt", "descent", "adam")
    assert SETTINGS["max_move"].label == "Max move"


def test_what_the_command_line_leaves_out_is_left_out():
    assert not {"descent.iterations", "distance.seed", "weights.direction"} & set(SETTINGS)
    assert "rigid" not in SECTIONS and "adam.first" in SETTINGS


def test_hints_are_docstrings_with_the_default_that_the_command_line_says():
    docs = docs_of(Settings)
    assert SETTINGS["margin"].hint == f"{docs['margin']} (default: 0)"
    assert SETTINGS["iterations"].hint.endswith(" (default: 200; descent, adam: 2000)")
    samples = SETTINGS["adaptive.samples"].hint
    assert samples.endswith(" (default: 16)") and "empty" in samples and "None" not in samples
    # Of a base class, whose subclass has none.
    damping = docs_of(LevenbergMarquardt)["damping"]
    assert SETTINGS["levenberg_marquardt.damping"].hint == f"{damping} (default: 0.01)"
    # In one line, after what its folder is about.
    assert SETTINGS["weights.contact"].hint.startswith(f"{docs['weights']} {docs_of(Weights)['contact']}")
    assert SETTINGS["scales.rotation"].hint.startswith(f"{plain(docs['scales'])} {docs_of(Scales)['rotation']}")
    assert "--weights.stay-near" in docs["scales"] and "weights: stay near" in SETTINGS["scales.rotation"].hint
    assert all(entry.hint for entry in SETTINGS.values())
    assert not any("--" in entry.hint or "\n" in entry.hint for entry in SETTINGS.values())


def test_a_folder_knows_which_choice_it_belongs_to():
    assert (SECTIONS["adam"].chosen_by, SECTIONS["adam"].choice) == ("solver", "adam")
    assert (SECTIONS["zeroth_order"].chosen_by, SECTIONS["zeroth_order"].choice) == ("derivative", "zeroth-order")
    assert SECTIONS["fixed"].chosen_by == "neighborhood"
    assert SECTIONS["weights"].chosen_by == "" and SECTIONS["scales"].chosen_by == ""


@pytest.mark.parametrize(
    "settings", [Settings(), Settings(max_move=(0.01, inf, 0.2), contacts=("a", "b"), seconds=2.5)]
)
def test_what_is_written_is_read_back(settings: Settings):
    for name, entry in SETTINGS.items():
        value = value_of(settings, name)
        assert entry.read(entry.write(value)) == value, name


@pytest.mark.parametrize(
    "value, text",
    [
        (1e-10, "1e-10"),
        (0.0016, "0.0016"),
        (100.0, "100"),
        (0.1 + 0.2, "0.30000000000000004"),
        (inf, "inf"),
        (None, ""),
    ],
)
def test_numbers_are_short_and_lose_nothing(value: float | None, text: str):
    assert as_text(value) == text
    assert value is None or float(text) == value


@pytest.mark.parametrize(
    "name, text, value",
    [
        ("tolerance", "1e-10", 1e-10),
        ("tolerance", " ", None),
        ("iterations", "50", 50),
        ("contacts", "thumb, index", ("thumb", "index")),
        ("contacts", "", ()),
        ("max_move", "0.01, inf 0.2", (0.01, inf, 0.2)),
        ("descent.shares", "0.5 0.8", (0.5, 0.8)),
    ],
)
def test_text_is_read(name: str, text: str, value: object):
    assert SETTINGS[name].read(text) == value


@pytest.mark.parametrize(
    "name, text, named",
    [
        ("margin", "1 mm", ("'1 mm'",)),
        ("margin", "", ("''",)),
        ("iterations", "1.5", ("'1.5'",)),
        ("max_move", "0.1, 0.2", ("3", "0.01,0.1,0.2", "2")),
        ("descent.factors", "0.1, x", ("'x'",)),
    ],
)
def test_text_that_is_no_value_is_refused(name: str, text: str, named: tuple[str, ...]):
    with refused(ValueError, *named):
        SETTINGS[name].read(text)


def test_a_field_inside_another_is_replaced():
    changed = with_value(Settings(), "weights.wrench", 0.5)
    assert changed.weights.wrench == 0.5 and value_of(changed, "weights.contact") == 1.0
    with refused(GraspRefineError, "damping", "0"):
        with_value(Settings(), "levenberg_marquardt.damping", 0.0)


def test_options_are_called_as_in_the_form():
    assert plain("--weights.stay-near is 0; raise --max-move") == "weights: stay near is 0; raise max move"


@dataclass(frozen=True)
class Inner:
    """Inside."""

    depth: float = 1.5
    """How deep."""


@dataclass(frozen=True)
class Other:
    """Any dataclass."""

    kind: Literal[1, 2] = 1
    hidden: Suppress[int] = 3
    named: Annotated[str | None, arg(help_behavior_hint="(default: nobody)")] = None
    inner: Inner = field(default_factory=Inner)


def test_any_dataclass_will_do():
    found = entries(parts_of(Other))
    assert list(found) == ["kind", "named", "inner.depth"]
    assert found["kind"].choices == ("1", "2") and found["kind"].read("2") == 2
    assert found["named"].hint == "(default: nobody)" and found["named"].read("x") == "x"
    assert docs_of(Inner) == {"depth": "How deep."}


@dataclass(frozen=True)
class Odd:
    """A field that no widget can show."""

    what: dict[str, int] = field(default_factory=dict)


def test_a_type_without_a_widget_is_named():
    with refused(TypeError, "what", "dict"):
        parts_of(Odd)
