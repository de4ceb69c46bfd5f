"""What README.md shows is true: its Python runs, its tables are complete, its links and options exist."""

from __future__ import annotations

import inspect
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from grasp_refine.grasps.grasp_set import OTHER_STAGES, REQUIRED, TARGET_KEYS, load_grasps
from grasp_refine.hands.hand import HAND_TOML, load_hand
from grasp_refine.results.verdict import HOLDS, should_hold
from grasp_refine.validation.metrics import metrics
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.job_list import read_jobs
from readme import ROOT, TEXT, blocks, python_block, run_python, section

BENCHES = ("bench align", "bench queries", "bench stability", "bench grasp", "bench hold", "bench --gate")


def test_the_example_in_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    names = run_python("refine(scene")
    before, after = names["result"].loss.T
    assert (after < 1e-2 * before).all()
    quality = metrics(names["hand"], names["mug"], names["result"].T_world_root, names["result"].q).quality
    assert should_hold(quality).all(), "the quality that it asks for is reached"
    refined = load_grasps(tmp_path / "refined.npz")
    assert len(refined) == len(names["grasps"]) and refined.joint_names == names["hand"].joint_names
    # And what follows it.
    names = run_python("simulate(", names)
    assert names["trials"].success.all() and not names["trials"].reason.any()


def test_the_example_of_the_layer_runs():
    names = run_python("T_ball.grad")
    # The ball is 8 cm from the axis of a mug of 4 cm, and has a radius of 2 cm.
    assert names["witness"].distance.item() == pytest.approx(0.02, abs=5e-4)
    gradient = names["T_ball"].grad
    assert gradient.isfinite().all() and gradient.abs().max() > 0


def test_the_loss_of_ones_own_takes_fifteen_lines_and_is_minimised():
    lines = [line for line in python_block("optimizer.step").splitlines() if line.strip()]
    assert len([line for line in lines if not re.match(r"import |from ", line)]) == 15
    witness = run_python("optimizer.step")["witness"]
    assert witness.distance.shape == (4, 4)
    assert (witness.distance - 0.002).abs().max() < 1e-3
    height = witness.point_b[..., 2]
    assert (height.amax(1) - height.amin(1)).max() < 3e-3


PYTHON = ("refine(scene", "simulate(", "T_ball.grad", "optimizer.step", "my_poses.npy")
"""What tells apart the blocks of Python; a test runs each."""

TOML = ("rest_pose", "[[job]]")
"""The same of TOML."""


@pytest.mark.parametrize(("language", "marks"), [("python", PYTHON), ("toml", TOML)])
def test_no_block_is_left_out(language: str, marks: tuple[str, ...]):
    assert [[mark in block for mark in marks].count(True) for block in blocks(language)] == [1] * len(marks)


def test_blocks_are_of_these_languages_only():
    fences = re.findall(r"^ *```(.*)$", TEXT, re.MULTILINE)
    assert set(fences[::2]) == {"python", "toml", "text", "sh", "bash"} and set(fences[1::2]) == {""}


def test_the_hand_toml_has_only_known_keys(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "rest_pose" in block)
    raw = tomllib.loads(block)
    assert set(raw) == {"urdf", "base_link", "rest_pose", "contact"}
    joints = "".join(
        f'<joint name="{child}_joint" type="revolute"><parent link="palm"/><child link="{child}"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="2" effort="1" velocity="1"/></joint>'
        f'<link name="{child}"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>'
        for child in ("thumb_tip", "other_tip")
    ).replace("thumb_tip_joint", "thumb_joint")
    (tmp_path / "my_hand.urdf").write_text(f'<robot name="my"><link name="palm"/>{joints}</robot>')
    (tmp_path / HAND_TOML).write_text(block)
    hand = load_hand(tmp_path)
    assert [contact.link for contact in hand.contacts] == ["thumb_tip"]
    assert dict(zip(hand.joint_names, hand.rest, strict=True))["thumb_joint"] == 1.2


def test_the_job_list_can_be_read(tmp_path: Path):
    (block,) = (block for block in blocks("toml") if "[[job]]" in block)
    for name in ("right/a.npz", "right/b.npz", "hands/right.urdf", "meshes/mug.obj"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    path = tmp_path / "jobs.toml"
    path.write_text(block)
    jobs = read_jobs([str(path)], Inputs())
    assert [job.name for job in jobs] == ["right hand/a", "right hand/b", "sample_1000"]
    assert [job.inputs.objects for job in jobs] == [tmp_path / "meshes"] * 3


def test_the_table_of_grasp_files_is_complete():
    lines = section("Grasp files").splitlines()
    listed = set(re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in lines if "|" in line)))
    stages = {f"{stage}_{key}" for stage in OTHER_STAGES for key in ("pose", "q")}
    assert listed == {*REQUIRED, *TARGET_KEYS, *stages, "schema", "initial_pose", "initial_q"}


