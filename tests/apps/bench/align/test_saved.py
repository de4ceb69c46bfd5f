"""Files of alignment tasks: what is read is what was written, and what is no such file is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import load_npz, save_npz
from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.pieces import box, capsule, sphere
from grasp_refine_apps.bench.align.saved import MARK, AlignmentTask, Solid, Trajectory, is_task, load_task, save_task
from refusals import refused
from shapes_for_tests import ring_body


def trajectory(label: str, count: int, rng: np.random.Generator) -> Trajectory:
    error = rng.uniform(size=count)
    error[-1] = np.nan
    return Trajectory(
        label, 1e-3, count // 2, np.arange(count), exp_se3(rng.normal(size=(count, 2, 6))),
        rng.normal(size=(count, 2, 3)), rng.normal(size=count), error, rng.uniform(size=count).cumsum(),
    )  # fmt: skip


@pytest.fixture
def task() -> AlignmentTask:
    rng = np.random.default_rng(0)
    round_ = Solid("round", (sphere(0.01), capsule(0.01, [0, 0, 0], [0, 0, 0.03]), box([0.01, 0.02, 0.03])))
    runs = tuple(trajectory(label, count, rng) for label, count in (("distance + EG", 5), ("rigid", 1), ("other", 3)))
    start = exp_se3(rng.normal(size=(2, 6)))
    return AlignmentTask(
        "concave", "face-vertex", (Solid("ring", ring_body().pieces), round_), rng.normal(size=(2, 3)), start, runs
    )


@pytest.fixture
def path(task: AlignmentTask, tmp_path: Path) -> Path:
    save_task(tmp_path / "folder" / "task.npz", task)
    return tmp_path / "folder" / "task.npz"


def test_what_is_read_is_what_was_written(task: AlignmentTask, path: Path):
    found = load_task(path)
    assert (found.kind, found.target_class) == (task.kind, task.target_class)
    np.testing.assert_array_equal(found.targets, task.targets)
    np.testing.assert_allclose(found.start, task.start, atol=1e-12)
    for body, wanted in zip(found.bodies, task.bodies, strict=True):
        assert body.name == wanted.name and len(body.pieces) == len(wanted.pieces)
        for piece, other in zip(body.pieces, wanted.pieces, strict=True):
            np.testing.assert_array_equal(piece.vertices, other.vertices)
            np.testing.assert_array_equal(piece.faces, other.faces)
            assert piece.radius == other.radius
    assert [run.label for run in found.trajectories] == ["distance + EG", "rigid", "other"]
    for run, wanted in zip(found.trajectories, task.trajectories, strict=True):
        assert (run.margin, run.result, len(run)) == (wanted.margin, wanted.result, len(wanted))
        np.testing.assert_allclose(run.poses, wanted.poses, atol=1e-12)
        for name in ("iteration", "witness", "distance", "error", "cpu_s"):
            np.testing.assert_array_equal(getattr(run, name), getattr(wanted, name))
    assert [entry.name for entry in path.parent.iterdir()] == ["task.npz"]


def test_a_body_is_one_surface_where_its_pieces_can_be_united(task: AlignmentTask):
    ring, round_ = (body.mesh() for body in task.bodies)
    assert ring.is_watertight and round_.is_watertight
    apart = sum(piece.mesh().volume for piece in task.bodies[1].pieces)
    assert 0 < round_.volume < apart


def test_such_a_file_is_known_by_its_entries(path: Path, tmp_path: Path):
    assert is_task(path)
    save_npz(tmp_path / "other.npz", {"q": np.zeros(3)})
    (tmp_path / "text.npz").write_text("no archive")
    others = (tmp_path / "other.npz", tmp_path / "text.npz", tmp_path / "missing.npz", tmp_path)
    assert not any(is_task(other) for other in others)


def dropped(key: str) -> Callable[[dict[str, np.ndarray]], None]:
    return lambda entries: entries.__delitem__(key)


def changed(key: str, change: Callable[[np.ndarray], object]) -> Callable[[dict[str, np.ndarray]], None]:
    return lambda entries: entries.update({key: np.asarray(change(entries[key].copy()))})


def with_value(index: object, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (dropped(MARK), ("alignment_schema", "refine-grasp bench align --save")),
        (changed(MARK, lambda _: 2), ("alignment_schema 2", "(1)")),
        (changed(MARK, lambda _: 0), ("alignment_schema", "from 1 to 1")),
        (changed(MARK, lambda _: "one"), ("alignment_schema", "integers", "0")),
        (dropped("kind"), ("kind",)),
        (dropped("iterate_error"), ("iterate_error",)),
        (changed("body", lambda names: names[:1]), ("body", "piece_body")),
        (changed("piece_body", lambda owner: 0 * owner), ("body", "piece_body")),
        (changed("piece_radius", lambda r: r[1:]), ("piece_radius", "(13,)", "(12,)")),
        (changed("piece_radius", lambda r: -1.0 - r), ("piece 0",)),
        (changed("piece_vertices", lambda n: n + 1), ("vertices", "shape")),
        (changed("vertices", with_value((0, 0), np.nan)), ("vertices", "finite", "row 0")),
        (changed("faces", lambda faces: faces + 1000), ("piece 0", "1 vertex")),
        (changed("faces", lambda faces: faces - 1), ("faces", "integers", "0")),
        (changed("faces", lambda faces: faces[:, :2]), ("faces", "piece_faces")),
        (changed("target", lambda t: t[:1]), ("target", "(2, 3)", "(1, 3)")),
        (changed("pose", lambda pose: 2 * pose), ("pose row 0", "qw qx qy qz", "2")),
        (changed("method", lambda names: names[:0]), ("method",)),
        (changed("method_iterates", lambda n: n + 1), ("iterate_number", "(12,)", "(9,)")),
        (changed("method_result", lambda n: n + 4), ("method_result", "distance + EG", "5 iterates")),
        (changed("iterate_witness", lambda w: w[..., :2]), ("iterate_witness", "(9, 2, 3)", "(9, 2, 2)")),
        (changed("iterate_cpu_s", with_value(2, np.nan)), ("iterate_cpu_s", "finite", "row 2")),
        (changed("iterate_pose", with_value((3, 1), 0.0)), ("iterate_pose row 7", "quaternion")),
        (changed("iterate_number", lambda n: n[::-1]), ("iterate_number", "distance + EG", "0")),
    ],
)
def test_a_damaged_file_is_refused(damage: Callable[[dict[str, np.ndarray]], None], named: tuple[str, ...], path: Path):
    entries = dict(load_npz(path).entries)
    damage(entries)
    save_npz(path, entries)
    with refused(GraspFileError, path, *named):
        load_task(path)


def test_what_is_no_archive_is_refused(tmp_path: Path):
    with refused(GraspFileError, tmp_path / "missing.npz"):
        load_task(tmp_path / "missing.npz")
