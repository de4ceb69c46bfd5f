"""Page of the margins: bars and curves of the numbers that the tables have."""

import re

import numpy as np
import pytest

from grasp_refine.results.margins_table import LIMITS
from grasp_refine_apps.margins.charts import CURVE_HEIGHT, SCALE, TOP, Side, factor_bars, limit_curve
from grasp_refine_apps.margins.page import page
from made_margins import made_margins

SIDES = [Side("before", made_margins()), Side("after <b>", made_margins(better=1))]


def test_bars_are_as_long_as_the_mean_probabilities() -> None:
    drawn = factor_bars(SIDES)
    for k, side in enumerate(SIDES):
        widths = [float(width) for width in re.findall(rf'class="s{k}"[^>]* width="([\d.]+)"', drawn)]
        means = [side.margins.mean(name)[0] for name in side.margins.trials]
        assert widths == pytest.approx([SCALE * mean for mean in means], abs=0.06)
    assert "66.7 % (" in drawn and "after &lt;b&gt;" in drawn


@pytest.mark.parametrize("limit", LIMITS)
def test_curves_end_at_the_share_of_grasps_that_hold_at_all(limit) -> None:
    drawn = limit_curve(limit, SIDES[:1])
    (points,) = re.findall(r'points="([^"]+)"', drawn)
    share = [1 - (float(point.split(",")[1]) - TOP) / CURVE_HEIGHT for point in points.split()]
    # Of three grasps, one holds nowhere.
    assert sorted({round(3 * each) for each in share}) == [0, 1, 2]
    assert np.all(np.diff(share) >= 0) if limit.lower_is_better else np.all(np.diff(share) <= 0)


def test_the_page_has_charts_changes_and_names_as_text() -> None:
    text = page("claw", ["a.npz", "b.npz"], SIDES, compared=True, seed=3)
    assert text.count("<svg") == 4 and "after &lt;b&gt;" in text and "after <b>" not in text
    assert "8 drawn worlds of seed 3" in text and "+8.3" in text and "a.npz" in text
    assert "cone" not in text
    one = page("claw", ["a.npz"], SIDES[:1], compared=False, seed=3)
    assert "Changes" not in one and one == page("claw", ["a.npz"], SIDES[:1], compared=False, seed=3)
