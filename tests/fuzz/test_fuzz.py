"""Every reader, fed changed files: it reads them or refuses them by name, and touches nothing else.

`PYTHONPATH=tests python -m fuzz --seconds 600` goes on for longer and prints a table; `--keep FOLDER` keeps inputs.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from random import Random

import pytest

from fuzz.broken import FAULTS, SOUND
from fuzz.child import drawn
from fuzz.mutations import LARGEST_INPUT, changed_bytes, changed_value
from fuzz.readers import READERS
from fuzz.runner import fuzz
from grasp_refine.core.errors import GraspFileError, GraspRefineError

FEW = 25
"""Inputs of each reader in every run of the tests."""


NAMES = [pytest.param(name, marks=pytest.mark.slow) if READERS[name].starts_programs else name for name in READERS]
"""Names of readers; processes take their time to start."""


@pytest.mark.parametrize("name", NAMES)
def test_sound_files_are_read(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Or nothing would be learned from changed ones."""
    reader = READERS[name]
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    reader.prepare(tmp_path)
    refused: dict[str, str] = {}
    for file, content in reader.seeds():
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        try:
            reader.read(path)
        except GraspFileError as error:
            refused[file] = str(error)
    # One file of grasps names a scene that is not there.
    assert set(refused) == ({"beside.npy"} if name == "foreign" else set())
    assert all("../outside/scene.npy" in said for said in refused.values())


@pytest.mark.parametrize("name", NAMES)
def test_a_few_changed_files_are_read_or_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """In this process, where warnings are errors; longer, and watched in all ways, in the next test."""
    reader, random = READERS[name], Random(name)
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    reader.prepare(tmp_path)
    refused, corpus = 0, reader.seeds()
    for _ in range(FEW):
        file, content = drawn(reader, random, corpus, len(corpus))
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        try:
            reader.read(path)
        except GraspRefineError as error:
            assert str(error).isprintable()
            refused += 1
    assert refused > 0 or name == "cache"


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_changed_files_are_read_or_refused(name: str):
    # So many, whatever the load: the same files in each run.
    outcome = fuzz(name, seed=1, seconds=120.0, most=200)
    assert not outcome.findings, outcome.findings
    assert outcome.executions == 200


def test_each_fault_is_found_and_nothing_else():
    outcome = fuzz("faulty", seconds=60.0, most=len(FAULTS) + len(SOUND), module="fuzz.broken")
    assert outcome.executions == len(FAULTS) + len(SOUND) and outcome.refused == 2
    assert len(outcome.findings) == len(FAULTS)
    for found, (kind, (_, named)) in zip(outcome.findings, FAULTS.items(), strict=True):
        assert found.kind == kind.split()[0] and named in found.details and found.name == "file.txt"


def test_what_was_refused_before_a_crash_counts():
    outcome = fuzz("crashing", seconds=60.0, most=4, module="fuzz.broken")
    assert (outcome.executions, outcome.refused) == (3, 2)
    assert [found.kind for found in outcome.findings] == ["crash"]


def test_changes_can_be_repeated_and_stay_small():
    value = {"a": [1, 2.5, "text"], "b": {"c": None}}
    for seed in range(200):
        random = Random(seed), Random(seed)
        one, other = (changed_value(each, value) for each in random)
        assert pickle.dumps(one) == pickle.dumps(other)
        data, again = (changed_bytes(each, b"solid 1 2 3\n" * 40, (b"facet",), (b"other",)) for each in random)
        assert data == again and len(data) <= LARGEST_INPUT
    assert value == {"a": [1, 2.5, "text"], "b": {"c": None}}
