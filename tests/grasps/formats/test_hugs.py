"""HUGS: records of its benchmark, told from those of DexGraspBench, whose pose is that of another frame."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from refusals import refused

Load = Callable[..., Hand]
FINGERS = [
    f"{finger}J{n}" for finger, count in (("FF", 4), ("MF", 4), ("RF", 4), ("LF", 5)) for n in range(count, 0, -1)
]
SHADOW = [f"rh_THJ{n}" for n in range(5, 0, -1)] + [f"rh_{joint}" for joint in FINGERS]
LEAP = [f"rh_joint_{n}" for n in (1, 0, 2, 3, 5, 4, 6, 7, 9, 8, 10, 11, 12, 13, 14, 15)]


def record(names: list[str] = SHADOW, **changes: Any) -> dict[str, Any]:
    """A record after its contract."""
    pose = np.array([0.1, 0.2, 0.3, 0.5, 0.5, 0.5, 0.5])
    stages = {
        f"{stage}_qpos": np.concatenate([pose, np.arange(len(names)) / 100 + at / 10]).astype(np.float32)
        for at, stage in enumerate(("pregrasp", "grasp", "squeeze"))
    }
    return {
        "obj_scale": 0.08,
        "obj_pose": np.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]),
        "obj_path": "object/DGN_2k/processed_data/core_mug",
        "scene_path": "object/DGN_2k/scene_cfg/core_mug/tabletop_ur10e/scale008_pose000_0.npy",
        "bench_contract_version": "1.0",
        "path_root": "ANYSCALEGRASP_DATA_ROOT",
        "joint_names": names,
        **stages,
    } | changes


def save(path: Path, content: Any) -> Path:
    np.save(path, np.array(content, dtype=object))
    return path


@pytest.mark.parametrize(("names", "hand", "link"), [(SHADOW, "shadow", "palm"), (LEAP, "leap", "palm_lower")])
def test_the_pose_is_that_of_the_palm(names: list[str], hand: str, link: str, tmp_path: Path):
    read = reading(save(tmp_path / "0_grasp.npy", record(names)))
    grasps = read.grasps
    assert (read.format.name, grasps.hand, grasps.base_link) == ("hugs", hand, link)
    assert grasps.object.tolist() == ["core_mug"] and grasps.scale.tolist() == [0.08]
    np.testing.assert_allclose(grasps.hand_pose, [[0.1, 0.2, 0.2, 0.5, 0.5, 0.5, 0.5]], atol=1e-7)
    prefix = "rh_" if hand == "shadow" else "rh_joint_"
    assert [f"{prefix}{name}" for name in grasps.joint_names] == names
    np.testing.assert_allclose(grasps.q[0], np.arange(len(names)) / 100 + 0.1, atol=1e-6)
    assert grasps.pregrasp is not None and grasps.squeeze is not None
    assert any("fingertips" in note for note in read.notes) == (hand == "leap")
    # Joints are matched by name.
    turned = record(names[::-1])
    for key in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
        turned[key] = np.concatenate([turned[key][:7], record(names)[key][7:][::-1]])
    again = reading(save(tmp_path / "b.npy", turned)).grasps
    order = [again.joint_names.index(name) for name in grasps.joint_names]
    np.testing.assert_array_equal(again.q[:, order], grasps.q)


def test_joints_are_written_with_prefixes_and_other_hands_are_refused(grasps: Callable[..., GraspSet], load: Load):
    for hand, names in (("shadow", SHADOW), ("leap", LEAP)):
        parts, lost = FORMATS["hugs"].write(grasps(hand), partial(load, hand))
        assert len(parts) == 7 and lost == ["there is no scene: scene_path is empty"]
        assert parts[0].content["joint_names"] == names
    with refused(GraspFileError, "hugs", "'allegro'"):
        FORMATS["hugs"].write(grasps("allegro"), partial(load, "allegro"))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"bench_contract_version": "2.0"}, ("bench_contract_version", "'2.0'", "1.0")),
        ({"joint_names": None}, ("joint_names",)),
        ({"joint_names": SHADOW[1:]}, ("22", "21", "FFJ4")),
        (
            {"joint_names": ["ra_x", *SHADOW, *(name.replace("rh", "lh") for name in SHADOW)]},
            ("two hands", "ra_x", "lh_"),
        ),
        ({"grasp_qpos": np.full(29, 2.0)}, ("grasp_qpos", "row 0")),
        ({"obj_scale": 0.0}, ("obj_scale", "0")),
    ],
)
def test_defects_are_named(changes: dict[str, Any], named: tuple[str, ...], tmp_path: Path):
    path = save(tmp_path / "a.npy", record(**changes))
    with refused(GraspFileError, path, *named):
        reading(path)
