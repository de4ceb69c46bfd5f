"""The command line as a user meets it: exit codes, one-line errors, files that appear whole or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

import grasp_refine
from command_line import PROGRAM, interruptible, refused, subprocess_environment
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.collision.engine import chosen
from grasp_refine.core.versions import own_version
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.measures import RECORDED
from grasp_refine_apps.cli import COMMANDS, main
from refusals import assert_names
from running_processes import PATIENCE_S

pytestmark = pytest.mark.usefixtures("workplace")

EXAMPLE = resource_dir("robots") / "allegro" / "example_rounded_box.npz"
QUICK = ("run", "--object", "rounded_box", "--iterations", "30")
"""A run on the one embedded object that needs no decomposition."""


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    """A folder for input files."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    return folder


@pytest.fixture
def grasp_file(inputs: Path) -> Callable[..., Path]:
    """Write the example with the given entries changed (None: left out); returns its path."""

    def write(name: str = "grasps.npz", **changes: object) -> Path:
        with np.load(EXAMPLE) as example:
            arrays = {**example, **changes}
        path = inputs / name
        np.savez(path, **{key: np.asarray(value) for key, value in arrays.items() if value is not None})
        return path

    return write


# The top level


@pytest.mark.slow
def test_help_is_instant_and_only_what_needs_torch_loads_it():
    """Help needs the standard library alone, of which it takes what `argparse` would load, too."""
    code = (
        "import sys; before = set(sys.modules); from grasp_refine_apps.cli import main; code = main(['--help']);"
        "loaded = set(sys.modules) - before; packages = {name.partition('.')[0] for name in loaded};"
        "print(sorted(packages - sys.stdlib_module_names), len(loaded) < 100, code);"
        "import grasp_refine_apps.commands.hands, grasp_refine_apps.commands.doctor;"
        "main(sys.argv[1:]); print('torch' in sys.modules)"
    )
    command = [sys.executable, "-c", code, *QUICK]
    result = subprocess.run(command, capture_output=True, text=True, env=subprocess_environment())
    assert "['grasp_refine', 'grasp_refine_apps'] True 0\n" in result.stdout and result.stdout.endswith("False\n")
    assert all(f"  {name} " in result.stdout for name in COMMANDS)


def test_the_package_runs_as_the_command_does():
    command = [sys.executable, "-m", "grasp_refine_apps", "--version"]
    result = subprocess.run(command, capture_output=True, text=True, env=subprocess_environment())
    assert result.stdout.startswith("refine-grasp ") and result.returncode == 0


@pytest.mark.parametrize(
    ("words", "unknown", "suggested"),
    [
        ("runn", "runn", "run"),
        ("xyz", "xyz", ""),
        ("bench algin --preset smoke", "bench algin", "bench align"),
        ("--versoin", "--versoin", "--version"),
    ],
)
def test_an_unknown_command_names_the_commands(
    words: str, unknown: str, suggested: str, capfd: pytest.CaptureFixture[str]
):
    answer = refused(capfd, *words.split())
    commands = ", ".join(COMMANDS)
    assert_names(answer, f"'{unknown}'", commands)
    assert suggested in answer.replace(commands, "").replace(unknown, "")


# run


OF_TRANSFERS = {measure.name for measure in RECORDED if measure.name.startswith("original_")}


