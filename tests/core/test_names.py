"""Names that come out of files of others: what is refused as one, and what is no path of anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.names import are_valid, exists, expand_user, from_cell, is_file, is_folder, is_valid, to_cell

SOUND = ("FFJ4", "", "with space", "ö手", "\U0001f590", "non\xa0breaking")
INVALID_CHARACTERS = ("a\nb", "\t", "\x1b[2J", "\x7f", "\x9b2J", "a\0b", "\u2028", "\u2029", "\ud800")
INVALID_CHARACTERS += ("exe.\u202egpj", "\u202a", "\u2066a\u2069", "\u2067", "\u2068")


@pytest.mark.parametrize("text", SOUND)
def test_letters_of_names(text: str):
    assert is_valid(text) and are_valid(np.array([text, "longer than all of them"]))


@pytest.mark.parametrize("text", INVALID_CHARACTERS)
def test_what_controls_a_terminal_or_is_no_letter_is_no_name(text: str):
    assert not is_valid(text) and not are_valid(np.array(["fine", text, "longer than all of them"]))


FORMULAS = ("=HYPERLINK(1)", "@SUM(1)", "+1", "-1", "\t=1", "\r=1", "\n=1", "\uff1d1", "'=1", "''@x")


@pytest.mark.parametrize("text", [*FORMULAS, "mug", "", "'", "it's", "'mug", "a=b", "1-2"])
def test_cells_hold_no_formulas_and_are_read_again(text: str):
    cell = to_cell(text)
    assert not cell.startswith(tuple("=+-@\t\r\n\uff1d")) and from_cell(cell) == text
    assert (cell == text) == (text not in FORMULAS)


def test_arrays_of_no_texts():
    assert are_valid(np.zeros(0, "<U4")) and are_valid(np.zeros((2, 3), "<U0")) and are_valid(np.array("x"))
    codes = np.array([[0x110000, 0]], dtype=np.uint32)
    assert not are_valid(codes.view("<U2"))


@pytest.mark.parametrize("name", ["a" * 300, "a/" * 3000, "a\0b", "no such"])
def test_what_cannot_be_the_name_of_a_file_is_none(tmp_path: Path, name: str):
    # Python raises "File name too long" for the first two.
    assert not (is_file(tmp_path / name) or is_folder(tmp_path / name) or exists(tmp_path / name))


def test_files_and_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").touch()
    assert is_file(tmp_path / "file") and exists(tmp_path / "file") and not is_folder(tmp_path / "file")
    assert is_folder(tmp_path) and exists(tmp_path) and not is_file(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert expand_user(Path("~/file")) == tmp_path / "file"
    assert expand_user(Path("~nobody-is-called-so/file")) == Path("~nobody-is-called-so/file")
