"""Forms of dataclasses: their fields as widgets, changed in a real viser server over its websocket as browsers do."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from operator import attrgetter
from typing import Any

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.report.fields import docs_of
from grasp_refine_apps.viewer.panels.form import (
    Entry,
    Form,
    Section,
    parts_of,
    plain,
    with_value,
)
from refusals import assert_names, refused
from websocket_page import Page, until


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
    chosen = {name: (part.chosen_by, part.choice) for name, part in SECTIONS.items()}
    assert chosen["adam"] == ("solver", "adam") and chosen["zeroth_order"] == ("derivative", "zeroth-order")
    assert chosen["weights"][0] == chosen["scales"][0] == ""
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


@pytest.mark.parametrize(
    "settings", [Settings(), Settings(max_move=(0.01, inf, 0.2), contacts=("a", "b"), seconds=2.5)]
)
def test_what_is_written_is_read_back(settings: Settings):
    for name, entry in SETTINGS.items():
        value = attrgetter(name)(settings)
        assert entry.read(entry.write(value)) == value, name


@pytest.mark.parametrize(
    "name, text, value",
    [
        ("tolerance", "1e-10", 1e-10),
        ("tolerance", " ", None),
        ("iterations", "50", 50),
        ("contacts", "thumb, index", ("thumb", "index")),
        ("contacts", "", ()),
        ("freeze", "palm, thumb", ("palm", "thumb")),
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
    assert changed.weights.wrench == 0.5 and attrgetter("weights.contact")(changed) == 1.0
    with refused(GraspRefineError, "damping", "0"):
        with_value(Settings(), "levenberg_marquardt.damping", 0.0)


class Shown:
    """A form of settings, what it told, and a page that shows it."""

    def __init__(self, server: Any, **options: Any) -> None:
        self.changes: list[Settings] = []
        self.errors: list[str] = []
        self.form = Form(
            server.gui,
            options.pop("value", Settings()),
            self.changes.append,
            self.errors.append,
            first=("solver", "weights", "margin", "tolerance"),
            left_out=("device",),
            patience=0.3,
            **options,
        )
        self.page = Page(server)

    def __getitem__(self, name: str) -> Any:
        return self.form.handles[name]

    def change(self, name: str, value: Any) -> None:
        self.page.change(self[name], value)

    def changed(self, count: int) -> Settings:
        """The last of so many changes."""
        until(lambda: len(self.changes) >= count)
        assert len(self.changes) == count
        return self.changes[-1]


@pytest.fixture
def shown(server: Any) -> Iterator[Shown]:
    shown = Shown(server)
    yield shown
    shown.page.close()


def test_widgets_show_the_dataclass(shown: Shown):
    assert shown["solver"].value == "levenberg-marquardt"
    assert shown["tolerance"].value == "" and shown["weights.wrench"].value == "0.0016"
    assert shown["starts"].value == Settings.starts and shown["geometry_only"].value is False
    assert "device" not in shown.form.handles
    # Those that were named come first.
    orders = [shown[name].order for name in ("solver", "weights", "margin", "tolerance")]
    assert orders == sorted(orders) and max(orders) < shown["starts"].order


def test_every_change_is_sent_as_a_new_dataclass(shown: Shown):
    shown.change("tolerance", "1e-10")
    assert shown.changed(1) == Settings(tolerance=1e-10)
    shown.change("geometry_only", True)
    shown.changed(2)
    shown.change("seed", 7)
    shown.changed(3)
    shown.change("weights.contact", "2.5")
    assert shown.changed(4) == Settings(
        tolerance=1e-10, geometry_only=True, seed=7, weights=replace(Settings().weights, contact=2.5)
    )
    assert not shown.errors


def test_what_is_half_typed_is_left_alone(shown: Shown):
    for text in ("1", "1e", "1e-", "1e-4", "1e-4 "):
        shown.change("margin", text)
    assert until(lambda: shown.changes and shown.changes[-1].margin == 1e-4)
    # "1e-4 " is no other number: the text stays as it was typed, and nothing is refused later.
    until(lambda: shown["margin"].value == "1e-4 ")
    shown.form.show(shown.changes[-1])
    assert shown.page.told(shown["margin"]) == []


@pytest.mark.parametrize(
    ("name", "text", "kept", "named"),
    [
        ("margin", "one", "0", ("Margin", "'one'")),
        ("levenberg_marquardt.damping", "0", "0.01", ("levenberg-marquardt", "damping", "0")),
    ],
)
def test_text_that_is_no_value_goes_back(shown: Shown, name: str, text: str, kept: str, named: tuple[str, ...]):
    shown.change(name, text)
    (error,) = until(lambda: shown.errors)
    assert_names(error, *named)
    assert shown[name].value == kept and shown.changes == []
    until(lambda: shown.page.told(shown[name]) == [kept])


def test_what_the_check_refuses_is_refused_and_a_choice_goes_back_at_once(server: Any):
    def check(settings: Settings) -> None:
        if settings.solver == "adam":
            raise GraspRefineError("not --solver adam")
        settings.config()

    shown = Shown(server, check=check)
    shown.change("margin", "-1")
    shown.change("seed", -1)
    until(lambda: len(shown.errors) == 2)
    margin, seed = sorted(shown.errors)
    assert_names(margin, "margin", "-1")
    assert_names(seed, "seed", "0 to 4294967295", "-1")
    shown.change("solver", "adam")
    until(lambda: shown.errors[2:] == ["not solver adam"])
    assert [shown[name].value for name in ("margin", "seed", "solver")] == ["0", 0, "levenberg-marquardt"]
    assert not shown.changes
    shown.page.close()


def test_options_of_a_method_are_seen_when_it_is_chosen(shown: Shown):
    methods = ("levenberg_marquardt", "descent", "adam")
    assert [shown[name].visible for name in methods] == [True, False, False]
    shown.change("solver", "adam")
    assert shown.changed(1) == Settings(solver="adam")
    until(lambda: [shown[name].visible for name in methods] == [False, False, True])


def test_hidden_options_are_at_their_defaults_and_come_back(shown: Shown):
    shown.change("levenberg_marquardt.damping", "0.5")
    damped = shown.changed(1)
    assert damped.levenberg_marquardt.damping == 0.5
    shown.change("solver", "descent")
    assert shown.changed(2) == Settings(solver="descent")
    shown.change("solver", "levenberg-marquardt")
    assert shown.changed(3) == damped


def test_showing_another_dataclass_sends_nothing(shown: Shown):
    other = Settings(solver="descent", tolerance=1e-9, max_move=(0.01, 0.1, 0.2), contacts=("thumb",))
    shown.form.show(other)
    assert shown["solver"].value == "descent" and shown["tolerance"].value == "1e-09"
    assert shown["max_move"].value == "0.01, 0.1, 0.2" and shown["contacts"].value == "thumb"
    assert shown["descent"].visible and not shown["levenberg_marquardt"].visible
    assert shown.changes == [] and shown.form.value == other
    shown.change("seed", 3)
    assert shown.changed(1) == replace(other, seed=3)


def test_a_state_that_comes_late_does_not_undo_what_was_typed_meanwhile(shown: Shown):
    before = shown.form.value
    for count, text in enumerate(("2", "25", "250"), start=1):
        shown.change("weights.table", text)
        until(lambda: shown["weights.table"].value == text)  # noqa: B023 - called in this turn
        if count == 1:
            shown.changed(1)
    last = until(lambda: shown.changes[-1].weights.table == 250.0 and shown.changes[-1])
    for late in (before, *shown.changes, last):
        shown.form.show(late)
        assert shown["weights.table"].value == "250"
    shown.form.show(replace(before))
    assert shown["weights.table"].value == "100"
