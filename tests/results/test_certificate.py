"""Certificates: verdicts of several engines stand side by side in a file, as long as they are on the same."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.npz_files import load_npz, save_npz
from grasp_refine.grasps.rows import rows_where
from grasp_refine.results.certificate import read_certificate, record_verdicts
from grasp_refine.results.result_numbers import result_values
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.task import Task
from grasp_refine.validation.engine_table import ENGINES
from grasp_refine.validation.trials import Reason, Trials
from made_results import made_trials, save_example_results

OWN = {"pregrasp": "file", "squeeze": "file"}
EVERY = np.arange(4)


def trials(*held: bool) -> Trials:
    return made_trials(np.where(np.array(held), Reason.HELD, Reason.ROTATED)[:, None])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return save_example_results(tmp_path / "results.npz", 4)


def test_a_second_engine_is_added_and_conditions_select_by_each(path: Path) -> None:
    record_verdicts(path, EVERY, {"mujoco": trials(True, True, False, False)}, DEXGRASPBENCH, Task(), OWN)
    line = record_verdicts(path, EVERY, {"drake": trials(True, False, True, False)}, DEXGRASPBENCH, Task(), OWN)
    assert "beside mujoco" in line and "replaces" not in line
    values = result_values([path])
    for condition, rows in (("held_mujoco=1", [0, 1]), ("held_drake=1", [0, 2]), ("held_drake=0", [1, 3])):
        assert rows_where(values, condition).tolist() == rows, condition
    # The first engine decides.
    assert rows_where(values, "held=1").tolist() == [0, 1]
    certificate = read_certificate(load_npz(path))
    assert certificate["protocol"]["name"] == "dexgraspbench"
    assert {name: found["version"] for name, found in certificate["engines"].items()} == {
        name: ENGINES[name].version for name in ("mujoco", "drake")
    }
    assert load_npz(path).entries["reason_drake_after"].tolist() == ["held", "rotated", "held", "rotated"]


def test_verdicts_under_other_conditions_are_replaced(path: Path) -> None:
    """Another protocol, closing, table, or other grasps: the line says what differs."""
    first = trials(True, True, False, False)

    def again(
        protocol: Protocol = DEXGRASPBENCH, task: Task | None = None, closing: dict[str, str] = OWN
    ) -> tuple[str, set[str]]:
        record_verdicts(path, EVERY, {"mujoco": first}, DEXGRASPBENCH, Task(), OWN)
        line = record_verdicts(path, EVERY, {"drake": trials(*[False] * 4)}, protocol, task or Task(), closing)
        found = load_npz(path)
        assert not any(found.entries["simulation_after"]), "that of the engine that is left"
        return line, set(read_certificate(found)["engines"])

    assert again(STRICT)[1] == {"drake"} and "mujoco" in again(STRICT)[0] and "protocol" in again(STRICT)[0]
    assert "task" in again(task=Task(table=-0.1))[0]
    assert "closing" in again(closing=dict(OWN, squeeze="own"))[0]
    record_verdicts(path, EVERY, {"mujoco": first}, DEXGRASPBENCH, Task(), OWN)
    entries = dict(load_npz(path).entries)
    save_npz(path, {**entries, "q": entries["q"] + 1e-9})
    line = record_verdicts(path, EVERY, {"drake": first}, DEXGRASPBENCH, Task(), OWN)
    assert "grasps" in line and not any(key.startswith("held_mujoco") for key in load_npz(path).entries)


def test_some_rows_are_recorded_and_the_others_stay(path: Path) -> None:
    record_verdicts(path, np.array([1, 3]), {"mujoco": trials(True, False)}, DEXGRASPBENCH, Task(), OWN)
    np.testing.assert_array_equal(load_npz(path).entries["held_mujoco_after"], [np.nan, 1.0, np.nan, 0.0])
    record_verdicts(path, np.array([0]), {"mujoco": trials(False)}, DEXGRASPBENCH, Task(), OWN)
    for name in ("held_mujoco", "held"):
        np.testing.assert_array_equal(result_values([path])[name], [0.0, 1.0, np.nan, 0.0])
    # Verdicts of another version are not mixed with these.
    entries = dict(load_npz(path).entries)
    old = json.loads(str(entries["certificate"]))
    old["engines"]["mujoco"]["version"] = "0.1"
    save_npz(path, {**entries, "certificate": np.array(json.dumps(old))})
    record_verdicts(path, np.array([2]), {"mujoco": trials(True)}, DEXGRASPBENCH, Task(), OWN)
    np.testing.assert_array_equal(result_values([path])["held_mujoco"], [np.nan, np.nan, 1.0, np.nan])


def test_the_protocol_counts_by_its_fields_not_by_its_name(path: Path) -> None:
    record_verdicts(path, EVERY, {"mujoco": trials(*[True] * 4)}, DEXGRASPBENCH, Task(), OWN)
    heavy = replace(DEXGRASPBENCH, mass=1.0)
    assert "protocol" in record_verdicts(path, EVERY, {"drake": trials(*[True] * 4)}, heavy, Task(), OWN)
