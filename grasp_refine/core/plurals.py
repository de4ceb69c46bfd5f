"""Counts as people read them."""

from __future__ import annotations

THIN_SPACE = "\u202f"
"""The space between thousands, at which no line breaks."""


def whole(number: int) -> str:
    """The number with thousands apart: 12 345."""
    return f"{number:,}".replace(",", THIN_SPACE)


def count_text(number: int, noun: str) -> str:
    """The number and the noun, in the plural but for one: 1 convex piece, 2 convex pieces."""
    return f"{whole(number)} {noun}{'' if number == 1 else 's'}"
