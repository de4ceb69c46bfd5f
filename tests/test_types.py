"""A checker of types finds nothing wrong in the program, and knows what its functions take and give in a user's."""

from __future__ import annotations

import ast
import builtins
import re
import subprocess
import sys
from pathlib import Path

import pytest

from readme import blocks, extension_blocks

pytest.importorskip("mypy", reason="the checker comes with the extra 'test'")

ROOT = Path(__file__).resolve().parents[1]

STRICT = """
[mypy]
strict = True
[mypy-grasp_refine.*,grasp_refine_apps.*]
follow_imports = silent
"""
"""Options of a careful user's project; what is installed is not reported on."""

REVEALED = """
import numpy as np
import torch
import grasp_refine as gr
from grasp_refine.core.se3 import exp_se3, transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.scene import Scene
from grasp_refine.measures.metrics import metrics
from grasp_refine_apps.cli import main

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
reveal_type(main([]))  # int
reveal_type(gr.refine(gr.load_hand("allegro"), gr.load_object("mug"), gr.load_grasps("grasps.npz")))  # RefinedGrasps
reveal_type(Kinematics(hand, hand.joint_names)(torch.eye(4), torch.zeros(16)))  # Tensor
"""

WRONG = """
from grasp_refine.hands.hand import load_hand
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine

refine(load_hand("allegro"))
Config(margin="thin")
load_hand("allegro", candidats=100)
load_hand("allegro").joint_name
"""


def check(folder: Path, *arguments: str | Path, cache: Path, **variables: str) -> list[str]:
    """Return what mypy prints, run in a folder with the given environment variables and no others of ours."""
    result = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-error-summary", "--no-pretty", "--hide-error-context"]
        + ["--cache-dir", str(cache), *map(str, arguments)],
        cwd=folder,
        env={"PATH": "/usr/bin:/bin", **variables},
        capture_output=True,
        text=True,
    )
    assert result.returncode in (0, 1), result.stdout + result.stderr
    return result.stdout.splitlines()


def check_project(folder: Path, **modules: str) -> list[str]:
    """Return what mypy prints of a user's modules, beside which both packages are on the search path."""
    (folder / "mypy.ini").write_text(STRICT)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    files = [f"{name}.py" for name in modules]
    return check(folder, *files, cache=folder / ".mypy_cache", MYPYPATH=f"{ROOT}:{ROOT / 'apps'}")


def undefined(code: str) -> set[str]:
    """Names that a block of code uses, but neither defines nor imports."""
    names = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name | ast.alias)]
    defined = {(n.asname or n.name).split(".")[0] for n in names if isinstance(n, ast.alias)}
    defined |= {n.id for n in names if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load)}
    return {n.id for n in names if isinstance(n, ast.Name)} - defined - set(dir(builtins))


def examples() -> list[str]:
    """The Python of README.md and the documentation: each block, with the one before where it goes on from there.

    Extensions are short, without annotations.
    """
    found: list[str] = []
    for block in (block for block in blocks("python") if block not in extension_blocks()):
        found.append(found[-1] + block if found and undefined(block) else block)
    return found


@pytest.mark.slow
def test_nothing_is_wrong_in_the_program(tmp_path: Path) -> None:
    """Run as a developer runs it: `mypy` in the checkout."""
    assert check(ROOT, cache=tmp_path / "cache") == []


def test_a_fault_in_either_package_is_found(tmp_path: Path) -> None:
    """So that mypy finding nothing wrong means that it has read both."""
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    for package in ("grasp_refine", "apps/grasp_refine_apps"):
        (tmp_path / package).mkdir(parents=True)
        (tmp_path / package / "__init__.py").write_text('length_m: float = "long"\n')
    said = check(tmp_path, cache=tmp_path / "cache")
    found = {line.partition(":")[0] for line in said if line.endswith("[assignment]")}
    assert found == {"grasp_refine/__init__.py", "apps/grasp_refine_apps/__init__.py"}


@pytest.mark.slow
def test_a_users_project(tmp_path: Path) -> None:
    blocks = {f"example{number}": block for number, block in enumerate(examples())}
    assert len(blocks) >= 5
    said = check_project(tmp_path, **blocks, revealed=REVEALED, wrong=WRONG)
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
