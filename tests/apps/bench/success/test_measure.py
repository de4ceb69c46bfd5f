"""Measurement of a case: every method on the same grasps of a gripper around a ball, and what is kept of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine_apps.bench.success import measure
from grasp_refine_apps.bench.success.cases import Case
from grasp_refine_apps.bench.success.measure import Measured, Measurement, methods_of
from grasp_refine_apps.bench.success.trials import HELD, Trial
from plate_gripper import URDF

RADIUS, OPEN = 0.03, 0.085
"""Of the ball, and between the middle of the gripper and a plate when it is open, metres."""

ALL = methods_of(("as-given", "own-stages", "geometry-only", "closest", "strongest"), (1,))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A grasp that nearly touches, and one that is open all the way; as given, they never close."""
    folder: Path = tmp_path_factory.mktemp("gripper")
    (folder / "gripper.urdf").write_text(URDF.replace('effort="1"', 'effort="50"'))
    pose = np.tile([0.0, 0.0, -0.05, 1.0, 0.0, 0.0, 0.0], (2, 1))
    q = np.array([[OPEN - RADIUS - 0.002, -OPEN + RADIUS + 0.002], [0.01, -0.01]])
    stages = {f"{name}_pose": pose for name in ("pregrasp", "squeeze")}
    stages |= {f"{name}_q": np.zeros((2, 2)) for name in ("pregrasp", "squeeze")}
    np.savez(
        folder / "mine.npz", hand="gripper", base_link="palm", joint_names=["l", "r"], object=f"sphere:{RADIUS}",
        scale=np.ones(2), hand_pose=pose, q=q, **stages,
    )  # fmt: skip
    return Case(ProblemSpec(hand=str(folder / "gripper.urdf"), grasps=folder / "mine.npz"), source="mine")


@pytest.fixture(scope="module")
def results(case: Case) -> list[Measured]:
    shares: list[float] = []
    found = Measurement(ALL, (Trial(DEXGRASPBENCH),), width=4, threads=1).run(case, shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    labels = ["as given", "own stages", "geometry only", "closest, 1 start", "strongest, 1 start"]
    assert [one.method.label for one in found] == labels
    return found


def test_stages_of_the_file_are_simulated_as_given(results: list[Measured]):
    given, own = results[:2]
    assert (given.verdict["dexgraspbench"] != HELD).all()
    assert own.verdict["dexgraspbench"][0] == HELD


def test_only_refinement_costs_and_moves(results: list[Measured]):
    for one in results[:2]:
        for name in ("cpu_s", "wall_s", "starts", "moved_palm_m", "displacement_m"):
            assert np.isnan(one.values[name]).all()
        assert one.values["contact_error_m"][0] == pytest.approx(0.002, abs=1e-6)
    for one in results[2:]:
        assert all((one.values[name] > 0).all() for name in ("cpu_s", "wall_s", "starts"))
        assert one.values["contact_error_m"][0] < 1e-4
        assert 0.001 < one.values["displacement_m"][0] and one.values["links_kept"][0] == 1.0
        assert one.verdict["dexgraspbench"][0] == HELD
        assert one.labels["hand"].tolist() == ["gripper"] * 2 and one.labels["source"].tolist() == ["mine"] * 2


def test_methods_refine_with_their_own_preference_or_without_forces():
    given, _, geometry, *preferred = (method.config(seed=0, width=4) for method in ALL)
    assert given is None and geometry is not None and not geometry.holds
    assert [(one.prefer, one.holds) for one in preferred if one] == [("closest", True), ("strongest", True)]


def test_a_second_run_does_only_what_is_missing(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def numbers(found: list[Measured]) -> list[list[list[float]]]:
        return [[np.nan_to_num(one.values[name], nan=-1.0).tolist() for name in sorted(one.values)] for one in found]

    first = Measurement(ALL[2:], (Trial(DEXGRASPBENCH),), width=4, threads=1, out=tmp_path)
    before = first.run(case, lambda share: None)
    assert len(list(tmp_path.rglob("*.npz"))) == 4, "three refinements, and what was measured"
    refine, refined = measure.refine_group, []

    def counted(*given: object, **more: object) -> object:
        refined.append(1)
        return refine(*given, **more)  # type: ignore[arg-type]  # passes on

    monkeypatch.setattr(measure, "refine_group", counted)
    loaded = []
    monkeypatch.setattr(measure, "load_case", lambda *given, **more: loaded.append(1) or load(*given, **more))
    again = first.run(case, lambda share: None)
    assert numbers(again) == numbers(before) and not loaded
    more = replace(first, trials=(*first.trials, Trial(PROTOCOLS["strict"]))).run(case, lambda share: None)
    assert loaded and not refined, "another protocol needs no refinement"
    assert set(more[0].verdict) == {"dexgraspbench", "strict"} and numbers(more) == numbers(before)
    replace(first, seed=1).run(case, lambda share: None)
    assert refined, "results of other settings are computed again"


load = measure.load_case
