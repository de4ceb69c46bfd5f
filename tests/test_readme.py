"""What README.md shows is true: its Python runs, its picture and files exist, its options are known."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from grasp_refine.cli import main
from grasp_refine.commands.inputs import Inputs
from grasp_refine.commands.job_list import read_jobs
from grasp_refine.grasps import OTHER_STAGES, REQUIRED, TARGET_KEYS, load_grasps
from grasp_refine.hand import HAND_TOML, load_hand
from grasp_refine.report.verdict import HOLDS

BENCHES = ("bench align", "bench queries", "bench grasp", "bench hold", "bench --gate")

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """The fenced blocks of README.md in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def test_the_example_in_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("python") if "refine(" in block)
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    before, after = names["result"].loss.T
    assert (after < 1e-2 * before).all()
    refined = load_grasps(tmp_path / "refined.npz")
    assert len(refined) == len(names["grasps"]) and refined.joint_names == names["hand"].joint_names


def test_the_example_of_the_layer_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("python") if "WitnessLayer" in block)
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    # The ball is 8 cm from the axis of a mug of 4 cm, and has a radius of 2 cm.
    assert names["witness"].distance.item() == pytest.approx(0.02, abs=5e-4)
    gradient = names["T_ball"].grad
    assert gradient.isfinite().all() and gradient.abs().max() > 0


def test_no_block_of_python_is_left_out():
    assert len(blocks("python")) == 2


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
    section = TEXT.partition("## Grasp files")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in section.splitlines() if "|" in line)))
    stages = {f"{stage}_{key}" for stage in OTHER_STAGES for key in ("pose", "q")}
    assert listed == {*REQUIRED, *TARGET_KEYS, *stages, "schema", "initial_pose", "initial_q"}


def test_the_links_and_places_exist():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", TEXT):
        assert (ROOT / target).is_file(), target
    development = TEXT.partition("## Development")[2].partition("\n## ")[0]
    for cell in re.findall(r"^\| (`.*?) \|", development, re.MULTILINE):
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
    [("Benchmarks", "align"), ("Benchmark of queries", "queries"), ("Benchmark of grasps", "grasp")],
)
def test_the_presets_of_the_benchmarks_are_listed(heading: str, bench: str):
    presets = import_module(f"grasp_refine.apps.bench.{bench}.presets").PRESETS
    section = TEXT.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    listed = re.findall(
        r"`([\w-]+)`", "".join(line.split("|")[1] for line in section.splitlines() if line.startswith("|"))
    )
    assert set(listed) == set(presets)
