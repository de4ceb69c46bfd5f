"""The console for people: its width, and text that cannot control a terminal."""

from collections.abc import Callable

import pytest
from rich.console import Group, RenderableType

from grasp_refine_apps.report.screen import screen


def test_the_screen_is_80_to_100_columns(monkeypatch: pytest.MonkeyPatch):
    for columns, width in (("40", 80), ("90", 90), ("200", 100)):
        monkeypatch.setenv("COLUMNS", columns)
        assert screen().width == width


@pytest.mark.parametrize("wrapped", [lambda text: text, lambda text: Group("b", text)], ids=["alone", "in a group"])
def test_what_is_printed_controls_no_terminal(
    wrapped: Callable[[str], RenderableType], capsys: pytest.CaptureFixture[str]
):
    screen().print(wrapped("a \x1b[31m\x9b2J\u202eé\nb"), markup=False, soft_wrap=True)
    out = capsys.readouterr().out
    assert all(character.isprintable() or character == "\n" for character in out)
    assert "a \\x1b[31m\\x9b2J\\u202eé\nb" in out
