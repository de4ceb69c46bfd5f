"""Rows: numbers that can be counted by hand, and what is shown of them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.json_files import dumps
from grasp_refine.measures.measures import COMPARED
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine_apps.bench.success.measure import Measured, Method
from grasp_refine_apps.bench.success.rows import ALL, ENGINES, FAILURE, auc, rows
from grasp_refine_apps.bench.success.study import SuccessStudy
from grasp_refine_apps.bench.success.trials import HELD, Trial

TRIALS = (Trial(PROTOCOLS["dexgraspbench"]), Trial(PROTOCOLS["strict"]))
NAN = np.nan
GIVEN, OWN_STAGES, GEOMETRY_ONLY = Method("as-given"), Method("own-stages"), Method("geometry-only", 1)
H, M, T = HELD, "moved", "rotated"


def part(
    method: Method,
    name: str,
    easy: list[str],
    hard: list[str],
    cpu_s: float = NAN,
    hand: str = "claw",
    drake: list[str] | None = None,
) -> Measured:
    n = len(easy)
    ramp = np.arange(n, dtype=float)
    values = {
        "penetration_m": 1e-3 * ramp, "self_penetration_m": 1e-4 * ramp, "contact_error_m": 1e-5 * ramp,
        "wrench_residual": 1e-2 * ramp, "quality": 0.5 + 0.01 * ramp, "cpu_s": cpu_s * (1.0 + ramp),
        "wall_s": 2 * cpu_s * (1.0 + ramp), "starts": np.full(n, NAN if method.starts is None else method.starts),
    }  # fmt: skip
    values = {each.name: np.full(n, NAN) for each in COMPARED} | values
    moved = {"moved_palm_m": 0.01, "moved_palm_rad": 0.1, "moved_joints_rad": 0.2, "contacts_moved_m": 5e-3}
    moved |= {"displacement_m": 1e-3 * (1.0 + ramp), "links_kept": 1.0 - 0.25 * ramp}
    values |= {name: np.full(n, NAN if method.starts is None else value) for name, value in moved.items()}
    labels = {"hand": hand, "source": "sampled", "object": name, "shape": "convex", "size": "not known", "scale": "1"}
    verdict = {"dexgraspbench": np.array(easy), "strict": np.array(hard)}
    verdict |= {} if drake is None else {"dexgraspbench in Drake": np.array(drake)}
    return Measured(method, name, {key: np.repeat(value, n) for key, value in labels.items()}, values, verdict)


@pytest.fixture
def parts() -> list[list[Measured]]:
    """Four grasps on a cup and one on a can, by four methods; of the cup three hold at first."""
    found = []
    for name, came, after, twice in (("cup", [H, H, H, M], [H, T, H, H], [H, H, H, H]), ("can", [M], [M], [H])):
        bad = [M] * len(came)
        found.append(
            [
                part(GIVEN, name, came, bad),
                part(OWN_STAGES, name, came, bad),
                part(GEOMETRY_ONLY, name, after, bad, 0.01),
                part(Method("closest", 6), name, twice, after, 0.1),
            ]
        )
    return found


def test_what_holds_is_counted_pooled_and_by_object(parts: list[list[Measured]]):
    found = [row for row in rows(parts, TRIALS) if row["by"] != FAILURE]
    assert [(row["by"], row["label"]) for row in found[::4]] == [(ALL, ALL), ("object", "can"), ("object", "cup")]
    given, own, geometry, closest = found[:4]
    assert [row["success_dexgraspbench"] for row in (given, own, geometry, closest)] == [0.6, 0.6, 0.6, 1.0]
    assert [row["success_strict"] for row in (given, geometry, closest)] == [0.0, 0.0, 0.6]
    # Of the three that held, the second one is lost.
    assert [row["lost_dexgraspbench"] for row in (given, geometry, closest)] == [0.0, 1 / 3, 0.0]
    assert (geometry["num_lost_dexgraspbench"], geometry["held_dexgraspbench"]) == (1, 3)
    assert closest["lost_strict"] is None, "none held before"
    assert geometry["reasons_dexgraspbench"] == {"moved": 1, "rotated": 1} and closest["reasons_dexgraspbench"] == {}
    can = next(row for row in found if row["label"] == "can" and row["method"] == "geometry-only")
    assert (can["grasps"], can["success_dexgraspbench"], can["lost_dexgraspbench"]) == (1, 0.0, None)


def test_costs_and_measures_are_pooled(parts: list[list[Measured]]):
    given, own, geometry, closest = rows(parts, TRIALS)[:4]
    assert (given["method"], given["starts"], closest["method"], closest["starts"]) == ("as-given", None, "closest", 6)
    for name in ("cpu_mean_s", "wall_median_s", "moved_palm_median_m", "displacement_q90_m", "starts_mean"):
        assert given[name] is None and own[name] is None
    # 10, 20, 30, 40 and 10 ms.
    assert (geometry["cpu_mean_s"], geometry["cpu_median_s"]) == pytest.approx((0.022, 0.02))
    assert geometry["wall_mean_s"] == pytest.approx(0.044) and closest["starts_mean"] == 6.0
    assert geometry["moved_palm_median_m"] == 0.01 and geometry["moved_joints_median_rad"] == 0.2
    # 1, 2, 3, 4 and 1 mm; 1, 3/4, 1/2, 1/4 and 1.
    assert (geometry["displacement_median_m"], geometry["displacement_q90_m"]) == pytest.approx((2e-3, 4e-3))
    assert geometry["links_kept_mean"] == pytest.approx(0.7) and geometry["contacts_moved_median_m"] == 5e-3
    # 0, 1, 2, 3 and 0 mm.
    assert given["penetration_mean_m"] == pytest.approx(1.2e-3) and given["penetration_q95_m"] == 3e-3
    assert given["self_penetration_max_m"] == pytest.approx(3e-4)
    assert given["contact_error_median_m"] == pytest.approx(1e-5)
    assert (given["wrench_residual_median"], given["wrench_residual_q75"]) == pytest.approx((0.01, 0.02))
    assert given["quality_median"] == pytest.approx(0.51)


def test_what_cannot_be_measured_counts_as_the_worst():
    bad = part(GIVEN, "cup", [H, H], [H, H])
    bad.values["penetration_m"][:] = bad.values["wrench_residual"][:] = NAN
    (row,) = rows([[bad]], TRIALS)
    assert row["penetration_mean_m"] == row["wrench_residual_median"] == np.inf
    assert json.loads(dumps(row))["penetration_mean_m"] is None


def test_the_front_is_of_all_inputs_and_of_those_good_enough_already():
    """Of eleven inputs six held with a quality of 0.95; one more held with less, one has the quality alone."""
    came = part(GIVEN, "cup", [H] * 7 + [M] * 4, [M] * 11)
    came.values["quality"][:] = [0.95, 0.96, 0.97, 0.98, 0.99, 1.0, 0.94, 0.99, 0.1, 0.1, NAN]
    after = part(Method("closest", 6), "cup", [M, M] + [H] * 9, [H] * 11, 0.1)
    after.values["quality"][:] = 1.0
    mm = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 20.0, 6.0, 30.0, 40.0, 50.0, NAN])
    moved = {"displacement_m": 1e-3 * mm, "moved_palm_m": 2e-3 * mm, "contacts_moved_m": 3e-3 * mm}
    moved["links_kept"] = np.array([1.0] * 5 + [0.4] + [0.5] * 4 + [NAN])
    came = replace(came, values={**came.values, **{name: np.full(11, NAN) for name in moved}})
    done = [[came, replace(after, values={**after.values, **moved})]]
    given, closest = (row for row in rows(done, TRIALS) if row["by"] == ALL)
    assert given["displacement_median_m"] is None and given["good"] == closest["good"] == 6
    # Sorted, 1, 2, 3, 4, 5, 6, 20, 30, 40 and 50 mm; of good inputs 1, 2, 3, 4, 5 and 20 mm.
    wanted = {
        "displacement_median_m": 5.5e-3, "displacement_q90_m": 0.05, "contacts_moved_median_m": 16.5e-3,
        "moved_palm_median_m": 0.011, "moved_palm_q90_m": 0.1, "links_kept_mean": 0.74,
        "good_displacement_median_m": 3.5e-3, "good_displacement_q90_m": 0.02, "good_moved_palm_median_m": 7e-3,
        "good_moved_palm_q90_m": 0.04, "good_links_kept_mean": 0.9,
    }  # fmt: skip
    assert {key: closest[key] for key in wanted} == pytest.approx(wanted)
    assert (closest["num_lost_dexgraspbench"], closest["success_dexgraspbench"]) == (2, pytest.approx(9 / 11))
    text = SuccessStudy().report(rows(done, TRIALS), ()).markdown(ABOUT)
    assert "Front, all: 11 grasps, 6 good enough already" in text
    assert "| closest, 6 starts | 81.8 | 2 | 100.0 | 0 | 5.5 | 50.0 | 11.0 | 100.0 | 3.5 | 20.0 | 7.0 | 40.0 |" in text


def test_engines_agree_on_grasps_tried_in_both():
    """One grasp of three holds in MuJoCo alone as given."""
    in_drake = Trial(PROTOCOLS["dexgraspbench"], "drake")
    done = [
        [
            part(GIVEN, "cup", [H, M, M], [M] * 3, drake=[M, M, M]),
            part(GEOMETRY_ONLY, "cup", [H, H, M], [M] * 3, 0.1, drake=[H, H, M]),
        ]
    ]
    given, geometry = (row for row in rows(done, (*TRIALS, in_drake)) if row["by"] == ENGINES)
    assert (given["grasps"], given["first_only"], given["second_only"]) == (3, 1, 0)
    assert (given["share"], given["kappa"]) == pytest.approx((2 / 3, 0.0)) and geometry["kappa"] == 1.0
    tables = SuccessStudy(trials=(*TRIALS, in_drake)).report(rows(done, (*TRIALS, in_drake)), ()).markdown(ABOUT)
    assert "| dexgraspbench, MuJoCo and Drake | 3 | 66.7 → 100.0 | 0.00 → 1.00 | 1 → 0 | 0 → 0 |" in tables
    assert "| moved | 2 → 1 | 3 → 3 | 3 → 1 |" in tables, "why they do not hold"


ABOUT = {
    "cpu_s": 60.0, "invocation": "this command", "versions": {"grasp-refine": "1"},
    "machine": {"cpus": 2, "cpu": "fast"},
}  # fmt: skip


def test_auc_is_that_of_all_pairs():
    random = np.random.default_rng(0)
    score, success = random.integers(0, 9, 60) / 9.0, random.random(60) < 0.4
    pairs = np.subtract.outer(score[success], score[~success])
    assert auc(score, success) == pytest.approx(((pairs > 0) + 0.5 * (pairs == 0)).mean())
