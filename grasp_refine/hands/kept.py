"""Structures that are built once for each hand, and kept while it lives."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

from grasp_refine.hands.hand import Hand

P = ParamSpec("P")
T = TypeVar("T")


def kept(build: Callable[Concatenate[Hand, P], T]) -> Callable[Concatenate[Hand, P], T]:
    """Return a function that calls `build` once for each hand and other arguments, which must be hashable.

    A structure is dropped with its hand, so it must not refer to it.
    """
    structures: WeakKeyDictionary[Hand, dict[object, T]] = WeakKeyDictionary()

    @wraps(build)
    def get(hand: Hand, /, *args: P.args, **kwargs: P.kwargs) -> T:
        of_hand = structures.setdefault(hand, {})
        key = args, tuple(kwargs.items())
        if key not in of_hand:
            of_hand[key] = build(hand, *args, **kwargs)
        return of_hand[key]

    return get
