"""The report of a batch: complete, one file, the same for the same input, and safe whatever names say."""

from __future__ import annotations

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from batch_rows import document, failure, made_up_rows
from drawn_charts import bars, paths, tooltips
from grasp_refine.measures.measures import COMPARED, MEASURES
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.batch.chart import CHARTED, chart, statistics_row
from grasp_refine_apps.batch.page import MAX_KINDS, page
from grasp_refine_apps.batch.pictures import Picture
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.words import NONE
from grasp_refine_apps.batch.worst import Case
from refusals import assert_names

PNG = b"\x89PNG\r\n\x1a\nnot a picture"
VOID = {"meta", "img", "br", "link", "input", "hr", "line", "rect"}


class Checker(HTMLParser):
    """Notes tags that are not closed, and what is fetched or run."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.problems: list[str] = []
        self.links: list[str] = []
        self.tags: dict[str, int] = {}
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags[tag] = self.tags.get(tag, 0) + 1
        self.links += [value or "" for name, value in attributes if name in ("src", "href")]
        self.problems += [f"{tag} {name}" for name, _ in attributes if name.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.problems.append(f"</{tag}>")


def some(*parts: Any) -> Statistics:
    found = Statistics.empty()
    for rows in parts or (made_up_rows(40, object="mug"), made_up_rows(40, 1, object="cup")):
        found.add(rows)
    return found


def case(**changes: Any) -> Case:
    plain = {
        "shard": 3, "file": Path("my sets/00003.npz"), "row": 7, "hand": "allegro", "object": "mug", "scale": 1.0,
        "source": "/data/grasps.npz", "source_row": 11, "status": "stalled",
        "measures": dict.fromkeys((one.name for one in COMPARED), (np.nan, np.nan)) | {
            "quality": (0.25, 0.5), "penetration_m": (1e-3, 2.5e-4), "contact_error_m": (np.nan, 1e-2),
        }, "held": False, "reason": "rotated",
        "look": ("--object", "/my meshes/mug.obj"),
    }  # fmt: skip
    return Case(**(plain | changes))


def words_of(html: str) -> str:
    """What a person reads."""
    body = re.sub(r"<(style|title|svg)\b.*?</\1>", " ", html, flags=re.S)
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", body)).split())


def test_the_page_is_whole_and_fetches_nothing():
    html = page(document(), some(), [Picture(case(), PNG, PNG)])
    checked = Checker(html)
    assert not checked.problems and not checked.open and "script" not in checked.tags
    assert all(link.startswith("data:image/png;base64,") or link == "my%20sets/00003.npz" for link in checked.links)
    assert "url(" not in html and "@import" not in html
    assert checked.tags["svg"] == len(CHARTED) and checked.tags["img"] == 2


@pytest.mark.usefixtures("without_charts")
def test_counts_are_as_in_the_statistics():
    found = some(
        made_up_rows(
            8,
            status=np.array(["converged"] * 5 + ["no target", "stalled", "stalled"]),
            good_before=np.arange(8) < 1, good_after=np.arange(8) < 6,
            held_before=np.arange(8) < 2, held_after=np.arange(8) < 5,
            reason_after=np.array([""] * 5 + ["moved", "moved", "rotated"]),
            change=np.array(["kept"] * 6 + ["other links"] * 2), quality_before=np.linspace(0.3, 1.0, 8),
            displacement_m=0.012,
        )
    )  # fmt: skip
    html = page(document(), found, ())
    said = words_of(html)
    assert_names(said, "8 grasps", "7 of 8", "12.0 / s")
    tiles = [re.findall(r"[\d.]+", words_of(tile)) for tile in re.findall("<li.*?</li>", html, re.S) if "→" in tile]
    most, other = ["12.5", "75.0", f"{HOLDS:g}", "1", "6", "8"], ["25.0", "62.5", "2", "5", "8"]
    assert tiles == [most, other], "62 points, then 38"
    agreement = [
        re.findall(r"\d+", line.rpartition(": ")[2]) for line in re.findall("<p>.*?</p>", html) if " of 8" in line
    ]
    assert agreement == [["1", "8", "1", "7"], ["6", "8", "1", "0", "2"]], "before and after"
    assert "moved 2 25.0 % rotated 1 12.5 %" in said
    assert "change: 6 kept, 2 other links." in said and "1 input grasp of quality 0.95 or more: 1 moved" in said
    assert "converged 5 62.5 % stalled 2 25.0 %" in said
    assert f"no target 1 12.5 % {Status.NO_TARGET.advice}" in said
    assert "refine.starts 6" in said and "sets 8 2 2" in said and "refine-grasp batch sets" in said


def headline(**columns: Any) -> str:
    """Words of the first tile, of 8 grasps that all hold and change in nothing but the columns."""
    plain = dict(made_up_rows(8, held_before=1.0, good_before=1.0).columns)
    same = {name.replace("before", "after"): plain[name] for name in plain if name.endswith("_before")}
    rows = made_up_rows(8, **{**plain, **same, "reason_after": "", **columns})
    return words_of(re.findall("<li.*?</li>", page(document(), some(rows), ()), re.S)[0])


@pytest.mark.usefixtures("without_charts")
def test_the_largest_message_is_what_changed_most():
    assert headline().startswith("no change"), "although 100 % hold, before and after"
    gap = np.linspace(0.010, 0.014, 8)
    closed = {"contact_error_m_before": gap, "contact_error_m_after": gap / 1000}
    assert_names(headline(**closed), "→ 0.01 mm", "contact error", "most")
    # A change of a share of the grasps weighs by that share, and one to the worse as much as one to the better.
    assert "quality 0.95 or more" in headline(**closed, good_before=0.0), "of equal changes, the verdict"
    assert "contact error" in headline(**closed, good_before=np.arange(8) < 4)
    assert "100 → 0 %" in headline(held_after=0.0, contact_error_m_before=gap, contact_error_m_after=gap[::-1] - 1e-3)
    # Values in which nobody is interested do not count.
    assert headline(penetration_m_before=1e-6, penetration_m_after=2e-6).startswith("no change")


@pytest.mark.usefixtures("without_charts")
def test_the_page_stays_small_whatever_failed():
    failed = [failure(k, f"mesh {k}.obj has holes") for k in range(5000)]
    html = page(document(failed=failed), some(), ())
    assert len(html) < 230_000 and f"{5000 - MAX_KINDS} more" in words_of(html)


@pytest.mark.usefixtures("without_charts")
def test_names_and_messages_cannot_become_html():
    bad = "<script>alert(1)</script>"
    html = page(
        document(failed=[failure(1, bad)], jobs=[{"job": bad}], invocation=bad, config={bad: bad}),
        some(made_up_rows(3, object=bad, status=bad)),
        [Picture(case(object=bad, hand=bad, source=bad, file=Path('"><b>')), problem=bad)],
    )
    checked = Checker(html)
    assert "<script" not in html and not checked.problems and checked.links == ["%22%3E%3Cb%3E"]


# Charts


def heights(svg: str, color: str) -> list[float]:
    """Heights of the bars that are not empty."""
    return [height for height in bars(svg, color) if height]


def test_bars_are_as_high_as_shares_and_hovering_says_them():
    found = some(made_up_rows(8, quality_before=0.1, quality_after=np.repeat([0.5, 0.97], [2, 6])))
    svg = chart(MEASURES["quality"], found.distributions)
    assert heights(svg, "line") == [1.0] and heights(svg, "c0") == pytest.approx([0.25, 0.75])
    assert "0.960 to 1.00: 0.0 % before, 75.0 % after" in tooltips(svg)
    (mark,) = [path for path in paths(svg, "fill: none") if len(path) == 2 and np.ptp(path[:, 1]) > 50]
    left, right = (path[:, 0].min() for path in np.array(paths(svg, "fill: var(--c0)"))[[0, -1]])
    assert HOLDS - 0.05 < (mark[0, 0] - left) / (right - left) < HOLDS + 0.05, (
        "at the quality from which a grasp should hold"
    )


def test_the_worst_is_at_the_end_where_a_measure_is_worse():
    values = np.arange(1, 101) / 100
    found = some(made_up_rows(100, quality_after=values, penetration_m_after=values / 100, quality_before=np.nan))
    before, after = np.split(np.array(statistics_row(MEASURES["quality"], found.distributions)), 2)
    assert set(before) == {NONE} and after.astype(float) == pytest.approx([0.505, 0.5, 0.05, 0.01], abs=0.011)
    depth = statistics_row(MEASURES["penetration_m"], found.distributions)[4:]
    assert [float(text) for text in depth] == pytest.approx([5.05, 5.0, 9.5, 10.0], rel=0.06), "millimetres"
