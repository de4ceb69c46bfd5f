"""TOML from anyone: what Python's reader takes too much of, or trips over, is an error of one kind."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path

import pytest

from grasp_refine.core import toml_file
from grasp_refine.core.toml_file import MAX_KEY_PARTS, read_toml
from refusals import refused


def put(folder: Path, text: str) -> Path:
    path = folder / "x.toml"
    path.write_text(text)
    return path


def test_a_file_is_read(tmp_path: Path):
    text = 'a.b = [0.1, 0.2]\n[c.d]\ne = "1.2.3"\n[[f]]\ng = {h = 1.5}\n'
    assert read_toml(put(tmp_path, text)) == {
        "a": {"b": [0.1, 0.2]},
        "c": {"d": {"e": "1.2.3"}},
        "f": [{"g": {"h": 1.5}}],
    }
    # Many numbers in a line are no long key.
    assert len(read_toml(put(tmp_path, f"x = [{'0.5, ' * 1000}]"))["x"]) == 1000


DOTS = "0.1" * 100


@pytest.mark.parametrize(
    "text",
    [
        f"# {DOTS}\nx = 1",
        f"x = 1 # {DOTS}",
        f'x = "{DOTS}"',
        f"x = '{DOTS}'",
        f'x = """\n{DOTS}\n"{DOTS}\\""" # {DOTS}"""',
        f"x = '''\n{DOTS}\n'{DOTS}\n'''",
        f'x = "\\"{DOTS}" # {DOTS}',
        f'"{DOTS}" = 1',
    ],
)
def test_dots_in_comments_and_texts_are_no_parts_of_a_key(tmp_path: Path, text: str):
    assert len(read_toml(put(tmp_path, text))) == 1


@pytest.mark.parametrize(
    "text",
    ['a = """x"""', 'a = """x""""', 'a = """x"""""', "a = '''x''''", 'a = """"""', 'a = "\\\\"', "a = '#'", 'a = ""'],
)
def test_a_long_key_behind_a_text_is_found(tmp_path: Path, text: str):
    with refused(ValueError, "64 parts"):
        read_toml(put(tmp_path, "x = {" + text + ", b" + ".b" * MAX_KEY_PARTS + " = 1}"))


@pytest.mark.parametrize("text", ['"""\n\\', "'''", 'x = "', "#"])
def test_texts_without_end_take_no_time(tmp_path: Path, text: str):
    path = put(tmp_path, text * 100_000)
    start = time.process_time()
    with pytest.raises(ValueError) if text != "#" else nullcontext():
        read_toml(path)
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("x = ", "Invalid value"),
        ("x = " + "[" * 5000, "nested"),
        ("x = " + "{a=" * 5000, "nested"),
        ("x = " + "9" * 5000, "4300"),
        ("x" + ".a" * MAX_KEY_PARTS + " = 1", "64 parts"),
        ("[x" + " . 'a'" * MAX_KEY_PARTS + "]", "64 parts"),
    ],
)
def test_what_cannot_be_read_is_one_kind_of_error(tmp_path: Path, text: str, named: str):
    with refused(ValueError, named):
        read_toml(put(tmp_path, text))


def test_a_key_of_thousands_of_parts_takes_neither_time_nor_memory(tmp_path: Path):
    # Python's reader took 3 GB and 10 s for this line.
    path = put(tmp_path, "x" + ".a" * 30000 + " = 1")
    start = time.process_time()
    with refused(ValueError, "64 parts"):
        read_toml(path)
    assert time.process_time() - start < 2.0


def test_a_file_that_is_too_large_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(toml_file, "MAX_FILE_BYTES", 10)
    with refused(ValueError, "MiB", "0"):
        read_toml(put(tmp_path, "x = 1 # and more"))
    with pytest.raises(FileNotFoundError):
        read_toml(tmp_path / "none.toml")
