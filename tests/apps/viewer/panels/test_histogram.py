"""Histograms of measures, and the lists that a brush over them gives."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import Column
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.panels.histogram import NUM_BINS, brushed_range, histogram_html
from open_viewer import example


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


def test_ranges_filter_the_list_together():
    collection = Collection.of(example())
    depth = replace(column(np.array([0.0, 1.0, 2.0, np.nan])), key="a")
    other = replace(column(np.array([3.0, 2.0, 1.0, 0.0])), key="b")
    collection = collection.with_columns(depth, other)
    listing = Listing().with_range("a", (0.5, 2.0))
    assert listing.numbers(collection).tolist() == [1, 2]
    both = listing.with_range("b", (1.5, 3.0))
    assert both.numbers(collection).tolist() == [1] and both.range_of("a") == (0.5, 2.0)
    assert both.with_range("a", None).numbers(collection).tolist() == [0, 1]