def test_a_run_writes_the_same_grasps_as_npz_and_json(capsys: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--out", "results/deep", "--json", "results/deep/report.json"]) == 0
    assert {str(path) for path in Path().rglob("*") if path.is_file()} == {
        "results/deep/allegro_rounded_box.npz",
        "results/deep/report.json",
    }
    captured = capsys.readouterr()
    assert_names(captured.err, "4 grasps", "allegro", "6 starts")
    assert_names(captured.out.splitlines()[0], "allegro", "rounded_box", "4 grasps")
    assert max(map(len, captured.out.splitlines())) <= 80

    document = json.loads(Path("results/deep/report.json").read_text())
    assert document["engine"] == chosen("auto")
    assert (document["schema"], document["command"], document["seed"]) == (1, "run", 0)
    assert document["versions"]["grasp-refine"] == grasp_refine.__version__
    solver = document["config"]["refine"]["solver"]
    assert (solver["type"], solver["iterations"]) == ("LevenbergMarquardt", 30)
    assert document["totals"]["n"] == len(document["grasps"]) == 4
    for grasp in document["grasps"]:
        unknown = {name for name, value in grasp.items() if value is None}
        assert unknown == {"moved_slides_m", *OF_TRANSFERS}, "no joint slides, and grasps are of their own hand"
        assert 0 < grasp["quality"]["before"] < grasp["quality"]["after"] <= 1
        assert grasp["simulation"] == {"before": None, "after": None}
        assert 0 <= grasp["wrench_residual"]["after"] < 1
        assert grasp["contact_error_m"]["after"] < grasp["contact_error_m"]["before"]
        assert 0 <= grasp["self_penetration_m"]["after"] < 1e-5

    before, after = load_grasps(EXAMPLE), load_grasps("results/deep/allegro_rounded_box.npz")
    assert len(after) == 4
    # A refined grasp gets a pregrasp and a squeeze of its own.
    assert after.pregrasp is not None and after.squeeze is not None
    assert (after.hand, after.base_link, after.joint_names) == ("allegro", "base_link", before.joint_names)
    assert after.targets is None
    moved = np.linalg.norm(after.hand_pose[:, :3] - before.hand_pose[:, :3], axis=1)
    np.testing.assert_allclose(moved, [grasp["moved_palm_m"] for grasp in document["grasps"]], atol=1e-12)
    with np.load("results/deep/allegro_rounded_box.npz") as arrays:
        assert set(arrays["contact_link"]) >= {contact.link for contact in load_hand("allegro").contacts}
        # A link that is too far away is no part of a grasp.
        length = np.linalg.norm(arrays["contact_normal"], axis=-1)
        np.testing.assert_array_equal(np.isnan(length), np.isnan(arrays["contact_distance"]))
        np.testing.assert_allclose(length[~np.isnan(length)], 1.0)
        errors = [grasp["contact_error_m"]["after"] for grasp in document["grasps"]]
        np.testing.assert_array_equal(arrays["contact_error_m_after"], errors)
        for when in ("before", "after"):
            said = [grasp["quality"][when] for grasp in document["grasps"]]
            np.testing.assert_array_equal(arrays[f"quality_{when}"], said)
        assert arrays["starts"].tolist() == [grasp["starts"] for grasp in document["grasps"]]
        assert (np.nanmax(np.abs(arrays["contact_distance"]), axis=1) <= arrays["contact_error_m_after"] + 1e-12).all()
        provenance = json.loads(str(arrays["provenance"]))
    assert provenance["source"]["path"] == str(EXAMPLE) and len(provenance["source"]["sha256"]) == 64
    assert provenance["index"] == provenance["row"] == [0, 1, 2, 3]


@pytest.mark.slow
def test_a_result_can_be_refined_further_but_not_overwritten(capfd: pytest.CaptureFixture[str]):
    assert main([*QUICK, "--index", "0", "--targets", "nearest"]) == 0
    result = "grasp-refine-results/allegro_rounded_box.npz"
    assert len(load_grasps(result).targets.links) >= 3
    capfd.readouterr()
    assert_names(refused(capfd, *QUICK, "--grasps", result), result, "--out", "--json")
    elsewhere = ("--grasps", result, "--out", "again", "--json", result, "--overwrite")
    assert_names(refused(capfd, *QUICK, *elsewhere), result, "--out", "--json")
    assert main([*QUICK, "--grasps", result, "--out", "again", "--json", "again.json"]) == 0
    first, again = load_grasps(result), load_grasps("again/allegro_rounded_box.npz")
    np.testing.assert_array_equal(first.targets.point_link, again.targets.point_link)
    np.testing.assert_array_equal(first.targets.point_object, again.targets.point_object)


@pytest.mark.slow
def test_a_result_is_replaced_by_the_same_refinement_only(capfd: pytest.CaptureFixture[str]):
    """A run with --geometry-only replaced the result of a full one, and nothing was said."""
    quick = (*QUICK, "--index", "0", "--starts", "1")
    result = Path("grasp-refine-results/allegro_rounded_box.npz")
    for _ in range(2):
        assert main([*quick]) == 0
    before = result.read_bytes()
    for other in (("--seed", "1"), ("--starts", "2"), ("--index", "1"), ("--json", "no/report.json")):
        capfd.readouterr()
        said = refused(capfd, *quick, *other)
        assert "--overwrite" in said if "--json" not in other else "folder no" in said
    capfd.readouterr()
    assert "--overwrite" in refused(capfd, *QUICK, "--index", "0", "--geometry-only")
    assert result.read_bytes() == before
    # What simulation says may be added, and is not lost.
    assert main([*quick, "--validate"]) == 0
    capfd.readouterr()
    for other in ((), ("--validate", "--protocol", "strict")):
        assert_names(refused(capfd, *quick, *other), result, "--overwrite")
    assert main([*QUICK, "--index", "0", "--geometry-only", "--overwrite"]) == 0
    assert "simulation_after" not in np.load(result).files


def test_index_counts_the_grasps_of_the_object(grasp_file: Callable[..., Path]):
    grasps = grasp_file(object=["mug", "rounded_box", "mug", "rounded_box"])
    chosen = ("--grasps", str(grasps), "--object-name", "rounded_box", "--index", "1", "0")
    assert main([*QUICK, *chosen, "--json", "report.json"]) == 0
    report = json.loads(Path("report.json").read_text())["grasps"]
    assert [(grasp["index"], grasp["row"]) for grasp in report] == [(1, 3), (0, 1)]
    with np.load("grasp-refine-results/allegro_rounded_box.npz") as result:
        np.testing.assert_allclose(result["hand_pose_before"], load_grasps(grasps).select([3, 1]).hand_pose)


def test_several_objects_and_scales_are_refined_together(grasp_file: Callable[..., Path], inputs: Path):
    grasps = grasp_file(object=["block", "rounded_box", "block", "block"], scale=[1.0, 1.0, 0.9, 1.0])
    trimesh.creation.box((0.07, 0.07, 0.09)).export(inputs / "block.obj")
    (inputs / "objects.toml").write_text('block = "block.obj"\nrounded_box = "rounded_box"\n')
    objects = ("--objects", str(inputs / "objects.toml"))
    arguments = ["run", "--grasps", str(grasps), *objects, "--iterations", "10", "--json", "report.json"]
    assert main(arguments) == 0
    report = json.loads(Path("report.json").read_text())["grasps"]
    assert [(grasp["object"], grasp["index"], grasp["row"]) for grasp in report] == [
        ("block", 0, 0), ("block", 1, 2), ("block", 2, 3), ("rounded_box", 0, 1)
    ]  # fmt: skip
    assert load_grasps("grasp-refine-results/allegro_block.npz").scale.tolist() == [1.0, 0.9, 1.0]
    assert len(load_grasps("grasp-refine-results/allegro_rounded_box.npz")) == 1


def test_targets_of_a_file_are_aimed_at(grasp_file: Callable[..., Path], capfd: pytest.CaptureFixture[str]):
    links, n = ["link_7.0_tip", "link_15.0_tip"], 4
    point_object = np.full((n, 2, 3), 0.02)
    point_object[1] = np.nan
    point_link = np.where(np.isnan(point_object), np.nan, 0.01)
    targets = {"target_link": links, "target_point_link": point_link, "target_point_object": point_object}
    aimed = grasp_file("targets.npz", **targets)
    alone = [*QUICK, "--geometry-only", "--targets", str(aimed)]
    assert main([*alone, "--json", "report.json"]) == 0
    capfd.readouterr()
    used = load_grasps("grasp-refine-results/allegro_rounded_box.npz").targets
    assert used.links == tuple(links)
    np.testing.assert_array_equal(used.point_object, point_object)
    for options in ("--contacts link_7.0_tip", "--reach 0.02", "--other-link-distance 0.001"):
        assert_names(
            refused(capfd, *alone, *options.split()), "--contacts", "--reach", "--other-link-distance", "targets"
        )
    statuses = [grasp["status"] for grasp in json.loads(Path("report.json").read_text())["grasps"]]
    assert [status == "no target" for status in statuses] == [False, True, False, False]


def test_frozen_parts_of_a_hand_stay():
    """The pose has the bits of the input, as has the thumb; other fingers move. The pregrasp opens the thumb."""
    quick = (*QUICK, "--index", "0", "--starts", "1")
    assert main([*quick, "--freeze", "palm", "thumb", "--json", "report.json"]) == 0
    report = json.loads(Path("report.json").read_text())
    assert report["config"]["refine"]["freeze"] == ["palm", "thumb"]
    assert all(grasp["moved_palm_m"] == 0.0 and grasp["moved_joints_rad"] > 0.0 for grasp in report["grasps"])
    with np.load("grasp-refine-results/allegro_rounded_box.npz") as result:
        np.testing.assert_array_equal(result["hand_pose"], result["hand_pose_before"])
        moved = (result["q"] != result["q_before"]).any(axis=0)
        thumb = np.isin(result["joint_names"], [f"joint_{joint}.0" for joint in range(12, 16)])
        assert moved.any() and not moved[thumb].any()
        assert (result["pregrasp_q"] != result["q"])[:, thumb].any()


def test_nothing_usable_is_exit_code_1(grasp_file: Callable[..., Path], capsys: pytest.CaptureFixture[str]):
    with np.load(EXAMPLE) as example:
        away = example["hand_pose"] + np.array([1.0, 0, 0, 0, 0, 0, 0])
    far = grasp_file(hand_pose=away)
    assert main([*QUICK, "--grasps", str(far), "--as-is", "--json", "report.json"]) == 1
    assert not Path("grasp-refine-results").exists()
    assert "4 no target" in capsys.readouterr().out
    grasp = json.loads(Path("report.json").read_text())["grasps"][0]
    assert grasp["status"] == "no target" and grasp["advice"]
    assert grasp["contact_error_m"] == grasp["contact_error_mean_m"] == {"before": None, "after": None}


# Bad input


def test_bad_grasp_files_are_refused(grasp_file: Callable[..., Path], inputs: Path, capfd: pytest.CaptureFixture[str]):
    text = inputs / "text.npz"
    text.write_text("hello")
    for path, *named in (
        (inputs / "missing.npz", "missing.npz"),
        (text, "text.npz", ".npz "),
        (grasp_file("joints.npz", joint_names=[f"x{i}" for i in range(16)]), "'allegro'", "x0"),
        (grasp_file("base.npz", hand="claw", base_link="mount"), "'claw'", "base_link 'mount'", "'allegro'"),
        (grasp_file("empty_base.npz", hand="claw", base_link="palm"), "'claw'", "base_link 'palm'", "'allegro'"),
    ):
        answer = refused(capfd, *QUICK, "--hand", "allegro", "--grasps", path, "--json", "report.json")
        assert_names(answer, *named)


def test_several_objects_need_a_choice(grasp_file: Callable[..., Path], capfd: pytest.CaptureFixture[str]):
    many = grasp_file(object=["mug", "mug", "can", "rounded_box"])
    answer = refused(capfd, "run", "--grasps", many)
    assert_names(answer, many, "3 objects", "--object-name", "--objects", "mug (2), can (1), rounded_box (1)")
    answer = refused(capfd, "run", "--grasps", many, "--object-name", "cans")
    assert_names(answer, "'cans'", "can (1), mug (2), rounded_box (1)")
    answer = refused(capfd, "run", "--grasps", many, "--object-name", "can")
    assert_names(answer, "'can'", "--object")


def test_targets_must_fit_the_grasps(grasp_file: Callable[..., Path], capfd: pytest.CaptureFixture[str]):
    points = {"target_point_link": np.zeros((4, 1, 3)), "target_point_object": np.zeros((4, 1, 3))}
    none = grasp_file("none.npz")
    assert_names(refused(capfd, *QUICK, "--targets", none), none, "targets")
    wrong = grasp_file("wrong.npz", target_link=["nose"], **points)
    assert_names(refused(capfd, *QUICK, "--targets", wrong), "'nose'")
    other = grasp_file("other.npz", object="mug", target_link=["link_3.0_tip"], **points)
    assert_names(refused(capfd, *QUICK, "--targets", other), other, EXAMPLE)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--itertions 5", ("--itertions, 5", "--iterations;")),
        ("--object missing.obj --object-name rounded_box", ("missing.obj",)),
        ("--object rounded_box --scale 0", ("scale", "0")),
        ("--object rounded_box --index 4", ("index 4", "'rounded_box'", "4 grasps", "0 to 3")),
        ("--index 0,x", ("--index", "'x'")),
        ("mine.npz", ("--grasps mine.npz",)),
        ("--object rounded_box --contacts thumbb", ("thumbb", "thumb?")),
        ("--object rounded_box --freeze pal", ("--freeze", "pal", "palm?", "translation", "thumb", "joint_3.0")),
        ("--object mugg", ("mugg", "mug?")),
        ("--weights.contact nan", ("--weights.contact", "nan")),
        ("--descent.shares 0.5", ("descent", "shares", "factors", "1 and 2")),
        ("--derivative rigid --neighborhood fixed", ("--derivative rigid", "--neighborhood fixed")),
        ("--distance.coupling one-sided", ("--distance.*", "--derivative distance", "contact-kinematics")),
        ("--threshold 2", ("threshold", "0.01 to 1", "2")),
        ("--device nonsense", ("--device nonsense", "--dtype float64")),
        ("--hand claw", ("'claw'", "allegro")),
        ("--object bowl", ("'allegro'", "'bowl'", "bottle, mug, rounded_box")),
        ("--json .", (".:",)),
        ("--weights.table 3", ("--weights.table", "--table")),
        ("--weights.direction 3", ("--weights.direction",)),
        ("--weights.joint-limits 3", ("--weights.joint-limits", "--solver descent", "adam")),
        ("--scales.rotation 2", ("--scales.*", "--weights.stay-near", "0")),
        ("--solver descent --adaptive.samples 4", ("--adaptive.samples", "--contact-kinematics.sampled")),
        ("--adaptive.samples 4", ("--adaptive.*", "--solver descent", "adam")),
        ("--contact-kinematics.smallest-curvature 3", ("--contact-kinematics.*", "--solver descent")),
        ("--levenberg-marquardt.widths", ("levenberg-marquardt", "widths")),
        ("--max-move 0.01,0.1", ("--max-move", "3 numbers", "0.01,0.1,0.2", "2")),
        ("--max-move 0.01,-1,3", ("--max-move", "0", "-1")),
        ("--seconds 0", ("--seconds", "0")),
        ("--geometry-only --starts 3", ("--geometry-only", "--starts")),
        ("--geometry-only --weights.wrench 1", ("--geometry-only", "--weights.wrench")),
        ("--weights.wrench 0 --starts 3", ("--starts", "--weights.wrench 0")),
        ("--targets nearest --starts 3", ("--starts", "targets")),
        ("--targets nearest --geometry-only", ("--geometry-only", "targets")),
        ("--solver adam --starts 3", ("--starts", "--solver levenberg-marquardt", "adam")),
        ("--solver descent --max-move 1,1,1", ("--max-move", "--solver levenberg-marquardt", "descent")),
        ("--solver adam --weights.wrench 2", ("--weights.wrench", "--solver levenberg-marquardt", "adam")),
        ("--dtype float32", ("--dtype float32", "--solver descent", "adam", "levenberg-marquardt")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "run", *options.split()), *named)


