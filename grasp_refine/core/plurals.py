"""Counts formatted for people."""

from __future__ import annotations

from collections.abc import Sequence

THIN_SPACE = "\u202f"
"""Thousands separator: a thin space that does not break lines."""

MAX_NAMED = 6
"""Most names of one kind in a note."""


def whole(number: int) -> str:
    """Number with separated thousands: 12 345."""
    return f"{number:,}".replace(",", THIN_SPACE)


def count_text(number: int, noun: str, plural: str | None = None) -> str:
    """Number and noun, in the plural, by default with an s, except for 1: 1 convex piece, 2 convex pieces."""
    return f"{whole(number)} {noun if number == 1 else plural or f'{noun}s'}"


def first_of(texts: Sequence[str], most: int) -> list[str]:
    """The first texts, at most so many, and how many others there are: a, b, and 3 more."""
    return [*texts[:most], *([f"and {len(texts) - most} more"] if len(texts) > most else [])]


def names_text(names: Sequence[str]) -> str:
    """Names for a note, of many the first: a, b, c, d, e, f, and 30 more."""
    return ", ".join(first_of(names, MAX_NAMED))
