"""Forms in a real viser server, changed over its websocket as browsers do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

viser = pytest.importorskip("viser", reason="the viewer comes with the extra 'viewer'")

from grasp_refine.core.errors import GraspRefineError  # noqa: E402
from grasp_refine_apps.commands.settings import Settings  # noqa: E402
from grasp_refine_apps.viewer.forms import Form  # noqa: E402
from refusals import assert_names  # noqa: E402
from websocket_page import Page, until  # noqa: E402


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
        return self.form._handles[name]

    def change(self, name: str, value: Any) -> None:
        self.page.change(self[name], value)

    def changed(self, count: int) -> Settings:
        """The last of so many changes."""
        until(lambda: len(self.changes) >= count)
        assert len(self.changes) == count
        return self.changes[-1]


@pytest.fixture
def server() -> Iterator[Any]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def shown(server: Any) -> Iterator[Shown]:
    shown = Shown(server)
    yield shown
    shown.page.close()


def test_widgets_show_the_dataclass(shown: Shown):
    assert shown["solver"].value == "levenberg-marquardt"
    assert shown["tolerance"].value == "" and shown["weights.wrench"].value == "0.0016"
    assert shown["starts"].value == Settings.starts and shown["geometry_only"].value is False
    assert "device" not in shown.form._handles
    # Those that were named come first.
    orders = [shown[name].order for name in ("solver", "weights", "margin", "tolerance")]
    assert orders == sorted(orders) and max(orders) < shown["starts"].order


def test_every_change_is_told_as_a_new_dataclass(shown: Shown):
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
    assert not shown.form._waiting and shown.page.told(shown["margin"]) == []


def test_text_that_is_no_number_is_refused_in_words(shown: Shown):
    shown.change("margin", "one")
    (error,) = until(lambda: shown.errors)
    assert_names(error, "Margin", "'one'")
    assert shown["margin"].value == "0" and shown.changes == []
    until(lambda: shown.page.told(shown["margin"]) == ["0"])


def test_what_the_dataclass_refuses_is_refused(shown: Shown):
    shown.change("levenberg_marquardt.damping", "0")
    (error,) = until(lambda: shown.errors)
    assert_names(error, "levenberg-marquardt", "damping", "0")
    assert shown["levenberg_marquardt.damping"].value == "0.01" and not shown.changes


def test_what_the_check_refuses_is_refused(server: Any):
    shown = Shown(server, check=lambda settings: settings.config())
    shown.change("margin", "-1")
    shown.change("seed", -1)
    until(lambda: len(shown.errors) == 2)
    margin, seed = sorted(shown.errors)
    assert_names(margin, "margin", "-1")
    assert_names(seed, "seed", "0 to 4294967295", "-1")
    assert (shown["margin"].value, shown["seed"].value) == ("0", 0) and not shown.changes
    shown.page.close()


def test_a_choice_that_is_refused_goes_back_at_once(server: Any):
    def check(settings: Settings) -> None:
        if settings.solver == "adam":
            raise GraspRefineError("not --solver adam")

    shown = Shown(server, check=check)
    shown.change("solver", "adam")
    assert until(lambda: shown.errors) == ["not solver adam"]
    assert shown["solver"].value == "levenberg-marquardt"
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


def test_unused_fields_are_hidden_and_their_methods_with_them(server: Any):
    def unused(settings: Settings) -> tuple[str, ...]:
        return ("derivative",) if settings.solver == "levenberg-marquardt" else ("starts",)

    shown = Shown(server, unused=unused, value=Settings(starts=9))
    assert not shown["derivative"].visible and not shown["contact_kinematics"].visible
    shown.change("solver", "descent")
    assert shown.changed(1) == Settings(solver="descent")
    until(lambda: shown["contact_kinematics"].visible)
    assert shown["derivative"].visible and not shown["starts"].visible
    shown.page.close()


def test_showing_another_dataclass_tells_nothing(shown: Shown):
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


def test_two_pages_see_the_same(server: Any, shown: Shown):
    other = Page(server)
    shown.change("tolerance", "1e-8")
    until(lambda: other.told(shown["tolerance"]) == ["1e-8"])
    other.change(shown["solver"], "adam")
    until(lambda: shown.page.told(shown["solver"]) == ["adam"])
    assert shown.changed(2) == Settings(solver="adam", tolerance=1e-8)
    other.close()


def test_python_setting_a_widget_is_no_change_by_a_user(shown: Shown):
    shown["seed"].value = 5
    assert shown.changes == [] and shown.form.value == Settings()