def test_only_embedded_hands_have_examples(inputs: Path, capfd: pytest.CaptureFixture[str]):
    shutil.copy(resource_dir("robots") / "allegro" / "allegro.urdf", inputs / "mine.urdf")
    assert_names(refused(capfd, "run", "--hand", inputs / "mine.urdf"), "--grasps", "allegro")


# Interruption


@pytest.mark.slow
def test_ctrl_c_leaves_one_line_and_no_files():
    options = "--object rounded_box --tolerance 0 --solver descent"
    command = [sys.executable, "-c", PROGRAM, "run", *options.split()]
    process = subprocess.Popen(
        [*command, "--descent.patience", "100000", "--iterations", "1000000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=subprocess_environment(),
        preexec_fn=interruptible,
    )  # fmt: skip
    assert process.stderr is not None and "4 grasps" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (130, "")
    assert_names(error, "refine-grasp: ")
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("line", [pytest.param("scenes", marks=pytest.mark.slow), "--help"])
def test_nobody_reads_the_output(line: str):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-c", PROGRAM, *line.split()]
    result = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, env=subprocess_environment())
    os.close(write)
    assert (result.returncode, result.stderr) == (141, "")


# hands and doctor


def test_hands_lists_what_comes_with_the_program(capsys: pytest.CaptureFixture[str]):
    assert main(["hands", "--json", "hands.json"]) == 0
    out = capsys.readouterr().out
    assert "allegro" in out and "Apache-2.0" in out
    document = json.loads(Path("hands.json").read_text())
    assert (document["schema"], document["command"]) == (1, "hands")
    (allegro,) = [hand for hand in document["hands"] if hand["name"] == "allegro"]
    assert len(allegro["joints"]) == 16 and len(allegro["contacts"]) == 4
    assert "example_mug.npz" in allegro["examples"]
    assert not any(contact["guessed"] for contact in allegro["contacts"])


