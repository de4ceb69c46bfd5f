"""Messages of errors: one line of bounded length that a terminal only shows, whatever a file has put into them."""

from __future__ import annotations

import pickle

import pytest

from grasp_refine.core.errors import MAX_MESSAGE_CHARACTERS, GraspRefineError, MeshError, quote_value


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("a.obj: plain, with ö and 手", "a.obj: plain, with ö and 手"),
        ("two\nlines\r\nand\ttabs", "two lines and tabs"),
        ("clears \x1b[2J the screen", "clears \\x1b[2J the screen"),
        ("so does \x9b2J, in one letter", "so does \\x9b2J, in one letter"),
        ("half a letter \ud800, no letter \x00", "half a letter \\ud800, no letter \\x00"),
        ("backwards \u202edrowssap", "backwards \\u202edrowssap"),
    ],
)
def test_a_message_is_one_line_that_a_terminal_only_shows(message: str, shown: str):
    assert str(GraspRefineError(message)) == shown
    assert str(pickle.loads(pickle.dumps(MeshError(message)))) == shown


def test_a_message_is_of_bounded_length():
    assert len(str(GraspRefineError("x" * 10**6))) == MAX_MESSAGE_CHARACTERS
    assert str(GraspRefineError("x" * MAX_MESSAGE_CHARACTERS)) == "x" * MAX_MESSAGE_CHARACTERS


def test_values_are_shown_like_repr_but_bounded():
    for value in ("box", "it's", 1.5, -3, None, [1, 2], {"a": 1}, 10**30):
        assert quote_value(value) == repr(value)
    assert len(quote_value("x" * 10**5)) <= 200
    # Python prints no integers of more than 4300 digits, and TOML reads them in hexadecimal.
    assert quote_value(16**9000) == "an integer of thousands of digits"
    deep: list = []
    for _ in range(10**5):
        deep = [deep]
    assert quote_value(deep) == "[[[[...]]]]"
