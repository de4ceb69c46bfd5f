"""Each format writes what it reads: fingertips stay, orders and frames are those of the format, defects are named."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import exp_so3, transform_from_pose
from grasp_refine.grasps.formats import source
from grasp_refine.grasps.formats.agreement import (
    DisagreementError,
    check_agreement,
    check_same,
    fingertip_distances,
)
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.dexgraspnet import angles_from_rotation, rotation_from_angles
from grasp_refine.grasps.formats.folders import natural, object_folder, scale_folder
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.grasps.formats.reading import load_grasps, reading
from grasp_refine.grasps.formats.writing import check_output, written
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from refusals import assert_names, refused

FOREARM = {"shadow": "forearm", "leap": "palm_lower"}
BASES = {"shadow": "palm", "allegro": "base_link", "leap": "palm_lower"}
Load, Grasps = Callable[..., Hand], Callable[..., GraspSet]
EXACT, SINGLE = 1e-14, 1e-6
"""Metres by which fingertips may move in double and in single precision."""
CASES = [("shadow", "palm", "ours", "out.npz", EXACT), ("shadow", "palm", "dexgraspnet", "out", EXACT)]
CASES += [
    (hand, base, to, "out", EXACT) for to in ("dexgraspbench", "bodex", "dexonomy") for hand, base in BASES.items()
]
CASES += [("shadow", "palm", "hugs", "out", EXACT), ("leap", "palm_lower", "hugs", "out", EXACT)]
CASES += [("allegro", "base_link", "multigripper", "out", EXACT), ("shadow", "forearm", "graspqp", "out", SINGLE)]
CASES += [(*hand, "isaac_grasp", "out", EXACT) for hand in BASES.items()]
CASES += [(*hand, "lightning_grasp", "out", SINGLE) for hand in BASES.items()]
CASES += [("allegro", "base_link", "graspqp", "out", SINGLE), ("allegro", "base_link", "multidex", "out.pt", SINGLE)]
CASES += [(*hand, to, "out.pt", SINGLE) for to in ("multidex", "dro") for hand in FOREARM.items()]
"""Hand, base link, format, file or folder, and precision."""
STAGED = ("ours", "dexgraspbench", "bodex", "dexonomy", "hugs")
"""Formats that hold pregrasp and squeeze."""
UNSCALED = ("graspqp", "lightning_grasp", "multidex", "dro", "multigripper")
"""Formats whose objects have their own size."""


def save(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, content)
    return path


def write(grasps: GraspSet, path: Path, to: str, load: Load) -> tuple[np.ndarray, list[str]]:
    """Write grasps; returns which rows they are in the order of reading, and what was lost."""
    known = FORMATS[to]
    parts, lost = known.write(grasps, partial(load, grasps.hand))
    check_output(path, known, parts)
    with written(path, known, parts) as (_, rows):
        pass
    return rows, list(lost)


def refusal(path: Path, **keywords) -> str:
    """The message with which a file is refused, behind its path."""
    with refused(GraspFileError) as raised:
        reading(path, **keywords)
    return str(raised.value).removeprefix(f"{path}: ")


@pytest.mark.parametrize(("hand", "base", "to", "name", "precision"), CASES)
def test_what_is_written_is_read_again(
    hand: str, base: str, to: str, name: str, precision: float, grasps: Grasps, load: Load, tmp_path: Path
):
    before = grasps(hand, base_link=base)
    before = replace(before, scale=np.ones(7)) if to in UNSCALED else before
    rows, lost = write(before, tmp_path / name, to, load)
    again = reading(tmp_path / name, hand=load(hand, base) if to == "multigripper" else None)
    assert (again.format.name, again.grasps.hand) == (to, hand)
    expected = before.select(rows)
    assert again.grasps.object.tolist() == expected.object.tolist()
    np.testing.assert_allclose(again.grasps.scale, expected.scale, rtol=1e-15)
    assert fingertip_distances(expected, again.grasps, partial(load, hand)).max() < precision
    stages = to in STAGED
    assert (again.grasps.pregrasp is not None) == (again.grasps.squeeze is not None) == stages
    assert any("pregrasp" in line and "squeeze" in line for line in lost) != stages or to == "isaac_grasp"
    assert any("single" in line for line in lost) == (precision == SINGLE)


def test_grasps_that_are_written_agree_within_a_micrometre(grasps: Grasps, load: Load):
    before = grasps("leap", count=2)
    near, far = (replace(before, hand_pose=before.hand_pose + np.eye(7)[0] * away) for away in (0.9e-6, 1.1e-6))
    for check in (partial(check_agreement, load=partial(load, "leap")), check_same):
        assert check(before, near) == pytest.approx(0.9e-6, rel=1e-3)
        for other in (far, before.select([0])):
            with refused(DisagreementError):
                check(before, other)


def test_the_leap_cache_is_read_again_to_single_precision(grasps: Grasps, load: Load, tmp_path: Path):
    before = grasps("leap").select([0, 6])
    with refused(GraspFileError, "bottle", "0.06", "mug"):
        write(grasps("leap"), tmp_path / "out_s06.npy", "leap_cache", load)
    _, lost = write(before, tmp_path / "out_s06.npy", "leap_cache", load)
    assert_names(lost[0], "'mug'", "0.06")
    again = reading(tmp_path / "out_s06.npy")
    assert set(again.grasps.object) == {"box:0.075,0.075,0.075"}
    assert set(again.grasps.scale) == {0.6}
    assert 0 < fingertip_distances(before, again.grasps, partial(load, "leap")).max() < 1e-7


def test_a_wrist_is_in_the_pose_where_a_format_has_none(grasps: Grasps, load: Load, tmp_path: Path):
    before = grasps("shadow", base_link="forearm")
    assert len(before.joint_names) == 24
    for to in ("dexgraspbench", "bodex", "dexonomy", "dexgraspnet"):
        rows, lost = write(before, tmp_path / to, to, load)
        assert any("WRJ2, WRJ1" in line for line in lost)
        again = reading(tmp_path / to).grasps
        assert (again.base_link, len(again.joint_names)) == ("palm", 22)
        assert fingertip_distances(before.select(rows), again, partial(load, "shadow")).max() < 1e-14


def test_a_hand_that_a_format_does_not_know_is_refused_with_both_lists(grasps: Grasps, load: Load, tmp_path: Path):
    with refused(GraspFileError, "dexgraspnet", "'leap'", "12, 13", "FFJ4"):
        write(grasps("leap"), tmp_path / "out", "dexgraspnet", load)
    with refused(GraspFileError, "leap_cache", "'shadow'"):
        write(grasps("shadow").select([0]), tmp_path / "out.npy", "leap_cache", load)
    assert not list(tmp_path.iterdir())


def bench(grasps: Grasps, load: Load, folder: Path) -> dict[str, Any]:
    """What one DexGraspBench file of ours holds."""
    write(grasps("shadow", count=1), folder / "seed.npy", "dexgraspbench", load)
    return load_content(folder / "seed.npy")


def test_more_numbers_than_memory_should_take_are_refused(
    grasps: Grasps, load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """64 MiB of float16 once took 1.6 GB as float64."""
    bench(grasps, load, tmp_path)
    monkeypatch.setattr(source, "MAX_NUMBERS", 28)
    assert_names(refusal(tmp_path / "seed.npy"), "grasp_qpos", "29", "28")


def test_the_object_pose_is_taken_into_account(grasps: Grasps, load: Load, tmp_path: Path):
    held = bench(grasps, load, tmp_path)
    at_origin = reading(tmp_path / "seed.npy").grasps
    # The object a quarter turn about z and half a metre away: the hand moves with it.
    turn = np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    held["obj_pose"] = np.array([0.5, 0, 0, *turn])
    x, y, z, qw, qx, qy, qz = held["grasp_qpos"][:7]
    w, k = turn[0], turn[3]
    moved = [0.5 - y, x, z, w * qw - k * qz, w * qx - k * qy, w * qy + k * qx, w * qz + k * qw]
    held["grasp_qpos"] = np.array([*moved, *held["grasp_qpos"][7:]])
    there = reading(save(tmp_path / "moved.npy", held)).grasps
    np.testing.assert_allclose(there.hand_pose, at_origin.hand_pose, atol=1e-12)


def test_names_of_objects_come_from_their_paths(grasps: Grasps, load: Load, tmp_path: Path):
    held = bench(grasps, load, tmp_path)
    for path, name in (
        ("assets/DGNObj/core_can", "core_can"),
        ("/home/someone/object/core_can/mesh/simplified.obj", "core_can"),
        ("C:\\data\\mug.obj", "mug"),
        ("../../etc/passwd", "passwd"),
        ("model.v2", "model.v2"),
    ):
        held["obj_path"] = path
        assert set(reading(save(tmp_path / "g.npy", held)).grasps.object) == {name}
    held["obj_path"] = "../.."
    assert_names(refusal(save(tmp_path / "g.npy", held)), "obj_path", "'../..'")


SPOILT = [
    ({"obj_pose": [0, 0, 0, 1, 0, 0]}, ("obj_pose", "(1, 7)", "(1, 6)")),
    ({"obj_pose": [0, 0, 0, 2, 0, 0, 0]}, ("obj_pose", "row 0", "3 to 6")),
    ({"obj_scale": 0.0}, ("obj_scale", "0")),
    ({"obj_scale": "big"}, ("obj_scale", "'big'")),
    ({"obj_scale": [0.1, 0.2, 0.1]}, ("obj_scale", "[0.1, 0.2, 0.1]")),
    ({"obj_path": 3}, ("obj_path", "int")),
    ({"obj_path": None}, ("obj_path", "NoneType")),
    ({"grasp_qpos": np.zeros((2, 29))}, ("grasp_qpos", "(N)", "(2, 29)")),
    ({"grasp_qpos": np.ones(29)}, ("grasp_qpos", "row 0", "3 to 6", "qw qx")),
    ({"obj_scale": np.nan}, ("obj_scale", "finite")),
    ({"obj_scale": [0.1, np.inf, 0.1]}, ("obj_scale[1]", "finite")),
    ({"grasp_qpos": np.zeros(5)}, ("grasp_qpos", "7", "5")),
    ({"grasp_qpos": [[1.0], [1.0, 2.0]]}, ("grasp_qpos", "rows")),
    ({"grasp_qpos": {"a": 1}}, ("grasp_qpos", "dict")),
    ({"squeeze_qpos": np.zeros(28)}, ("squeeze_qpos", "(1, 29)", "(1, 28)")),
    ({"joint_names": ["a"] * 22}, ("22", "1", "a, a")),
    ({"joint_names": "FFJ4"}, ("joint_names", "'FFJ4'")),
    ({"joint_names": [f"J{i}" for i in range(22)]}, ("J0, J1, J2",)),
]


@pytest.mark.parametrize(("change", "named"), SPOILT, ids=[f"{next(iter(c))}_{i}" for i, (c, _) in enumerate(SPOILT)])
def test_defects_are_named(change: dict[str, Any], named: tuple[str, ...], grasps: Grasps, load: Load, tmp_path: Path):
    held = bench(grasps, load, tmp_path)
    # Other order of stages: the one that is spoilt is looked at first.
    spoilt = {**change, **{key: value for key, value in held.items() if key not in change}}
    assert_names(refusal(save(tmp_path / "g.npy", spoilt)), *named)


@pytest.mark.parametrize(
    ("at", "value"),
    [(9, np.nan), (9, np.inf), (1, -np.inf), (4, np.nan), (slice(3, 7), 0.0), (9, None)],
)
def test_a_grasp_that_is_not_finite_costs_no_other_file_of_a_folder(
    at: Any, value: float | None, grasps: Grasps, load: Load, tmp_path: Path
):
    held = bench(grasps, load, tmp_path)
    folder = tmp_path / "folder"
    for number in range(3):
        save(folder / f"{number}.npy", held)
    whole = reading(folder)
    spoilt = dict(held)
    if value is None:  # all stages, and the pose of the object
        spoilt |= {key: np.full_like(held[key], np.nan) for key in held if key.endswith("_qpos")}
        spoilt["obj_pose"] = np.full(7, np.nan)
    else:
        spoilt["grasp_qpos"] = held["grasp_qpos"].copy()
        spoilt["grasp_qpos"][at] = value
    save(folder / "1.npy", spoilt)
    read = reading(folder)
    np.testing.assert_array_equal(read.grasps.finite, [True, False, True])
    for name in ("hand_pose", "q", "object", "scale"):
        np.testing.assert_array_equal(getattr(read.grasps, name)[[0, 2]], getattr(whole.grasps, name)[[0, 2]])
    (note,) = set(read.notes) - set(whole.notes)
    assert_names(note, "1 of 3", "row 1")
    # Whether a stage is there is what the others say.
    assert (read.grasps.pregrasp is None) == (whole.grasps.pregrasp is None)


def test_stages_that_are_the_grasp_itself_are_none_beside_one_that_is_not_finite(
    grasps: Grasps, load: Load, tmp_path: Path
):
    held = bench(grasps, load, tmp_path)
    held |= {key: held["grasp_qpos"] for key in ("pregrasp_qpos", "squeeze_qpos")}
    save(tmp_path / "folder" / "0.npy", held)
    save(tmp_path / "folder" / "1.npy", held | {"grasp_qpos": np.full(29, np.nan)})
    read = reading(tmp_path / "folder").grasps
    assert read.pregrasp is None and read.squeeze is None and read.finite.tolist() == [True, False]


def test_defects_of_bodex_files(grasps: Grasps, load: Load, tmp_path: Path):
    write(grasps("shadow", count=1), tmp_path / "seed.npy", "bodex", load)
    held = load_content(tmp_path / "seed.npy")
    assert held["robot_pose"].shape == (1, 1, 3, 29)
    assert held["joint_names"][:5] == ["THJ5", "THJ4", "THJ3", "THJ2", "THJ1"]
    path = tmp_path / "g.npy"
    without = {key: value for key, value in held.items() if key != "joint_names"}
    np.testing.assert_array_equal(reading(save(path, without)).grasps.q, reading(tmp_path / "seed.npy").grasps.q)
    lacking = refusal(save(path, {**held, "robot_pose": held["robot_pose"][:, :, :2]}))
    assert_names(lacking, "robot_pose", "(1, N, 3, 7 + joints)", "(1, 1, 2, 29)")
    assert_names(refusal(save(path, {"robot_pose": held["robot_pose"]})), "obj_pose", "scene_cfg", "scene_path")


def test_bodex_files_with_a_scene_beside_them(grasps: Grasps, load: Load, tmp_path: Path):
    write(grasps("shadow", count=1), tmp_path / "seed.npy", "bodex", load)
    held = {key: load_content(tmp_path / "seed.npy")[key] for key in ("robot_pose", "joint_names")}
    held["scene_path"] = ["/data/assets/scene/mug_on_table.npy"]
    path = save(tmp_path / "out" / "deep" / "g.npy", held)
    assert_names(refusal(path), "/data/assets/scene/mug_on_table.npy")
    pose = np.array([0, 0, 0.3, 1, 0, 0, 0])
    scene = {"scene": {"mug": {"pose": pose, "scale": np.full(3, 0.12)}}, "task": {"obj_name": "mug"}}
    save(tmp_path / "data" / "assets" / "scene" / "mug_on_table.npy", scene)
    read = reading(path).grasps
    assert (read.object[0], read.scale[0]) == ("mug", 0.12)
    lower = reading(tmp_path / "seed.npy").grasps.hand_pose[0, :3] - [0, 0, 0.3]
    np.testing.assert_allclose(read.hand_pose[0, :3], lower, atol=1e-12)
    place = tmp_path / "data" / "assets" / "scene" / "mug_on_table.npy"
    save(place, {**scene, "task": {"obj_name": "cup"}})
    assert_names(refusal(path), place, "'cup'", " mug")
    save(place, {"scene": {"mug": {"pose": pose}}, "interest_obj_name": "mug"})
    assert_names(refusal(path), place, "'mug'", "scale")
    save(place, {"scene": 1})
    assert_names(refusal(path), place, "scene_cfg", "'scene'")


def test_a_scene_is_looked_for_only_where_it_may_lie(grasps: Grasps, load: Load, tmp_path: Path):
    """A grasp file of anyone names a path; around the root of all folders that would be any file of this machine."""
    write(grasps("shadow", count=1), tmp_path / "seed.npy", "bodex", load)
    held = {key: load_content(tmp_path / "seed.npy")[key] for key in ("robot_pose", "joint_names")}
    scene = {"scene": {"mug": {"pose": [0, 0, 0, 1, 0, 0, 0], "scale": 0.5}}, "task": {"obj_name": "mug"}}
    place = save(tmp_path / "scenes" / "mug.npy", scene)

    def at(name: str) -> Path:
        return save(tmp_path / "uploads" / "1" / "g.npy", held | {"scene_path": name})

    for within in (None, tmp_path):
        assert reading(at("scenes/mug.npy"), within=within).grasps.scale[0] == 0.5
    for within in (tmp_path / "uploads" / "1", tmp_path / "uploads"):
        with refused(GraspFileError, "scenes/mug.npy"):
            reading(at("scenes/mug.npy"), within=within)
    # Nor is a file opened that cannot be a scene.
    (tmp_path / "scenes" / "secret").write_bytes(place.read_bytes())
    for name in ("scenes/secret", str(place), f"../..{place}", "a/" * 3000 + "b.npy", "a" * 300):
        assert_names(refusal(at(name)), name[:2900])


def test_former_keys_of_dexonomy_are_read(grasps: Grasps, load: Load, tmp_path: Path):
    write(grasps("allegro", count=1), tmp_path / "seed.npy", "dexonomy", load)
    held = load_content(tmp_path / "seed.npy")
    former = {"n_evo": "evolution_num", "hand_name": "hand_type", "tmpl_name": "hand_template_name"}
    renamed = {former.get(key, key): value for key, value in held.items()}
    for key in ("pregrasp_qpos", "grasp_qpos", "squeeze_qpos"):
        renamed[key] = renamed[key][0]
    renamed["scene_cfg"] = {"scene": held["scene_cfg"]["scene"], "interest_obj_name": "mug"}
    one, other = reading(tmp_path / "seed.npy").grasps, reading(save(tmp_path / "former.npy", renamed)).grasps
    assert other.hand == "allegro"
    for name in ("q", "hand_pose", "object", "scale"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.squeeze.q, other.squeeze.q)
    held["grasp_qpos"] = np.zeros((2, 23))
    assert_names(refusal(save(tmp_path / "g.npy", held)), "grasp_qpos", "(2, 23)")


def test_defects_of_dexgraspnet_files(grasps: Grasps, load: Load, tmp_path: Path):
    write(grasps("shadow", count=1), tmp_path / "out", "dexgraspnet", load)
    (held,) = load_content(tmp_path / "out" / "mug.npy")
    path = tmp_path / "mug.npy"
    for change, named in (
        ({"robot0:FFJ9": 0.0}, ("qpos", "grasp 0", "robot0:FFJ9", "robot0:FFJ3, robot0:FFJ2")),
        ({"WRJTx": "a"}, ("qpos", "list")),
    ):
        spoilt = {"qpos": {**held["qpos"], **change}, "scale": 0.1}
        assert_names(refusal(save(path, np.array([spoilt], dtype=object))), *named)
    lost = {"qpos": {**held["qpos"], "WRJRz": np.nan}, "scale": 0.1}
    assert reading(save(path, np.array([held, lost, held], dtype=object))).grasps.finite.tolist() == [True, False, True]
    lacking = {"qpos": {key: value for key, value in held["qpos"].items() if key != "WRJTy"}, "scale": 0.1}
    assert_names(refusal(save(path, np.array([lacking], dtype=object))), "qpos", "grasp 0", "WRJTy", "robot0:FFJ3")
    assert_names(refusal(save(path, np.array([{"qpos": held["qpos"]}], dtype=object))), "grasp 0", "scale")
    leap = load("leap")
    assert_names(refusal(tmp_path / "out" / "mug.npy", hand=leap), "hand shadow", "FFJ4")
    odd = GraspSet(**{**vars(grasps("shadow", count=1)), "object": np.array(["a/b"])})
    with refused(GraspFileError, "'a/b'"):
        FORMATS["dexgraspnet"].write(odd, partial(load, "shadow"))


def test_defects_of_leap_caches(load: Load, tmp_path: Path):
    rows = np.zeros((3, 23), dtype=np.float32)
    rows[:, 22] = 1
    read = reading(save(tmp_path / "cube_s105.npy", rows)).grasps
    assert set(read.scale) == {1.05}
    # The cube is at the world's origin, so that the palm is half a metre above it, upside down.
    np.testing.assert_allclose(read.hand_pose[0], [0, 0, 0.5, 0, 1, 0, 0], atol=1e-12)
    assert "scale" in reading(save(tmp_path / "cube.npy", rows)).notes[0]
    assert_names(refusal(save(tmp_path / "c_s00.npy", rows)), "scale", " _s00")
    rows[1, 22] = 0.9
    assert_names(refusal(save(tmp_path / "a.npy", rows)), "16 to 22", "row 1")
    rows[0, 2], rows[1, 19:], rows[2, 18] = np.nan, 0.0, np.inf
    assert not reading(save(tmp_path / "a.npy", rows)).grasps.finite.any()
    assert_names(refusal(tmp_path / "cube_s105.npy", hand=load("shadow")), "hand leap", "1, 0")
    assert_names(refusal(save(tmp_path / "b.npy", rows[:, 1:])), "leap_cache", "(N, 23)", "(3, 22)")


def test_angles_about_fixed_axes():
    # A quarter turn about x, then one about y: the y axis ends at x.
    R = rotation_from_angles(np.array([[np.pi / 2, np.pi / 2, 0.0]]))[0]
    np.testing.assert_allclose(R @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    random = exp_so3(np.random.default_rng(1).normal(size=(200, 3)) * 2)
    locked = rotation_from_angles(np.array([[0.3, np.pi / 2, 0.7], [-1.0, -np.pi / 2, 2.0], [3.0, 0.0, -3.0]]))
    for R in (random, locked):
        np.testing.assert_allclose(rotation_from_angles(angles_from_rotation(R)), R, atol=1e-12)


def test_names_of_folders():
    assert [object_folder(name) for name in ("mug", "a/b", "../x", "..", "box:1,2", "")] == [
        "mug",
        "a_b",
        "_x",
        "object",
        "box_1,2",
        "object",
    ]
    assert [scale_folder(scale) for scale in (0.06, 0.1, 0.0637, 1.0)] == [
        "scale006",
        "scale010",
        "scale006",
        "scale100",
    ]
    paths = ["a/10.npy", "a/2.npy", "a2/1.npy", "a10/1.npy", "a/1_grasp.npy", "B/1.npy"]
    assert sorted(paths, key=natural) == ["B/1.npy", "a/1_grasp.npy", "a/2.npy", "a/10.npy", "a2/1.npy", "a10/1.npy"]


def test_outputs_that_cannot_be(grasps: Grasps, load: Load, tmp_path: Path):
    def cannot(path: Path, to: str, *named: str, count: int = 7) -> None:
        with refused(GraspFileError, path, *named):
            write(grasps("shadow", count), path, to, load)

    cannot(tmp_path / "out", "ours", "ours", ".npz")
    cannot(tmp_path / "out.npy", "bodex", "bodex", "6 files")
    cannot(tmp_path / "mug.npy", "dexgraspnet", "dexgraspnet", "1 file", count=1)
    cannot(tmp_path, "bodex")
    (tmp_path / "dir.npz").mkdir()
    cannot(tmp_path / "dir.npz", "ours")
    (tmp_path / "file").write_text("")
    cannot(tmp_path / "file" / "out", "bodex")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dir.npz", "file"]
    with refused(GraspFileError, "'x'", "ours, dexgraspbench, bodex, dexonomy, dexgraspnet"):
        FORMATS["x"]


def test_nothing_is_left_when_writing_fails(grasps: Grasps, load: Load, tmp_path: Path):
    known = FORMATS["bodex"]
    parts, _ = known.write(grasps("shadow"), partial(load, "shadow"))
    with pytest.raises(ZeroDivisionError), written(tmp_path / "out", known, parts) as (place, _):
        assert len(list(place.rglob("*.npy"))) == 6
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_a_cache_of_leap_is_read_as_by_others(shared_assets: Path) -> None:
    """Joints by name and poses, against the same grasps that the assets hold in another form."""
    found = load_grasps(shared_assets / "grasps/leap_cube_cache/leap_hand_in_palm_cube_grasp_50k_s10.npy")
    other = load_grasps(shared_assets / "grasps/normalised/leap_cube.npz").select(np.arange(20))
    order = [found.joint_names.index(name) for name in other.joint_names]
    apart = np.abs(other.q[:, None] - found.q[None, :, order]).max(axis=2)
    assert apart.min(axis=1).max() < 1e-6
    T, expected = (transform_from_pose(one) for one in (found.hand_pose[apart.argmin(axis=1)], other.hand_pose))
    np.testing.assert_allclose(T, expected, atol=1e-5)
