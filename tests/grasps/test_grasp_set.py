"""Grasp files: what is read, what is refused and with which words, and how joints meet a hand."""

import itertools
import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, Stage, Targets, load_grasps, match_joints, save_npz
from grasp_refine.grasps.rows import best_rows, choose_rows, row_numbers, rows_where
from grasp_refine.hands.files.tree import Joint, Mimic
from grasp_refine.hands.hand import Actuator, Hand
from refusals import assert_names
from refusals import refused as expected


def entries(n: int = 3) -> dict:
    """A valid version-1 file of n grasps of a hand with two joints."""
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=(n, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return {
        "schema": 1,
        "hand": "claw",
        "base_link": "palm",
        "joint_names": ["a", "b"],
        "object": "mug",
        "scale": 0.1,
        "hand_pose": np.concatenate([rng.normal(size=(n, 3)), quaternion], axis=1),
        "q": rng.normal(size=(n, 2)),
    }


def targets(n: int = 3) -> dict:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(2, n, 2, 3))
    points[:, 1, 0] = np.nan
    return {"target_link": ["tip", "thumb"], "target_point_link": points[0], "target_point_object": points[1]}


def stages(n: int = 3) -> dict:
    pregrasp, squeeze = entries(n), entries(n)
    return {
        "pregrasp_pose": pregrasp["hand_pose"] + [0.1, 0, 0, 0, 0, 0, 0],
        "pregrasp_q": pregrasp["q"] - 0.1,
        "squeeze_pose": squeeze["hand_pose"],
        "squeeze_q": squeeze["q"] + 0.3,
    }


@pytest.fixture
def write(tmp_path: Path):
    """Write the valid file with the given entries changed (None: left out); returns its path."""

    def write(**changes: object) -> Path:
        path = tmp_path / "grasps.npz"
        arrays = {**entries(), **changes}
        np.savez(path, **{key: np.asarray(v) for key, v in arrays.items() if v is not None})
        return path

    return write


