"""The stopwatch of alignment: its parts sum to the time of a run, and what is measured answers as if it were not."""

from __future__ import annotations

import pytest

from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.descent import align
from grasp_refine_apps.bench.align.levenberg_marquardt import run_levenberg_marquardt
from grasp_refine_apps.bench.align.stopwatch import PARTS
from grasp_refine_apps.bench.align.tasks import draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from grasp_refine_apps.bench.timing import cpu_share
from shapes_for_tests import convex_body


@pytest.mark.parametrize("solver", ["descent", "levenberg-marquardt"])
def test_the_stages_of_a_run_sum_to_its_time(solver: str):
    pair = BodyPair("hulls", "convex", convex_body(1, 30), convex_body(2, 30))
    tasks = draw_tasks(pair, ["vertex-vertex"], 4, 0)
    if solver == "descent":
        result = align([pair], [tasks], Variant(budget=30))
    else:
        result = run_levenberg_marquardt([pair], [tasks], Variant.least_squares(budget=30))
    spent = cpu_share([result.watch], PARTS)
    assert set(spent) == set(PARTS) and min(spent.values()) > 0.0
    assert sum(spent.values()) == pytest.approx(1.0)
    assert result.watch.cpu_s == pytest.approx(result.cpu_s, rel=0.02)
    assert not result.watch.running
