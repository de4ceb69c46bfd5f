"""ACRONYM: HDF5 within bounds, its gripper's frame in the Franka hand's, JSON with the same keys, and GraspGen's."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_se3, transform_from_pose, transform_points
from grasp_refine.grasps.formats import hdf5_files, reading_apart
from grasp_refine.grasps.formats.agreement import check_same
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.hdf5_files import dump_hdf5, parse_hdf5
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.pickled import Refused
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.writing import written
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

h5py = pytest.importorskip("h5py")
T = exp_se3(np.random.default_rng(4).normal(size=(5, 6)) * [0.1, 0.1, 0.1, 2, 2, 2])


def tree(**changes: Any) -> dict[str, Any]:
    """What a file of the dataset holds; a change is of the part with its key."""
    held: dict[str, Any] = {
        "grasps": {
            "transforms": T,
            "qualities": {"flex": {"object_in_gripper": np.array([1, 0, 1, 1, 0])}},
        },
        "gripper": {"type": "panda", "configuration": np.array([0.04])},
        "object": {"file": "meshes/Mug/10f6e090.obj", "scale": 0.0003, "mass": 0.013},
    }
    for key, value in changes.items():
        group = next(name for name, part in held.items() if key in part)
        held[group][key] = value
    return held


def save(path: Path, content: dict[str, Any]) -> Path:
    path.write_bytes(dump_hdf5(content))
    return path


def load(base_link: str) -> Hand:
    raise AssertionError("nothing is rebased")


def test_a_file_of_the_dataset(tmp_path: Path):
    read = reading(save(tmp_path / "Mug_10f6e090_0.0003.h5", tree()))
    grasps = read.grasps
    assert read.format.name == "acronym" and (grasps.hand, grasps.base_link) == ("franka_hand", "panda_hand")
    assert set(grasps.object) == {"10f6e090"} and set(grasps.scale) == {0.0003}
    assert grasps.joint_names == ("panda_finger_joint1",) and set(grasps.q.ravel()) == {0.04}
    assert_names(read.notes[0], "open")
    assert_names(read.notes[1], "success", "1 of 3", "0 of 2")
    # The tips of both fingers: the file draws them at x = 41 mm and -41 mm, ours move along y.
    tips = np.array([[0.041, 0.0, 0.112], [-0.041, 0.0, 0.112]])
    ours = np.array([[0.0, 0.041, 0.112], [0.0, -0.041, 0.112]])
    for row in range(5):
        T_object_hand = transform_from_pose(grasps.hand_pose[row])
        np.testing.assert_allclose(transform_points(T_object_hand, ours), transform_points(T[row], tips), atol=1e-12)


def test_json_with_its_keys_and_with_graspgen_keys(tmp_path: Path):
    whole = reading(save(tmp_path / "a.h5", tree())).grasps
    flat = {
        "transforms": T.tolist(),
        "quality_flex_object_in_gripper": [1, 0, 1, 1, 0],
        "object": "meshes/Mug/10f6e090.obj",
        "object_scale": 0.0003,
    }
    (tmp_path / "flat.json").write_text(json.dumps(flat))
    read = reading(tmp_path / "flat.json")
    assert read.format.name == "acronym" and read.grasps.hand == "franka_hand" and not read.grasps.joint_names
    np.testing.assert_allclose(read.grasps.hand_pose, whole.hand_pose, atol=1e-12)
    graspgen = {
        "object": {"file": "mug.obj", "scale": 0.5},
        "gripper": {"name": "robotiq_2f_85", "width": 0.087},
        "grasps": {"transforms": T.tolist(), "object_in_gripper": [True, False, True, True, True]},
    }
    (tmp_path / "graspgen.json").write_text(json.dumps(graspgen))
    read = reading(tmp_path / "graspgen.json")
    assert (read.grasps.hand, set(read.grasps.object)) == ("robotiq_2f_85", {"mug"})
    np.testing.assert_allclose(transform_from_pose(read.grasps.hand_pose), T, atol=1e-12)
    assert_names(" ".join(read.notes), "`hand`", "success (1 of 4, 0 of 1)")


def test_round_trips_to_the_last_digit(tmp_path: Path):
    before = reading(save(tmp_path / "a.h5", tree())).grasps
    before = replace(before, object=np.array(["cup", "mug", "cup", "mug", "cup"]), q=np.full((5, 1), 0.0123))
    known = FORMATS["acronym"]
    parts, lost = known.write(before, load)
    assert len(parts) == 2 and not any("object_in_gripper" in note for note in lost)
    with written(tmp_path / "out", known, parts) as (_, rows):
        pass
    again = reading(tmp_path / "out")
    assert again.format == known and again.grasps.object.tolist() == before.select(rows).object.tolist()
    assert check_same(before.select(rows), again.grasps) < 1e-14
    np.testing.assert_array_equal(again.grasps.scale, before.scale)
    np.testing.assert_array_equal(again.grasps.labels["success"], before.select(rows).labels["success"])
    assert any("object_in_gripper" in note for note in known.write(replace(before, labels={}), load)[1])
    with refused(GraspFileError, "acronym", "success"):
        known.write(replace(before, labels={"success": np.array([1, np.nan, 1, 0, 1])}), load)
    with refused(GraspFileError, "acronym", "one opening", "'cup'"):
        known.write(replace(before, q=np.linspace(0, 0.04, 5)[:, None]), load)


def test_other_hands_have_no_place(grasps: Callable[..., GraspSet]):
    with refused(GraspFileError, "acronym", "'shadow'", "panda_finger_joint1"):
        FORMATS["acronym"].write(grasps("shadow"), load)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (tree(transforms=T[:, :3]), ("grasps/transforms", "(N, 4, 4)", "(5, 3, 4)")),
        (tree(transforms=2 * T), ("grasps/transforms", "row 0")),
        (tree(qualities={"flex": {"object_in_gripper": np.ones(3)}}), ("object_in_gripper", "(5,)", "(3,)")),
        (tree(configuration=np.array([np.nan])), ("configuration", "finite")),
        (tree(configuration=np.zeros(5)), ("configuration", "5")),
        (tree(type=3), ("gripper/type",)),
        (tree(scale=0.0), ("object/scale", "0")),
        (tree(file=1.0), ("object/file",)),
    ],
)
def test_defects_are_named(content: dict[str, Any], named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.h5", content)
    with refused(GraspFileError, path, *named):
        reading(path)


def test_a_hand_without_that_link_is_refused(grasps: Callable[..., GraspSet], tmp_path: Path):
    from grasp_refine.hands.hand import load_hand

    with refused(GraspFileError, "panda_hand", "'allegro'"):
        reading(save(tmp_path / "a.h5", tree()), hand=load_hand("allegro", candidates=16))


def test_bounds_and_links(tmp_path: Path):
    path = tmp_path / "a.h5"

    def check(*named: str, **parts: Any) -> None:
        with h5py.File(path, "w") as file:
            for name, part in parts.items():
                if isinstance(part, h5py.SoftLink | h5py.ExternalLink):
                    file[name] = part
                else:
                    file.create_dataset(name, **part)
        with refused(Refused, *named):
            parse_hdf5(path.read_bytes())

    check("elsewhere", "'a'", a=h5py.ExternalLink("other.h5", "/b"))
    check("elsewhere", "'a'", a=h5py.SoftLink("/b"))
    check("another file", "'a'", a={"shape": (4,), "dtype": "f8", "external": [("other.bin", 0, 32)]})
    check("MiB", "'a'", a={"shape": (2**40,), "dtype": "f8", "chunks": (2**10,), "compression": "gzip"})
    check("type", "'a'", a={"data": np.zeros(2, np.dtype([("x", "f8")]))})
    check("texts", "'a'", a={"data": ["x"] * 20_000, "dtype": h5py.string_dtype()})
    nested: dict[str, Any] = {}
    for _ in range(40):
        nested = {"g": nested}
    for content, named in ((nested, ("nested", "32")), ({f"{n}": {} for n in range(10_001)}, ("10000",))):
        with refused(Refused, *named):
            parse_hdf5(dump_hdf5(content))
    with h5py.File(path, "w") as file:
        file["g/loop"] = file["/"]
    with refused(Refused, "nested"):
        parse_hdf5(path.read_bytes())
    path.write_bytes(hdf5_files.HDF5_MAGIC + bytes(100))
    with refused(GraspFileError, path, "HDF5"):
        load_content(path)


def test_reading_ends_after_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The HDF5 library may run for ever on a damaged file."""
    path = save(tmp_path / "a.h5", tree())
    monkeypatch.setattr(reading_apart, "TIME_LIMIT_S", 0.001)
    with refused(GraspFileError, path, "0.001 s"):
        load_content(path)


def test_without_h5py_its_name_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = save(tmp_path / "a.h5", tree())
    monkeypatch.setitem(sys.modules, "h5py", None)
    with refused(GraspFileError, path, "h5py", "grasp-refine[hdf5]"):
        load_content(path)
