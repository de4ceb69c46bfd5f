"""Names out of untrusted files: checks that they can be displayed and used as file names."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from pathlib import Path

import numpy as np

INVALID_CHARACTERS = ("Cc", "Cs", "Zl", "Zp")
"""Unicode categories refused in names: control characters, surrogates, and line and paragraph separators."""

CODES_AT_ONCE = 2**20
"""Code points that are checked at a time, which bounds the memory."""

BIDI_CONTROLS = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that reverse the display order of others, so that one name looks like another."""

FORMULA_STARTS = tuple("=+-@\t\r\n\uff1d\uff0b\uff0d\uff20")
"""Characters with which a spreadsheet formula begins, including their full-width forms."""


def is_valid(text: str) -> bool:
    """Return whether a text is free of terminal controls, line ends, display-order controls and lone surrogates."""
    return text.isprintable() or not any(
        unicodedata.category(character) in INVALID_CHARACTERS or character in BIDI_CONTROLS for character in text
    )


def are_valid(texts: np.ndarray) -> bool:
    """Return whether all texts of an array are valid; their codes need not be Unicode code points."""
    if not texts.itemsize or not texts.size:
        return True
    codes = np.ascontiguousarray(texts).reshape(-1, 1).view(np.uint32)
    rows = max(CODES_AT_ONCE // codes.shape[1], 1)
    return all(_are_valid_codes(codes[start : start + rows]) for start in range(0, len(codes), rows))


def _are_valid_codes(codes: np.ndarray) -> bool:
    """Return whether all codes (N, length) are code points that `is_valid` accepts."""
    # Zeros pad a text at its end; before another character they are characters.
    padding = np.logical_and.accumulate((codes == 0)[:, ::-1], axis=1)[:, ::-1]
    control = (codes < 32) | ((codes >= 127) & (codes < 160)) | (codes == 0x2028) | (codes == 0x2029)
    turning = np.isin(codes, [ord(character) for character in BIDI_CONTROLS])
    half = (codes >= 0xD800) & (codes < 0xE000)
    return not ((control & ~padding) | turning | half | (codes >= 0x110000)).any()


def to_cell(text: str) -> str:
    """Text for a cell of a CSV; an apostrophe protects one that a spreadsheet would run as a formula.

    `from_cell` is the inverse.
    """
    return f"'{text}" if text.lstrip("'").startswith(FORMULA_STARTS) else text


def from_cell(cell: str) -> str:
    """Text from a CSV cell that `to_cell` wrote."""
    return cell[1:] if cell.startswith("'") and cell.lstrip("'").startswith(FORMULA_STARTS) else cell


def is_file(path: Path) -> bool:
    """Return whether the file exists; false for an impossible name, such as one of 300 characters."""
    return _is_possible(path.is_file)


def is_folder(path: Path) -> bool:
    """Return whether the folder exists; false for an impossible name."""
    return _is_possible(path.is_dir)


def exists(path: Path) -> bool:
    """Return whether the file or folder exists; false for an impossible name."""
    return _is_possible(path.exists)


def _is_possible(check: Callable[[], bool]) -> bool:
    try:
        return check()
    except OSError:
        return False


def expand_user(path: Path) -> Path:
    """Return the path with a leading ~ expanded; unchanged where there is no such home."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path
