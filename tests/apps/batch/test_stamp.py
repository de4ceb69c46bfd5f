"""Stamps: a result is computed again when anything that it depends on changes, and only then."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from boxed_example import FILE
from grasp_refine.collision.engine import why_not_native
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import dumps
from grasp_refine.grasps.grasp_set import save_npz
from grasp_refine.problem.input_cache import NoCache
from grasp_refine.problem.load import Loader
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.results.document import settings
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.witness.distance import Distance
from grasp_refine_apps.batch import digests
from grasp_refine_apps.batch.jobs import Job
from grasp_refine_apps.batch.plan import Plan, Planner
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.batch.work import check_unchanged, problem_of
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands import batch as command
from made_hands import link, links, robot, slide, solid
from plate_gripper import PLATE, URDF
from refusals import refused

MJCF = """<mujoco><compiler angle="radian" meshdir="stl"/><include file="parts/assets.xml"/>
<worldbody><body name="palm"><geom type="box" size="0.1 0.015 0.01"/>{}</body></worldbody></mujoco>"""
FINGER = """<body name="{0}" pos="{1} 0 0.05"><joint name="{2}" type="slide" axis="-1 0 0" range="{3}"/>
<geom type="mesh" mesh="pad"/></body>"""
SCENE_TOML = """lift = 0.1
[object]
touch = ["below:z=1"]
position = [0.1, 0.0, 0.5]
[table]
position = [0, 0, 0.3]
[[body]]
name = "tin"
mesh = "tin.stl"
position = [0.5, 0.0, 0.5]
margin = 0.004
movable = true
mass = 0.2
[[body]]
sphere = 0.02
position = [0.4, 0.3, 0.5]
"""
SCENE_EDITS = {
    "lift = 0.1": "lift = 0.2", "below": "above", "position = [0.1": "position = [0.11", "0.3]": "0.31]",
    '"tin"': '"can"', "tin.stl": "can.stl", "0.5, 0.0": "0.51, 0.0", "0.004": "0.005", "true\nmass = 0.2": "false",
    "0.2\n": "0.3\n", "0.02": "0.03", "[0.4": "[0.41",
}  # fmt: skip
"""Part of the scene's file -> another, which makes another scene."""


def box_mesh(path: Path, *size: float) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(size).export(path)


