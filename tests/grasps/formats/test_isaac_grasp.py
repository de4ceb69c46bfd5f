"""isaac_grasp as Isaac Sim documents it, as GraspGen and GraspDataGen write it; round trips; what is wrong in it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.agreement import check_same
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.formats.writing import written
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.hands.hand import Hand
from made_hands import link, links, made_hand, slide, solid
from refusals import assert_names, refused

Load = Callable[..., Hand]

ISAAC_SIM = """
format: isaac_grasp
format_version: 1.0

object_frame: /World/cup
gripper_frame: /World/panda_hand

grasps:
  "grasp_0":
    confidence: 1.0
    position: [0.1, -0.02, 1e-3]
    orientation: {w: 0.0, xyz: [1.0, 0.0, 0.0]}
    cspace_position:
      panda_finger_joint1: 0.01
    pregrasp_cspace_position:
      panda_finger_joint1: 0.04
"""
"""The keys of Isaac Sim's documentation, with numbers of ours."""
GRASP_GEN = {
    "format": "isaac_grasp",
    "format_version": 1.0,
    "grasps": {
        f"grasp_{i}": {
            "confidence": 0.5 + 0.1 * i,
            "position": [0.0, 0.0, -0.1 - i],
            "orientation": {"w": 1.0, "xyz": [0.0, 0.0, 0.0]},
        }
        for i in range(3)
    },
}
"""What GraspGen writes."""
GRASP_DATA_GEN = {
    "format": "isaac_grasp",
    "format_version": "1.0",
    "created_with": "grasp_guess",
    "created_at": "2026-01-01T00:00:00",
    "object_file": "objects/cup.obj",
    "object_scale": 0.5,
    "gripper_file": "bots/onrobot_rg6.usd",
    "gripper_frame_link": "base_frame",
    "open_limit": "lower",
    "bite_point": [0.02, 0.0, 0.05],
    "grasps": {
        f"grasp_{i}_5": {
            "confidence": float(i),
            "position": [0.0, 0.0, 0.1],
            "orientation": {"w": 1.0, "xyz": [0.0, 0.0, 0.0]},
            "cspace_position": dict(sorted({"a": 0.1, "b": 0.2}.items(), reverse=bool(i))),
            "bite_point": [0.0, 0.0, 0.0],
            "pregrasp_cspace_position": {"b": 0.4, "a": 0.3},
            "pregrasp_bite_point": [0.0, 0.0, 0.0],
        }
        for i in range(2)
    },
}
"""What GraspDataGen writes, its quaternions with w apart, too."""


