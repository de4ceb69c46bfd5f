"""Cases of the evidence: hands, objects and generators of a folder of assets as a job list."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence_assets import OBJECTS, write_assets
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.bench.evidence.cases import (
    SAMPLED,
    Cases,
    ObjectCase,
    find_hands,
    matching_object,
    read_objects,
    save_jobs,
    with_file,
)
from refusals import refused


@pytest.fixture
def assets(tmp_path: Path) -> Path:
    return write_assets(tmp_path / "assets")


def test_each_hand_has_sampled_grasps_on_each_object_and_generators_have_their_own_hand(assets: Path, tmp_path: Path):
    hands = ("allegro", "plates", "allegro_mjcf/right", "embedded/leap")
    cases = Cases(assets, hands, sampled=3).write(tmp_path / "out")
    sampled = [(case.hand.name, case.object.name) for case in cases if case.is_sampled]
    assert sampled == [(hand, name) for hand in ("allegro", "embedded/leap", "plates") for name in sorted(OBJECTS)]
    made = [(case.hand.name, case.object.name, case.count) for case in cases if case.generator == "made"]
    assert made == [("allegro", "my_rounded_box", 4), ("allegro_mjcf/right", "my_rounded_box", 4)]
    assert {case.count for case in cases if case.is_sampled} == {3}
    assert len({case.job for case in cases}) == len(cases)


def test_with_every_nth_object_all_objects_have_grasps_of_some_hand(assets: Path, tmp_path: Path):
    hands = ("allegro", "embedded/leap", "embedded/shadow")
    cases = Cases(assets, hands, generators=(SAMPLED,), every=2).write(tmp_path / "out")
    assert len(cases) == 3
    assert {case.object.name for case in cases} == set(OBJECTS)
    assert {case.hand.name for case in cases} == set(hands)


def test_some_grasps_of_a_generator_are_taken_evenly(assets: Path, tmp_path: Path):
    cases = Cases(assets, ("allegro",), generators=("made",), generated=2)
    (case,) = cases.write(tmp_path / "out")
    found, whole = load_grasps(case.grasps), load_grasps(assets / "grasps/normalised/made.npz")
    np.testing.assert_array_equal(found.q, whole.q[[0, 3]])
    before = Path(case.grasps).read_bytes()
    cases.write(tmp_path / "out")
    assert Path(case.grasps).read_bytes() == before, "results would be computed again"


def test_jobs_name_all_inputs_and_can_be_read_as_a_batch(assets: Path, tmp_path: Path):
    cases = Cases(assets, ("allegro",)).write(tmp_path / "out")
    file_of = {case.job: tmp_path / f"{number}.npz" for number, case in enumerate(cases) if case.is_sampled}
    for path in file_of.values():
        path.touch()
    save_jobs(tmp_path / "jobs.csv", [with_file(case, file_of) for case in cases])
    jobs = {job.name: job.inputs for job in read_jobs([str(tmp_path / "jobs.csv")], ProblemSpec())}
    for case in cases:
        job = jobs[case.job]
        assert (job.hand, job.object) == ("allegro", case.object.source)
        assert job.urdf == assets / "hands/allegro/allegro.urdf"
        assert job.grasps == (file_of[case.job] if case.is_sampled else Path(case.grasps))
        # Sampled grasps have the scale in metres already; those of the generator, in metres, that of the mesh.
        assert job.scale == (1.0 if case.is_sampled else OBJECTS[case.object.name])


def test_grasps_that_scale_the_mesh_are_not_scaled_again(assets: Path, tmp_path: Path):
    file = assets / "grasps/normalised/made.npz"
    with np.load(file) as entries:
        np.savez(file, **{**entries, "scale": np.full(4, 0.5)})
    table = assets / "objects.csv"
    table.write_text(table.read_text().replace("my_rounded_box,1.0", "my_rounded_box,0.7"))
    (case,) = Cases(assets, ("allegro",), generators=("made",)).write(tmp_path / "out")
    assert case.scale == 1.0


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
    hands = {hand.name: hand for hand in find_hands(assets / "hands")}
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
def test_errors_name_what_is_missing(fault: str, named: tuple[str, ...], assets: Path, tmp_path: Path):
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
        Cases(assets).write(tmp_path / "out")


@pytest.mark.parametrize("option", ["hands", "objects", "generators"])
def test_a_choice_must_exist(option: str, assets: Path, tmp_path: Path):
    known = {"hands": "allegro", "objects": "ball", "generators": "made"}[option]
    with refused(GraspRefineError, f"--{option}", "spoon", known):
        Cases(assets, **{option: ("spoon",)}).write(tmp_path / "out")
