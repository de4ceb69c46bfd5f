"""A checker of types finds nothing wrong in the program, and knows what its functions take and give in a user's."""

from __future__ import annotations

import ast
import builtins
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

pytest.importorskip("mypy", reason="the checker comes with the extra 'test'")

ROOT = Path(__file__).resolve().parents[1]

STRICT = """
[mypy]
strict = True
[mypy-grasp_refine.*]
follow_imports = silent
"""
"""How a careful user checks a project; what is installed is not reported on."""

REVEALED = """
import numpy as np
import torch
from grasp_refine.grasps import load_grasps, match_joints
from grasp_refine.hand import load_hand
from grasp_refine.kinematics import Kinematics
from grasp_refine.objects import load_object
from grasp_refine.refine import refine
from grasp_refine.scene import Scene
from grasp_refine.se3 import exp_se3, transform_from_pose
from grasp_refine.validation.metrics import metrics

hand, obj, grasps = load_hand("allegro"), load_object("mug"), load_grasps("grasps.npz")
q, notes = match_joints(grasps, hand)
T = transform_from_pose(grasps.hand_pose)
result = refine(Scene(hand, obj, T, q))
reveal_type(hand)  # Hand
reveal_type(obj)  # Object
reveal_type(grasps)  # GraspSet
reveal_type(q)  # ndarray
reveal_type(notes)  # tuple[str, ...]
reveal_type(T)  # ndarray
reveal_type(exp_se3(torch.zeros(6)))  # Tensor
reveal_type(result)  # Refinement
reveal_type(result.loss)  # ndarray
reveal_type(metrics(hand, obj, result.T_world_root, result.q).quality)  # ndarray
reveal_type(Kinematics(hand, hand.joint_names)(torch.eye(4), torch.zeros(16)))  # Tensor
"""

WRONG = """
from grasp_refine.config import Config
from grasp_refine.hand import load_hand
from grasp_refine.refine import refine

refine(load_hand("allegro"))
Config(margin="thin")
load_hand("allegro", candidats=100)
load_hand("allegro").joint_name
"""


@pytest.fixture(scope="module")
def laid_out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as the wheel holds it: in a checkout `grasp_refine_apps` is elsewhere."""
    folder = tmp_path_factory.mktemp("laid_out")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for place, source in project["tool"]["scikit-build"]["wheel"]["packages"].items():
        shutil.copytree(ROOT / source, folder / place, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    return folder


def checked(laid_out: Path, folder: Path, *arguments: str | Path) -> list[str]:
    """What mypy says, run in a folder."""
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--no-pretty", "--hide-error-context"]
    result = subprocess.run(
        [*command, "--cache-dir", folder / ".mypy_cache", *arguments],
        cwd=folder,
        env={"MYPYPATH": str(laid_out), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
    )
    assert result.returncode in (0, 1), result.stdout + result.stderr
    return result.stdout.splitlines()


def users(laid_out: Path, folder: Path, **modules: str) -> list[str]:
    """What mypy says of some modules of a user."""
    (folder / "mypy.ini").write_text(STRICT)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    return checked(laid_out, folder, *(f"{name}.py" for name in modules))


def undefined(code: str) -> set[str]:
    """Names that a block of code uses, but neither defines nor imports."""
    names = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name | ast.alias)]
    defined = {(n.asname or n.name).split(".")[0] for n in names if isinstance(n, ast.alias)}
    defined |= {n.id for n in names if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load)}
    return {n.id for n in names if isinstance(n, ast.Name)} - defined - set(dir(builtins))


def examples() -> list[str]:
    """The Python of the README: each block, with the one before where it goes on from there."""
    found: list[str] = []
    for block in re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE):
        found.append(found[-1] + block if found and undefined(block) else block)
    return found


@pytest.mark.slow
def test_nothing_is_wrong_in_the_program(laid_out: Path) -> None:
    said = checked(laid_out, laid_out, "--config-file", ROOT / "pyproject.toml")
    assert said == []


@pytest.mark.slow
def test_a_users_project(laid_out: Path, tmp_path: Path) -> None:
    blocks = {f"example{number}": block for number, block in enumerate(examples())}
    assert len(blocks) >= 5
    said = users(laid_out, tmp_path, **blocks, revealed=REVEALED, wrong=WRONG)
    assert [line for line in said if line.startswith("example")] == []

    revealed = [line for line in said if line.startswith("revealed")]
    wanted = re.findall(r"^reveal_type\(.*  # (.*)$", REVEALED, re.MULTILINE)
    assert len(revealed) == len(wanted)
    for line, name in zip(revealed, wanted, strict=True):
        assert re.search(rf'note: Revealed type is "(\w+\.)*{re.escape(name)}', line), line

    wrong = [line for line in said if line.startswith("wrong")]
    assert [re.search(r"\[([a-z-]+)\]$", line).group(1) for line in wrong if ": error:" in line] == [
        "arg-type",
        "arg-type",
        "call-arg",
        "attr-defined",
    ]


def test_examples_that_go_on_are_joined() -> None:
    assert undefined("import numpy as np\nx = np.zeros(3)\nprint(x, y)") == {"y"}
    assert undefined("from a.b import c as d\nfor i in d:\n    i.go()") == set()
