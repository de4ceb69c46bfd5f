"""What a grasp file most likely means: told where it is clear, and nothing said of grasps that may be meant so."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from boxed_example import FILE, boxed_example
from grasp_refine.core.se3 import exp_so3, inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.pipeline.load import load_problem
from grasp_refine.pipeline.spec import ProblemSpec
from grasp_refine.scene.convention_check import convention_notes, joint_notes, position_notes
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.session import Session
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.cli import main
from refusals import assert_names

XYZW = [0, 1, 2, 4, 5, 6, 3]
"""Takes x y z, qw qx qy qz to x y z, qx qy qz qw."""

FAULTS = {
    "degrees": lambda pose, q: (pose, np.degrees(q)),
    "millimetres": lambda pose, q: (pose * [1e3, 1e3, 1e3, 1, 1, 1, 1], q),
    "centimetres": lambda pose, q: (pose * [1e2, 1e2, 1e2, 1, 1, 1, 1], q),
    "x y z w": lambda pose, q: (pose[:, XYZW], q),
    "object in the hand's frame": lambda pose, q: (pose_from_transform(inverse(transform_from_pose(pose))), q),
}
"""What has to be told -> makes grasps that are written so."""


def written(*faults: str) -> tuple[np.ndarray, np.ndarray]:
    """Poses and joint values of the example, as another program might write them."""
    grasps = load_grasps(FILE)
    pose, q = grasps.hand_pose, grasps.q
    for fault in faults:
        pose, q = FAULTS[fault](pose, q)
    return pose, q


example = cache(partial(boxed_example, 64))


def scene(pose: np.ndarray, q: np.ndarray) -> Scene:
    return replace(example(), T_world_root=transform_from_pose(pose), q=q)


@pytest.mark.parametrize(
    "faults",
    [
        (),
        *((fault,) for fault in FAULTS),
        ("degrees", "x y z w"),
        ("degrees", "millimetres"),
        ("object in the hand's frame", "x y z w"),
        ("object in the hand's frame", "millimetres"),
        ("x y z w", "centimetres"),
        ("degrees", "x y z w", "millimetres"),
    ],
    ids="+".join,
)
def test_what_is_meant_is_told_and_nothing_else(faults: tuple[str, ...]):
    text = "; ".join(convention_notes([scene(*written(*faults))]))
    assert {fault for fault in FAULTS if fault in text} == set(faults)


def test_grasps_that_lack_precision_are_left_alone():
    """Refining them is what the program is for."""
    pose, q = (np.repeat(values, 16, axis=0) for values in written())
    T, rng = transform_from_pose(pose), np.random.default_rng(0)
    ways = rng.normal(size=(2, len(T), 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    T[:, :3, :3] = exp_so3(np.radians(40.0) * ways[0]) @ T[:, :3, :3]
    T[:, :3, 3] += 0.06 * ways[1]
    assert convention_notes([scene(pose_from_transform(T), q)]) == ()


@pytest.mark.parametrize("fault", FAULTS)
def test_of_few_grasps_only_units_are_told(fault: str):
    """Three may come near by chance in another frame."""
    pose, q = (values[:3] for values in written(fault))
    assert bool(convention_notes([scene(pose, q)])) == (fault in ("degrees", "millimetres", "centimetres"))


def test_hands_that_are_nowhere_near_are_told_with_the_frame_that_is_needed():
    pose, q = written()
    (note,) = convention_notes([scene(pose + [0, 0.8, 0.3, 0, 0, 0, 0], q)])
    assert_names(note, "'base_link'")


def test_grasps_that_are_nowhere_do_not_count():
    pose, q = written("degrees")
    pose[0], q[1] = np.nan, np.inf
    one = scene(pose, q)
    assert len(convention_notes([one])) == 1
    assert convention_notes([one.masked(np.zeros(4, dtype=bool))]) == ()


def test_all_objects_of_a_file_count_together():
    """Two grasps on each of two objects are as many as four on one."""
    whole = scene(*written("x y z w"))
    parts = [replace(whole, T_world_root=whole.T_world_root[rows], q=whole.q[rows]) for rows in ([0, 1], [2, 3])]
    assert convention_notes(parts) == convention_notes([whole]) != ()


def test_values_in_radians_beyond_their_limits_are_no_degrees():
    """As degrees any of them would be within."""
    hand, (_, q) = example().hand, written()
    assert joint_notes(hand, q + 2.0) == ()
    assert joint_notes(hand, q[:0]) == ()


def test_without_an_object_positions_are_compared_with_what_is_near_any_object():
    (pose, _), (far, _) = written(), written("millimetres")
    assert position_notes(pose) == position_notes(pose[:0]) == ()
    assert len(position_notes(far)) == 1


@pytest.fixture
def file(workplace: Path) -> Path:
    """The example in millimetres and degrees."""
    pose, q = written("millimetres", "degrees")
    save_npz(workplace / "grasps.npz", replace(load_grasps(FILE), hand_pose=pose, q=q).arrays())
    return Path("grasps.npz")


def test_what_is_read_stays_as_it_is(file: Path):
    pose, q = written("millimetres", "degrees")
    problem = load_problem(ProblemSpec(grasps=file))
    np.testing.assert_array_equal(problem.groups[0].scene.q, q)
    np.testing.assert_allclose(problem.groups[0].scene.T_world_root[:, :3, 3], pose[:, :3])
    assert len(problem.convention_notes) == 2
    assert set(problem.convention_notes) <= set(problem.notes)


def test_run_says_so_before_and_after(file: Path, capsys: pytest.CaptureFixture[str]):
    main(["run", "--grasps", str(file), "--geometry-only"])
    out, error = capsys.readouterr()
    for word in ("degrees", "millimetres"):
        assert word in out and word in error


def test_convert_says_so_without_an_object(file: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["convert", str(file), "new.npz", "--to", "ours", "--json", "new.json"]) == 0
    notes = json.loads(Path("new.json").read_text())["notes"]
    units = ("degrees", "millimetres")
    assert [unit for note in notes for unit in units if unit in note] == list(units)
    error = capsys.readouterr().err
    assert [error.count(unit) for unit in units] == [1, 1]
    np.testing.assert_array_equal(load_grasps("new.npz").q, load_grasps(file).q)


def test_batch_says_so_once_a_job(tmp_path: Path):
    jobs = ("first", "first", "second")
    shards = [
        Shard(n, "hand/object", f"{job}, part {n}", 4, tmp_path / f"{n}.npz", "stamp", SimpleNamespace(job=job))
        for n, job in enumerate(jobs)
    ]
    session, console = Session(tuple(shards), (), set()), Console(file=io.StringIO())
    with Progress(console, shards, 1) as progress:
        for one in shards:
            notes = (f"joint values look like degrees: in {one.number} of 4",)
            done = Done(4, 4, (0, 0), None, 0.0, 0.0, 0, convention_notes=notes)
            session.take(one, done, progress)
    told = [line for line in console.file.getvalue().splitlines() if "degrees" in line]
    assert [line.split(": ")[1] for line in told] == ["first", "second"]
