"""Formats of users: added by a script or by an entry point, found wherever ours are, and refused by name."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.listing import FORMATS, add_format
from grasp_refine.grasps.formats.reading import load_grasps
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine_apps.batch.jobs import read_jobs
from refusals import refused

MODULE = """
import numpy as np
from grasp_refine.grasps.formats.format import Format, Part
from grasp_refine.grasps.grasp_set import GraspSet


class Mine(Format):
    name, what = "mine", "mine: one .json file per object"

    def mismatch(self, content):
        return "" if isinstance(content, dict) and "my_hand" in content else "it has no my_hand"

    def read(self, source, hand):
        held = source.content
        poses = source.poses(held["poses"], "poses")
        q = source.numbers(held["q"], "q", (len(poses), len(held["joints"])))
        things = np.full(len(q), held["thing"]), np.ones(len(q))
        return GraspSet(held["my_hand"], held["link"], tuple(held["joints"]), *things, poses, q), ()

    def write(self, grasps, load):
        content = {
            "my_hand": grasps.hand, "link": grasps.base_link, "joints": list(grasps.joint_names),
            "thing": grasps.object[0], "poses": grasps.hand_pose.tolist(), "q": grasps.q.tolist(),
        }
        return [Part("mine.json", np.arange(len(grasps)), content)], ()


MINE = Mine()
"""
"""A format as a user's package has it."""

CONTENT = {
    "my_hand": "any", "link": "palm", "joints": ["a", "b"], "thing": "mug", "poses": [[0, 0, 0.1, 1, 0, 0, 0]],
    "q": [[0.1, 0.2]],
}  # fmt: skip


@pytest.fixture
def mine(tmp_path: Path) -> Iterator[Any]:
    """The format, added."""
    names: dict[str, Any] = {}
    exec(MODULE, names)
    add_format(names["MINE"])
    yield names["MINE"]
    FORMATS.remove("mine")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "grasps.json"
    path.write_text(json.dumps(CONTENT))
    return path


def test_an_added_format_is_recognised(mine: Format, file: Path):
    for found in (load_grasps(file), load_grasps(file, format="mine"), load_grasps(file.parent)):
        assert found.q.tolist() == CONTENT["q"] and found.hand == "any" and found.object.tolist() == ["mug"]
    assert [job.inputs.grasps for job in read_jobs([str(file.parent)], ProblemSpec())] == [file]
    with refused(GraspFileError, file, "bodex"):
        load_grasps(file, format="bodex")


def test_without_it_the_file_is_of_no_format(file: Path):
    with refused(GraspRefineError, file.parent):
        read_jobs([str(file.parent)], ProblemSpec())
    with refused(GraspFileError, file, "no known format"):
        load_grasps(file)
    with refused(GraspFileError, "'mine'", "ours"):
        load_grasps(file, format="mine")


def test_entry_points_are_found_by_convert(file: Path, tmp_path: Path):
    package = tmp_path / "site"
    (package / "mine-1.0.dist-info").mkdir(parents=True)
    (package / "mine.py").write_text(MODULE)
    (package / "mine-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (package / "mine-1.0.dist-info" / "entry_points.txt").write_text("[grasp_refine.formats]\nmine = mine:MINE\n")
    code = (
        "import sys\nfrom grasp_refine_apps.cli import main\nsys.exit(any(main(one.split()) for one in sys.argv[1:]))"
    )
    commands = "convert grasps.json ours.npz --to ours", "convert ours.npz back.json --to mine"
    paths = os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code, *commands], cwd=tmp_path, env={**os.environ, "PYTHONPATH": paths},
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert load_grasps(tmp_path / "ours.npz").q.tolist() == CONTENT["q"]
    assert json.loads((tmp_path / "back.json").read_text()) == CONTENT


class Silent(Format):
    name, what = "silent", "a format whose mismatch says nothing"

    def mismatch(self, content: Any) -> Any:
        return None

    def read(self, source: Any, hand: Any) -> Any:
        return np.zeros(3)


class Bare:
    name = "bare"

    def read(self, source: Any, hand: Any) -> Any:
        return GraspSet


def test_what_is_no_format_is_refused():
    with refused(GraspRefineError, "Bare", "what", "named_by_path", "mismatch", "write"):
        add_format(Bare())  # type: ignore[arg-type]
    with refused(GraspRefineError, "the class Silent itself", "Silent()"):
        add_format(Silent)  # type: ignore[arg-type]
    with refused(GraspRefineError, "'bodex'", "taken"):
        add_format(FORMATS["bodex"])
    with pytest.raises(TypeError, match="mismatch"):
        type("Half", (Format,), {"name": "half", "what": "half"})()