def refused(path: Path) -> str:
    """The message with which the file is refused; one line that starts with the path."""
    with expected(GraspFileError) as caught:
        load_grasps(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def test_reads_a_file_and_spreads_single_values_over_the_rows(write):
    grasps = load_grasps(write())
    assert len(grasps) == 3
    assert (grasps.hand, grasps.base_link, grasps.joint_names) == ("claw", "palm", ("a", "b"))
    assert grasps.object.tolist() == ["mug"] * 3
    assert grasps.scale.tolist() == [0.1] * 3
    assert grasps.hand_pose.dtype == grasps.q.dtype == np.float64
    assert grasps.targets is None
    np.testing.assert_array_equal(grasps.q, entries()["q"])


def test_rows_that_are_not_finite_are_read_as_they_are(write):
    """One such row once cost a file all of its grasps."""
    pose, q, squeeze = entries()["hand_pose"], entries()["q"], stages()
    pose[1, 4], q[2, 0], squeeze["squeeze_q"][0] = np.nan, -np.inf, np.nan
    grasps = load_grasps(write(hand_pose=pose, q=q, **squeeze))
    np.testing.assert_array_equal(grasps.finite, [False, False, False])
    np.testing.assert_array_equal(grasps.q, q)
    np.testing.assert_array_equal(np.isnan(grasps.hand_pose).any(axis=1), [False, True, False])
    np.testing.assert_allclose(grasps.hand_pose[[0, 2]], load_grasps(write()).hand_pose[[0, 2]], atol=1e-15)
    assert load_grasps(write()).finite.all()


def test_a_quaternion_of_length_0_is_a_pose_that_nobody_knows(write):
    """Programs write it for grasps that they did not find; one such row once cost a file all of its grasps."""
    pose, squeeze = entries()["hand_pose"], stages()
    pose[1, 3:], squeeze["squeeze_pose"][2, 3:] = 0.0, 0.0
    grasps = load_grasps(write(hand_pose=pose, **squeeze))
    np.testing.assert_array_equal(np.isnan(grasps.hand_pose), np.repeat([[False], [True], [False]], 7, axis=1))
    np.testing.assert_array_equal(grasps.finite, [True, False, False])
    np.testing.assert_array_equal(grasps.q, entries()["q"])
    # Any other length is one of a mix-up, in all rows.
    pose[1, 3:] = [0.1, 0.0, 0.0, 0.0]
    assert_names(refused(write(hand_pose=pose)), "hand_pose", "row 1", "unit quaternion", "qw qx qy qz", "0.1")


def test_a_file_without_schema_is_version_1(write):
    assert len(load_grasps(write(schema=None))) == 3


def test_quaternions_of_float32_are_normalised(write):
    pose = entries()["hand_pose"]
    pose[:, 3:] *= 1.0009
    grasps = load_grasps(write(hand_pose=pose.astype(np.float32)))
    np.testing.assert_allclose(np.linalg.norm(grasps.hand_pose[:, 3:], axis=1), 1.0, atol=1e-15)


def test_reads_targets_with_nan_for_none(write):
    grasps = load_grasps(write(**targets()))
    assert grasps.targets is not None
    assert grasps.targets.links == ("tip", "thumb")
    assert np.isnan(grasps.targets.point_link[1, 0]).all()
    assert np.isfinite(grasps.targets.point_object[0]).all()


@pytest.mark.parametrize("content", [b"", b"text", pickle.dumps({"q": [1.0]}), b"\x93NUMPY"])
def test_not_an_npz(tmp_path: Path, content: bytes):
    path = tmp_path / "grasps.npz"
    path.write_bytes(content)
    assert_names(refused(path), ".npz")


class Bomb:
    """Creates a folder when unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize("key", ["q", "extra"])
def test_pickles_are_refused_and_never_run(write, tmp_path: Path, key: str):
    message = refused(write(**{key: np.array([Bomb(tmp_path / "boom")], dtype=object)}))
    assert_names(message, f"'{key}'", "pickle")
    assert not (tmp_path / "boom").exists()


def test_missing_entries_list_found_and_needed(write):
    missing, found, needed = refused(write(hand=None, q=None)).split("; ")
    assert_names(missing, " hand, q")
    assert_names(found, "base_link, hand_pose, joint_names, object, scale, schema")
    assert_names(needed, "hand, base_link, joint_names, object, scale, hand_pose, q")


PARTLY = targets()
PARTLY["target_point_object"][0, 1, 2] = np.nan
INFINITE = targets()
INFINITE["target_point_link"][2, 0, 0] = np.inf


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"schema": 2}, ("schema 2", "(1)")),
        ({"schema": 0}, ("schema", "1 to 1")),
        ({"schema": "one"}, ("schema", "1 to 1")),
        ({"hand": 3}, ("hand ", "text", "int64")),
        ({"hand": ["a", "b"]}, ("hand ", "(2,)")),
        ({"joint_names": "a"}, ("joint_names", "()")),
        ({"joint_names": ["a", "a"]}, ("joint_names", " a ")),
        ({"hand_pose": np.ones((3, 6))}, ("hand_pose", "(N, 7)", "x y z qw qx qy qz", "(3, 6)")),
        (
            {"hand_pose": np.ones((0, 7)), "q": np.ones((0, 2))},
            ("hand_pose", "(N, 7)", "N >= 1", "x y z qw qx qy qz", "(0, 7)"),
        ),
        ({"q": np.ones((3, 4))}, ("q ", "(3, 2)", "hand_pose", "joint_names", "(3, 4)")),
        ({"q": np.ones((2, 2))}, ("q ", "(3, 2)", "hand_pose", "joint_names", "(2, 2)")),
        ({"q": [["x", "y"]] * 3}, ("q ", "numbers", "<U1")),
        ({"q": np.ones((3, 2), complex)}, ("q ", "numbers", "complex128")),
        ({"scale": np.inf}, ("scale", "finite", "row 0")),
        ({"scale": [1.0, 0.0, 1.0]}, ("scale", "positive", "row 1", "0")),
        ({"scale": [1.0, 1.0]}, ("scale", "(3,)", "(2,)")),
        ({"object": ["mug", "can"]}, ("object", "(3,)", "(2,)")),
        (
            {"hand_pose": np.tile([0, 0, 0, 1, 0.1, 0, 0], (3, 1))},
            ("hand_pose", "row 0", "unit quaternion", "qw qx qy qz", "1.00499"),
        ),
        ({"target_link": ["tip"]}, ("target_link, target_point_link, target_point_object",)),
        ({**targets(), "target_link": ["tip"]}, ("target_point_link", "(3, 1, 3)", "(3, 2, 3)")),
        ({"label_score": [1.0, 2.0]}, ("label_score", "(3,)", "(2,)")),
        ({"label_score": ["a", "b", "c"]}, ("label_score", "numbers")),
        (PARTLY, ("'thumb'", "row 0", "NaN")),
        (INFINITE, ("target_point_link", "finite", "row 2")),
    ],
)
def test_malformed_entries(write, changes: dict, named: tuple[str, ...]):
    assert_names(refused(write(**changes)), *named)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"squeeze_q": None}, ("squeeze_pose and squeeze_q", "squeeze_pose")),
        ({"pregrasp_pose": None}, ("pregrasp_pose and pregrasp_q", "pregrasp_q")),
        ({"pregrasp_pose": np.zeros((2, 7))}, ("pregrasp_pose", "(3, 7)", "x y z qw qx qy qz", "(2, 7)")),
        ({"squeeze_q": np.zeros((3, 5))}, ("squeeze_q", "(3, 2)", "hand_pose", "joint_names", "(3, 5)")),
        (
            {"pregrasp_pose": np.tile([0, 0, 0, 2.0, 0, 0, 0], (3, 1))},
            ("pregrasp_pose", "row 0", "unit quaternion", "qw qx qy qz", "2"),
        ),
    ],
)
def test_malformed_stages(write, changes: dict, named: tuple[str, ...]):
    assert_names(refused(write(**{**stages(), **changes})), *named)


def test_stages_are_read_where_they_are(write):
    grasps = load_grasps(write(**stages()))
    np.testing.assert_array_equal(grasps.pregrasp.q, stages()["pregrasp_q"])
    np.testing.assert_array_equal(grasps.squeeze.q, stages()["squeeze_q"])
    np.testing.assert_allclose(grasps.pregrasp.pose, stages()["pregrasp_pose"], atol=1e-12)
    only = {key: value for key, value in stages().items() if key.startswith("squeeze")}
    grasps = load_grasps(write(**only))
    assert grasps.pregrasp is None and grasps.squeeze is not None
    assert load_grasps(write()).squeeze is None


def test_saved_grasps_load_again(write, tmp_path: Path):
    grasps = load_grasps(write(label_score=[1.0, np.nan, 3.0], **targets(), **stages()))
    path = tmp_path / "new" / "folder" / "result.npz"
    save_npz(path, {**grasps.arrays(), "contact_error_m": np.zeros(3)})
    again = load_grasps(path)
    for key, value in grasps.arrays().items():
        np.testing.assert_array_equal(again.arrays()[key], value)
    assert [entry.name for entry in path.parent.iterdir()] == ["result.npz"]


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch):
    path = tmp_path / "result.npz"
    save_npz(path, entries())
    before = path.read_bytes()

    def full(stream, **arrays):
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with expected(GraspFileError, path, "No space left on device"):
        save_npz(path, entries())
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_object_arrays_are_not_written(tmp_path: Path):
    with expected(GraspFileError, "note"):
        save_npz(tmp_path / "result.npz", {"note": np.array([None])})
    assert not list(tmp_path.iterdir())


def joint(name: str, mimic: Mimic | None = None) -> Joint:
    return Joint(name, "revolute", "palm", f"{name}_link", np.eye(4), np.array([0.0, 0.0, 1.0]), -9, 9, mimic, None)


CLAW = Hand(
    name="claw",
    urdf=Path("claw.urdf"),
    base_link="palm",
    links=(),
    joint_names=("b", "c", "a"),
    lower=np.full(3, -9.0),
    upper=np.full(3, 9.0),
    rest=np.array([0.1, 0.2, 0.3]),
    joints=(
        joint("b"),
        joint("c"),
        joint("follower", Mimic("a", -2.0, 0.5)),
        joint("last", Mimic("follower", 3.0, 0.0)),
        joint("a"),
    ),
    contacts=(),
    notes=(),
    actuator=Actuator(*np.ones((5, 3))),
)


def grasp_set(names: tuple[str, ...], q: np.ndarray) -> GraspSet:
    n = len(q)
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (n, 1))
    return GraspSet("claw", "palm", names, np.array(["mug"] * n), np.ones(n), pose, q)


def test_joints_are_matched_by_name():
    q, notes = match_joints(grasp_set(("a", "b", "c"), np.array([[1.0, 2, 3], [4, 5, 6]])), CLAW)
    assert q.tolist() == [[2, 3, 1], [5, 6, 4]]
    assert notes == ()


def all_parts(n: int = 3) -> GraspSet:
    pose = entries(n)["hand_pose"]
    q, points = np.arange(2.0 * n).reshape(n, 2), np.arange(6.0 * n).reshape(2, n, 1, 3)
    grasps = GraspSet("claw", "palm", ("a", "b"), np.array(["mug", "box", "mug"][:n]), np.full(n, 0.1), pose, q)
    return replace(grasps, targets=Targets(("tip",), *points), squeeze=Stage(pose, q + 1), labels={"success": q[:, 0]})


def test_grasps_are_indexed_and_iterated_like_a_list():
    grasps = all_parts()
    for rows, chosen in (
        (1, [1]), (-1, [2]), (np.int64(0), [0]), (slice(1, None), [1, 2]), (slice(None, None, -1), [2, 1, 0]),
        ([2, 0], [2, 0]), (np.array([True, False, True]), [0, 2]), (grasps.object == "mug", [0, 2]), (slice(0, 0), []),
    ):  # fmt: skip
        found = grasps[rows]
        np.testing.assert_array_equal(found.q, grasps.q[chosen])
        np.testing.assert_array_equal(found.squeeze.q, grasps.squeeze.q[chosen])
        np.testing.assert_array_equal(found.targets.point_link, grasps.targets.point_link[chosen])
        np.testing.assert_array_equal(found.labels["success"], grasps.labels["success"][chosen])
        assert found.object.tolist() == grasps.object[chosen].tolist()
    assert [one.q.tolist() for one in grasps] == [[[0.0, 1.0]], [[2.0, 3.0]], [[4.0, 5.0]]]
    for wrong in (3, -4, "mug", 0.5, [0, 7], [True]):
        with expected(GraspFileError, "rows"):
            grasps[wrong]


def test_grasps_are_joined_by_the_names_of_their_joints_links_and_labels():
    one, other = all_parts(), all_parts(2)
    other = replace(
        other,
        joint_names=("b", "a"),
        targets=Targets(("thumb",), *np.ones((2, 2, 1, 3))),
        labels={"energy": np.ones(2)},
    )
    found = one + other
    assert len(found) == 5 and found.joint_names == ("a", "b") and found.object.tolist() == [*one.object, *other.object]
    np.testing.assert_array_equal(found.q[3:], other.q[:, ::-1])
    np.testing.assert_array_equal(found.squeeze.q[3:], other.squeeze.q[:, ::-1])
    assert found.targets.links == ("tip", "thumb")
    assert np.isnan(found.targets.point_link[:3, 1]).all() and np.isnan(found.targets.point_object[3:, 0]).all()
    np.testing.assert_array_equal(found.targets.point_link[:3, 0], one.targets.point_link[:, 0])
    np.testing.assert_array_equal(found.labels["success"], [0, 2, 4, np.nan, np.nan])
    np.testing.assert_array_equal(found.labels["energy"], [np.nan] * 3 + [1, 1])
    again = GraspSet.join(iter(one))
    np.testing.assert_array_equal(again.q, one.q)
    assert set(again.arrays()) == set(one.arrays())
    for wrong, named in (
        (replace(one, hand="paw"), ("paw", "claw")),
        (replace(one, joint_names=("a", "c")), ("a, c", "a, b")),
        (replace(one, squeeze=None), ("squeeze", "only some")),
    ):
        with expected(GraspFileError, *named):
            GraspSet.join([one, wrong])
    with expected(GraspFileError, "no grasps"):
        GraspSet.join([])


def test_grasps_are_columns_of_a_table():
    grasps = all_parts()
    columns = grasps.columns()
    assert list(columns) == ["object", "scale", "x", "y", "z", "qw", "qx", "qy", "qz", "a", "b", "label_success"]
    assert {values.shape for values in columns.values()} == {(3,)}
    np.testing.assert_array_equal(columns["qw"], grasps.hand_pose[:, 3])
    np.testing.assert_array_equal(columns["b"], grasps.q[:, 1])


def test_one_grasp_needs_no_batch_dimension_and_tensors_may_be_on_a_graph():
    pose, q = entries(1)["hand_pose"][0], [0.1, 0.2, 0.3]
    T = transform_from_pose(pose)
    tensor = torch.tensor(q, dtype=torch.float64, requires_grad=True)
    poses = pose, pose.tolist(), T, pose[None], torch.tensor(T, requires_grad=True), torch.tensor(pose)[None]
    for given, values in itertools.product(poses, (q, tensor, [q], tensor[None] * 1.0)):
        found = GraspSet.of(CLAW, given, values)
        assert len(found) == 1 and found.q.tolist() == [q]
        np.testing.assert_allclose(transform_from_pose(found.hand_pose)[0], T, atol=1e-12)
    stage = Stage(torch.tensor(pose, requires_grad=True), tensor)
    found = replace(GraspSet.of(CLAW, pose, q), squeeze=stage)
    assert isinstance(found.squeeze.q, np.ndarray) and found.squeeze.q.tolist() == [q]
    with expected(GraspFileError, "squeeze.q", "(1, 3)", "(1, 2)"):
        replace(found, squeeze=Stage(pose[None], np.zeros((1, 2))))
    with expected(GraspFileError, "pose", "numbers"):
        GraspSet.of(CLAW, "here", q)


def test_joints_of_a_stage_are_matched_like_the_grasp():
    grasps = grasp_set(("a", "b", "c"), np.array([[1.0, 2, 3]]))
    stage = Stage(np.tile([1.0, 2, 3, 1, 0, 0, 0], (1, 1)), np.array([[7.0, 8, 9]]))
    grasps = replace(grasps, squeeze=stage)
    squeeze = grasps.at(grasps.squeeze)
    assert match_joints(squeeze, CLAW)[0].tolist() == [[8, 9, 7]]
    assert squeeze.hand_pose[0, :3].tolist() == [1, 2, 3]
    assert grasps.q.tolist() == [[1, 2, 3]]


def test_joints_that_the_file_lacks_stay_at_rest_which_is_said():
    q, (note,) = match_joints(grasp_set(("a",), np.array([[1.0]])), CLAW)
    assert q.tolist() == [[0.1, 0.2, 1.0]]
    assert_names(note, "rest", "b, c")


def test_mimic_joints_in_the_file_are_ignored_which_is_said():
    q, (note,) = match_joints(grasp_set(("a", "follower", "b", "c"), np.array([[1.0, -1.5, 2, 3]])), CLAW)
    assert q.tolist() == [[2, 3, 1]]
    assert_names(note, "mimic", ": follower")


def test_mimic_joints_that_are_elsewhere_in_the_file_are_reported():
    values = np.array([[1.0, -1.5, -4.5, 2, 3], [0.0, 0.5, 1.7, 2, 3]])
    q, (ignored, elsewhere) = match_joints(grasp_set(("a", "follower", "last", "b", "c"), values), CLAW)
    assert q.tolist() == [[2, 3, 1], [2, 3, 0]]
    assert_names(ignored, "mimic", "follower, last")
    assert_names(elsewhere, "mimic", " last ", "0.2", " a ")


def test_a_mimic_joint_says_where_the_joint_is_that_the_file_lacks():
    values = np.array([[1.5, 2, 3], [-4.5, 2, 3]])
    q, (note,) = match_joints(grasp_set(("last", "b", "c"), values), CLAW)
    assert q.tolist() == [[2, 3, 0], [2, 3, 1]], "last = 3 (-2 a + 0.5)"
    assert_names(note, "mimic", " a from last")


def test_joints_that_the_hand_lacks_are_refused():
    with expected(GraspFileError, "'gripper'", "'claw'", " x, y", " b, c, a"):
        match_joints(replace(grasp_set(("a", "x", "y"), np.zeros((1, 3))), hand="gripper"), CLAW)


@pytest.mark.parametrize(("named", "said"), [("claw", False), ("Claw_right", False), ("gripper", True)])
def test_another_hand_than_the_file_names_is_said(named: str, said: bool):
    grasps = replace(grasp_set(("a", "b", "c"), np.zeros((1, 3))), hand=named)
    notes = match_joints(grasps, CLAW)[1]
    assert len(notes) == said
    for note in notes:
        assert_names(note, "'gripper'", "'claw'")


@pytest.fixture
def mixed() -> GraspSet:
    grasps = grasp_set(("a",), np.arange(5.0)[:, None])
    return GraspSet(
        grasps.hand,
        grasps.base_link,
        grasps.joint_names,
        np.array(["mug", "can", "mug", "can", "mug"]),
        grasps.scale,
        grasps.hand_pose,
        grasps.q,
    )


def test_an_index_counts_the_grasps_of_the_object(mixed: GraspSet):
    assert choose_rows(mixed.object, object_name="mug", index=[2, 0]).tolist() == [4, 0]


@pytest.mark.parametrize(
    ("object_name", "index", "named"),
    [
        (None, None, ("2 objects", "can (2), mug (3)")),
        (None, [0], ("2 objects", "can (2), mug (3)")),
        ("jar", None, ("'jar'", "can (2), mug (3)")),
        ("mug", [0, 3, -1], ("3, -1", "'mug'", "3 grasps", "0 to 2")),
    ],
)
def test_rows_that_do_not_exist(mixed: GraspSet, object_name, index, named: tuple[str, ...]):
    with expected(GraspFileError, *named):
        choose_rows(mixed.object, object_name=object_name, index=index)


NAN = np.nan


@pytest.mark.parametrize(
    ("condition", "rows"),
    [
        ("a>=2", [1, 3, 4]),
        ("a>2", [4]),
        ("a<=2", [0, 1, 3]),
        ("a<2", [0]),
        (" a = 2.0 ", [1, 3]),
        ("a>-9", [0, 1, 3, 4]),
        ("word=kept", [0, 4]),
        (" word = contacts moved ", [1]),
        ("word=keptt", []),
    ],
)
def test_conditions_hold_for_rows_with_the_value(condition: str, rows: list[int]):
    word = np.array(["kept", "contacts moved", "", "other links", "kept"])
    assert rows_where({"a": np.array([-1.0, 2.0, NAN, 2.0, 3.0]), "word": word}, condition).tolist() == rows


@pytest.mark.parametrize("condition", ["a", "a=", "a==1", "b=1", "a=x", "a=1 2", "word>kept", "word>1", "word="])
def test_other_conditions_are_refused(condition: str):
    with expected(GraspFileError, condition.strip().partition("=")[0]):
        rows_where({"a": np.zeros(2), "word": np.array(["1", "kept"])}, condition)


def test_best_rows_are_the_largest_values_of_each_object_and_never_nan():
    objects = np.array(["mug", "can", "mug", "can", "mug", "mug", "box"])
    values = np.array([NAN, 1.0, 2.0, NAN, 5.0, 2.0, NAN])
    assert best_rows(values, objects, 1).tolist() == [1, 4]
    assert best_rows(values, objects, 2).tolist() == [1, 2, 4], "of equal values the first"
    assert best_rows(values, objects, 9).tolist() == [1, 2, 4, 5]


def test_numbers_and_masks_choose_rows():
    assert row_numbers([2, -3], 3).tolist() == [2, -3] and row_numbers([True, False, True], 3).tolist() == [0, 2]
    for wrong in ([3], [-4], [0.5], [[0]], [True, False], "a"):
        with expected(GraspFileError, "rows"):
            row_numbers(wrong, 3)
