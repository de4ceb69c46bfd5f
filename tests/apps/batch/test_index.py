"""The index: every row of every result file, in order, with nulls where nothing was measured, as Parquet and CSV."""

from __future__ import annotations

import csv
import json
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from batch_rows import made_up_rows, shard
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.names import from_cell
from grasp_refine.measures.change import Change
from grasp_refine.measures.measures import RECORDED
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.batch import index as module
from grasp_refine_apps.batch.index import index_path, index_writer
from grasp_refine_apps.batch.rows import Rows, column_kinds, read_rows
from grasp_refine_apps.batch.shard import Shard
from made_results import refined, save_example_results, save_refined
from refusals import refused


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Shard]]:
    """A folder of results, with two shards of real refinements."""
    out = tmp_path_factory.mktemp("out")
    shards = [shard(k, out / f"examples/{k:05d}.npz") for k in range(2)]
    outcome = refined("rounded_box")
    half = len(outcome) // 2
    save_refined(shards[0].path, outcome.select(np.arange(half)), look=["--object", "a mug.obj"])
    save_refined(shards[1].path, outcome.select(np.arange(half, len(outcome))))
    return out, shards


def write(path: Path, parts: list[Rows]) -> None:
    with index_writer(path) as add:
        for rows in parts:
            add(rows)


# Rows


def test_rows_are_what_the_result_file_says(batch: tuple[Path, list[Shard]]):
    out, shards = batch
    rows = [read_rows(one, out) for one in shards]
    with np.load(shards[0].path) as file:
        assert len(rows[0]) == len(file["status"]) > 0 and list(rows[0].columns) == list(column_kinds())
        for name in (entry for measure in RECORDED for entry in measure.entries.values()):
            np.testing.assert_array_equal(rows[0][name], file[name])
        np.testing.assert_array_equal(rows[0]["status"], file["status"])
        np.testing.assert_array_equal(rows[0]["change"], file["change"])
        assert set(file["change"]) <= {*Change} and len(set(file["displacement_m"])) > 1
        np.testing.assert_array_equal(rows[0]["scale"], file["scale"])
    first = len(rows[0])
    for one, number, begin in ((rows[0], 0, 0), (rows[1], 1, first)):
        assert set(one["job"]) == {"examples"} and set(one["shard"]) == {number}
        assert set(one["file"]) == {f"examples/{number:05d}.npz"} and set(one["source"]) == {"example.npz"}
        assert set(one["hand"]) == {"allegro"} and set(one["object"]) == {"rounded_box"}
        np.testing.assert_array_equal(one["row_in_file"], np.arange(len(one)))
        np.testing.assert_array_equal(one["row"], begin + np.arange(len(one)))
        assert np.isnan(one["held_after"]).all() and set(one["reason_after"]) == {""}
    assert rows[0].look == ("--object", "a mug.obj") and rows[1].look == ()


def test_a_grasp_is_good_by_its_own_quality(tmp_path: Path):
    rows = read_rows(shard(0, save_example_results(tmp_path / "r.npz", 100)), tmp_path)
    # Qualities are 0 to 99 hundredths after, and half of that before.
    assert not rows["good_before"].any() and rows["good_after"].sum() == 5
    np.testing.assert_array_equal(rows["good_after"], rows["quality_after"] >= HOLDS)


def test_what_an_older_file_lacks_is_null(tmp_path: Path):
    path, lacks = save_example_results(tmp_path / "r.npz", 3), ("queries", "moved_palm_m", "cpu_s", "wall_s", "change")
    with np.load(path) as file:
        kept = {name: file[name] for name in file.files if name not in lacks}
    np.savez(path, **kept)
    rows = read_rows(shard(0, path), tmp_path)
    for column in (*lacks[:-1], "held_before", "held_after"):
        assert np.isnan(rows[column]).all()
    assert rows["change"].tolist() == ["", "", ""]


def test_simulation_is_read_and_held_is_no_reason(tmp_path: Path):
    path = save_example_results(tmp_path / "r.npz", 2)
    with np.load(path) as file:
        kept = dict(file)
    more = {
        "simulation_before": np.array([False, True]),
        "simulation_after": np.array([True, False]),
        "simulation_reason_after": np.array(["held", "moved"]),
    }
    np.savez(path, **(kept | more))
    rows = read_rows(shard(0, path), tmp_path)
    assert rows["held_before"].tolist() == [0, 1] and rows["held_after"].tolist() == [1, 0]
    assert rows["reason_after"].tolist() == ["", "moved"]


