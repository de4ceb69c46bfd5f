"""`refine-grasp scenes`, and `--scene` of the commands that refine and validate."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.inputs import Inputs

EXAMPLE = Path(__file__).parents[3] / "robots" / "allegro" / "example_mug.npz"
QUICK = ("--hand", "allegro", "--grasps", "sample:2", "--starts", "1")


def test_a_scene_of_ones_own_is_checked(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "desk.toml"
    path.write_text('[object]\nname = "mug"\nposition = [0, 0, -0.004]\n[table]\n')
    assert main(["scenes", str(path), "--json", str(tmp_path / "desk.json")]) == 0
    assert "4.0 mm into 'table'" in capfd.readouterr().out
    (table,) = json.loads((tmp_path / "desk.json").read_text())["scene"]["bodies"]
    assert table["distance_m"] == pytest.approx(-0.004, abs=1e-6) and table["movable"] is False
    path.write_text('[object]\nname = "mug"\nposition = [0, 0, -0.028]\n[table]\n')
    assert main(["scenes", str(path), "--json", str(tmp_path / "deep.json")]) == 2
    assert "28.0 mm" in capfd.readouterr().err and (tmp_path / "deep.json").exists()
    path.write_text('[object]\nname = "mug"\n[tabel]\n')
    assert main(["scenes", str(path)]) == 2
    assert "did you mean table?" in capfd.readouterr().err


@pytest.mark.slow
def test_a_run_in_a_scene_is_validated_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    given = ("run", *QUICK, "--scene", "ball-in-clutter", "--out", "out", "--json", "run.json")
    assert main([*given, "--validate"]) == 0
    for grasp in json.loads(Path("run.json").read_text())["grasps"]:
        assert grasp["scene_penetration_m"]["after"] < 5e-4
        after = grasp["simulation"]["after"]
        assert (after["protocol"], after["direction"]) == ("scene", "lift")
        assert set(after["pushed_m"]) == {"block", "slab", "upper slab", "can", "bowl", "cube"}
    (result,) = Path("out").glob("*.npz")
    capfd.readouterr()
    assert main(["validate", str(result), "--scene", "mug-on-table", "--no-simulate"]) == 2
    assert "ball-in-clutter" in capfd.readouterr().err


def test_surroundings_that_cannot_be_are_refused_by_every_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("sunk.toml").write_text('[object]\nname = "mug"\nposition = [0, 0, -0.028]\n[table]\n')
    example = str(EXAMPLE)
    for command in (
        ("run", *QUICK, "--object", "mug", "--table", "1.0"),
        ("run", "--grasps", example, "--table", "1.0"),
        ("validate", example, "--no-simulate", "--table", "1.0"),
    ):
        assert main([*command]) == 2
        assert "1000.0 mm" in capfd.readouterr().err
    for command in (
        ("run", *QUICK, "--scene", "sunk.toml"),
        ("run", "--grasps", example, "--scene", "sunk.toml"),
        ("validate", example, "--no-simulate", "--scene", "sunk.toml"),
        ("view", "--grasps", example, "--scene", "sunk.toml"),
    ):
        assert main([*command]) == 2
        assert "28.0 mm" in capfd.readouterr().err
    assert not Path("grasp-refine-results").exists()


def test_results_on_a_scaled_object_of_a_scene_are_read_in_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text('[object]\nname = "mug"\nscale = 0.75\n[table]\n')
    assert main(["run", *QUICK, "--scene", "small.toml", "--out", "out"]) == 0
    (result,) = Path("out").glob("*.npz")
    assert main(["validate", str(result), "--no-simulate", "--json", "small.json"]) == 0
    assert json.loads(Path("small.json").read_text())["grasps"][0]["scale"] == pytest.approx(0.75)
    assert main(["run", *QUICK, "--scene", "small.toml", "--scale", "1.33", "--out", "other"]) == 2
    assert "--scale" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scene", "mug-on-tabel"), ("mug-on-tabel", "did you mean mug-on-table?")),
        (("--scene", "none.toml"), ("none.toml", "no such scene file")),
        (("--scene", "mug-on-table", "--table", "0"), ("--table", "--scene")),
        (("--scene", "mug-on-table", "--object", "bowl"), ("'mug'", "'bowl'")),
        (("--object", "mug", "--weights.environment", "3"), ("--weights.environment", "--scene")),
    ],
)
def test_what_cannot_be_meant_is_refused(
    options: tuple[str, ...], words: tuple[str, ...], capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *QUICK, *options]) == 2
    error = capfd.readouterr().err
    assert all(word in error for word in words), error


def test_a_job_has_a_scene_beside_its_list_or_one_of_ours(tmp_path: Path) -> None:
    (tmp_path / "desk.toml").write_text('[object]\nname = "rounded_box"\n[table]\n')
    jobs = tmp_path / "jobs.toml"
    job = '[[job]]\nhand = "allegro"\ngrasps = "sample:2"\nscene = "{}"\n'
    jobs.write_text(job.format("desk.toml") + job.format("mug-on-table"))
    mine, ours = (one.inputs.scene for one in read_jobs([str(jobs)], Inputs()))
    assert (mine, ours) == (str(tmp_path / "desk.toml"), "mug-on-table")
