"""Marks of grasps: what is written, what is read again, and what is refused."""

import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError
from grasp_refine_apps.viewer.model.marks import HEADER, Marks, marks_path
from refusals import refused

TOP = ",".join(HEADER)


def test_marks_are_read_again_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "grasps.npz.marks.csv"
    marks = Marks.read(path)
    assert not marks.by_row
    marks = marks.with_mark(7, "bad", object='a "cup", blue', index=3).with_mark(2, "good", object="mug", index=2)
    marks.save()
    assert Marks.read(path) == marks
    assert [marks.of(row) for row in (2, 7, 8)] == ["good", "bad", ""]
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(row["row"], row["object"], row["index"], row["mark"]) for row in rows] == [
        ("2", "mug", "2", "good"),
        ("7", 'a "cup", blue', "3", "bad"),
    ]
    age = datetime.now(UTC) - datetime.fromisoformat(rows[0]["time"])
    assert timedelta(0) <= age < timedelta(minutes=1)
    marks.with_mark(2, "", object="mug", index=2).save()
    assert list(Marks.read(path).by_row) == [7]
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_marks_lie_beside_the_grasps_but_never_in_the_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert marks_path(tmp_path / "a" / "g.npz") == tmp_path / "a" / "g.npz.marks.csv"
    assert marks_path(Path("folder")) == tmp_path / "folder.marks.csv"
    example = resource_dir("robots") / "allegro" / "example_mug.npz"
    assert marks_path(example) == tmp_path / "example_mug.npz.marks.csv"


def test_no_name_is_a_formula_of_a_spreadsheet_and_all_are_read_again(tmp_path: Path) -> None:
    names = ("=HYPERLINK(1)", "@SUM(1)", "-1", "'=1", "mug")
    marks = Marks.read(tmp_path / "g.npz.marks.csv")
    for row, name in enumerate(names):
        marks = marks.with_mark(row, "good", object=name, index=row)
    marks.save()
    cells = [line.split(",")[1] for line in marks.text.splitlines()[1:]]
    assert cells == ["'=HYPERLINK(1)", "'@SUM(1)", "'-1", "''=1", "mug"]
    assert Marks.read(tmp_path / "g.npz.marks.csv") == marks


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", (TOP,)),
        ("row,mark\n1,good\n", (TOP,)),
        (f"{TOP}\n1,mug,0,good\n", ("line 2", "4 values", "5")),
        (f"{TOP}\n1,mug,0,good,\n-1,mug,0,good,\n", ("line 3", "row", "index")),
        (f"{TOP}\n1,mug,²,good,\n", ("line 2", "row", "index")),
        (f"{TOP}\n1,mug,0,<b>,\n", ("line 2", "good", "bad")),
        (f"{TOP}\n{'9' * 5000},mug,0,good,\n", ("line 2", "row", "index")),
        ("\udcff", ("can't decode byte",)),
    ],
)
def test_a_damaged_file_of_marks_is_named_and_kept(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    path = tmp_path / "g.npz.marks.csv"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with refused(GraspFileError, path, *named):
        Marks.read(path)
    assert path.read_bytes() == text.encode(errors="surrogateescape")


def test_a_folder_in_the_place_of_marks_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "g.npz.marks.csv"
    marks = Marks.read(path).with_mark(0, "good", object="mug", index=0)
    (path / "inside").mkdir(parents=True)
    with refused(GraspFileError, path):
        marks.save()
    assert marks.of(0) == "good"
    with refused(GraspFileError):
        Marks(None).with_mark(0, "good", object="mug", index=0).save()
