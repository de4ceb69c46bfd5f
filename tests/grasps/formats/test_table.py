"""Tables of any make: fingertips that MuJoCo computes stay, whatever notation, unit, order and file hold the grasps."""

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats import parquet_files
from grasp_refine.grasps.formats.reading import is_other, reading
from refusals import refused

MODEL = """<mujoco><worldbody><body name="palm"><freejoint/><geom size="0.02"/>
<body name="link" pos="0.03 0.01 0.05" euler="20 10 30"><joint name="knuckle" axis="0 1 0"/><geom size="0.01"/>
<body name="tip" pos="0 0.02 0.04" euler="0 40 5"><joint name="distal" axis="1 0 0.2"/><geom size="0.01"/></body></body>
</body></worldbody></mujoco>"""
COUNT = 5


def tips(position: np.ndarray, R: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Position (N, 3) of the tip behind two joints, by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data, found = mujoco.MjData(model), []
    for p, r, angles in zip(position, R, q, strict=True):
        data.qpos[:] = [*p, *Rotation.from_matrix(r).as_quat(scalar_first=True), *angles]
        mujoco.mj_kinematics(model, data)
        found.append(data.body("tip").xpos.copy())
    return np.array(found)


class Made:
    """Random grasps in a world with an object, and the tips in the frame of the object."""

    def __init__(self) -> None:
        random = np.random.default_rng(7)
        self.p, self.q = random.normal(size=(COUNT, 3)) * 0.1, random.uniform(-1.2, 1.2, (COUNT, 2))
        self.R = Rotation.random(COUNT, random_state=1).as_matrix()
        self.object_p = random.normal(size=(COUNT, 3)) * 0.2
        self.object_R = Rotation.random(COUNT, random_state=2).as_matrix()
        self.tips = tips(self.p, self.R, self.q)

    def assert_read(self, path: Path, in_world: bool = False) -> None:
        """Assert that the tips of the grasps that are read are these."""
        read = reading(path)
        assert read.format.name == "table"
        assert (read.grasps.hand, read.grasps.base_link) == ("mine", "palm")
        columns = [read.grasps.joint_names.index(name) for name in ("knuckle", "distal")]
        pose = np.asarray(read.grasps.hand_pose)
        R = Rotation.from_quat(pose[:, 3:], scalar_first=True).as_matrix()
        expected = self.tips
        if in_world:
            expected = np.einsum("nji,nj->ni", self.object_R, self.tips - self.object_p)
        np.testing.assert_allclose(tips(pose[:, :3], R, read.grasps.q[:, columns]), expected, atol=1e-9)


NOTATIONS: dict[str, Any] = {
    "wxyz": lambda R: Rotation.from_matrix(R).as_quat(scalar_first=True),
    "xyzw": lambda R: Rotation.from_matrix(R).as_quat(),
    "rotvec": lambda R: Rotation.from_matrix(R).as_rotvec(),
    "fixed_xyz": lambda R: Rotation.from_matrix(R).as_euler("xyz"),
    "rotated_xyz": lambda R: Rotation.from_matrix(R).as_euler("XYZ"),
    "matrix": lambda R: R.reshape(-1, 9),
}


def toml(path: Path, **keys: Any) -> Path:
    lines = [f"{key} = {json.dumps(value)}" for key, value in keys.items() if not isinstance(value, dict)]
    for key, value in keys.items():
        if isinstance(value, dict):
            lines += [f"[{key}]", *(f"{json.dumps(name)} = {json.dumps(column)}" for name, column in value.items())]
    path.write_text("\n".join(lines))
    return path


def save(folder: Path, kind: str, columns: dict[str, np.ndarray]) -> str:
    """A table with columns (N,) or (N, n); CSV has one column per number. Returns its name."""
    if kind == "csv":
        flat = {}
        for name, column in columns.items():
            parts = column.reshape(len(column), -1)
            flat |= {f"{name}{at}" if parts.shape[1] > 1 else name: parts[:, at] for at in range(parts.shape[1])}
        with (folder / "t.csv").open("w", newline="") as file:
            csv.writer(file).writerow(flat)
            csv.writer(file).writerows(zip(*(column.tolist() for column in flat.values()), strict=True))
        return "t.csv"
    if kind == "h5":
        with h5py.File(folder / "t.h5", "w") as file:
            for name, column in columns.items():
                file[f"grasps/{name}"] = column if column.dtype.kind != "U" else column.astype("S")
        return "t.h5"
    pq.write_table(
        pa.table({name: pa.array(column.tolist()) for name, column in columns.items()}), folder / "t.parquet"
    )
    return "t.parquet"


def numbered(name: str, count: int, kind: str) -> Any:
    """Columns of a vector in one kind of file."""
    if kind == "csv":
        return [f"{name}{at}" for at in range(count)]
    return f"grasps/{name}" if kind == "h5" else name


@pytest.mark.parametrize(
    ("kind", "notation"), [*(("csv", name) for name in NOTATIONS), ("parquet", "matrix"), ("h5", "rotvec")]
)
def test_all_notations_and_files_give_the_same_fingertips(kind: str, notation: str, tmp_path: Path):
    made, angles = Made(), NOTATIONS[notation]
    r, near = angles(made.R), angles(made.object_R)
    columns = {"p": made.p * 1000, "r": r, "op": made.object_p * 1000, "or": near, "q": np.degrees(made.q)}
    table = save(tmp_path, kind, columns)
    path = toml(
        tmp_path / "mine.toml",
        table=table,
        hand="mine",
        base_link="palm",
        position=numbered("p", 3, kind),
        rotation=numbered("r", r.shape[1], kind),
        object_position=numbered("op", 3, kind),
        object_rotation=numbered("or", r.shape[1], kind),
        notation=notation,
        length_unit="mm",
        joint_unit="deg",
        **(
            {"joints": {"distal": "q1", "knuckle": "q0"}}
            if kind == "csv"
            else {"joints": ["knuckle", "distal"], "joint_column": numbered("q", 2, kind)}
        ),
    )
    made.assert_read(path, in_world=True)


def test_a_pose_of_the_object_in_the_hand_is_inverted(tmp_path: Path):
    made = Made()
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = made.R, made.p
    table = save(tmp_path, "h5", {"T": np.linalg.inv(T), "q": made.q})
    keys: dict[str, Any] = {"table": table, "hand": "mine", "base_link": "palm", "pose": "grasps/T"}
    keys |= {"notation": "transform", "joints": ["knuckle", "distal"], "joint_column": "grasps/q"}
    made.assert_read(toml(tmp_path / "mine.toml", pose_of="object", **keys))


def test_objects_scales_and_labels_come_from_columns(tmp_path: Path):
    made = Made()
    names = np.array(["mug", "bottle", "mug", "can", "can"])
    columns = {"p": made.p, "r": NOTATIONS["wxyz"](made.R), "name": names, "s": np.linspace(0.1, 0.5, 5)}
    columns |= {"q0": made.q[:, 0], "q1": made.q[:, 1], "ok": np.array([True, False, True, True, False])}
    for kind in ("csv", "parquet"):
        if kind == "csv":
            columns["ok"] = columns["ok"].astype(int)
        path = toml(
            tmp_path / "mine.toml",
            table=save(tmp_path, kind, columns),
            hand="mine",
            base_link="palm",
            position=numbered("p", 3, kind),
            rotation=numbered("r", 4, kind),
            object_column="name",
            scale_column="s",
            joints={"knuckle": "q0", "distal": "q1"},
            labels={"success": "ok"},
        )
        made.assert_read(path)
        grasps = reading(path).grasps
        assert grasps.object.tolist() == names.tolist()
        np.testing.assert_allclose(grasps.scale, columns["s"])
        assert grasps.labels["success"].tolist() == [1, 0, 1, 1, 0]


@pytest.mark.parametrize("version", ["names", "motors"])
def test_a_lerobot_data_set_gives_the_row_before_the_lift_of_each_episode(version: str, tmp_path: Path):
    made, length = Made(), 12
    folder = tmp_path / "set"
    state = np.repeat(np.concatenate([made.p, NOTATIONS["xyzw"](made.R), made.q], axis=1), length, axis=0)
    frame = np.tile(np.arange(length), COUNT)
    state[:, 0] += np.where(frame < 6, 0.01 * (6 - frame), 0)  # approaches
    state[:, 2] += np.where(frame > 6, 0.01 * (frame - 6), 0)  # lifts
    names = [f"hand_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")] + ["knuckle", "distal"]
    entries: Any = names if version == "names" else {"motors": names}
    features = {"observation.state": {"dtype": "float32", "shape": [9], "names": entries}}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": features}))
    kind = pa.list_(pa.float64(), 9)
    for at, rows in enumerate(np.array_split(np.arange(len(state)), 2)):
        place = folder / f"data/chunk-000/file-{at:03d}.parquet"
        place.parent.mkdir(parents=True, exist_ok=True)
        table = {
            "observation.state": pa.array(state[rows].tolist(), type=kind),
            "episode_index": rows // length,
            "frame_index": frame[rows],
        }
        pq.write_table(pa.table(table), place)
    path = toml(
        tmp_path / "mine.toml",
        table="set",
        hand="mine",
        base_link="palm",
        pose=[f"observation.state.{name}" for name in names[:7]],
        notation="xyzw",
        episode="episode_index",
        frame="before_lift",
        joints={name: f"observation.state.{name}" for name in names[7:]},
        object="mug",
    )
    made.assert_read(path)
    assert set(reading(path).grasps.object) == {"mug"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"table": "../t.csv"}, ["../t.csv"]),
        ({"table": "none.csv"}, ["none.csv"]),
        ({"speed": 3}, ["speed", "length_unit"]),
        ({"position": ["x", "y", "z"]}, ["x, y, z", "p0"]),
        ({"notation": "wxzy"}, ["wxzy", "xyzw"]),
        ({"position": []}, ["0", "3"]),
        ({"rotation": ["r0", "r1", "r2"]}, ["r0", "4"]),
        ({"length_unit": "inch"}, ["inch", "mm"]),
        ({"frame": "last"}, ["episode"]),
        ({"joints": 3}, ["joints"]),
        ({"base_link": ""}, ["base_link"]),
    ],
)
def test_a_wrong_mapping_is_named(change: dict[str, Any], words: list[str], tmp_path: Path):
    made = Made()
    table = save(tmp_path, "csv", {"p": made.p, "r": NOTATIONS["wxyz"](made.R), "q": made.q})
    keys: dict[str, Any] = {"table": table, "base_link": "palm", "position": ["p0", "p1", "p2"]}
    keys |= {"rotation": ["r0", "r1", "r2", "r3"], "joints": {"knuckle": "q0", "distal": "q1"}}
    with refused(GraspFileError, *words):
        reading(toml(tmp_path / "mine.toml", **keys | change))


