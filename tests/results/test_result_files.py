"""What result files record of where they come from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.hands.hand import load_hand
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.results.result_files import (
    fingerprint,
    is_same_refinement,
    result_paths,
    save_results,
)
from grasp_refine.results.simulated import SimulatedGrasps
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import links_of
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.cli import main
from made_results import made_trials, plain_outcome
from refusals import refused


def test_result_files_have_names_that_any_file_system_takes(tmp_path: Path):
    paths = result_paths(tmp_path, "claw", ("mug", "box:1,2,3", "a/b", "a b"))
    assert [path.name for path in paths.values()] == [
        "claw_mug.npz", "claw_box_1,2,3.npz", "claw_a_b.npz", "claw_a_b_.npz"
    ]  # fmt: skip


def test_a_folder_is_known_by_the_names_and_contents_of_its_files(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "0.npy").write_bytes(b"one")
    first = fingerprint(tmp_path / "a")
    (tmp_path / "b" / "deep").mkdir(parents=True)
    (tmp_path / "b" / "0.npy").write_bytes(b"one")
    assert fingerprint(tmp_path / "b")["sha256"] == first["sha256"]
    (tmp_path / "b" / "0.npy").rename(tmp_path / "b" / "deep" / "0.npy")
    assert fingerprint(tmp_path / "b")["sha256"] != first["sha256"]
    (tmp_path / "a" / "0.npy").write_bytes(b"two")
    assert fingerprint(tmp_path / "a")["sha256"] != first["sha256"]
    assert fingerprint(tmp_path / "a" / "0.npy")["path"] == str(tmp_path / "a" / "0.npy")


def test_only_a_simulation_may_be_added(tmp_path: Path) -> None:
    path, strict = tmp_path / "results.npz", {"name": "strict"}
    assert not is_same_refinement(path, "stamp", None)
    for recorded, protocol, same in (
        (None, None, True),
        (None, strict, True),
        (strict, strict, True),
        (strict, None, False),
        (strict, {"name": "tabletop"}, False),
    ):
        text = json.dumps({"stamp": "stamp", "config": {"protocol": recorded}})
        np.savez(path, provenance=np.array(text))
        assert is_same_refinement(path, "stamp", protocol) == same
        assert not is_same_refinement(path, "other stamp", protocol)


def test_the_simulation_of_a_file_is_that_of_the_worst_direction(tmp_path: Path) -> None:
    reason = np.array([[Reason.HELD, Reason.MOVED], [Reason.HELD, Reason.HELD]])
    number = np.array([[1.0, 2.0], [4.0, 3.0]])
    after = made_trials(reason, displacement_m=number, angle_rad=number, peak_m=1e-3 * number)
    hand, path = load_hand("allegro"), tmp_path / "results.npz"
    before = made_trials(np.full((2, 2), Reason.HELD))
    simulated = SimulatedGrasps(DEXGRASPBENCH, {"mujoco": before}, {}, {"mujoco": after})
    outcome = plain_outcome(2, links=len(links_of(hand)), q=hand.rest[None].repeat(2, axis=0))
    save_results(path, hand, links_of(hand), outcome, {}, simulated)
    with np.load(path) as entries:
        assert entries["simulation_after"].tolist() == [False, True] and entries["simulation_before"].all()
        assert entries["simulation_reason_after"].tolist() == ["moved", "held"]
        assert entries["simulation_direction_after"].tolist() == ["-x", "+x"]
        assert entries["simulation_displacement_m_after"].tolist() == [2.0, 4.0]
        assert entries["simulation_angle_rad_after"].tolist() == [2.0, 4.0]
        assert entries["held_mujoco_after"].tolist() == [0.0, 1.0] and entries["held_mujoco_before"].all()
        assert entries["reason_mujoco_after"].tolist() == ["moved", "held"]
        assert list(json.loads(str(entries["certificate"]))["engines"]) == ["mujoco"]


def test_the_urdf_is_recorded_in_result_files_only(tmp_path: Path) -> None:
    results = tmp_path / "results.npz"
    np.savez(results, provenance=np.array(json.dumps({"urdf": {"path": "hand.urdf", "sha256": "abc"}})))
    assert read_provenance(results)["urdf"]["sha256"] == "abc"
    for entry in ({"q": np.zeros(1)}, *({"provenance": np.array(text)} for text in ("{}", "no JSON"))):
        np.savez(results, **entry)
        assert read_provenance(results) == {}
    assert read_provenance(tmp_path / "folder") == {}


def test_grasps_of_another_urdf_are_not_judged_with_ours_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user's hand may be called like one of ours; the file that it was refined with is recorded."""
    monkeypatch.chdir(tmp_path)
    ours = resource_dir("robots") / "allegro"
    (tmp_path / "allegro").mkdir()
    text = (ours / "allegro.urdf").read_text(encoding="utf-8")
    (tmp_path / "allegro" / "mine.urdf").write_text(text.replace("Metres", "metres"), encoding="utf-8")
    quick = ["--geometry-only", "--index", "0", "--grasps", str(ours / "example_rounded_box.npz")]
    assert main(["run", "--hand", "./allegro", *quick, "--out", "mine"]) == 0
    results = Path("mine/allegro_rounded_box.npz")
    with refused(GraspFileError, results, "'allegro'", ours / "allegro.urdf", "`hand`", "`urdf`", "`hand='allegro'`"):
        load_problem(ProblemSpec(grasps=results))
    assert any(str(results) in note for note in load_problem(ProblemSpec(hand="allegro", grasps=results)).notes)
    assert not any(str(results) in note for note in load_problem(ProblemSpec(hand="./allegro", grasps=results)).notes)


@pytest.mark.parametrize("content", [b"", b"PK\x05\x06 and no more", b"no archive"])
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    """Whatever zipfile and NumPy raise; they left the file open, too."""
    (tmp_path / "results.npz").write_bytes(content)
    with refused(GraspFileError, tmp_path / "results.npz"):
        read_provenance(tmp_path / "results.npz")
