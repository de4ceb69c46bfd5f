"""Zips from anyone: what is unpacked, and every way to leave the folder or to fill the disk that is refused."""

import io
import stat
import zipfile
from pathlib import Path

import pytest

from grasp_refine_apps.viewer.files import unpacking
from grasp_refine_apps.viewer.files.unpacking import UploadError, unpack
from refusals import assert_names
from refusals import refused as expected


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name) if not name.endswith("/") else name, content, method)
    return stream.getvalue()


def refused(content: bytes, folder: Path) -> str:
    """What is said, and nothing must lie anywhere."""
    before = sorted(folder.parent.rglob("*"))
    with pytest.raises(UploadError) as raised:
        unpack("hand.zip", content, folder)
    assert sorted(folder.parent.rglob("*")) == before
    text = str(raised.value)
    assert text.startswith("hand.zip: ") and "\n" not in text and text.isprintable()
    return text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


def test_what_may_mean_something_is_unpacked(folder: Path):
    content = zipped(
        {
            "hand/": b"",
            "hand/urdf/hand.urdf": b"<robot/>",
            "hand/meshes/tip.STL": b"solid",
            "hand/run.sh": b"rm -rf /",
            "hand/texture.png": b"\x89PNG",
            "__MACOSX/hand/urdf/._hand.urdf": b"shadow",
            "hand/urdf/._hand.urdf": b"shadow",
        }
    )
    files = unpack("hand.zip", content, folder)
    assert [path.relative_to(folder).as_posix() for path in files] == ["hand/meshes/tip.STL", "hand/urdf/hand.urdf"]
    assert {path for path in folder.rglob("*") if path.is_file()} == set(files)
    assert (folder / "hand/urdf/hand.urdf").read_bytes() == b"<robot/>"
    # Nothing that was unpacked can be run.
    assert not any(path.stat().st_mode & 0o111 for path in files)


@pytest.mark.parametrize(
    "name",
    [
        "../out.urdf",
        "a/../../out.urdf",
        "a/b/../out.urdf",
        "/etc/out.urdf",
        "//server/share/out.urdf",
        "C:/out.urdf",
        "c:out.urdf",
        "..\\out.urdf",
        "a\\out.urdf",
        "a/./out.urdf",
        "a//out.urdf",
        "a/ ./out.urdf",
        ".../out.urdf",
    ],
)
def test_paths_that_lead_out_are_refused(name: str, folder: Path):
    assert_names(refused(zipped({"fine.urdf": b"", name: b"bad"}), folder), f"'{name}'")


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFCHR, stat.S_IFIFO, stat.S_IFSOCK])
def test_links_and_devices_are_refused(kind: int, folder: Path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        entry = zipfile.ZipInfo("meshes/tip.stl")
        entry.create_system, entry.external_attr = 3, (kind | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")
    assert_names(refused(stream.getvalue(), folder), "'meshes/tip.stl'")


def test_archive_bombs_are_refused_before_they_are_unpacked(folder: Path):
    bomb = zipped({"a.stl": bytes(2**24)})
    assert len(bomb) < 2**16
    assert_names(refused(bomb, folder), f"{2**24 / len(bomb):.0f} times", "100 times")
    many = zipped({f"{i}.stl": b"" for i in range(unpacking.MAX_FILES + 1)})
    assert_names(refused(many, folder), "2000 files")


def test_sizes_are_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(unpacking, "MAX_FILE_BYTES", 2**20)
    monkeypatch.setattr(unpacking, "MAX_UNPACKED_BYTES", 3 * 2**20)
    noise = bytes(range(256)) * 2**12
    assert_names(refused(zipped({"a.stl": 2 * noise}, 0), folder), "'a.stl'", "2 MiB", "1 MiB")
    # Files that are left out count, too.
    content = zipped({f"{i}.png": noise for i in range(4)}, 0)
    assert_names(refused(content, folder), "4 MiB", "3 MiB")


def test_a_zip_that_lies_about_its_sizes_is_refused(folder: Path):
    said, true = 3, 2**21
    content = bytearray(zipped({"a.stl": bytes(true)}))
    size = true.to_bytes(4, "little")
    # In the list at the end alone, and in both places.
    end = content.rfind(size)
    content[end : end + 4] = said.to_bytes(4, "little")
    with expected(UploadError, "hand.zip"):
        unpack("hand.zip", bytes(content), folder)
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) <= said


def test_oddly_packed_zips_and_odd_names_are_refused(folder: Path):
    for content, named in (
        (zipped({"a.urdf": b"x"}, zipfile.ZIP_LZMA), ("'a.urdf'", "method 14")),
        (zipped({"a.urdf": b"x"}, zipfile.ZIP_BZIP2), ("'a.urdf'", "method 12")),
        (zipped({"a/" * 12 + "b.urdf": b""}), ("13 levels",)),
        (zipped({"a" * 300 + ".urdf": b""}), ("305 characters",)),
        (zipped({"hand.URDF": b"a", "Hand.urdf": b"b"}), ("'Hand.urdf'",)),
        (zipped({"hand.urdfX.png": b"bad"}).replace(b"hand.urdfX.png", b"hand.urdf\0.png"), ("'hand.urdf?.png'",)),
        (zipped({"a\x1b[31m.urdf": b""}), ("'a?[31m.urdf'",)),
    ):
        assert_names(refused(content, folder), *named)
    content = bytearray(zipped({"a.urdf": b"x"}))
    content[content.find(b"PK\x01\x02") + 8] |= 1
    assert_names(refused(bytes(content), folder), "encrypted")
    # The deepest and the longest names that are unpacked.
    unpack("hand.zip", zipped({"a/" * 11 + "b.urdf": b"", "a" * 235 + ".urdf": b""}), folder)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a zip", zipped({"a.urdf": b"x" * 99})[:-30]])
def test_damaged_zips_are_refused(content: bytes, folder: Path):
    refused(content, folder)


def test_a_file_that_is_a_folder_too_is_refused(folder: Path):
    with expected(UploadError, "hand.zip"):
        unpack("hand.zip", zipped({"a.urdf": b"", "a.urdf/b.urdf": b""}), folder)
