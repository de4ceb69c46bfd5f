"""Names out of files that may come from anyone: whether a person can be shown them and a file can be called so."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import numpy as np

INVALID_CHARACTERS = ("Cc", "Cs", "Zl", "Zp")
"""Kinds of letters in Unicode: those that control a terminal, halves of letters, and ends of lines and paragraphs."""

CODES_AT_ONCE = 2**20
"""Codes of letters that are looked at together, which bounds the memory that it takes."""

BIDI = frozenset("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Letters that turn the order in which others are shown, so that a name looks like another one."""

FORMULA = tuple("=+-@\t\r\n\uff1d\uff0b\uff0d\uff20")
"""What spreadsheets take for the beginning of a formula, in its wide forms too."""


def is_valid(text: str) -> bool:
    """Whether a text holds no letters that control a terminal, end a line, turn the order, or that no text has."""
    return text.isprintable() or not any(
        unicodedata.category(letter) in INVALID_CHARACTERS or letter in BIDI for letter in text
    )


def are_valid(texts: np.ndarray) -> bool:
    """The same of an array of texts, whose codes need not be those of letters at all."""
    if not texts.itemsize or not texts.size:
        return True
    codes = np.ascontiguousarray(texts).reshape(-1, 1).view(np.uint32)
    rows = max(CODES_AT_ONCE // codes.shape[1], 1)
    return all(_are_letters(codes[start : start + rows]) for start in range(0, len(codes), rows))


def _are_letters(codes: np.ndarray) -> bool:
    """Whether all codes (N, length) are those of letters, as `is_valid` has them."""
    # Zeros fill a text up to its end; before another letter they are letters.
    padding = np.logical_and.accumulate((codes == 0)[:, ::-1], axis=1)[:, ::-1]
    control = (codes < 32) | ((codes >= 127) & (codes < 160)) | (codes == 0x2028) | (codes == 0x2029)
    turning = np.isin(codes, [ord(letter) for letter in BIDI])
    half = (codes >= 0xD800) & (codes < 0xE000)
    return not ((control & ~padding) | turning | half | (codes >= 0x110000)).any()


def to_cell(text: str) -> str:
    """The text for a cell of a CSV: one that a spreadsheet would run as a formula begins with an apostrophe.

    `from_cell` reads it again.
    """
    return f"'{text}" if text.lstrip("'").startswith(FORMULA) else text


def from_cell(cell: str) -> str:
    """The text that `to_cell` wrote."""
    return cell[1:] if cell.startswith("'") and cell.lstrip("'").startswith(FORMULA) else cell


def is_file(path: Path) -> bool:
    """Whether there is such a file; what cannot be the name of one, such as a text of 300 letters, is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; what cannot be the name of one is none."""
    try:
        return path.is_dir()
    except OSError:
        return False


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; what cannot be the name of one is none."""
    try:
        return path.exists()
    except OSError:
        return False


def expand_user(path: Path) -> Path:
    """The path with a ~ at its beginning replaced, as it is where there is no such home."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path
