"""Histograms of measures, and the lists that a brush over them gives."""

import re
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine_apps.viewer.model.columns import Column
from grasp_refine_apps.viewer.panels.histogram import NUM_BINS, brushed_range, histogram_html


def column(values: np.ndarray) -> Column:
    return Column("depth", "Depth", "", values, "mm", 1e3)


def test_bars_count_what_is_known_and_what_is_listed():
    values = np.array([0.0, 0.0, 0.5, 1.0, np.nan])
    page = histogram_html(column(values), np.array([0, 3]), None)
    heights = {
        name: [float(h) for h in re.findall(rf'class="{name}".*?height="(.*?)"', page)]
        for name in ("gr-all", "gr-listed")
    }
    assert len(heights["gr-all"]) == 3 and len(heights["gr-listed"]) == 2
    assert heights["gr-all"][0] == pytest.approx(2 * heights["gr-all"][1])
    assert 'gr-range"' not in page and "1000.00" in page


def test_a_brush_gives_the_values_below_it_and_a_click_none():
    found = brushed_range(column(np.array([1.0, 3.0])), 0.75, 0.25)
    assert found == pytest.approx((1.5, 2.5))
    assert brushed_range(column(np.array([1.0, 3.0])), 0.5, 0.5 + 0.1 / NUM_BINS) is None
    low, high = brushed_range(column(np.array([2.0, 2.0])), 0.0, 1.0)
    assert low <= 2.0 <= high


def test_names_and_values_of_files_run_no_scripts():
    bad = replace(column(np.array([1.0, 2.0])), key="<img>", label="<script>")
    assert "<img" not in histogram_html(bad, np.arange(2), None) and "<script>" not in histogram_html(
        bad, np.arange(2), None
    )
