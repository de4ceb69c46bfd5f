"""`refine-grasp bench stability` as a user meets it: nothing is wrong, what is would be seen, and refusals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_line import call, refused
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine_apps.bench.stability.cases import KINDS, METHODS, STATES
from grasp_refine_apps.bench.stability.presets import FAST
from grasp_refine_apps.bench.stability.rows import of_measure, total
from grasp_refine_apps.cli import main
from refusals import assert_names

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.mark.slow
def test_of_20000_queries_in_all_states_none_is_wrong():
    """In a process of its own: with annotations checked it would take twice as long."""
    pytest.importorskip("jinja2", reason="the report needs it")
    done = call("bench", "stability", "--json", "found.json", "--html", "found.html")
    assert done.stdout.rstrip(), done.stderr
    found = json.loads(Path("found.json").read_text())
    rows = found["rows"]
    queries, derivatives = of_measure(rows, "forward"), of_measure(rows, "derivative")
    assert total(rows)["wrong"] == 0, done.stdout
    assert (done.returncode, found["problems"], done.stderr) == (0, [], "")
    assert total(queries)["queries"] >= 20_000 and total(queries)["points_compared"] > 2_000
    assert {row["kind"] for row in queries} == set(KINDS) and {row["kind"] for row in derivatives} == set(FAST)
    # One of four pairs of slivers cannot be built, and nothing else is refused.
    assert {row["kind"] for row in rows if row["refused"]} == {"slivers"}
    assert all(4 * row["refused"] == row["queries"] for row in queries if row["kind"] == "slivers")
    assert all(row["where"] is None for row in rows)
    assert {row["state"] for row in queries} == set(STATES)
    assert {row["method"] for row in derivatives} == set(METHODS)
    assert max(map(len, map(str.rstrip, done.stdout.splitlines()))) <= 80
    text = Path("found.html").read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)=["']https?:""", text)


ONE = "--preset smoke --kinds needle --diagonals 0.1 --measures forward --engines python".split()


def test_wrong_answers_are_counted_and_end_with_code_1(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    """Of all answers in a state some are made wrong in one way: each is seen as what it is, and nothing else is."""

    def broken(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> Witness:
        found = query(pairs, T_a, T_b)
        distance, status = found.distance.copy(), found.status.copy()
        point_a = found.point_a.copy()
        distance[0, 0] += 1e-8
        distance[1, 0] *= -1
        status[2, 0] = QueryStatus.FAILED
        distance[3, 0] = np.nan
        point_a[4, 0] += 0.01
        return replace(found, distance=distance, status=status, point_a=point_a)

    monkeypatch.setattr("grasp_refine_apps.bench.stability.forward.query", broken)
    asked = ["--states", "near", "--queries", "30", "--batches", "64", "--json", "found.json", "--html", "found.html"]
    assert main(["bench", "stability", *ONE, *asked]) == 1
    out, _ = capfd.readouterr()
    row = next(row for row in json.loads(Path("found.json").read_text())["rows"] if row["dtype"] == "float64")
    # A distance of the wrong sign is a wrong distance too, and not that of its points.
    names = ("wrong_distance", "wrong_sign", "failed", "not_finite")
    assert [row[name] for name in names] == [2, 1, 1, 1] and row["wrong_points"] >= 1
    assert total([row])["wrong"] == sum(row[name] for name in names) + row["wrong_points"]
    assert row["error_max"] > 100
    assert "--states near --measures forward --dtypes float64" in " ".join(out.replace("\\\n", " ").split())
    assert "1 wrong sign" in Path("found.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--kinds teapot", ("'teapot'", "'--kinds'")),
        ("--diagonals 0", ("--diagonals", "0")),
        ("--translations nan", ("--translations", "nan")),
        ("--queries 0", ("--queries", "1", "0")),
    ],
)
def test_bad_options_are_refused(options: str, named: tuple[str, ...], capfd: pytest.CaptureFixture[str]):
    assert_names(refused(capfd, "bench", "stability", *options.split()), *named)
