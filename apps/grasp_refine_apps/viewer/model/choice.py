"""Choice of grasps for commands on many: all, the listed ones, or the ones marked good."""

from __future__ import annotations

from typing import Literal, get_args

from grasp_refine_apps.viewer.model.present import present
from grasp_refine_apps.viewer.model.state import State

Choice = Literal["all", "listed", "marked good"]
CHOICES: tuple[Choice, ...] = get_args(Choice)
"""Choices of several grasps."""


def chosen(state: State, choice: str) -> tuple[int, ...]:
    """Return the numbers of the chosen grasps; listed ones in the order of the list."""
    collection = state.collection
    if choice == "listed":
        return tuple(state.listing.numbers(present(state)).tolist())
    every = range(len(collection))
    return tuple(n for n in every if collection.mark(n) == "good") if choice == "marked good" else tuple(every)
