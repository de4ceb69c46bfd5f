"""The report: heat maps with a square for each body and state, in one file."""

from __future__ import annotations

import re
from typing import Any

import pytest

from grasp_refine_apps.bench.stability.rows import Cell
from stability_cells import derivative, forward

pytest.importorskip("jinja2", reason="the report needs it")

from grasp_refine_apps.bench.stability.page import page  # noqa: E402


def document(*cells: Cell, **changed: Any) -> dict[str, Any]:
    """What the benchmark writes as JSON."""
    return {
        "invocation": "refine-grasp bench stability",
        "versions": {"grasp-refine": "1"},
        "machine": {"cpus": 2, "cpu": "x", "system": "y"},
        "engine": "python",
        "preset": "quick",
        "seed": 0,
        "cpu_s": 1.0,
        "problems": [],
        "rows": [cell.row() for cell in cells],
        **changed,
    }


def squares(text: str) -> list[str]:
    """How the squares of all heat maps look."""
    return re.findall(r'<td class="(right|wrong|refused|none)"', text)


def test_a_run_without_faults_says_so():
    made = document(forward(), forward(state="deep", error_max=1e-2), derivative())
    text = page(made)
    assert text == page(made), "the same input gives the same text"
    assert not re.search(r"""(?:src|href)=["']""", text) and text.count("<h1") == 1
    # Distances by body, and by way of asking, have two states each; derivatives have one by each of three.
    assert squares(text) == ["right"] * 9 and '--depth: 75" title="box, 10 cm, deep: 10 queries' in text
    assert "<pre>" not in text
    assert "<b>20</b>queries" in text and "<b>3</b>derivatives" in text and "<b>0</b>wrong sign" in text
    assert "<b>0</b>collapsed" in text and "slip" in text


def test_what_is_wrong_is_counted_shown_and_can_be_asked_again():
    text = page(document(forward(), forward(state="deep", wrong_sign=4, error_max=3.0, where="pose 7")))
    assert squares(text).count("wrong") == 3 and re.findall(r'<td class="wrong"[^>]*>4</td>', text)
    assert "<b>4</b>wrong sign" in text and re.search("4 wrong sign\\W+pose 7</td>", text)
    assert "--kinds box --diagonals 0.1 --states deep --measures forward" in text


def test_refusals_have_their_reasons_and_crashes_their_tracebacks():
    thin = [
        forward(kind="plate", diagonal=size, refused=10, error_max=None, refusal="<1e-9 m thin") for size in (1e-4, 0.1)
    ]
    part = forward(kind="plate", diagonal=10.0, refused=5, wrong_sign=1, refusal="<1e-9 m thin", where="pose 3")
    text = page(document(*thin, forward(), part, problems=["box, 1 mm: ZeroDivisionError: <x>"]))
    assert squares(text).count("refused") == 4
    assert re.search(r'<td>&lt;1e-9 m thin</td><td class="n">25</td><td>plate\b[^<]* 0\.1 mm, 10 cm, 10 m</td>', text)
    assert "<b>1</b>crashes" in text and "ZeroDivisionError: &lt;x&gt;</pre>" in text


def test_mujoco_is_counted_apart():
    text = page(document(forward(mujoco_queries=5, mujoco_wrong=2), forward(kind="ball")))
    assert "wrong" not in squares(text)
    assert '<th scope="row">box</th><td class="n">5</td><td class="n">2</td>' in text
    assert '<th scope="row">ball</th><td class="n">' not in text
    assert "MuJoCo" not in page(document(forward())).replace("mujoco", "")
