"""Engines by name, and how far two agree."""

import sys
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.task import Task
from grasp_refine.validation import engine_table
from grasp_refine.validation.engine_agreement import EngineAgreement
from grasp_refine.validation.engine_table import ENGINES, EngineName, chosen_engines, engine_of
from grasp_refine.validation.engines.mujoco.world import World, build_world
from gripper import RADIUS, ball, gripper


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


def test_without_drake_its_engine_says_how_to_install_it(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("grasp_refine.validation.engines.drake")]:
        monkeypatch.delitem(sys.modules, name)
    for name in {"pydrake", *(name for name in sys.modules if name.startswith("pydrake"))}:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(GraspRefineError, match=r"grasp-refine\[drake\]"):
        engine_of("drake", world)


def test_an_unknown_engine_is_refused_with_the_choices(world: World) -> None:
    with pytest.raises(GraspRefineError, match="mujoco, drake"):
        engine_of("bullet", world)
    for wrong in ("mujoco", [], ["mujoco", "bullet"]):
        with pytest.raises(GraspRefineError, match="drake"):
            chosen_engines(wrong, [world])


def test_names_of_engines_are_those_of_the_table() -> None:
    assert set(get_args(EngineName)) == set(ENGINES)


def test_another_engine_is_one_entry_and_all_leaves_out_those_that_cannot(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second MuJoCo by the name of PhysX, and one whose package is not there."""
    second = replace(ENGINES["mujoco"], title="Second", has_scenes=False)
    missing = replace(second, title="Missing", module="no_such_package.rows", imports="no_such_package", extra="there")
    entries = {"mujoco": ENGINES["mujoco"], "drake": missing, "physx": second}
    monkeypatch.setattr(engine_table, "ENGINES", entries)
    notes: list[str] = []
    assert chosen_engines(["all"], [world], notes.append) == ("mujoco", "physx")
    (note,) = notes
    assert "drake" in note and "grasp-refine[there]" in note
    assert chosen_engines(["physx", "all"], [world]) == ("physx", "mujoco")
    table = EnvironmentBody("table", build_body("table", [box([1.0, 1.0, 0.04])], candidates=16), np.eye(4))
    table.T_world_body[2, 3] = -RADIUS - 0.02
    in_scene = build_world(gripper(), ball(), Task(SCENE, scene=Environment((table,), np.eye(4))))
    notes.clear()
    assert chosen_engines(["all"], [world, in_scene], notes.append) == ("mujoco",)
    assert "physx" in notes[1] and in_scene.scene in notes[1]


def test_agreement_counts_grasps_and_kappa_is_what_chance_leaves() -> None:
    mujoco = np.repeat([True, True, False, False], [20, 5, 10, 15])
    drake = np.repeat([True, False, True, False], [20, 5, 10, 15])
    agreement = EngineAgreement.of(mujoco, drake)
    assert agreement == EngineAgreement(20, 5, 10, 15)
    # The example of Cohen's kappa in textbooks: 0.7 observed, 0.5 by chance.
    assert agreement.share == pytest.approx(0.7) and agreement.kappa == pytest.approx(0.4)


def test_independent_verdicts_have_no_kappa_and_equal_ones_have_one() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.uniform(size=(2, 20000)) < 0.8
    assert EngineAgreement.of(first, second).kappa == pytest.approx(0.0, abs=0.02)
    assert EngineAgreement.of(first, first).kappa == pytest.approx(1.0)
    every = np.ones(3, dtype=bool)
    assert np.isnan(EngineAgreement.of(every, every).kappa) and EngineAgreement.of(every, every).share == 1.0
