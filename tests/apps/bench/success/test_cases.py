"""Cases of the benchmark of success: hands, objects and generators of a folder of assets; perturbed grasps."""

from __future__ import annotations

import csv
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
from grasp_refine_apps.bench.success.assets import ObjectCase, find_hands, matching_object, read_objects
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


def test_with_every_nth_object_all_objects_have_grasps_of_some_hand(assets: Path):
    hands = ("allegro", "embedded/leap", "embedded/shadow")
    cases = Axes(assets=assets, hands=hands, generators=(SAMPLED,), every=2).cases()
    assert len(cases) == 3
    assert {case.object.name for case in cases if case.object} == set(OBJECTS)
    assert {case.hand for case in cases} == set(hands)


def test_some_grasps_of_a_generator_are_taken_evenly_at_its_scale(assets: Path):
    axes = Axes(assets=assets, hands=("allegro",), generators=("made",), generated=2)
    (case,) = axes.cases()
    assert case.spec.index == (0, 3)
    file = assets / "grasps/normalised/made.npz"
    with np.load(file) as entries:
        np.savez(file, **{**entries, "scale": np.full(4, 0.5)})
    table = assets / "objects.csv"
    table.write_text(table.read_text().replace("my_rounded_box,1.0", "my_rounded_box,0.7"))
    (case,) = axes.cases()
    assert case.spec.scale == 1.0, "grasps that scale the mesh are not scaled again"


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
    ("convexity", "diagonal", "shape", "size"),
    [
        (0.95, 0.1, "convex", "below 14 cm"),
        (0.9, 0.14, "convex", "14 to 18 cm"),
        (0.89, 0.18, "concave", "14 to 18 cm"),
        (0.1, 0.1801, "concave", "above 18 cm"),
        (np.nan, np.nan, "not known", "not known"),
    ],
)
def test_classes_of_objects(convexity: float, diagonal: float, shape: str, size: str):
    thing = ObjectCase("thing", "thing.obj", 1.0, diagonal, convexity)
    assert (thing.shape, thing.size) == (shape, size)


def test_diagonals_are_as_in_the_scaled_mesh(assets: Path):
    ball = next(thing for thing in read_objects(assets) if thing.name == "ball")
    assert ball.diagonal == pytest.approx(2.0 * OBJECTS["ball"])


def test_generators_may_leave_out_the_beginning_of_a_name_and_its_hyphens():
    things = [ObjectCase(name, f"{name}.obj", 1.0) for name in ("ycb_065c_cups", "ycb_065g_cups", "cups")]
    assert matching_object("065-c_cups", things).name == "ycb_065c_cups"
    assert matching_object("cups", things).name == "cups"
    cube = matching_object("cube_75mm", things)
    assert cube.source == "box:0.075,0.075,0.075"
    assert cube.size == "below 14 cm"
    with refused(GraspRefineError, "c_cups", "ycb_065c_cups"):
        matching_object("c_cups", [*things, replace(things[0], name="my_065c_cups")])
    with refused(GraspRefineError, "mug", "objects.csv"):
        matching_object("mug", things)


def test_hands_of_ours_add_what_they_know_to_the_urdf(assets: Path):
    hands = {hand.name: hand for hand in find_hands(assets)}
    assert (hands["allegro"].hand, hands["allegro"].urdf) == ("allegro", assets / "hands/allegro/allegro.urdf")
    assert (hands["plates"].hand, hands["plates"].urdf) == (str(assets / "hands/plates/plates.urdf"), None)
    assert hands["allegro_mjcf/right"].mjcf == assets / "hands/allegro_mjcf/right.xml"
    assert hands["embedded/leap"].hand == "leap"
    assert "embedded/barrett" not in hands, "its URDF is not ours"


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ("no objects.csv", ("objects.csv",)),
        ("no hands", ("hands",)),
        ("no column", ("objects.csv", "convexity")),
        ("no number", ("line 2", "suggested_scale", "large")),
        ("no mesh", ("line 3", "my_rounded_box")),
        ("two URDFs", ("allegro", "other.urdf")),
        ("no hand in a folder", ("hands/nothing", ".urdf")),
        ("MJCF without URDF", ("claw_mjcf", "claw")),
        ("no such object of a generator", ("'spoon'",)),
    ],
)
def test_errors_name_what_is_missing(fault: str, named: tuple[str, ...], assets: Path):
    table = assets / "objects.csv"
    rows = list(csv.reader(table.read_text().splitlines()))
    if fault == "no objects.csv":
        table.unlink()
    elif fault == "no hands":
        (assets / "hands").rename(assets / "arms")
    elif fault == "no column":
        table.write_text("\n".join(",".join(row[:-1]) for row in rows))
    elif fault == "no number":
        rows[1][1] = "large"
        table.write_text("\n".join(map(",".join, rows)))
    elif fault == "no mesh":
        (assets / "objects/my_rounded_box.obj").unlink()
    elif fault == "two URDFs":
        (assets / "hands/allegro/other.urdf").touch()
    elif fault == "no hand in a folder":
        (assets / "hands/nothing").mkdir()
    elif fault == "MJCF without URDF":
        (assets / "hands/claw_mjcf").mkdir()
        (assets / "hands/claw_mjcf/claw.xml").touch()
    else:
        file = assets / "grasps/normalised/made.npz"
        with np.load(file) as entries:
            np.savez(file, **{**entries, "object": np.full(4, "spoon")})
    with refused(GraspRefineError, *named):
        Axes(assets=assets).cases()


@pytest.mark.parametrize(("option", "known"), [("hands", "allegro"), ("on", "ball"), ("generators", "made")])
def test_a_choice_must_exist(option: str, known: str, assets: Path):
    with refused(GraspRefineError, f"--{option}", "spoon", known):
        replace(Axes(assets=assets), **{option: ("spoon",)}).cases()
