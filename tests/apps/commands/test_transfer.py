"""`transfer`, and `batch` with --transfer-from: fidelity in files, tables and the index; bad input is named."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from command_line import refused
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.measures.fidelity import Likeness
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.digests import Digests
from grasp_refine_apps.cli import main

ROBOTS = resource_dir("robots")
EXAMPLE = ROBOTS / "shadow" / "example_mug.npz"
WORDS = {each.value for each in Likeness}


@pytest.fixture(autouse=True)
def in_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_transfer_writes_grasps_of_the_other_hand_with_their_fidelity(capsys: pytest.CaptureFixture[str]):
    assert (
        main(
            ["transfer", str(EXAMPLE), "--from", "shadow", "--hand", "allegro", "--index", "0", "--json", "found.json"]
        )
        == 0
    )
    printed = capsys.readouterr().out
    assert "1 grasp transferred" in printed
    with np.load("grasp-refine-results/allegro_mug.npz") as file:
        assert str(file["hand"]) == "allegro"
        words, fingers = file["fidelity"].tolist(), file["fingers"].tolist()
        pinch = file["original_pinch_shift_m"]
        provenance = json.loads(str(file["provenance"]))
    assert set(words) <= WORDS
    assert all("thumb: " in text for text in fingers)
    assert np.nanmedian(pinch) < 0.015
    assert provenance["config"]["inputs"]["transfer_from"] == "shadow"
    entries = json.loads(Path("found.json").read_text())["grasps"]
    assert [entry["fidelity"] for entry in entries] == words
    np.testing.assert_allclose([entry["original_pinch_shift_m"] for entry in entries], pinch)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([], "--from"),
        (["--from", "shadow"], "--hand"),
        (["--hand", "allegro"], "--from"),
        (["--from", "nothing", "--hand", "allegro"], "nothing"),
    ],
)
def test_what_a_transfer_lacks_is_named(capfd: pytest.CaptureFixture[str], words: list[str], named: str):
    assert named in refused(capfd, "transfer", EXAMPLE, *words)


@pytest.mark.slow
def test_a_batch_transfers_and_resumes_and_its_index_has_the_fidelity(capsys: pytest.CaptureFixture[str]):
    command = ["batch", str(EXAMPLE), "--hand", "allegro", "--transfer-from", "shadow", "--out", "out"]
    command += ["--workers", "1", "--index-format", "csv"]
    assert main(command) == 0
    with Path("out/index.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    assert {row["hand"] for row in rows} == {"allegro"}
    assert {row["fidelity"] for row in rows} <= WORDS
    assert all(float(row["original_kept"]) <= 1.0 for row in rows)
    written = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.npz")}
    capsys.readouterr()
    assert main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in Path("out").rglob("*.npz")} == written


def test_files_of_the_source_hand_are_part_of_the_digest(tmp_path: Path):
    shutil.copytree(ROBOTS / "leap", tmp_path / "other")
    spec = ProblemSpec(hand="allegro", transfer_from=str(tmp_path / "other"))

    def digest() -> str:
        return Digests().hand("allegro", spec, print)[1]

    first = digest()
    assert first != Digests().hand("allegro", ProblemSpec(hand="allegro"), print)[1]
    toml = tmp_path / "other" / "hand.toml"
    toml.write_text(toml.read_text() + "\n# changed\n")
    assert digest() != first
