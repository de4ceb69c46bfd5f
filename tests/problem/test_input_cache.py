"""Inputs in memory: whatever a hand or an object depends on has an entry of its own; grasps come back in order."""

from collections.abc import Callable, Hashable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from grasp_refine.objects.source import ObjectSource
from grasp_refine.problem.input_cache import MAX_ENTRIES, InputCache
from grasp_refine.problem.load import Loader
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import ProblemSpec


class Noted(Exception):
    """Nothing is made, only the key is noted."""


class Keys(InputCache):
    """Notes the keys."""

    def __init__(self) -> None:
        super().__init__()
        self.keys: list[Hashable] = []

    def get(self, kind: str, key: Hashable, make: Callable[[], Any]) -> Any:
        self.keys.append((kind, key))
        raise Noted


HANDS = [{}, {"hull_limit": 0.01}, {"urdf": Path("a.urdf")}, {"mjcf": Path("a.xml")}]
OBJECTS = [{}, {"unit": "mm"}, {"holes": "cap"}]


def test_whatever_a_hand_or_an_object_depends_on_is_in_its_key():
    cache = Keys()
    hands = [("leap", None, {}), *(("allegro", base_link, change) for base_link in (None, "palm") for change in HANDS)]
    for name, base_link, change in hands:
        with pytest.raises(Noted):
            Loader(replace(ProblemSpec(), **change), cache=cache).hands.load(name, base_link)
    for name, scale, change in [(n, s, c) for n in "ab" for s in (1.0, 2.0) for c in OBJECTS]:
        with pytest.raises(Noted):
            Loader(replace(ProblemSpec(), **change), cache=cache).read_object(ObjectSource(name), scale)
    assert len(set(cache.keys)) == len(cache.keys) == 1 + 2 * len(HANDS) + 4 * len(OBJECTS)


@pytest.mark.parametrize("kind", ["hand", "other"])
def test_the_last_used_values_are_held(kind: str):
    cache, made = InputCache(), []
    most = MAX_ENTRIES.get(kind, 4)

    def get(key: int) -> int:
        return cache.get(kind, key, lambda: made.append(key) or key)

    assert [get(key) for key in (*range(most), 0, most, 0, 1)] == [*range(most), 0, most, 0, 1]
    assert made == [*range(most), most, 1], "0 was used again before a further one came"


def test_rows_of_groups_come_back_in_the_requested_order():
    groups = [SimpleNamespace(place=np.array([2, 0])), SimpleNamespace(place=np.array([1]))]
    order = Problem.order.fget(SimpleNamespace(groups=groups))
    names = np.array(["mug 2", "mug 0", "can 1"])
    assert names[order].tolist() == ["mug 0", "can 1", "mug 2"]
