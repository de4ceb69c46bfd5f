"""One poisoned grasp never spoils its batch: it gets a status, the others keep theirs and their results to 1e-9."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from boxed_example import FILE, boxed_example
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.hands.hand import load_hand
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.status import UNUSABLE, Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.cli import main

GEOMETRY = Weights(wrench=0.0)
LM, DESCENT = LevenbergMarquardt(iterations=25, restarts=1), Descent(iterations=4)
CONFIGS = {
    "holding": Config(solver=LM, starts=2),
    "nearest": Config(solver=LM, weights=GEOMETRY, nearest=True),
    "near": Config(solver=LM, weights=Weights(wrench=0.0, stay_near=1e-6), max_move=MaxMove(0.05, 0.5, 0.5)),
    "descent": Config(solver=DESCENT, weights=GEOMETRY, dtype="float32"),
}

Poison = Callable[[np.ndarray, np.ndarray], None]
"""Changes a pose (4, 4) and joint values (n,) in place."""


def pose(value: object, *place: object) -> Poison:
    def poison(T: np.ndarray, q: np.ndarray) -> None:
        T[place] = value

    return poison


def joints(value: float, place: object) -> Poison:
    def poison(T: np.ndarray, q: np.ndarray) -> None:
        q[place] = value

    return poison


ROTATION = (slice(0, 3), slice(0, 3))
POISONS: dict[str, tuple[Poison, Status]] = {
    "position NaN": (pose(np.nan, 0, 3), Status.NOT_FINITE),
    "position inf": (pose(np.inf, 1, 3), Status.NOT_FINITE),
    "rotation NaN": (pose(np.nan, 0, 0), Status.NOT_FINITE),
    "last row NaN": (pose(np.nan, 3, 3), Status.NOT_FINITE),
    "all NaN": (pose(np.nan, ...), Status.NOT_FINITE),
    "joint NaN": (joints(np.nan, 3), Status.NOT_FINITE),
    "joint -inf": (joints(-np.inf, 0), Status.NOT_FINITE),
    "1e6 m away": (pose(1e6, 0, 3), Status.NO_TARGET),
    "1e30 m away": (pose(1e30, 0, 3), Status.INVALID),
    "1e154 m away": (pose(-1e154, 1, 3), Status.INVALID),
    "1e308 m away": (pose(1e308, slice(0, 3), 3), Status.INVALID),
    "joint 1e30": (joints(1e30, 3), Status.INVALID),
    "joints -1e308": (joints(-1e308, slice(None)), Status.INVALID),
    "no rotation": (pose(0.0, *ROTATION), Status.INVALID),
    "reflection": (pose(np.diag([1.0, 1.0, -1.0]), *ROTATION), Status.INVALID),
    "rotation in other units": (pose(1e3 * np.eye(3), *ROTATION), Status.INVALID),
    "rotation 1e200": (pose(1e200, *ROTATION), Status.INVALID),
    "rotation 1e-200": (pose(1e-200 * np.eye(3), *ROTATION), Status.INVALID),
    "last row": (pose([1.0, 2.0, 3.0, 4.0], 3), Status.INVALID),
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The four example grasps of the embedded hand on the embedded box."""
    return boxed_example()


@pytest.fixture(scope="module")
def aimed(scene: Scene) -> Scene:
    """The same with targets where links are nearest."""
    goal = goal_of(scene, ContactSelection(), nearest=True)
    return replace(scene, target_link=goal.target_link, target_object=goal.target_object)


def poisoned(scene: Scene) -> tuple[Scene, np.ndarray, np.ndarray]:
    """The grasps with poisoned ones between them, where the four are, and where the others are."""
    count = len(POISONS)
    index = np.concatenate([[0, 1], np.resize(np.arange(4), count), [2, 3]])
    mixed = scene.select(index)
    bad = 2 + np.arange(count)
    for row, (poison, _) in zip(bad, POISONS.values(), strict=True):
        poison(mixed.T_world_root[row], mixed.q[row])
    return mixed, np.array([0, 1, 2 + count, 3 + count]), bad


def same(one: Refinement, other: Refinement, index: np.ndarray, own: np.ndarray) -> None:
    """The grasps `index` of one result are `own` of the other."""
    for name in ("status", "iterations", "queries", "starts", "touching"):
        np.testing.assert_array_equal(getattr(one, name)[index], getattr(other, name)[own], err_msg=name)
    for name in ("T_world_root", "q", "loss", "target_link", "target_object"):
        np.testing.assert_allclose(
            getattr(one, name)[index], getattr(other, name)[own], rtol=0, atol=1e-9, err_msg=name
        )


