"""`refine-grasp convert`: one line for what was done, a self-check, and nothing left where it fails."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import refused
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.hands.hand import load_hand
from grasp_refine_apps.cli import main
from refusals import assert_names


@pytest.fixture
def file(workplace: Path) -> Path:
    """Two grasps of the Allegro hand on two objects, in our format."""
    hand = load_hand("allegro", candidates=16)
    entries = {
        "hand": "allegro",
        "base_link": "base_link",
        "joint_names": np.array(hand.joint_names),
        "object": np.array(["mug", "bottle"]),
        "scale": np.array([1.0, 0.5]),
        "hand_pose": np.array([[0.1, 0.0, 0.2, 1, 0, 0, 0], [0.0, 0.1, 0.0, 0.6, 0.0, 0.8, 0.0]]),
        "q": np.stack([hand.rest, hand.rest + 0.1]),
    }
    save_npz(workplace / "grasps.npz", entries)
    return workplace / "grasps.npz"


def test_there_and_back(file: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["convert", "grasps.npz", "bench", "--to", "dexgraspbench", "--json", "there.json"]) == 0
    out, error = capsys.readouterr()
    read, grasps, wrote, _ = out.splitlines()
    assert_names(read, "grasps.npz", "ours", "1 file")
    assert_names(grasps, "2 grasps", "allegro", "2 objects")
    assert_names(wrote, "bench", "dexgraspbench", "2 files")
    for note, stage in zip(error.splitlines(), ("pregrasp", "squeeze"), strict=True):
        assert note.startswith("note: ") and stage in note
    assert sorted(str(path) for path in Path("bench").rglob("*.npy")) == [
        "bench/bottle/scale050_pose000/0.npy",
        "bench/mug/scale100_pose000/0.npy",
    ]
    document = json.loads(Path("there.json").read_text())
    assert document["schema"] == 1
    assert document["command"] == "convert"
    assert document["input"] == {"path": "grasps.npz", "format": "ours", "files": 1}
    assert document["output"] == {"path": "bench", "format": "dexgraspbench", "files": 2}
    assert (document["grasps"], document["left_out"]) == (2, 0)
    assert document["objects"] == {"mug": 1, "bottle": 1}
    assert 0 <= document["largest_difference_m"] < 1e-15
    assert len(document["notes"]) == 2
    assert main(["convert", "bench", "back.npz", "--to", "ours"]) == 0
    before, after = load_grasps("grasps.npz"), load_grasps("back.npz")
    # Nobody has invented a pregrasp or a squeeze.
    assert after.pregrasp is None and after.squeeze is None
    notes = capsys.readouterr().err.splitlines()
    assert any("squeeze" in note and "all 2" in note for note in notes)
    np.testing.assert_allclose(after.q[[1, 0]], before.q, atol=1e-15)
    np.testing.assert_allclose(after.hand_pose[[1, 0]], before.hand_pose, atol=1e-15)


def test_grasps_that_are_not_finite_are_left_out(file: Path, capfd: pytest.CaptureFixture[str]):
    grasps = load_grasps(file).select([0, 1, 0])
    q = grasps.q.copy()
    q[1, 3] = np.nan
    save_npz(Path("bad.npz"), replace(grasps, q=q).arrays())
    assert main(["convert", "bad.npz", "bench", "--to", "dexgraspbench", "--json", "x.json"]) == 0
    out, error = capfd.readouterr()
    assert_names(out.splitlines()[1], "3 grasps", "allegro", "2 objects")
    notes = [line for line in error.splitlines() if line.startswith("note: 1 of 3 grasps")]
    assert len(notes) == 2 and sum("row 1" in note for note in notes) == 1
    document = json.loads(Path("x.json").read_text())
    assert (document["grasps"], document["left_out"], document["objects"]) == (2, 1, {"mug": 2})
    assert main(["convert", "bench", "back.npz", "--to", "ours"]) == 0
    np.testing.assert_allclose(load_grasps("back.npz").q, grasps.q[[0, 2]], atol=1e-15)
    capfd.readouterr()
    save_npz(Path("worse.npz"), replace(grasps, q=np.full_like(q, np.inf)).arrays())
    assert_names(refused(capfd, "convert", "worse.npz", "x", "--to", "bodex"), "worse.npz", "3 grasps", "finite")
    assert not Path("x").exists()


def test_measures_and_verdicts_choose_refined_grasps(file: Path, capfd: pytest.CaptureFixture[str]):
    grasps = load_grasps(file).select([0, 1, 0, 1, 0])
    grasps = replace(grasps, q=grasps.q + 1e-3 * np.arange(5)[:, None])
    results = {
        "quality_before": np.array([0.9, 0.1, 0.1, 0.1, 0.1]),
        "quality_after": np.array([0.2, 0.99, 0.95, 0.91, 0.95]),
        "penetration_m_after": np.array([0.0, 2e-3, 0.0, 0.0, 1e-4]),
        "simulation_after": np.array([True, False, True, True, False]),
        "change": np.array(["kept", "contacts moved", "other grasp", "kept", ""]),
    }
    save_npz(Path("results/one.npz"), grasps.arrays() | results)
    save_npz(Path("results/two.npz"), grasps.select([1]).arrays() | {"quality_after": np.array([0.5])})
    every = np.concatenate([grasps.q, grasps.q[[1]]])
    for source, options, rows in (
        ("results/one.npz", ["--where", "held=1"], [0, 2, 3]),
        ("results/one.npz", ["--where", "quality>=0.95", "penetration_m<1e-3"], [2, 4]),
        ("results/one.npz", ["--where", "quality_before>0.5"], [0]),
        ("results/one.npz", ["--best", "1"], [1, 2]),
        ("results/one.npz", ["--where", "held=1", "--best", "1"], [2, 3]),
        ("results/one.npz", ["--where", "change=contacts moved"], [1]),
        # Of two files, the second not simulated.
        ("results", ["--where", "change=kept", "held=1"], [0, 3]),
        ("results", ["--where", "held=0"], [1, 4]),
        ("results", ["--where", "quality<0.6", "--best", "9"], [0, 5]),
    ):
        assert main(["convert", source, "some.npz", "--to", "ours", *options, "--overwrite"]) == 0
        np.testing.assert_array_equal(load_grasps("some.npz").q, every[rows])
        assert_names(capfd.readouterr().out.splitlines()[2], f"{len(rows)} grasps" if len(rows) > 1 else "1 grasp")
    for options, named in (
        (["--where", "hold=1"], ("'hold'", "quality", "penetration_m", "held")),
        (["--where", "held=1", "quality<0.1"], ("held=1 and quality<0.1",)),
        (["--best", "0"], ("--best", "at least 1")),
    ):
        assert_names(refused(capfd, "convert", "results/one.npz", "x.npz", "--to", "ours", *options), *named)
    assert_names(refused(capfd, "convert", file.name, "x.npz", "--to", "ours", "--best", "2"), "--best", "quality")
    assert not Path("x.npz").exists()


def test_the_hand_decides_where_joints_have_no_names(file: Path, capfd: pytest.CaptureFixture[str]):
    assert main(["convert", "grasps.npz", "bench", "--to", "dexgraspbench"]) == 0
    for path in Path("bench").rglob("*.npy"):
        held = dict(load_content(path))
        del held["joint_names"]
        np.save(path, np.array(held, dtype=object))
    capfd.readouterr()
    message = refused(capfd, "convert", "bench", "back.npz", "--to", "ours")
    assert_names(message, "16 joint", "allegro (joint_0.0, joint_1.0", "leap (1, 0, 2, 3", "--hand")
    assert main(["convert", "bench", "back.npz", "--to", "ours", "--hand", "allegro"]) == 0
    np.testing.assert_allclose(load_grasps("back.npz").q[[1, 0]], load_grasps(file).q, atol=1e-15)


@pytest.mark.parametrize("shift", [2e-6, float("nan")])
def test_two_micrometres_are_found_out_and_places_that_are_none(
    shift: float, file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    hand = load_hand("leap", candidates=16, base_link="palm_lower")
    grasps = load_grasps(file).select([0]).arrays() | {
        "hand": "leap",
        "base_link": "palm_lower",
        "joint_names": np.array(hand.joint_names),
    }
    save_npz(Path("leap.npz"), grasps)
    honest = LeapCache.write

    def shifted(self: LeapCache, *arguments: Any) -> Any:
        parts, lost = honest(self, *arguments)
        parts[0].content[:, 16] += shift
        return parts, lost

    assert main(["convert", "leap.npz", "cube_s10.npy", "--to", "leap_cache"]) == 0
    capsys.readouterr()
    monkeypatch.setattr(LeapCache, "write", shifted)
    assert main(["convert", "leap.npz", "other_s10.npy", "--to", "leap_cache"]) == 1
    assert_names(capsys.readouterr().err, "other_s10.npy", "1e-06 m")
    assert not Path("other_s10.npy").exists()


def test_bad_input(file: Path, capfd: pytest.CaptureFixture[str]):
    def check(arguments: tuple[str | Path, ...], *named: str | Path) -> None:
        assert_names(refused(capfd, "convert", *arguments), *named)

    check(("none.npz", "x.npz", "--to", "ours"), "none.npz")
    check((file, "x.npz", "--to", "graspit"), "--to", "dexgraspbench")
    check(("grasps.npz", "grasps.npz", "--to", "ours"), "grasps.npz", "input")
    check((file, "x.npy", "--to", "bodex"), "x.npy", "bodex", "2 files")
    for overwrite in ((), ("--overwrite",)):
        check((file, "x", "--to", "bodex", "--json", file, *overwrite), file, "input")
    check((file, "x.npz", "--to", "ours", "--json", "x.npz"), "x.npz", "twice")
    check((file, "x", "--to", "bodex", "--format", "bodex"), file, "bodex", ".npz")
    check((file, "x", "--to", "dexgraspnet"), "dexgraspnet", "'allegro'", "joint_0.0", "FFJ4, FFJ3")
    save_npz(Path("own.npz"), load_grasps(file).arrays() | {"hand": "mine"})
    check(("own.npz", "x", "--to", "bodex"), "own.npz", "'mine'", "allegro, ", "--hand")
    save_npz(Path("odd.npz"), load_grasps(file).arrays() | {"joint_names": np.array([f"j{i}" for i in range(16)])})
    check(("odd.npz", "x.npz", "--to", "ours"), "'allegro'", "j0, j1")


def test_what_is_there_is_kept(file: Path, capfd: pytest.CaptureFixture[str]):
    """A file of two grasps was replaced by one of a single grasp, and nothing was said."""
    save_npz(Path("one.npz"), load_grasps(file).select([0]).arrays())
    before = Path("one.npz").read_bytes()
    for output in (("one.npz",), ("new.npz", "--json", "one.npz")):
        assert_names(refused(capfd, "convert", file, *output, "--to", "ours"), "one.npz", "--overwrite")
    assert Path("one.npz").read_bytes() == before
    assert_names(refused(capfd, "convert", file, "deep/new.npz", "--to", "ours"), "folder deep")
    assert_names(refused(capfd, "convert", file, "deep/new", "--to", "bodex"), "folder deep")
    assert main(["convert", str(file), "one.npz", "--to", "ours", "--overwrite"]) == 0
    assert len(load_grasps("one.npz")) == 2
    # A folder may hold more than what would replace it.
    assert main(["convert", str(file), "folder", "--to", "bodex"]) == 0
    capfd.readouterr()
    assert_names(refused(capfd, "convert", file, "folder", "--to", "bodex", "--overwrite"), "folder: ")


class Call:
    """Makes a folder when it is unpickled."""

    def __reduce__(self) -> Any:
        return os.mkdir, ("made",)


def test_a_file_that_would_run_code_is_refused_and_does_not(workplace: Path, capfd: pytest.CaptureFixture[str]):
    np.save("evil.npy", np.array({"grasp_qpos": Call()}, dtype=object))
    message = refused(capfd, "convert", "evil.npy", "x.npz", "--to", "ours", "--format", "dexgraspbench")
    assert_names(message, "evil.npy", "posix.mkdir")
    assert not Path("made").exists()


@pytest.mark.parametrize("to", ["isaac_grasp", "multidex", "graspqp", "lightning_grasp", "multigripper"])
def test_formats_of_other_generators_there_and_back(to: str, file: Path):
    before, there = load_grasps(file), "there.pt" if to == "multidex" else "there"
    assert main(["convert", "grasps.npz", there, "--to", to]) == 0
    assert main(["convert", there, "back.npz", "--to", "ours"]) == 0
    after = load_grasps("back.npz")
    order = [after.object.tolist().index(name) for name in before.object.tolist()]
    columns = [after.joint_names.index(name) for name in before.joint_names]
    precision = 1e-15 if to in ("isaac_grasp", "multigripper") else 2e-7
    np.testing.assert_allclose(after.q[order][:, columns], before.q, atol=precision)
    np.testing.assert_allclose(after.hand_pose[order], before.hand_pose, atol=precision)