def test_files_that_are_no_results_are_named(tmp_path: Path):
    with refused(GraspFileError, "gone.npz"):
        read_rows(shard(0, tmp_path / "gone.npz"), tmp_path)
    path = save_example_results(tmp_path / "r.npz", 2)
    with np.load(path) as file:
        whole = dict(file)
    np.savez(path, **{name: whole[name] for name in whole if name != "quality_after"})
    with refused(GraspFileError, "r.npz", "quality_after"):
        read_rows(shard(0, path), tmp_path)
    np.savez(path, **(whole | {"provenance": np.array("{")}))
    with refused(GraspFileError, "r.npz", "provenance", "JSON"):
        read_rows(shard(0, path), tmp_path)
    np.savez(path, **(whole | {"provenance": np.array("[1]")}))
    with refused(GraspFileError, "r.npz", "provenance", "JSON object"):
        read_rows(shard(0, path), tmp_path)
    for row in (["a", "b"], [10**400, 0]):
        np.savez(path, **(whole | {"provenance": np.array(json.dumps({"row": row}))}))
        with refused(GraspFileError, "r.npz", "provenance"):
            read_rows(shard(0, path), tmp_path)
    np.savez(path, **(whole | {"quality_after": np.zeros(3)}))
    with refused(GraspFileError, "r.npz", "quality_after", "(2,)"):
        read_rows(shard(0, path), tmp_path)


# Parquet and CSV


def test_both_kinds_read_back_as_the_result_files(batch: tuple[Path, list[Shard]], tmp_path: Path):
    parquet = pytest.importorskip("pyarrow.parquet")
    out, shards = batch
    parts = [read_rows(one, out) for one in shards]
    for ending in ("csv", "parquet"):
        write(tmp_path / f"index.{ending}", parts)
    table = parquet.read_table(tmp_path / "index.parquet").to_pylist()
    with (tmp_path / "index.csv").open(newline="", encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    assert len(table) == len(lines) == sum(map(len, parts)) and list(table[0]) == list(lines[0]) == list(column_kinds())
    for name, kind in column_kinds().items():
        wanted = np.concatenate([rows[name] for rows in parts]).tolist()
        null = [value == "" or value != value for value in wanted]
        assert [row[name] is None for row in table] == [line[name] == "" for line in lines] == null
        for value, row, line in zip(wanted, table, lines, strict=True):
            if value == "" or value != value:
                continue
            assert row[name] == value
            words = {"flag": str(bool(value)).lower(), "text": value}.get(kind)
            # Numbers come back to the last bit.
            assert line[name] == words if words is not None else float(line[name]) == value
    assert isinstance(table[0]["iterations"], int) and lines[0]["iterations"].isdigit()
    assert isinstance(table[0]["good_after"], bool)


def test_no_text_of_a_csv_is_run_by_a_spreadsheet(tmp_path: Path):
    name = '=HYPERLINK("http://x")'
    rows = made_up_rows(1, object=name, source="@SUM(1).npz", scale=-1.5)
    write(tmp_path / "index.csv", [rows])
    with (tmp_path / "index.csv").open(newline="", encoding="utf-8") as stream:
        (line,) = csv.DictReader(stream)
    assert (line["object"], line["source"], line["scale"]) == (f"'{name}", "'@SUM(1).npz", "-1.5")
    assert from_cell(line["object"]) == name
    if find_spec("pyarrow") is not None:
        import pyarrow.parquet

        write(tmp_path / "index.parquet", [rows])
        assert pyarrow.parquet.read_table(tmp_path / "index.parquet")["object"].to_pylist() == [name]


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_the_same_rows_give_the_same_bytes_however_they_are_cut(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    parts = [made_up_rows(10, number) for number in range(5)]
    for name in ("a", "b"):
        write(tmp_path / f"{name}.{ending}", parts)
    assert (tmp_path / f"a.{ending}").read_bytes() == (tmp_path / f"b.{ending}").read_bytes()
    if ending == "parquet":
        monkeypatch.setattr(module, "ROW_GROUP_SIZE", 20)
        write(tmp_path / "c.parquet", parts)
        import pyarrow.parquet

        a, c = (pyarrow.parquet.ParquetFile(tmp_path / f"{name}.parquet") for name in "ac")
        assert (a.num_row_groups, c.num_row_groups) == (1, 3)
        assert a.read().to_pylist() == c.read().to_pylist()


def test_where_the_index_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pyarrow")
    assert index_path(tmp_path, "auto") == index_path(tmp_path, "parquet") == tmp_path / "index.parquet"
    assert index_path(tmp_path, "csv") == tmp_path / "index.csv"
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    assert index_path(tmp_path, "auto") == tmp_path / "index.csv"
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with refused(GraspRefineError, "index.parquet", "pyarrow", 'pip install "grasp-refine'):
        index_path(tmp_path, "parquet")
    with refused(GraspRefineError, ".csv", ".parquet"), index_writer(tmp_path / "index.xlsx"):
        pass