def strict(text: str) -> dict:
    def no_number(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(text, parse_constant=no_number)


# refinement


@pytest.mark.parametrize("name", CONFIGS)
def test_poisoned_poses_spoil_only_themselves(scene: Scene, name: str) -> None:
    """A hand at 1e300 m, or joint values that overflowed, once ended the refinement of all."""
    config = CONFIGS[name]
    clean = refine(scene, config)
    mixed, good, bad = poisoned(scene)
    found = refine(mixed, config)
    same(found, clean, good, np.arange(4))
    expected = {key: status.name for key, (_, status) in POISONS.items()}
    assert {key: Status(found.status[row]).name for key, row in zip(POISONS, bad, strict=True)} == expected
    # They come back as they were given, and no result is no number.
    np.testing.assert_array_equal(found.T_world_root[bad], mixed.T_world_root[bad])
    np.testing.assert_array_equal(found.q[bad], mixed.q[bad])
    assert np.isnan(found.loss[bad]).all() and not found.iterations[bad].any() and not found.touching[bad].any()


@pytest.mark.parametrize("solver", [LM, DESCENT], ids=["levenberg-marquardt", "descent"])
@pytest.mark.parametrize("side", ["target_link", "target_object"])
def test_impossible_targets_spoil_only_themselves(aimed: Scene, side: str, solver: object) -> None:
    """A target 1e6 m from its link made a matrix singular, which once ended the refinement of all."""
    config = Config(solver=solver, weights=GEOMETRY)
    values = {np.inf: Status.INVALID, 1e30: Status.INVALID, 1e300: Status.INVALID, 1e6: Status.UNREACHABLE}
    values |= {0.3: Status.UNREACHABLE, -1e3: Status.UNREACHABLE}
    mixed = aimed.select(np.concatenate([np.arange(4), np.ones(len(values) + 1, dtype=int)]))
    points = getattr(mixed, side)
    column = int(np.flatnonzero(np.isfinite(points[1, :, 0]))[0])
    for row, value in enumerate(values, 4):
        points[row, column] = value
    points[-1] = np.nan
    found = refine(mixed, config)
    same(found, refine(aimed, config), np.arange(4), np.arange(4))
    expected = [*values.values(), Status.NO_TARGET]
    assert [Status(status).name for status in found.status[4:]] == [status.name for status in expected]
    assert not np.isinf(found.loss).any() and np.isfinite(found.T_world_root[:-1]).all()


@pytest.mark.parametrize("solver", [LM, DESCENT], ids=["levenberg-marquardt", "descent"])
def test_wanted_normals_that_are_none_spoil_only_themselves(scene: Scene, solver: object) -> None:
    config = Config(solver=solver, weights=Weights(wrench=0.0, direction=1e-8))
    wanted = np.full((4, len(scene.links), 3), np.nan)
    wanted[:, 0] = [0.0, 0.0, -1.0]
    clean = replace(scene, direction=wanted)
    nonsense = ([np.inf, 0, 0], [0, 0, 0], [1e200, 0, 0], [0, 2, 0], [1, np.nan, 0])
    mixed = clean.select(np.concatenate([np.arange(4), np.ones(len(nonsense), dtype=int)]))
    mixed.direction[4:, 0] = nonsense
    found = refine(mixed, config)
    same(found, refine(clean, config), np.arange(4), np.arange(4))
    assert (found.status[4:] == Status.INVALID).all()


def test_a_batch_of_nothing_but_poison_ends_at_once(scene: Scene) -> None:
    mixed, _, bad = poisoned(scene)
    for config in (CONFIGS["holding"], CONFIGS["descent"]):
        found = refine(mixed.select(bad), config)
        assert np.isin(found.status, UNUSABLE).all() and not found.iterations.any()


def test_a_singular_matrix_is_no_step_and_no_error() -> None:
    """Not of all members, that is; LAPACK refuses the whole batch."""
    J = np.array([[[1e12, 1e12]], [[1.0, 2.0]], [[0.5, 0.0]]])
    r, damping, metric = np.ones((3, 1)), np.full(3, 1e-2), np.ones((3, 2))
    far = np.full((3, 2), np.inf)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.solve(J[:1].mT @ J[:1] + 1e-2 * np.eye(2), np.ones((1, 2, 1)))
    dx, fall = bounded_step(J, r, damping, metric, -far, far)
    np.testing.assert_array_equal(dx[0], 0.0)
    assert fall[0] == 0.0
    alone, _ = bounded_step(J[1:], r[1:], damping[1:], metric[1:], -far[1:], far[1:])
    np.testing.assert_array_equal(dx[1:], alone)
    np.testing.assert_allclose(dx[1], [-1.0 / 5.01, -2.0 / 5.01], rtol=1e-12)


# files


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `clean.npz` of four grasps, and `poisoned.npz` of these with five more that are poisoned."""
    folder = tmp_path_factory.mktemp("files")
    grasps = load_grasps(FILE)
    save_npz(folder / "clean.npz", grasps.arrays())
    mixed = grasps.select([0, 1, 0, 1, 2, 3, 0, 2, 3])
    poses, q = mixed.hand_pose.copy(), mixed.q.copy()
    poses[2, 0], poses[3, 4], q[4, 2], q[5, 0], poses[6, :3] = np.nan, np.nan, np.inf, 1e30, -1e300
    save_npz(folder / "poisoned.npz", replace(mixed, hand_pose=poses, q=q).arrays())
    return folder


GOOD, BAD = [0, 1, 7, 8], [2, 3, 4, 5, 6]
LABELS = ["not finite", "not finite", "not finite", "invalid", "invalid"]
NUMBERS = ("hand_pose", "q", "pregrasp_pose", "pregrasp_q", "squeeze_pose", "squeeze_q", "loss_m2", "quality_after")
NUMBERS += ("penetration_m_after", "contact_error_m_after", "self_penetration_m_after", "wrench_residual_after")


def check_results(clean: Path, poisoned: Path) -> None:
    """Results of both files: the same for the good grasps, a status for the others."""
    with np.load(clean) as alone, np.load(poisoned) as found:
        assert found["status"][BAD].tolist() == LABELS
        np.testing.assert_array_equal(found["status"][GOOD], alone["status"])
        for name in NUMBERS:
            np.testing.assert_allclose(found[name][GOOD], alone[name], rtol=0, atol=1e-9, err_msg=name)
        # They come back as they were.
        assert np.isnan(found["hand_pose"][2, 0]) and found["q"][5, 0] == 1e30 and found["hand_pose"][6, 1] == -1e300
        assert np.isnan(found["quality_after"][BAD]).all() and np.isnan(found["squeeze_q"][BAD]).all()


@pytest.mark.slow
def test_run_refines_the_others_of_a_file(files: Path, workplace: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """One NaN once cost a file all of its grasps, and a result file all of its pregrasps and squeezes."""
    options = "--geometry-only", "--iterations", "20", "--validate"
    for name in ("clean", "poisoned"):
        arguments = ("--grasps", files / f"{name}.npz", "--out", name, "--json", f"{name}.json", *options)
        assert main(["run", *map(str, arguments)]) == 0
    check_results(Path("clean/allegro_rounded_box.npz"), Path("poisoned/allegro_rounded_box.npz"))
    text = " ".join(capfd.readouterr().out.split())
    assert f"3 not finite (2, 3, 4): {Status.NOT_FINITE.advice}" in text
    assert f"2 invalid (5, 6): {Status.INVALID.advice}" in text
    grasps = strict(Path("poisoned.json").read_text())["grasps"]
    assert [grasps[row]["status"] for row in BAD] == LABELS
    assert all(grasps[row]["penetration_m"] == {"before": None, "after": None} for row in BAD)
    reasons = [grasp["simulation"]["after"]["reason"] for grasp in grasps]
    assert [reasons[row] for row in BAD] == ["not finite"] * 5
    assert "not finite" not in [reasons[row] for row in GOOD]
    # What came out goes in again.
    assert len(load_grasps("poisoned/allegro_rounded_box.npz")) == 9


def test_other_formats_leave_out_what_is_not_finite(
    files: Path, workplace: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """And only that: numbers that are merely wrong are the next reader's to judge."""
    assert main(["convert", str(files / "poisoned.npz"), "other", "--to", "bodex"]) == 0
    assert "3 of 9" in capfd.readouterr().err
    given, found = load_grasps(files / "poisoned.npz"), reading(Path("other"), hand=load_hand("allegro")).grasps
    np.testing.assert_allclose(found.hand_pose[:, :3], given.hand_pose[[0, 1, 5, 6, 7, 8], :3], rtol=0, atol=1e-6)
    assert np.isfinite(found.hand_pose).all() and np.isfinite(found.q).all()
