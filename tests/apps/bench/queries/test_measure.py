"""Rows of small cases: counts are exact and again the same, times are positive, what is warm is told."""

from __future__ import annotations

from typing import Any

import pytest

from grasp_refine.collision.engine import engines
from grasp_refine_apps.bench.queries.cases import Case
from grasp_refine_apps.bench.queries.measure import MIN_POSES, Measurement

CASES = (Case(batch=8), Case("mixed", 4, batch=40), Case("concave", 4, state="deep", batch=40))


def measured(case: Case, **changed: Any) -> list[dict[str, Any]]:
    settings = {"engines": engines(), "methods": ("contact-kinematics",), "peers": ("coal-reused",)} | changed
    return Measurement(rounds=2, least_s=0.0, seed=2, **settings).rows(case)


@pytest.fixture(scope="module", params=CASES, ids=lambda case: case.kind)
def found(request: pytest.FixtureRequest) -> list[dict[str, Any]]:
    return measured(request.param)


def test_what_was_asked_and_what_was_pruned_are_all_piece_pairs(found: list[dict[str, Any]]):
    case = next(case for case in CASES if case.kind == found[0]["kind"])
    for row in found:
        assert row["poses"] == max(case.batch, MIN_POSES) and row["piece_pairs"] == row["poses"] * case.piece_pairs
        assert row["queries_asked"] + row["pruned"] == row["piece_pairs"]
        if row["peer"]:
            assert row["pruned"] == 0
        else:
            # At least one query a pose, and never more than there are; of convex bodies, exactly one.
            assert row["poses"] <= row["queries_asked"] <= row["piece_pairs"]
            assert case.kind != "convex" or row["queries_asked"] == row["poses"]
            assert case.kind == "convex" or row["pruned"] > 0.5 * row["piece_pairs"]


def test_times_are_positive_and_finite(found: list[dict[str, Any]]):
    for row in found:
        assert 0 < row["forward_us"] < 1e6 and 0 < row["forward_ratio"] < 1e4
    first, *others = found
    assert (first["by"], first["warm"], first["forward_ratio"]) == (engines()[0], False, 1.0)
    assert first["backward_contact_kinematics_us"] > 0 and first["layer_us"] > 0
    # The derivative is the same, whatever answers.
    assert all(row["backward_contact_kinematics_us"] is None and row["layer_us"] is None for row in others[:1])


def test_answers_agree_and_only_what_was_apart_is_warm(found: list[dict[str, Any]]):
    for row in found:
        assert row["distance_error_m"] is None or row["distance_error_m"] < 1e-9
        apart = row["poses"] if row["state"] == "near" else 0
        assert row["queries_warm"] == (apart if row["warm"] else 0)
    assert {(row["by"], row["warm"]) for row in found} >= {("python", False), ("python", True), ("coal-reused", False)}
