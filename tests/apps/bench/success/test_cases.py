"""Cases of the benchmark of success: hands, objects and generators of a folder of assets; perturbed grasps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence_assets import OBJECTS, write_assets
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.input_cache import InputCache, NoCache
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine_apps.bench.success import cases
from grasp_refine_apps.bench.success.cases import SAMPLED, Axes, Case, load_case, perturbed
from refusals import refused


@pytest.fixture
def assets(tmp_path: Path) -> Path:
    return write_assets(tmp_path / "assets")


def test_each_hand_has_sampled_grasps_on_each_object_and_generators_have_their_own_hand(assets: Path):
    hands = ("allegro", "plates", "allegro_mjcf/right", "embedded/leap")
    cases = Axes(assets=assets, hands=hands, count=3).cases()
    sampled = [(case.hand, case.object.name) for case in cases if case.source == SAMPLED and case.object]
    assert sampled == [(hand, name) for hand in ("allegro", "embedded/leap", "plates") for name in sorted(OBJECTS)]
    made = [(case.hand, case.object.name, case.requested) for case in cases if case.source == "made" and case.object]
    assert made == [("allegro", "my_rounded_box", 4), ("allegro_mjcf/right", "my_rounded_box", 4)]
    assert {str(case.spec.grasps) for case in cases if case.source == SAMPLED} == {"sample:3"}
    assert len({case.name for case in cases}) == len(cases)
    # The scale of the assets takes meshes to metres; grasps of the generator name it.
    assert all(case.spec.scale == OBJECTS[case.object.name] for case in cases if case.object)


def test_a_number_of_grasps_is_taken_evenly_from_the_whole_file(assets: Path):
    file = assets / "grasps/normalised/made.npz"
    with np.load(file) as entries:
        changed = {**entries, "object": np.array(["ball", "ball", "my_rounded_box", "my_rounded_box"])}
    np.savez(file, **changed)
    for number, indices in ((2, [(0,), (1,)]), (3, [(0,), (0, 1)]), (9, [(0, 1), (0, 1)]), (1, [(0,)])):
        found = Axes(assets=assets, hands=("allegro",), generators=(f"made:{number}",), generated=1).cases()
        assert [case.spec.index for case in found] == indices
    with refused(GraspRefineError, "made:none"):
        Axes(assets=assets, generators=("made:none",)).cases()


def test_a_perturbation_moves_the_middle_of_the_pads_by_5_mm_and_turns_by_10_degrees():
    case = Case(ProblemSpec(hand="franka_hand", object="box:0.02,0.02,0.1", grasps=Path("sample:4")))
    problem, factor = load_case(case, 0, NoCache())
    (group,) = problem.groups
    moved = perturbed(group, 0)
    before, after = group.scene, moved.scene
    center = np.append(closure_frame(before.hand).center, 1.0)
    shift = (after.T_world_root - before.T_world_root) @ center
    np.testing.assert_allclose(np.linalg.norm(shift[:, :3], axis=1), 0.005, rtol=1e-9)
    R = after.T_world_root[:, :3, :3] @ before.T_world_root[:, :3, :3].mT
    np.testing.assert_allclose(np.degrees(np.arccos((np.trace(R, axis1=1, axis2=2) - 1) / 2)), 10.0, rtol=1e-9)
    assert factor == 1.0 and (after.q == before.q).all()
    np.testing.assert_allclose(moved.grasps.hand_pose[:, :3], after.T_world_root[:, :3, 3])


def test_an_object_that_is_too_wide_is_scaled_until_a_grasp_is_found(monkeypatch: pytest.MonkeyPatch):
    load = cases.load_problem

    def narrow(spec: ProblemSpec, cache: InputCache, *, seed: int) -> Problem:
        if spec.scale > 0.7:
            raise GraspRefineError("no grasp is found")
        return load(spec, cache, seed=seed)

    monkeypatch.setattr(cases, "load_problem", narrow)
    case = Case(ProblemSpec(hand="franka_hand", object="sphere:0.03", grasps=Path("sample:1")))
    with refused(GraspRefineError, "no grasp"):
        load_case(case, 0, NoCache())
    problem, factor = load_case(case, 0, NoCache(), shrink=True)
    assert factor == pytest.approx(0.64)
    assert problem.groups[0].scene.object.body.diagonal == pytest.approx(0.64 * 0.06 * 3**0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (lambda assets: (assets / "objects.csv").unlink(), ("objects.csv",)),
        (lambda assets: (assets / "objects/my_rounded_box.obj").unlink(), ("line 3", "my_rounded_box")),
        (lambda assets: (assets / "hands/allegro/other.urdf").touch(), ("allegro", "other.urdf")),
        (lambda assets: (assets / "hands/nothing").mkdir(), ("hands/nothing", ".urdf")),
    ],
)
def test_errors_name_what_is_missing(fault: Callable[[Path], None], named: tuple[str, ...], assets: Path):
    fault(assets)
    with refused(GraspRefineError, *named):
        Axes(assets=assets).cases()


@pytest.mark.parametrize(("option", "known"), [("hands", "allegro"), ("on", "ball"), ("generators", "made")])
def test_a_choice_must_exist(option: str, known: str, assets: Path):
    with refused(GraspRefineError, f"--{option}", "spoon", known):
        replace(Axes(assets=assets), **{option: ("spoon",)}).cases()
