"""Command lines of README.md and the documentation: all can be read, recipes run, and what is shown is printed."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scans.depth_camera import D435, depth_of, views_around
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands import options
from readme import GUIDES, PAGES, TEXT, blocks, run_python


def commands_of(block: str) -> list[str]:
    """The commands of a block of shell: lines put together, comments left out, variables with values."""
    text = re.sub(r"\\\n", " ", re.sub(r"\$\{?[A-Z_]+\}?", "1", block))
    lines = [shlex.split(line, comments=True) for line in text.splitlines()]
    return [part for words in lines if words for part in " ".join(words).split(" && ")]


def ours(command: str) -> list[str] | None:
    """The words after `refine-grasp` in a command, also where another program runs it; None: it is not there."""
    found = re.search(r"(?:^|/|srun |--wrap )refine-grasp(.*)", command)
    return None if found is None else found[1].split()


OTHERS = {
    "python3 -m venv .venv": "the two commands that set it up are run by .ci/run",
    ".venv/bin/pip install": "likewise",
    "pip install": "likewise, for Drake",
    ".venv/bin/pytest": "likewise",
    ".venv/bin/ruff": ".ci/run runs it",
    "PYTHONPATH=tests .venv/bin/python -m mutation": "tests/mutation/test_mutants.py runs it",
    ".venv/bin/mkdocs": ".ci/run builds the documentation",
    ".venv/bin/refine-grasp run": "likewise",
    ".venv/bin/python allegro_mug_mujoco/simulate.py": "tests/export/test_export.py runs this script",
    "ros2 topic pub": "no ROS is here; tests/export/test_ros2.py reads the messages",
    "dask ": "tests/dask_cluster.py starts such a cluster",
    "parts=$(sbatch": "no scheduler is here; what it runs is read below",
}
"""How commands of other programs begin, and why they are not tried here."""

COMMANDS = [command for language in ("sh", "bash") for block in blocks(language) for command in commands_of(block)]
INLINE = [code for code in re.findall(r"`(refine-grasp [^`]+)`", TEXT) if not code.endswith((" ...", "COMMAND"))]


def checked_options(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """From now on commands are parsed, told in the list that is returned, and not executed."""
    said: list[tuple[str, ...]] = []
    parse = options.parse

    def parse_only(command: type, program: str, arguments: list[str]) -> object:
        said.append((program, *arguments))
        parse(command, program, arguments)
        return SimpleNamespace(execute=lambda: 0)

    monkeypatch.setattr(options, "parse", parse_only)
    return said


@pytest.mark.parametrize("command", dict.fromkeys([*COMMANDS, *INLINE]))
def test_every_command_line_can_be_read(
    command: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    words = ours(command.replace("FILE...", "FILE"))
    if words is None or command.startswith(".venv/bin/refine-grasp run"):
        assert any(command.startswith(start) for start in OTHERS), f"nobody tries: {command}"
        return
    said = checked_options(monkeypatch)
    try:
        code = main(words)
    except SystemExit as end:  # of --help
        code = end.code
    assert code == 0, capfd.readouterr().err
    assert len(said) <= 1


# recipes


@pytest.fixture
def newcomer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a hand, an object and grasps that are somebody's own; commands run in it."""
    grasps = load_grasps(resource_dir("robots") / "allegro" / "example_rounded_box.npz")
    shutil.copy(resource_dir("robots") / "allegro" / "allegro.urdf", tmp_path / "my_hand.urdf")
    (tmp_path / "meshes").mkdir()
    for path in ("my_object.obj", "meshes/my_object.obj"):
        load_object("rounded_box").mesh.export(tmp_path / path)
    q, _ = match_joints(grasps, load_hand("allegro", candidates=16))
    np.save(tmp_path / "my_poses.npy", transform_from_pose(grasps.hand_pose))
    np.save(tmp_path / "my_joints.npy", q)
    monkeypatch.chdir(tmp_path)
    run_python("my_poses.npy")
    (pose,) = views_around(load_object("rounded_box").mesh, 1, seed=0)
    depth = depth_of(load_object("rounded_box").mesh, pose)
    Image.fromarray(np.round(depth * 1e3).astype(np.uint16)).save("depth.png")
    Image.fromarray((depth > 0).astype(np.uint8)).save("mask.png")
    np.savetxt("camera.txt", pose)
    Path("lens.json").write_text(json.dumps({name: getattr(D435, name) for name in ("fx", "fy", "cx", "cy")}))
    return tmp_path


RECIPES = ("my-hand", "my-object", "my-dataset", "validate", "scenes", "use-it-in", "scans")
"""Guides that begin with commands to be copied."""


def recipe(guide: str) -> list[list[str]]:
    """The commands that a guide begins with, as words after `refine-grasp`."""
    beginning = PAGES[f"{GUIDES}/{guide}.md"].partition("\n## ")[0]
    return [ours(command) for block in blocks("sh", beginning) for command in commands_of(block)]


def test_the_recipes_of_the_readme_are_as_in_the_guides():
    text = PAGES["README.md"].partition("\n## Recipes\n")[2].partition("\n## ")[0]
    shown = [ours(command) for block in blocks("sh", text) for command in commands_of(block)]
    told = [command for guide in RECIPES for command in recipe(guide)]
    assert len(shown) >= 5 and [command for command in shown if command not in told] == []