def save(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def test_the_file_of_isaac_sims_documentation(tmp_path: Path):
    read = reading(save(tmp_path / "a.yaml", ISAAC_SIM))
    grasps = read.grasps
    assert read.format.name == "isaac_grasp" and not read.notes
    assert (grasps.hand, grasps.base_link, grasps.joint_names) == (
        "franka_hand",
        "panda_hand",
        ("panda_finger_joint1",),
    )
    assert grasps.object.tolist() == ["cup"] and grasps.scale.tolist() == [1.0]
    # A number without a point is text for PyYAML.
    np.testing.assert_array_equal(grasps.hand_pose, [[0.1, -0.02, 1e-3, 0.0, 1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(grasps.q, [[0.01]])
    assert grasps.pregrasp is not None
    np.testing.assert_array_equal(grasps.pregrasp.q, [[0.04]])
    former = ISAAC_SIM.replace("_frame:", "_frame_link:")
    check_same(grasps, reading(save(tmp_path / "b.yml", former)).grasps)


def test_files_of_graspgen_have_poses_only(tmp_path: Path, load: Load):
    read = reading(save(tmp_path / "box.yaml", GRASP_GEN))
    assert read.grasps.q.shape == (3, 0) and set(read.grasps.object) == {"box"}
    joints, frame, labels = read.notes
    assert_names(joints, "no joint")
    assert_names(frame, "gripper_frame", "`hand`")
    assert_names(labels, "confidence", "0.5 to 0.7")
    np.testing.assert_allclose(read.grasps.labels["confidence"], [0.5, 0.6, 0.7])
    given = reading(tmp_path / "box.yaml", hand=load("allegro", "base_link"))
    assert (given.grasps.hand, given.grasps.base_link) == ("allegro", "base_link")
    assert_names(given.notes[1], "gripper_frame", "base_link")


OPENS = {"limits": (0, 0.04), "effort": 50}
JAWS = (
    link("base", solid("box 0.05 0.04 0.05", "-0.06 0.02 0")),
    links("first", "second", inside=solid("box 0.04 0.01 0.02")),
    slide("slide", "base", "first", at="0 0.005 0", axis="0 1 0", **OPENS),
    slide("other", "base", "second", at="0 -0.005 0", axis="0 -1 0", follow=("slide",), **OPENS),
)
"""Jaws that move along y and point along x: they are around the origin of the base link, and their palm behind it."""


def test_graspgens_frame_is_that_of_the_jaws(tmp_path: Path, load: Load):
    """Along x of the file the fingers move, along z they point; a frame with a name, or joints, are taken as given."""
    files = {name: GRASP_GEN | more for name, more in (("bare", {}), ("named", {"gripper_frame": "/World/base"}))}
    for hand, axis, approach, joint in (
        (load("franka_hand", "panda_hand"), [0, 1, 0], [0, 0, 1], "panda_finger_joint1"),
        (made_hand(tmp_path, *JAWS, name="jaws", candidates=1024), [0, 1, 0], [1, 0, 0], "slide"),
    ):
        bare, named = (reading(save(tmp_path / f"{name}.yaml", file), hand=hand) for name, file in files.items())
        R = transform_from_pose(bare.grasps.hand_pose)[:, :3, :3]
        # The orientations of the file are those of the world.
        np.testing.assert_allclose(np.abs(R @ axis), np.tile([1.0, 0.0, 0.0], (3, 1)), atol=1e-12)
        np.testing.assert_allclose(R @ approach, np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-12)
        np.testing.assert_allclose(
            transform_from_pose(named.grasps.hand_pose)[:, :3, :3], np.tile(np.eye(3), (3, 1, 1))
        )
        for read in (bare, named):
            np.testing.assert_array_equal(read.grasps.hand_pose[:, :3], [[0.0, 0.0, -0.1 - i] for i in range(3)])
            assert read.grasps.joint_names == (joint,)
            np.testing.assert_array_equal(read.grasps.q, np.full((3, 1), 0.04))
        assert_names(bare.notes[1], "GraspGen", hand.base_link)


def test_files_of_graspdatagen(tmp_path: Path):
    read = reading(save(tmp_path / "x.yaml", GRASP_DATA_GEN))
    grasps = read.grasps
    assert (grasps.hand, grasps.base_link) == ("onrobot_rg6", "base_frame")
    assert set(grasps.object) == {"cup"} and set(grasps.scale) == {0.5}
    # By name: the second grasp lists its joints the other way round.
    assert grasps.joint_names == ("a", "b")
    np.testing.assert_array_equal(grasps.q, [[0.1, 0.2], [0.1, 0.2]])
    assert grasps.pregrasp is not None
    np.testing.assert_array_equal(grasps.pregrasp.q, [[0.3, 0.4], [0.3, 0.4]])
    np.testing.assert_array_equal(grasps.labels["confidence"], [0.0, 1.0])
    assert_names(read.notes[0], "confidence", "1 of 1", "0 of 1")


def test_a_pregrasp_is_written_where_the_hand_stays(grasps: Callable[..., GraspSet], load: Load, tmp_path: Path):
    before, known = grasps("shadow"), FORMATS["isaac_grasp"]
    opened = replace(before, pregrasp=Stage(before.hand_pose, before.q + 0.1))
    for one, kept in ((opened, True), (before, False)):
        parts, lost = known.write(one, partial(load, "shadow"))
        assert any("squeeze" in note for note in lost) and any("confidence" in note for note in lost)
        assert any("pregrasp" in note for note in lost) != kept
        with written(tmp_path / str(kept), known, parts) as (_, rows):
            pass
        again = reading(tmp_path / str(kept)).grasps
        assert (again.pregrasp is not None) == kept and check_same(one.select(rows), again) < 1e-14


def changed(**changes: object) -> dict:
    """The contents of a sound file with changes; keys of a grasp are those of the first one."""
    content = yaml.safe_load(yaml.safe_dump(GRASP_DATA_GEN))
    for key, value in changes.items():
        holder = content if key in content or key.startswith("format") else content["grasps"]["grasp_0_5"]
        holder[key] = value
    return content


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (changed(format_version=2.0), ("format_version", "'2.0'", "1.0")),
        (changed(grasps=[]), ("grasps", "mapping")),
        (changed(grasps={}), ("grasps",)),
        (changed(grasps={"g": 3}), ("'g'", "int")),
        (changed(position=[0, 0]), ("position", "grasp_0_5", "(3)", "(2,)")),
        (changed(position=["a", 0, 0]), ("position", "grasp_0_5")),
        (changed(orientation={"w": 1.0}), ("grasp_0_5", "xyz")),
        (changed(orientation={"w": 2.0, "xyz": [0, 0, 0]}), ("orientation", "row 0", "2")),
        (changed(cspace_position={"a": 0.1}), ("cspace_position", "grasp_1_5", "b", "a")),
        (changed(cspace_position=[0.1]), ("cspace_position", "grasp_0_5", "mapping")),
        (changed(cspace_position={}), ("cspace_position", "grasp_0_5", "grasp_1_5")),
        (changed(object_scale=-1.0), ("object_scale", "-1")),
        (changed(object_file=3), ("object_file", "int")),
    ],
)
def test_defects_are_named(content: dict, named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.yaml", content)
    with refused(GraspFileError, path, *named):
        reading(path)


def test_other_files_of_a_folder_are_left_out(tmp_path: Path):
    save(tmp_path / "a.yaml", ISAAC_SIM)
    save(tmp_path / "settings.yaml", {"a": 1})
    (tmp_path / "summary.json").write_text("{}")
    (tmp_path / "damaged.json").write_text("{")
    read = reading(tmp_path)
    assert [file.name for file in read.files] == ["a.yaml"]
    (note,) = read.notes
    assert_names(note, "damaged.json", "JSON")
    (tmp_path / "a.yaml").unlink()
    with refused(GraspFileError, tmp_path, ".yaml", "damaged.json"):
        reading(tmp_path)
