"""Cache of inputs in memory: files, hands and objects that the next problem needs too."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

MAX_ENTRIES = {"file": 2, "hand": 4, "object": 16}
"""Largest number of entries of each kind, of any other kind 4, which bounds the memory of a worker."""

Value = TypeVar("Value")


class InputCache:
    """Cache of values by kind and key; of each kind, the last used ones are kept."""

    def __init__(self) -> None:
        """Begin empty."""
        self._kinds: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, made by `make` where it is not held."""
        known = self._kinds.setdefault(kind, OrderedDict())
        if key not in known:
            # Before `make`, so that there are never more than `MAX_ENTRIES` in memory.
            while len(known) >= MAX_ENTRIES.get(kind, 4):
                known.popitem(last=False)
            known[key] = make()
        known.move_to_end(key)
        return known[key]


class NoCache(InputCache):
    """A cache that holds nothing: each value is made anew."""

    def get(self, kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return a new value."""
        return make()
