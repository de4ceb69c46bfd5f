"""The report of the alignment benchmark: complete, self-contained, and the same for the same rows."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from running_processes import PATIENCE_S

pytest.importorskip("matplotlib", reason="charts are drawn with matplotlib")
pytest.importorskip("jinja2", reason="the page is a template of jinja2")

from grasp_refine.geometry.body import build_body  # noqa: E402
from grasp_refine.geometry.pieces import box  # noqa: E402
from grasp_refine_apps.bench.align import page as module  # noqa: E402
from grasp_refine_apps.bench.align.chart import styles, sweep_chart, time_chart  # noqa: E402
from grasp_refine_apps.bench.align.failures import Failure, WitnessPoints  # noqa: E402
from grasp_refine_apps.bench.align.labels import at_largest_budget, labels_of, swept  # noqa: E402
from grasp_refine_apps.bench.align.page import page  # noqa: E402
from grasp_refine_apps.bench.align.table import bench_table  # noqa: E402
from grasp_refine_apps.report.panels import spread  # noqa: E402


def row(method: str = "distance", kind: str = "convex", **changes: Any) -> dict[str, Any]:
    """A row with plausible numbers."""
    errors = {"targets": 200, "acc_1e6": 0.9, "acc_1e8": 0.8, "d5": 1.23e-9, "d9": 4e-5}
    return {
        "kind": kind,
        "method": method,
        "neighborhood": "adaptive" if method == "distance" else None,
        "solver": "descent",
        "transport": False,
        "margin": 0.001,
        "budget": 100,
        "budget_s": None,
        "pairs": 4,
        **errors,
        "reachable": errors | {"acc_1e6": 0.95},
        "unfiltered": errors | {"acc_1e6": 0.7},
        "pair": "all",
        "target_class": "all",
        "witness": "plain",
        "coupling": "coupled",
        "step_size": 10.0,
        "optimise": "T2",
        "dtype": "float64",
        "forward_us": 30.0,
        "backward_us": 40.0,
        "queries_mean": 80.0,
        "iterations_mean": 80.0,
        "cpu_s_per_pair": 1.5,
        "wall_s_per_pair": 1.0,
        "cpu_share": {"broadphase": 0.1, "narrowphase": 0.4, "derivative": 0.3, "solver": 0.2},
        **changes,
    }


def document(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "schema": 1,
        "command": "bench align",
        "versions": {"coal": "3.0.3"},
        "config": {"pairs": 4, "descent": {"step": 0.001, "none": None}},
        "seed": 5,
        "machine": {"cpus": 2, "cpu": "a processor"},
        "engine": "native",
        "preset": "methods",
        "invocation": "refine-grasp bench align --preset methods --seed 5",
        "wall_s": 61.2,
        "cpu_s": 300.0,
        "rows": rows,
    }


def several() -> list[dict[str, Any]]:
    """Two methods, two kinds, two budgets, with rows of a class and of a pair."""
    rows = []
    for kind in ("concave", "convex"):
        for k, method in enumerate(("analytical", "distance")):
            for budget in (10, 100):
                share, time = 0.4 + 0.2 * k + 0.002 * budget, 0.01 * budget * (k + 1)
                rows.append(row(method, kind, budget=budget, acc_1e6=share, d5=1e-4 / budget, cpu_s_per_pair=time))
            rows.append(row(method, kind, target_class="face-vertex", acc_1e6=0.1234 + 0.1 * k))
            rows.append(row(method, kind, pair="mug | bowl", acc_1e6=0.4321))
    return rows


def scene(method: str = "distance") -> Failure:
    cube = build_body("cube", [box([0.04, 0.04, 0.04])])
    T_b = np.eye(4)
    T_b[2, 3] = 0.05
    witness = WitnessPoints(np.array([0.0, 0, 0.02]), np.array([0.0, 0, 0.03]), np.array([0.0, 0, 1]), 0.01, 0)
    corner = np.full(3, 0.02)
    return Failure(method, "convex", "vertex-vertex", cube, cube, np.eye(4), T_b, corner, corner, 0.0, witness)


class Balance(HTMLParser):
    """Collects tags, and fails where one is closed that is not open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.ids += [value for name, value in attrs if name == "id" and value]
        if tag not in {"meta", "img", "br", "link"}:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def text_of(html: str) -> str:
    return re.sub(r"<[^>]*>", " ", html)


def findings(document: dict[str, Any]) -> str:
    """The words of a page before those on how it was measured, which begin with the command."""
    before, found, _ = text_of(page(document, [])).partition(document["invocation"])
    assert found
    return before


def test_the_same_input_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "picture", lambda failure: b"png")
    first, again = (page(document(several()), [scene()]) for _ in range(2))
    assert first == again


def test_the_page_is_one_file_with_balanced_tags():
    html = page(document(several()), [scene()])
    balance = Balance(html)
    assert not balance.open
    assert len(balance.ids) == len(set(balance.ids))
    assert not {"script", "link", "iframe"} & set(balance.tags)
    assert "http" not in re.sub(r' xmlns(:\w+)?="[^"]*"', "", html)
    assert "@import" not in html and not re.search(r"url\((?!#)", html)
    assert html.count("data:image/png;base64,") == 1
    assert "10.0 mm" in html