@pytest.fixture
def inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A job of every kind of file: a hand with meshes on an arm, simulated as an MJCF with includes, in a scene."""
    monkeypatch.setenv("GRASP_REFINE_CACHE", str(tmp_path.parent / "cache"))
    folder = tmp_path / "job"
    for name in ("hand/parts", "arm", "objects"):
        (folder / name).mkdir(parents=True)
    (folder / "hand/hand.toml").write_text('urdf = "gripper.urdf"\nmjcf = "gripper.xml"\n')
    (folder / "hand/gripper.urdf").write_text(URDF.replace(PLATE, solid("mesh pad.stl")))
    sides = FINGER.format("left", 0.09, "l", "0 0.07") + FINGER.format("right", -0.09, "r", "-0.07 0")
    (folder / "hand/gripper.xml").write_text(MJCF.format(sides))
    (folder / "hand/parts/assets.xml").write_text(
        '<mujoco><asset><mesh name="pad" file="simulated.stl"/></asset></mujoco>'
    )
    box_mesh(folder / "hand/pad.stl", 0.01, 0.03, 0.06)
    box_mesh(folder / "hand/stl/simulated.stl", 0.01, 0.03, 0.06)
    box_mesh(folder / "arm/link.stl", 0.02, 0.02, 0.02)
    up = slide("up", "base", "tool", axis="0 0 1", limits=(-2, 2))
    (folder / "arm/arm.urdf").write_text(robot("arm", links("base"), link("tool", solid("mesh link.stl")), up))
    box_mesh(folder / "objects/block.ply", 0.06, 0.06, 0.06)
    box_mesh(folder / "tin.stl", 0.05, 0.05, 0.1)
    (folder / "desk.toml").write_text(SCENE_TOML)
    (folder / "heavy.toml").write_text('based_on = "scene"\nmass = 0.5\n')
    (folder / "faces.txt").write_text("0 1 2 3 4 5\n")
    n = 2
    grasps = {
        "hand": "gripper", "base_link": "palm", "joint_names": ["l", "r"], "object": "block", "scale": np.ones(n),
        "hand_pose": np.tile([0.0, 0, 0.05, 0, 1, 0, 0], (n, 1)), "q": np.tile([0.05, -0.05], (n, 1)),
    }  # fmt: skip
    save_npz(folder / "mine.npz", grasps)
    aims = {f"target_point_{side}": np.zeros((n, 1, 3)) for side in ("link", "object")}
    save_npz(folder / "aims.npz", grasps | aims | {"target_link": ["left"]})
    files = {"grasps": "mine.npz", "hand": "hand", "arm": "arm/arm.urdf", "objects": "objects", "scene": "desk.toml",
             "protocol": "heavy.toml", "targets": "aims.npz"}  # fmt: skip
    paths = {
        name: folder / path if name in ("grasps", "objects") else str(folder / path) for name, path in files.items()
    }
    return paths | {"touch": (f"faces:{folder / 'faces.txt'}",), "base": "0.1,0,0,0,0,0"}


def plan(jobs: dict[str, dict[str, Any]], size: int = 64, seed: int = 0, depends: object = None) -> Plan:
    planner = Planner(Path("/out"), size, "a batch", {"refine": depends}, seed)
    listed = [Job(name, ProblemSpec(**spec)) for name, spec in jobs.items()]
    return planner.plan(listed, lambda _: None, lambda *_: None)


def stamps(options: dict[str, Any], **planner: Any) -> set[str]:
    made = plan({"job": options}, **planner)
    assert made.shards and not made.refused, made.refused
    return {shard.stamp for shard in made.shards}


# Files


def scaled(path: Path) -> None:
    trimesh.load(path).apply_scale(1.01).export(path)


def replaced(old: str, new: str) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))

    return edit


def moved(name: str) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        with np.load(path) as file:
            entries = dict(file)
        entries[name] = entries[name] + 1e-9
        np.savez(path, **entries)

    return edit


EDITS: dict[str, Callable[[Path], None]] = {
    "mine.npz": moved("q"),
    "aims.npz": moved("target_point_link"),
    "hand/hand.toml": replaced("urdf", "# another\nurdf"),
    "hand/gripper.urdf": replaced('upper="0.07"', 'upper="0.06"'),
    "hand/pad.stl": scaled,
    "hand/gripper.xml": replaced("0 0.07", "0 0.06"),
    "hand/parts/assets.xml": replaced("<mesh", '<mesh scale="1 1 2"'),
    "hand/stl/simulated.stl": scaled,
    "arm/arm.urdf": replaced('upper="2"', 'upper="3"'),
    "arm/link.stl": scaled,
    "objects/block.ply": scaled,
    "desk.toml": replaced("0.3", "0.31"),
    "tin.stl": scaled,
    "heavy.toml": replaced("0.5", "0.6"),
    "faces.txt": replaced("5", "6"),
}
"""File of the job -> another content."""


@pytest.mark.parametrize("name", EDITS)
def test_a_result_depends_on_every_file_of_its_job(name: str, inputs: dict[str, Any]) -> None:
    folder = inputs["grasps"].parent
    before = stamps(inputs)
    assert stamps(inputs) == before
    EDITS[name](folder / name)
    assert not stamps(inputs) & before


def test_a_result_depends_on_every_value_of_its_scene(inputs: dict[str, Any]) -> None:
    path = inputs["grasps"].with_name("desk.toml")
    box_mesh(path.with_name("can.stl"), 0.05, 0.05, 0.11)
    job, jobs = inputs | {"hand": "allegro", "arm": None, "touch": (), "targets": "auto"}, {}
    for number, (old, new) in enumerate([("", ""), *SCENE_EDITS.items()]):
        assert old in SCENE_TOML
        path.with_name(f"{number}.toml").write_text(f'name = "desk"\n{SCENE_TOML.replace(old, new, 1)}')
        jobs[f"{number}"] = job | {"scene": str(path.with_name(f"{number}.toml"))}
    made = plan(jobs)
    assert not made.refused and len({shard.stamp for shard in made.shards}) == len(jobs), made


def test_no_file_that_is_read_is_left_out_of_the_list(inputs: dict[str, Any]) -> None:
    """Of all files in the folder, and of those that Python opens when a worker loads the job."""
    folder, opened, listening = inputs["grasps"].parent, set(), [True]

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if listening and event == "open" and isinstance(arguments[0], str | Path):
            opened.add(Path(arguments[0]))

    sys.addaudithook(hook)
    (shard,) = plan({"job": inputs}).shards
    problem = problem_of(shard.task, 0, NoCache(), lambda *_: None)
    listening.clear()
    assert len(problem) == 2
    read = {str(path.relative_to(folder)) for path in opened if path.is_relative_to(folder) and path.is_file()}
    assert (
        {"mine.npz", "aims.npz", "hand/pad.stl", "desk.toml", "tin.stl", "heavy.toml", "faces.txt"}
        <= read
        <= set(EDITS)
    )
    assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == set(EDITS)


def test_an_input_that_changes_while_the_batch_runs_is_refused(inputs: dict[str, Any]) -> None:
    """A stamp says of what a result was made: it must not be put on a result of something else."""
    folder = inputs["grasps"].parent
    (shard,) = plan({"job": inputs}).shards
    task = shard.task
    for name, edit in EDITS.items():
        shutil.copytree(folder, folder.with_name("before"))
        edit(folder / name)
        loader = Loader(task.inputs, cache=NoCache())
        with refused(GraspRefineError, "changed"):
            check_unchanged(task, loader, task.inputs.grasps)
        shutil.rmtree(folder)
        folder.with_name("before").rename(folder)
    check_unchanged(task, Loader(task.inputs, cache=NoCache()), task.inputs.grasps)


# Fields of a job

FIELDS: dict[str, dict[str, Any]] = {
    "transfer_from": {"transfer_from": "hand"},
    "hand": {"hand": "allegro"},
    "urdf": {"urdf": Path("other.urdf")},
    "mjcf": {"mjcf": Path("other.xml")},
    "collision": {"collision": "visual"},
    "follower_limits": {"follower_limits": "leader"},
    "base_link": {"base_link": "palm"},
    "hull_limit": {"hull_limit": 0.02},
    "arm": {"arm": "arm/arm.urdf"},
    "mount": {"arm": "arm/arm.urdf", "mount": "base"},
    "mount_pose": {"arm": "arm/arm.urdf", "mount_pose": "0,0,0.01,0,0,0"},
    "object": {"object": "box:0.06,0.06,0.06"},
    "objects": {"object": None, "objects": Path("larger")},
    "scale": {"scale": 1.1},
    "unit": {"unit": "cm"},
    "holes": {"holes": "cap"},
    "threshold": {"threshold": 0.1},
    "format": {"format": "ours"},
    "grasps": {"grasps": Path("aims.npz")},
    "targets": {"targets": "aims.npz"},
    "task": {"task": "task.toml"},
    "protocol": {"protocol": "strict"},
    "friction": {"friction": 0.3},
    "mass": {"mass": 0.3},
    "table": {"table": -0.1},
    "scene": {"scene": "desk.toml"},
    "base": {"base": "0.1,0,0,0,0,0"},
    "touch": {"touch": ("above:z=0",)}, "avoid": {"avoid": ("above:z=0",)},
    "seen_from": {"seen_from": ("0,0,1",)},
    "camera": {"camera": "camera.txt"},
    "intrinsics": {"intrinsics": "600,600,320,240"},
    "mask": {"mask": Path("task.toml")},
    "hypotheses": {"hypotheses": 2},
    "completions": {"completions": Path("objects")},
}  # fmt: skip
"""Field of a job -> another job, in which it is the last of the entries."""

BEFORE: dict[str, dict[str, Any]] = {
    "mount": {"arm": "arm/arm.urdf"}, "mount_pose": {"arm": "arm/arm.urdf"},
    "objects": {"object": None, "objects": Path("objects")},
}  # fmt: skip
"""Field -> the job before, where the field has no meaning otherwise."""


def test_a_result_depends_on_every_field_of_its_job(inputs: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    folder = inputs["grasps"].parent
    monkeypatch.chdir(folder)
    for name in ("urdf", "xml"):
        shutil.copy(f"hand/gripper.{name}", f"other.{name}")
    box_mesh(Path("larger/block.ply"), 0.061, 0.06, 0.06)
    Path("task.toml").write_text("table = -0.2\n")
    plain = {"grasps": Path("mine.npz"), "hand": "hand", "object": "objects/block.ply"}
    # These choose rows, or only permit something.
    others = {"object_name": "block", "other_object": True, "as_is": True}
    assert {*FIELDS, *others, "index"} == {field.name for field in fields(ProblemSpec)}
    jobs = {"first": plain, **{f"before {name}": plain | job for name, job in BEFORE.items()}}
    jobs |= {name: plain | job for name, job in FIELDS.items()} | {
        name: plain | {name: others[name]} for name in others
    }
    # In one batch, which keeps what several jobs share.
    made = plan(jobs)
    assert not made.refused, made.refused
    found = {shard.task.job: shard.stamp for shard in made.shards}
    assert {found[name] for name in ("first", *others)} == {found["first"]}
    assert len({found[name] for name in jobs if name not in others}) == 1 + len(FIELDS), found


def test_a_result_depends_on_rows_seed_settings_and_version(
    inputs: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = {"grasps": inputs["grasps"], "hand": inputs["hand"], "object": "box:0.06,0.06,0.06"}
    found = [stamps(plain), stamps(plain, size=1), stamps(plain, seed=1), stamps(plain, depends="others")]
    found += [stamps(plain | {"grasps": Path("sample:3")}, size=size) for size in (2, 3)]
    copied = Path(shutil.copy(inputs["grasps"], inputs["grasps"].with_name("copy.npz")))
    assert stamps(plain | {"grasps": copied}) == found[0], "a copy of the same grasps"
    for name, value in (("own_version", lambda: "9.9"), ("LAYOUT_VERSION", 99)):
        with monkeypatch.context() as patch:
            patch.setattr(digests, name, value)
            found.append(stamps(plain))
    assert list(map(len, found)) == [1, 2, 1, 1, 2, 1, 1, 1] and len(set().union(*found)) == 10


# Settings


def changed(value: Any) -> Any:
    """Yield copies of a dataclass with one field changed, at any depth; what no field may have is not checked."""
    for field in fields(value):
        own = getattr(value, field.name)
        for other in changed(own) if is_dataclass(own) else ("another value",):
            one = copy(value)
            object.__setattr__(one, field.name, other)
            yield one


@pytest.mark.parametrize(
    "value", [Config(), Config(solver=Descent(), derivative=Distance()), SCENE], ids=["default", "descent", "scene"]
)
def test_no_field_of_settings_and_protocols_is_left_out(value: Any) -> None:
    every = [dumps(settings(one)) for one in (value, *changed(value))]
    assert len(set(every)) == len(every) > 20


def test_results_depend_on_options_that_change_them_only(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planned: list[str] = []

    @contextmanager
    def locked(out: Path, shards: Sequence[Shard], part: tuple[int, int]) -> Iterator[None]:
        planned.extend(shard.stamp for shard in shards)
        raise GraspRefineError("planned")
        yield

    def stamp(*options: str) -> str:
        assert main(["batch", str(FILE), *options]) == 2
        return planned.pop()

    monkeypatch.setattr(command, "locked", locked)
    monkeypatch.setenv("GRASP_REFINE_ENGINE", "python")
    first, same = (
        stamp(),
        "--workers 3 --tries 5 --patience 77 --json x.json --no-report --again --profile --out elsewhere",
    )
    assert stamp(*same.split(), "--index-format", "csv") == first
    others = ("--iterations 7", "--seed 1", "--validate", "--validate --protocol strict")
    found = {first, *(stamp(*words.split()) for words in others)}
    if not why_not_native():
        monkeypatch.setenv("GRASP_REFINE_ENGINE", "native")
        found.add(stamp())
    assert len(found) == 1 + len(others) + (not why_not_native())
