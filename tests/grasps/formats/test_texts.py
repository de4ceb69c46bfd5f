"""JSON and YAML: plain values, and refusals in one line of what is damaged, too deep, or refers to itself."""

from pathlib import Path

import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats import texts
from grasp_refine.grasps.formats.content import load_content
from refusals import refused

VALUE = {"a": [1, 2.5, None, True, "text"], "b": {"c": [-1e-7, 1e300]}}


@pytest.mark.parametrize(("name", "dump"), [("a.json", texts.dump_json), ("a.yaml", texts.dump_yaml)])
def test_what_is_written_is_read(name: str, dump: object, tmp_path: Path):
    path = tmp_path / name
    path.write_bytes(dump(VALUE))
    assert load_content(path) == VALUE
    # The form is told by how a file begins, not by its name.
    other = tmp_path / "noname"
    other.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load_content(other) == VALUE


BOMB = "a: &a [1, 1]\n" + "\n".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]" for i in range(20)
)


@pytest.mark.parametrize(
    ("name", "data", "named"),
    [
        ("a.json", b"{", ("JSON",)),
        ("a.json", b'{"a": 1', ("JSON",)),
        ("a.json", b"[" * 100_000, ("nested", "32")),
        ("a.json", b"[" * 40 + b"]" * 40, ("nested", "32")),
        ("a.json", b"[" + b"9" * 10_000 + b"]", ("JSON",)),
        ("a.json", b'{"a": "\xff"}', ("UTF-8",)),
        ("a.yaml", b"a: [", ("YAML",)),
        ("a.yaml", b"a: " + b"[" * 40 + b"]" * 40, ("nested", "32")),
        ("a.yaml", b"a: " + b"[" * 100_000, ("nested", "32")),
        ("a.yaml", BOMB.encode(), ("refers", "*a")),
        ("a.yaml", b"a: !!python/object/apply:os.system [touch x]", ("YAML", "python/object")),
        ("a.yaml", b"a: 2020-99-99", ("not read",)),
        ("a.yaml", b"{[a]: 1}", ("hash",)),
        ("a.yaml", b"a: \xff", ("UTF-8",)),
    ],
)
def test_refusals(name: str, data: bytes, named: tuple[str, ...], tmp_path: Path):
    path = tmp_path / name
    path.write_bytes(data)
    with refused(GraspFileError, path, *named):
        load_content(path)
    assert not Path("x").exists()


def test_texts_are_of_bounded_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(texts, "MAX_TEXT_BYTES", 10)
    for name, data in (("a.json", b'{"a": 123456}'), ("a.yaml", b"a: 123456789")):
        (tmp_path / name).write_bytes(data)
        with refused(GraspFileError, tmp_path / name, "MiB"):
            load_content(tmp_path / name)
