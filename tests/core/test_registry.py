"""Registries: names are unique, additions stand after ours, and packages of others are read by their entry points."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from operator import attrgetter

import pytest

from grasp_refine.core import registry
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.registry import Registry
from refusals import refused


@dataclass(frozen=True)
class Thing:
    name: str
    size: int = 1


THIRD = Thing("third", 3)
"""Entry that an entry point names."""


def made(monkeypatch: pytest.MonkeyPatch, *points: str) -> Registry[Thing]:
    """A registry of two things, in an environment with some entry points."""
    found = [EntryPoint("any", value, "a.group") for value in points]
    monkeypatch.setattr(registry, "entry_points", lambda group: found if group == "a.group" else [])
    ours = Thing("first"), Thing("second")
    return Registry("thing", "a.group", ours, name_of=attrgetter("name"), check=lambda it: check_kind("it", it, Thing))


def test_additions_come_last_and_are_found_by_name(monkeypatch: pytest.MonkeyPatch):
    things = made(monkeypatch, f"{__name__}:THIRD")
    large = things.view(lambda every: (thing for thing in every if thing.size > 1))
    things.add(Thing("fourth", 4))
    assert [thing.name for thing in things] == ["first", "second", "third", "fourth"] and len(things) == 4
    assert list(large) == [THIRD, Thing("fourth", 4)] and large[-1] is things["fourth"] and len(large) == 2
    things.remove("fourth")
    assert list(large) == [THIRD]
    with refused(GraspRefineError, "thing 'fourth'", "first, second, third"):
        things["fourth"]


def test_names_are_taken_once(monkeypatch: pytest.MonkeyPatch):
    things = made(monkeypatch, f"{__name__}:THIRD")
    for name in ("first", "third"):
        with refused(GraspRefineError, f"'{name}'", "taken"):
            things.add(Thing(name), replace=True)
    things.add(Thing("own"))
    with refused(GraspRefineError, "'own'", "taken", "replace=True"):
        things.add(Thing("own", 2))
    things.add(Thing("own", 2), replace=True)
    assert things["own"].size == 2
    with refused(GraspRefineError, "first"):
        things.remove("first")


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        ("no_such_module_of_ours:X", ("ModuleNotFoundError",)),
        (f"{__name__}:Thing", ("the class Thing itself",)),
        (f"{__name__}:refused", ("must be a Thing",)),
        (f"{__name__}:SECOND", ("AttributeError",)),
    ],
)
def test_entry_points_that_do_not_fit_are_named_each_time(
    monkeypatch: pytest.MonkeyPatch, value: str, parts: tuple[str, ...]
):
    things = made(monkeypatch, value)
    assert things["first"] == Thing("first"), "ours need no package"
    for _ in range(2):
        with refused(GraspRefineError, value, "a.group", *parts):
            list(things)
