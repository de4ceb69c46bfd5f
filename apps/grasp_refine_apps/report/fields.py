"""Fields of dataclasses, which options and widgets are made of: their docstrings, and fields that are no options."""

from __future__ import annotations

from dataclasses import is_dataclass
from functools import cache

from docstring_parser import parse_from_object


class Without:
    """Annotation of a field that is a dataclass itself: these fields of it are neither options nor widgets."""

    def __init__(self, *names: str) -> None:
        """Name the fields."""
        self.names = names


@cache
def docs_of(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a dataclass, its bases' too, each in one line."""
    return {
        param.arg_name: " ".join(param.description.split())
        for base in reversed(kind.__mro__)
        if is_dataclass(base)
        for param in parse_from_object(base).params
        if param.description
    }
