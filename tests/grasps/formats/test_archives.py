"""Archives of grasp files: read in place, folder by folder, and never more than is allowed."""

import gzip
import io
import tarfile
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats import archives
from grasp_refine.grasps.formats.reading import is_other, reading
from grasp_refine_apps.cli import main
from refusals import refused

BOTTLE, CAN = "bench/core_bottle/grasp", "bench/core_can/grasp"


def grasp(number: int, name: str) -> bytes:
    """One grasp of DexGraspBench, as NumPy pickles it."""
    row = np.concatenate([[0.1, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0], np.full(22, number / 100)])
    content = {"obj_pose": np.array([0, 0, 0.3, 1, 0, 0, 0]), "obj_scale": 0.06, "obj_path": f"assets/object/{name}"}
    content |= {f"{stage}_qpos": row for stage in ("pregrasp", "grasp", "squeeze")}
    file = io.BytesIO()
    np.save(file, np.array(content, dtype=object), allow_pickle=True)
    return file.getvalue()


def archive(path: Path, files: dict[str, bytes], **kinds: bytes) -> Path:
    """A tar archive; `kinds` are the types of members that are no files."""
    with tarfile.open(path, "w:gz" if path.suffix in (".gz", ".tgz") else "w") as tar:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size, member.type = len(data), kinds.get(Path(name).stem, tarfile.REGTYPE)
            member.linkname = "/etc/passwd" if member.type != tarfile.REGTYPE else ""
            tar.addfile(member, io.BytesIO(data))
    return path


def files() -> dict[str, bytes]:
    return {
        f"{BOTTLE}/1.npy": grasp(1, "core_bottle"),
        "bench/summary.json": b'{"success": 1}',
        "bench/read.me": b"no grasps",
        f"{CAN}/0.npy": grasp(2, "core_can"),
        f"{BOTTLE}/0.npy": grasp(3, "core_bottle"),
    }


@pytest.mark.parametrize("name", ["grasps.tar", "grasps.tar.gz", "grasps.tgz"])
def test_an_archive_is_read_in_its_order_and_its_folders_like_any(name: str, tmp_path: Path):
    path = archive(tmp_path / name, files())
    read = reading(path)
    assert (read.format.name, read.files) == ("dexgraspbench", (path,))
    assert read.grasps.object.tolist() == ["core_bottle", "core_can", "core_bottle"]
    np.testing.assert_allclose(read.grasps.q[:, 0], [0.01, 0.02, 0.03])
    np.testing.assert_allclose(reading(path / "bench/core_can").grasps.q[:, 0], [0.02])
    np.testing.assert_allclose(reading(path / f"{BOTTLE}/0.npy").grasps.q[:, 0], [0.03])
    assert len(reading(tmp_path).grasps) == 3
    assert not is_other(path)
    with refused(GraspFileError, "core_mug"):
        reading(path / "bench/core_mug")
    assert list(tmp_path.iterdir()) == [path]


def test_paths_out_of_the_archive_are_names_and_links_are_no_files(tmp_path: Path):
    held = {"../../up/0.npy": grasp(1, "mug"), "/abs/1.npy": grasp(2, "mug"), "link.npy": b"", "pipe.npy": b""}
    (tmp_path / "in").mkdir()
    path = archive(tmp_path / "in/grasps.tar", held, link=tarfile.SYMTYPE, pipe=tarfile.FIFOTYPE)
    read = reading(path)
    np.testing.assert_allclose(read.grasps.q[:, 0], [0.01, 0.02])
    assert list(tmp_path.rglob("*")) == [tmp_path / "in", path]


def test_damage_is_named_with_the_file_in_the_archive(tmp_path: Path):
    whole = archive(tmp_path / "whole.tar", files()).read_bytes()
    (tmp_path / "cut.tar").write_bytes(whole[: len(whole) // 3])
    with refused(GraspFileError, "cut.tar", "cut off"):
        reading(tmp_path / "cut.tar")
    with refused(GraspFileError, "none.tar"):
        reading(archive(tmp_path / "none.tar", {"a/readme.txt": b"x"}))
    with refused(GraspFileError, "bad.tar/a/0.npy"):
        reading(archive(tmp_path / "bad.tar", {"a/0.npy": b"\x93NUMPY damaged"}))
    with refused(GraspFileError, "no.tar"):
        (tmp_path / "no.tar").write_bytes(b"no archive at all")
        reading(tmp_path / "no.tar")


def test_an_archive_takes_no_more_memory_than_is_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = archive(tmp_path / "grasps.tar", files())
    monkeypatch.setattr(archives, "MAX_FILES", 1)
    with refused(GraspFileError, f"{path}/bench"):
        reading(path)
    assert len(reading(path / "bench/core_can").grasps) == 1
    monkeypatch.setattr(archives, "MAX_FILES", 10)
    monkeypatch.setattr(archives, "MAX_MEMBERS", 5)
    monkeypatch.setattr(archives, "MAX_READ_BYTES", len(grasp(0, "core_can")) * 3 // 2)
    with refused(GraspFileError, f"{path}/{CAN}"):
        reading(path)
    monkeypatch.setattr(archives, "MAX_MEMBERS", 4)
    with refused(GraspFileError, "4 members"):
        reading(path / "bench/core_can")


def test_a_name_of_any_stated_length_is_refused(tmp_path: Path):
    header = tarfile.TarInfo("././@LongLink")
    header.type, header.size = tarfile.GNUTYPE_LONGNAME, archives.MAX_AT_ONCE_BYTES * 2
    data = header.tobuf(tarfile.GNU_FORMAT) + bytes(1024)
    (tmp_path / "name.tar").write_bytes(data)
    (tmp_path / "name.tgz").write_bytes(gzip.compress(data + bytes(2**20)))
    for name in ("name.tar", "name.tgz"):
        with refused(GraspFileError, name):
            reading(tmp_path / name)


def test_a_compressed_archive_that_unpacks_to_far_more_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = archive(tmp_path / "bomb.tgz", {"a/big.bin": bytes(2**22), **files()})
    monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 2**21)
    with refused(GraspFileError, "bomb.tgz"):
        reading(path)


def test_the_command_line_takes_a_folder_of_an_archive(tmp_path: Path):
    path = archive(tmp_path / "grasps.tar", files())
    assert main(["convert", str(path / "bench/core_bottle"), str(tmp_path / "out.npz"), "--to", "ours"]) == 0
    assert len(reading(tmp_path / "out.npz").grasps) == 2