@pytest.mark.slow
@pytest.mark.parametrize("guide", RECIPES)
def test_recipes_run(guide: str, newcomer: Path, capfd: pytest.CaptureFixture[str]):
    commands, said = recipe(guide), ""
    assert len(commands) >= 2
    for words in commands:
        assert main(words) == 0, (words, capfd.readouterr().err)
        out = capfd.readouterr().out
        said += out
        if words[0] == "run" and "my_grasps.npz" in words:
            assert "→ 2 of 2" in out, "the grasps were told as they are"
    made = {
        "my-hand": ("hand.toml", "grasp-refine-results/my_hand_mug.npz"),
        "my-object": ("grasp-refine-results/leap_my_object.npz", "box.json"),
        "my-dataset": ("refined/report.html", "grasp-refine-results/my_hand_my_object.npz"),
        "validate": ("grasp-refine-results/allegro_mug.npz", "replays"),
        "scenes": ("grasp-refine-results/allegro_mug.npz",),
        "scans": ("grasp-refine-results/allegro_depth.npz",),
        "use-it-in": (
            "allegro_mug_mujoco/simulate.py",
            "allegro_mug_tables/contacts.csv",
            "allegro_mug_ros2/grasps/0.cdr",
            "allegro_mug_isaac/mug.obj",
            "allegro_mug_lerobot/meta/info.json",
        ),
    }
    for name in made[guide]:
        assert (newcomer / name).exists(), name
    if guide == "validate":
        film = set() if "no film" in said else {".gif"}  # where nothing can be drawn without a screen
        assert {path.suffix for path in (newcomer / "replays").iterdir()} == {".npz", ".xml"} | film


# what commands print

PRINTED = ("$ refine-grasp run\n", "validate geometry", "held in simulation (", "--margins")
"""What tells apart the blocks of text; a test compares each."""


def test_no_block_of_text_is_left_out():
    assert [[mark in block for mark in PRINTED].count(True) for block in blocks("text")] == [1] * len(PRINTED)


def sessions(block: str) -> list[tuple[list[str], str]]:
    """The commands of a block, as words after `refine-grasp`, with what they print as far as it is shown."""
    parts = re.split(r"^\$ refine-grasp (.*)\n", block, flags=re.MULTILINE)[1:]
    return [(shlex.split(command), shown) for command, shown in zip(parts[::2], parts[1::2], strict=True)]


def words_of(text: str) -> list[str]:
    """Words and numbers without what differs from machine to machine: how long it took."""
    return re.sub(r"[\d.]+ m?s\b|─+", "", text).split()


def is_close(shown: str, printed: str) -> bool:
    try:
        return abs(float(shown) - float(printed)) <= 0.02 + 0.1 * abs(float(shown))
    except ValueError:
        return shown == printed


def is_as_shown(shown: str, printed: str) -> bool:
    """Whether a number is that of a run here to the last digit, give or take one of them and a hundredth."""
    _, point, decimals = shown.partition(".")
    if not point or not is_close(shown, printed):
        return is_close(shown, printed)
    return shown == printed or abs(float(shown) - float(printed)) <= 1.01 * 10.0 ** -len(decimals) + 0.01 * float(shown)


def test_what_you_get_is_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("text") if PRINTED[0] in block)
    ((command, shown),) = sessions(block)
    assert main(command) == 0
    wanted, printed = words_of(shown), words_of(capfd.readouterr().out)
    assert len(wanted) == len(printed)
    assert [pair for pair in zip(wanted, printed, strict=True) if not is_as_shown(*pair)] == []


def test_the_validation_that_is_shown_has_these_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    """The measures of its grasps, and that most are lost; how each is lost may differ from machine to machine."""
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("text") if PRINTED[1] in block)
    (_, shown) = sessions(block)[-1]
    for command, _ in sessions(block):
        assert main(command) == 0
        printed = capfd.readouterr().out
    rows = [[line.split() for line in text.splitlines() if re.match(r" {5}\d ", line)] for text in (shown, printed)]
    assert [len(part) for part in rows] == [4, 4]
    for wanted, found in zip(*rows, strict=True):
        assert all(is_close(*pair) for pair in zip(wanted[:6], found[:6], strict=True)), (wanted, found)
    told, held = (int(re.search(r"^(\d) of 4 grasps held", text, re.MULTILINE)[1]) for text in (shown, printed))
    assert told == 1 and held <= 2
    assert printed.split("\n")[0].split() == shown.split("\n")[0].split()


@pytest.mark.slow
def test_what_simulation_says_of_a_run_is_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("text") if PRINTED[2] in block)
    assert main(["run", "--validate"]) == 0
    assert " ".join(block.split()) in " ".join(capfd.readouterr().out.split())


@pytest.mark.slow
def test_the_margins_that_are_shown_are_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    (block,) = (block for block in blocks("text") if PRINTED[3] in block)
    ((command, shown),) = sessions(block)
    for first in (["run"], ["run", "--geometry-only", "--out", "geometry"], command):
        assert main(first) == 0
        printed = capfd.readouterr().out
    wanted, found = (
        [line.split() for line in text.splitlines() if re.match(r" {5}\d  |   all  ", line)]
        for text in (shown, printed)
    )
    # Of the second file the table of drawn worlds comes last.
    assert len(wanted) == 5 and [row[1:4] for row in wanted] == [row[1:4] for row in found[-5:]]