def test_every_pooled_row_class_and_pair_is_there():
    rows = several()
    html = page(document(rows), [])
    words = text_of(html)
    for chosen in rows:
        value = chosen["acc_1e6"]
        assert f"{100 * value:.2f} %" in words, chosen
    assert words.count("10 iterations") >= 4
    for part in ("face-vertex", "mug | bowl", "Concave", "Convex", "a processor", "3.0.3"):
        assert part in words
    assert "descent.step" in words and "--preset methods --seed 5" in words
    assert "<figure" not in html


def test_best_numbers_are_bold_and_misses_are_not_rounded_away():
    rows = [row(), row("analytical", acc_1e6=0.99999, acc_1e8=0.8, d5=1e-12)]
    html = page(document(rows), [])
    assert "<b>99.99 %</b>" in html and "100.00 %" not in html
    assert "<b>1.0e-12</b>" in html and "<b>1.2e-9</b>" not in html
    # A column in which all are alike has no best.
    assert "<b>80.00 %</b>" not in html


def test_without_a_preset_nothing_is_said_of_one():
    invocation = "refine-grasp bench align --pairs 3"
    words = text_of(page(document(several()) | {"preset": None, "invocation": invocation}, []))
    before, found, _ = words.partition(invocation)
    assert found and "None" not in words and "reset" not in before


def test_a_tie_has_no_winner():
    tied = [row("distance", acc_1e6=0.5), row("rigid", acc_1e6=0.5)]
    assert "distance (50.00 %)" not in text_of(page(document(tied), []))
    words = text_of(page(document([tied[0], row("rigid", acc_1e6=0.4)]), []))
    assert 0 < words.find("distance (50.00 %)") < words.find("rigid (40.00 %)")


@pytest.mark.parametrize("failures", [0, 1])
def test_one_row_suffices(failures: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "picture", lambda failure: b"png")
    html = page(document([row()]), [scene()] * failures)
    assert "90.00 %" in html and "<b>9" not in html
    assert html.count('class="chart"') == 1


def test_nothing_but_nulls_is_shown_as_such():
    keep = ("kind", "method", "pair", "target_class")
    empty = {key: value if key in keep else None for key, value in row().items()}
    nothing = document([empty, row("analytical"), {**empty, "kind": "concave", "cpu_share": {"solver": None}}])
    nothing |= dict.fromkeys(("seed", "wall_s", "cpu_s", "machine", "versions", "config"))
    html = page(nothing, [])
    assert "–" in html and "nan" not in text_of(html)
    assert "None" not in text_of(html)
    assert "<svg" in page(document([row()]), [])
    assert "<svg" not in page(document([empty]), [])
    assert "<svg" not in page(document([]), [])


def test_names_are_escaped(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "picture", lambda failure: b"png")
    evil = "<b>&\"'$x_"
    rows = [row(evil), row(evil, pair=evil), row(evil, target_class=evil), row("analytical", kind="concave")]
    html = page(document(rows) | {"preset": evil, "machine": {evil: evil}}, [scene(evil)])
    assert "<b>&" not in html and "&lt;b&gt;" in html
    assert not Balance(html).open


def test_labels_say_only_what_differs():
    rows = [row(), row(transport=True), row("analytical"), row("analytical", budget=7)]
    assert labels_of(rows) == ["distance", "distance + EG", "analytical", "analytical"]
    rows = [row(margin=0.0), row(margin=0.0005, neighborhood="fixed")]
    assert labels_of(rows) == ["distance + adaptive + margin 0 mm", "distance + fixed + margin 0.5 mm"]
    assert labels_of(rows, without=["margin"]) == ["distance + adaptive", "distance + fixed"]
    assert len(set(labels_of([row(optimise="T1T2"), row()]))) == 2
    assert labels_of([]) == []


def least_squares(**changes: Any) -> dict[str, Any]:
    """A row of Levenberg-Marquardt."""
    nothing = {"neighborhood": None, "coupling": None, "step_size": None}
    return row("contact-kinematics", solver="levenberg-marquardt", **nothing, **changes)


def patched(epsilon: float = 1e-5, **changes: Any) -> dict[str, Any]:
    """What the patch says of a row."""
    patch = {"epsilon": epsilon, "targets": 200, "acc_1e6": 0.9871, "acc_1e8": 0.8, "d5": 1e-12, "d9": 3e-7}
    return {"epsilon": epsilon, "patch": patch, **changes}