def test_the_doctor_finds_a_working_installation(capsys: pytest.CaptureFixture[str]):
    assert main(["doctor", "--json", "doctor.json", "--overwrite"]) == 0
    out = capsys.readouterr().out
    assert "cpu" in out and "allegro" in out and f"grasp-refine {own_version()}" in out
    document = json.loads(Path("doctor.json").read_text())
    assert document["problems"] == []
    assert document["cache"]["entries"] == 0
    names = {package["name"] for package in document["packages"]}
    assert names >= {"torch", "coal", "coacd", "viser"} and not names & {"pytest", "playwright", "ruff"}
    assert "playwright" not in out


def test_the_doctor_names_what_is_missing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    from grasp_refine.core.versions import Requirement
    from grasp_refine_apps.commands import doctor

    needs = (Requirement("no-such-package", ">=1"), Requirement("numpy", ">=999"), Requirement("nor-this", "", "x"))
    monkeypatch.setattr(doctor, "requirements", lambda: needs)
    assert main(["doctor"]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert re.search(r"no-such-package is missing\b.* >=1 ", out) and re.search(r"numpy is too old\b.* >=999 ", out)
    assert (
        "nor-this is missing" not in out and "pip install --upgrade" in out and 'pip install "grasp-refine[x]"' in out
    )
