"""Counts formatted for people."""

from __future__ import annotations

THIN_SPACE = "\u202f"
"""Thousands separator: a thin space that does not break lines."""


def whole(number: int) -> str:
    """Number with separated thousands: 12 345."""
    return f"{number:,}".replace(",", THIN_SPACE)


def count_text(number: int, noun: str, plural: str | None = None) -> str:
    """Number and noun, in the plural, by default with an s, except for 1: 1 convex piece, 2 convex pieces."""
    return f"{whole(number)} {noun if number == 1 else plural or f'{noun}s'}"