def test_a_table_that_is_damaged_is_named(tmp_path: Path):
    keys: dict[str, Any] = {"base_link": "palm", "position": ["a", "b", "c"], "rotation": "r", "joints": {}}
    for name, data in (("t.csv", b"a,b,c,r\n1,2\n"), ("t.csv", b"\xff\xfe\x00"), ("t.parquet", b"PAR1damagedPAR1")):
        (tmp_path / name).write_bytes(data)
        with refused(GraspFileError, name):
            reading(toml(tmp_path / "mine.toml", table=name, **keys))


def test_parquet_that_would_unpack_to_far_more_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pq.write_table(pa.table({"a": np.zeros(20_000), "b": np.zeros(20_000)}), tmp_path / "t.parquet")
    monkeypatch.setattr(parquet_files, "MAX_NUMBERS", 20_000)
    assert len(parquet_files.parse_parquet([tmp_path / "t.parquet"], ["a"])[0]["a"]) == 20_000
    with refused(GraspFileError, "t.parquet", "20000"):
        parquet_files.parse_parquet([tmp_path / "t.parquet"], ["a", "b"])


def test_a_file_that_ends_its_library_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "pyarrow").mkdir()
    (tmp_path / "pyarrow/__init__.py").write_text("import os; os.abort()")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "t.parquet").write_bytes(b"PAR1")
    keys: dict[str, Any] = {"base_link": "palm", "position": ["a", "a", "a"], "rotation": "a", "joints": {}}
    with refused(GraspFileError, "t.parquet", "-6"):
        reading(toml(tmp_path / "mine.toml", table="t.parquet", **keys))


def test_other_toml_files_are_no_grasps(tmp_path: Path):
    (tmp_path / "hand.toml").write_text('urdf = "hand.urdf"')
    assert is_other(tmp_path / "hand.toml")
