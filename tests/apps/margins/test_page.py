"""Page of the margins: bars and curves of the numbers that the tables have."""

import numpy as np
import pytest

from drawn_charts import bars, paths
from grasp_refine.results.margins_table import LIMITS
from grasp_refine_apps.margins.charts import Side, color_names, factor_bars, limit_curve
from grasp_refine_apps.margins.page import page
from made_results import made_margins

SIDES = [Side("before", made_margins()), Side("after <b>", made_margins(better=1))]


def test_bars_are_as_long_as_the_mean_probabilities() -> None:
    drawn = factor_bars(SIDES)
    for side, color in zip(SIDES, color_names(2), strict=True):
        means = [side.margins.mean(name)[0] for name in side.margins.trials]
        assert bars(drawn, color, along=0)[: len(means)] == pytest.approx(means, abs=1e-3), "one of them is 1"
    assert "66.7 % (" in drawn and "after &lt;b&gt;" in drawn


@pytest.mark.parametrize("limit", LIMITS)
def test_curves_end_at_the_share_of_grasps_that_hold_at_all(limit) -> None:
    (line,) = paths(limit_curve(limit, SIDES[:1]), "fill: none; stroke: var(--c0)")
    (base,) = {path[0, 1] for path in paths(limit_curve(limit, SIDES[:1]), "fill: none; stroke: var(--line)")[:1]}
    heights = base - line[:, 1]
    # Of three grasps, one holds nowhere.
    assert sorted({round(each / np.ptp(heights) * 2) for each in heights}) == [0, 1, 2]
    assert np.all(np.diff(heights) >= 0) if limit.lower_is_better else np.all(np.diff(heights) <= 0)


def test_the_page_has_charts_changes_and_names_as_text() -> None:
    text = page(["a.npz", "b.npz"], SIDES, compared=True, seed=3)
    assert text.count("<svg") == 4 and "after &lt;b&gt;" in text and "after <b>" not in text
    assert "8 drawn worlds of seed 3" in text and "+8.3" in text and "a.npz" in text
    assert "cone" not in text
    one = page(["a.npz"], SIDES[:1], compared=False, seed=3)
    assert "Changes" not in one