def test_the_links_and_places_exist():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", TEXT):
        assert (ROOT / target).is_file(), target
    for cell in re.findall(r"^\| (`.*?) \|", section("Development"), re.MULTILINE):
        for place in re.findall(r"`([^`]+)`", cell):
            assert (ROOT / place).exists() or (ROOT / "grasp_refine" / place).exists(), place


def test_the_options_are_those_of_the_commands(capsys: pytest.CaptureFixture[str]):
    known = set()
    for command in ("run", "batch", "validate", "view", "hands", "convert", "assets fetch", *BENCHES):
        with pytest.raises(SystemExit):
            main([*command.split(), "--help"])
        known |= set(re.findall(r"--[a-z][\w.-]*", capsys.readouterr().out))
    named = set(re.findall(r"`(--[a-z][\w.-]*)", TEXT)) | set(re.findall(r" (--[a-z][\w.]*-?[\w.]*) ", TEXT))
    elsewhere = {"--help", "--scheduler-file", "--nworkers", "--nthreads", "--parsable", "--wrap"}
    assert {"--hand", "--transport", "--distance.coupling", "--preset"} <= named
    assert named - elsewhere <= known


def test_the_quality_from_which_on_grasps_should_hold_is_told():
    told = re.findall(r"(?:quality|from|\() ?(0\.\d{3}) (?:or more|on)", TEXT)
    assert len(told) >= 3 and set(told) == {f"{HOLDS:.3f}"}


@pytest.mark.parametrize(
    ("heading", "bench"),
    [
        ("Benchmarks", "align"),
        ("Benchmark of queries", "queries"),
        ("Benchmark of grasps", "grasp"),
        ("Benchmark of stability", "stability"),
    ],
)
def test_the_presets_of_the_benchmarks_are_listed(heading: str, bench: str):
    presets = import_module(f"grasp_refine_apps.bench.{bench}.presets").PRESETS
    lines = section(heading).splitlines()
    listed = re.findall(r"`([\w-]+)`", "".join(line.split("|")[1] for line in lines if line.startswith("|")))
    assert set(listed) == set(presets)


# the names that are for use from outside


def entry_points() -> list[tuple[str, str]]:
    return re.findall(r"^\| `([\w.]+)` \| (.*) \|$", section("In Python"), re.MULTILINE)


@pytest.mark.parametrize(("name", "told"), entry_points())
def test_entry_points_are_what_their_docstrings_say(name: str, told: str):
    module, _, attribute = name.rpartition(".")
    point = getattr(import_module(f"grasp_refine.{module}"), attribute)
    assert point.__module__ == f"grasp_refine.{module}", f"name it where it is defined: {point.__module__}"
    first = inspect.getdoc(point).partition("\n")[0]
    assert told == first.rstrip(".").replace("|", "\\|"), "the table repeats the first line of the docstring"


def test_what_the_python_of_the_readme_imports_is_among_the_entry_points():
    imported = {
        f"{module}.{name.strip()}"
        for block in blocks("python")
        for module, names in re.findall(r"^from grasp_refine\.(\S+) import (.*)$", block, re.MULTILINE)
        for name in names.split(",")
        if not name.strip().isupper()
    }
    assert len(entry_points()) >= 50
    assert imported - {name for name, _ in entry_points()} == set()


def anchors() -> set[str]:
    """Headings as links name them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", TEXT, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_within_the_readme_lead_somewhere():
    links = set(re.findall(r"\]\(#([^)]+)\)", TEXT))
    assert len(links) >= 5 and links <= anchors(), links - anchors()


def test_the_order_is_what_a_newcomer_needs_first():
    marks = ("![", "\n## ", "pip install .", "\n$ refine-grasp run\n", "\n### 1. ")
    places = [TEXT.index(mark) for mark in marks]
    assert places == sorted(places), "a picture, how to run it, what comes out, recipes"
    assert len(re.findall(r"^### \d\. ", TEXT, re.MULTILINE)) == 5