def test_another_solver_has_its_own_name_and_colour():
    rows = [row("contact-kinematics"), least_squares(budget=10, cpu_s_per_pair=0.1), least_squares()]
    assert labels_of(rows) == ["contact-kinematics", "levenberg-marquardt", "levenberg-marquardt"]
    found = styles(rows, labels_of(rows))
    assert found["contact-kinematics"].color != found["levenberg-marquardt"].color
    svg = time_chart(rows).svg
    assert ">levenberg-marquardt<" in svg and "var(--c7)" in svg
    words = text_of(page(document(rows), []))
    assert "Levenberg-Marquardt" in words and "gradient descent" in words
    alone = text_of(page(document(rows[1:]), []))
    assert "gradient descent" not in alone and "Levenberg-Marquardt" in alone
    assert "Levenberg-Marquardt" not in findings(document(rows[:1]))


def test_a_patch_is_told_with_its_epsilon_wherever_it_appears():
    rows = [row(**patched()), row(**patched(witness="patch"))]
    assert labels_of(rows) == ["distance", "distance + patch 10 µm"]
    html = page(document(rows), [])
    words = text_of(html)
    assert "epsilon" in words and "10 µm" in words and "98.71 %" in words and "patch 1e-6" in words
    assert "patch" not in findings(document([row(), row("rigid")]))
    # Alone, too.
    assert labels_of([row(**patched(2e-6, witness="patch"))]) == ["distance + patch 2 µm"]


def test_the_table_shows_both_metrics():
    def printed(rows: list[dict[str, Any]]) -> str:
        console = Console(width=120, record=True, file=io.StringIO())
        console.print(bench_table(rows, "title"))
        return console.export_text()

    last = {"last": {"acc_1e6": 0.5}}
    both = printed([row(**last, **patched()), least_squares(**last, **patched(witness="patch"))])
    assert "epsilon 10 µm" in both and both.count("98.7") == 2 and "70.0" not in both
    assert "levenberg-marquardt + patch 10 µm" in both
    plain = printed([row(**last, patch=None)])
    assert "patch" not in plain and "70.0" in plain


def test_methods_keep_their_colours_and_variants_get_their_own():
    rows = [row(), row(transport=True), row("analytical"), row("rigid")]
    found = styles(rows, labels_of(rows))
    assert len({style.color for style in found.values()}) == 4
    alone = styles([row("rigid")], ["rigid"])
    assert alone["rigid"].color == found["rigid"].color
    many = [row(margin=0.001 * k) for k in range(20)]
    looks = styles(many, labels_of(many)).values()
    assert len({(style.color, style.marker, style.dashes) for style in looks}) == 20


def test_the_largest_budget_of_each_variant_counts():
    rows = [row(budget=100), row(budget=20), row("rigid", budget=20, kind="concave"), row("rigid", budget=50)]
    assert [r["budget"] for r in at_largest_budget(rows, labels_of(rows))] == [100, 20, 50]
    seconds = [row(budget=None, budget_s=2.0), row(budget=None, budget_s=5.0)]
    assert at_largest_budget(seconds, labels_of(seconds)) == seconds[1:]


def test_no_misses_are_drawn_at_half_a_target():
    perfect = time_chart([row(acc_1e6=1.0), row(acc_1e6=0.5, budget=10, cpu_s_per_pair=0.1)])
    assert "hollow" in perfect.note and "var(--page)" in perfect.svg
    heights = {}
    for share in (1.0, 0.9975, 0.995):
        svg = time_chart([row(acc_1e6=share), row(acc_1e6=0.5, budget=10, cpu_s_per_pair=0.1)]).svg
        heights[share] = svg.replace("var(--page)", "var(--c0)")
    # With 200 targets, none missed lies where half a target would, and not where one does.
    assert heights[1.0] == heights[0.9975] != heights[0.995]
    assert not time_chart([row()]).note


def test_several_margins_get_a_chart_of_their_own():
    rows = [row(method, margin=margin) for method in ("distance", "rigid") for margin in (0.0, 0.0005, 0.002)]
    assert swept(rows) == ["margin"]
    assert swept([row(), row("rigid", margin=0.1)]) == []
    svg = sweep_chart(rows, "margin")
    assert all(f">{label}<" in svg for label in ("0 mm", "0.5 mm", "2 mm", "distance", "rigid"))
    assert svg in page(document(rows), [])


def test_many_swept_lines_are_cut_to_the_best_value():
    rows = [row(step_size=float(k), acc_1e6=0.5 + 0.01 * k) for k in range(1, 20)]
    chart = time_chart(rows)
    assert "step size" in chart.note
    assert ">distance<" in chart.svg and "step 3" not in chart.svg


@pytest.mark.parametrize("count", [1, 2, 7, 30])
def test_labels_are_spread_in_order(count: int):
    heights = np.random.default_rng(count).uniform(0.4, 0.45, count)
    placed = spread(heights, 0.05)
    assert (np.argsort(placed) == np.argsort(heights)).all()
    if count < 20:
        assert (np.diff(np.sort(placed)) >= 0.05 - 1e-3).all()
        assert placed.min() >= 0 and placed.max() <= 1


def test_importing_the_page_loads_no_plotting():
    root = Path(__file__).resolve().parents[4]
    code = (
        "import sys, grasp_refine_apps.bench.align.page; assert not {'matplotlib', 'jinja2', 'PIL'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root / "apps", timeout=PATIENCE_S)
