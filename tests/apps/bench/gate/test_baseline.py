"""Verdicts of the gate: which way each ratio may not go, when it is measured again, and baselines that are none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from grasp_refine.collision.engine import VARIABLE, why_not_native
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.gate import measures
from grasp_refine_apps.bench.gate.baseline import (
    BASELINE,
    RATIOS,
    Group,
    Known,
    Ratio,
    _of,
    judged,
    load_baseline,
    updated,
)
from refusals import refused

BY_NAME = {ratio.name: ratio for ratio in RATIOS}
UPDATE = "refine-grasp bench --gate --update FILE"
"""The command that every refusal of a baseline names."""


def values(native: bool = False) -> dict[str, float]:
    """A value of each ratio, better than what is promised."""
    return {
        ratio.name: 0.5 + 0.01 * k + 10.0 * (ratio.promised is not None and ratio.higher)
        for k, ratio in enumerate(RATIOS)
        if native or not ratio.native
    }


def known(native: bool = False) -> dict[str, Known]:
    return {name: Known(value, BY_NAME[name].limit(value)) for name, value in values(native).items()}


class Measuring:
    """Gives values that some change, from the first time on or only then, and remembers who asked."""

    def __init__(self, first: dict[str, float], later: dict[str, float] | None = None) -> None:
        self.first, self.later, self.asked = first, first if later is None else later, []

    def __call__(self, group: Group) -> dict[str, float]:
        now = self.later if group in self.asked else self.first
        self.asked.append(group)
        return {name: value for name, value in now.items() if BY_NAME[name].group == group}


def test_a_limit_lies_on_the_worse_side():
    assert Ratio("a", "", "grasps", factor=1.5, slack=0.1).limit(2.0) == pytest.approx(3.1)
    assert Ratio("a", "", "grasps", higher=True, factor=1.5, slack=0.1).limit(3.0) == pytest.approx(1.9)
    for ratio in RATIOS:
        value = values(native=True)[ratio.name]
        limit = ratio.limit(value)
        assert (limit < value) == ratio.higher and ratio.allowed(value, limit)
        assert not ratio.allowed(0.999 * limit if ratio.higher else 1.001 * limit, limit)
        assert not ratio.allowed(float("nan"), limit) and not ratio.allowed(float("inf"), limit)
        assert ratio.better(1.0, 2.0) == (2.0 if ratio.higher else 1.0)


def test_no_baseline_takes_back_what_is_promised():
    engines, loop = BY_NAME["engines"], BY_NAME["bare-loop"]
    assert [engines.limit(value) for value in (2.0, 4.0, 9.0)] == [3.0, 3.0, 6.0]
    assert [loop.limit(value) for value in (1.0, 1.4, 2.0)] == pytest.approx([1.5, 2.0, 2.0])
    verdicts = judged(known(native=True), Measuring(values(native=True) | {"engines": 2.9, "bare-loop": 2.01}))
    assert [one.ratio.name for one in verdicts if one.ok is False] == ["engines", "bare-loop"]


def test_what_is_on_one_side_only_is_refused():
    """A ratio that nobody measures any longer passed."""
    less = {name: value for name, value in values().items() if name != "steps"}
    with refused(GraspRefineError, "grasps", "steps", UPDATE):
        judged(known(), Measuring(less))
    before = {name: one for name, one in known().items() if name != "good"}
    with refused(GraspRefineError, "forces", "good", UPDATE):
        judged(before, Measuring(values()))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["native", "python"])
def test_what_is_measured_is_what_is_judged(engine: str, monkeypatch: pytest.MonkeyPatch):
    if engine == "native" and why_not_native():
        pytest.skip(f"no compiled engine: {why_not_native()}")
    monkeypatch.setenv(VARIABLE, engine)
    few = {"ROUNDS": 1, "MIN_TIMED_S": 0.0, "NUM_TASKS": 4, "BATCH_SIZE": 2, "NUM_SINGLES": 2, "NUM_FORCED": 2}
    few |= {"DESCENT_STEPS": 4, "COAL_QUERIES": 10}
    for name, value in few.items():
        monkeypatch.setattr(measures, name, value)
    for group in get_args(Group):
        found = measures.measure(group, lambda share: None)
        assert set(found) == {ratio.name for ratio in _of(engine) if ratio.group == group}
        assert np.isfinite(list(found.values())).all()


@pytest.mark.parametrize("ratio", RATIOS, ids=lambda ratio: ratio.name)
def test_each_ratio_that_gets_worse_fails(ratio: Ratio):
    before = values(native=True)
    limit = ratio.limit(before[ratio.name])
    measuring = Measuring(before | {ratio.name: 0.9 * limit if ratio.higher else 1.1 * limit})
    verdicts = judged(known(native=True), measuring)
    assert [one.ratio.name for one in verdicts if one.ok is False] == [ratio.name]
    # It had its second chance, and nobody else.
    assert [one.ratio.name for one in verdicts if one.again] == [ratio.name]
    assert measuring.asked.count(ratio.group) == 2 and len(measuring.asked) == 1 + len(get_args(Group))


@pytest.mark.parametrize("bad", [100.0, float("nan")])
def test_a_disturbed_measurement_is_made_up_for_by_the_next(bad: float):
    verdicts = judged(known(), Measuring(values() | {"grasp": bad}, values()))
    (one,) = [one for one in verdicts if one.again]
    assert (one.ratio.name, one.now, one.ok) == ("grasp", values()["grasp"], True)
    twice = judged(known(), Measuring(values() | {"grasp": 100.0}, values() | {"grasp": bad}))
    assert [(one.now, one.ok) for one in twice if one.again] == [(100.0, False)]


def test_a_baseline_comes_back_as_it_was_written(tmp_path: Path):
    path = tmp_path / "baseline.json"
    document = updated(path, "python", values(), {"machine": {"cpus": 2}})
    path.write_text(json.dumps(document))
    found = load_baseline(path, "python")
    assert {name: (one.value, one.limit) for name, one in found.items()} == {
        name: (pytest.approx(one.value, rel=1e-3), pytest.approx(one.limit, rel=1e-3)) for name, one in known().items()
    }
    assert document["engines"]["python"]["machine"] == {"cpus": 2}
    # That of another engine is added, and neither disturbs the other.
    both = updated(path, "native", values(native=True), {})
    path.write_text(json.dumps(both))
    assert both["engines"]["python"] == document["engines"]["python"]
    assert set(load_baseline(path, "native")) == set(BY_NAME)
    with refused(GraspRefineError, "steps", "finite"):
        updated(path, "python", values() | {"steps": float("inf")}, {})


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[1", ("JSONDecodeError",)),
        ("[]", ("TypeError",)),
        ('{"engines": {}}', ("KeyError", "'schema'")),
        ('{"schema": 2, "engines": {}}', ("ValueError", "schema", "2", "1")),
        ('{"schema": 1, "engines": {"python": {}}}', ("KeyError", "'ratios'")),
        ('{"schema": 1, "engines": {}}', ("engine", "python")),
        ('{"schema": 1, "engines": {"python": {"ratios": {}}}}', ("backward, bookkeeping, ",)),
        (
            '{"schema": 1, "engines": {"python": {"ratios": {"old": {"value": 1, "limit": 2}}}}}',
            ("warm-query", "old", "python"),
        ),
    ],
)
def test_what_is_no_baseline_is_refused(text: str, named: tuple[str, ...], tmp_path: Path):
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with refused(GraspRefineError, path, *named, UPDATE):
        load_baseline(path, "python")


@pytest.mark.parametrize("engine", ["python", "native"])
def test_the_committed_baseline_is_one(engine: str):
    for name, one in load_baseline(BASELINE, engine).items():
        # Limits were not written by hand, unless to be stricter.
        loosest = BY_NAME[name].limit(one.value)
        assert one.limit >= 0.995 * loosest if BY_NAME[name].higher else one.limit <= 1.005 * loosest
    assert load_baseline(BASELINE, engine)["solved"].value >= 0.99
