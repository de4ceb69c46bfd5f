"""Rows of `bench scans`: shares, intervals, what is promised and what holds."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.margins.intervals import wilson
from grasp_refine_apps.bench.scans.measure import Case, Measured
from grasp_refine_apps.bench.scans.study import BIN, OBJECT, VIEWS, ScanStudy, calibration_error
from grasp_refine_apps.bench.scans.ways import Way
from grasp_refine_apps.bench.success.assets import HandCase, ObjectCase


def measured(way: Way, name: str, quality: list[float], held: list[bool], views: int = 1) -> Measured:
    case = Case(HandCase("allegro", "allegro", "allegro"), ObjectCase(name, name, 1.0))
    return Measured(way, np.array(quality), np.array(held), case=case, views=views, points=100 * views)


def test_shares_are_by_views_and_way_and_answers_are_the_confident_ones():
    yes, no = True, False
    done = [
        [measured("reconstruction", "mug", [1.0, 1.0], [yes, no])],
        [measured("hypotheses", "mug", [0.96, 0.5], [yes, yes])],
        [measured("reconstruction", "can", [1.0, 1.0], [no, no])],
        [measured("hypotheses", "can", [0.97, 0.2], [no, no])],
        [measured("mesh", "can", [1.0, 1.0, 1.0, 1.0], [yes] * 4), measured("mesh", "can", [1.0], [no], views=2)],
    ]
    rows = ScanStudy().rows(done)
    found = {(row["views"], row["way"]): row for row in rows if row["by"] == VIEWS}
    assert found[1, "reconstruction"]["held"] == 0.25
    one = found[1, "hypotheses"]
    assert (one["held"], one["answered"], one["answered_held"]) == (0.5, 0.5, 0.5)
    assert (one["held_lower"], one["held_upper"]) == pytest.approx([float(end) for end in wilson(np.array(2), 4)])
    assert one["way_to_mesh"] == pytest.approx((0.5 - 0.25) / (1.0 - 0.25))
    assert found[2, "mesh"]["way_to_mesh"] is None
    by_object = {(row["label"], row["way"]): row["held"] for row in rows if row["by"] == OBJECT}
    assert by_object["can", "mesh"] == 0.8
    assert by_object["mug", "hypotheses"] == 1.0


def test_promises_of_hypotheses_are_compared_with_truth_in_bins():
    done = [[measured("hypotheses", "mug", [0.05, 0.95, 0.99, np.nan], [False, True, False, True])]]
    bins = [row for row in ScanStudy().rows(done) if row["by"] == BIN]
    assert [(row["grasps"], row["held"]) for row in bins] == [(2, 0.5), (2, 0.5)]
    assert [row["promised"] for row in bins] == pytest.approx([0.025, 0.97])
    assert calibration_error(bins) == pytest.approx((0.475 + 0.47) / 2)


def test_names_that_do_not_exist_are_refused(tmp_path):
    with pytest.raises(GraspRefineError, match="hands"):
        ScanStudy(assets=tmp_path).jobs(lambda line: None)
