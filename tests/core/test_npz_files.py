"""Archives that would unpack to more than they should are refused before they are unpacked."""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core import npz_files
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import MAX_UNPACKED_BYTES, array_header, load_npz
from grasp_refine.grasps.grasp_set import load_grasps
from refusals import refused


def npy(value: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, value)
    return stream.getvalue()


def claiming(shape: tuple[int, ...]) -> bytes:
    """What an array file of zeros of this shape begins with."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


def check_refused(path: Path, *named: object) -> None:
    with refused(GraspFileError, path, *named):
        load_npz(path)


def peak() -> int:
    """The largest amount of memory that this process ever had, in bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def test_an_archive_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in ("q", "hand_pose"):
            with archive.open(f"{name}.npy", "w") as entry:
                entry.write(claiming((2**24,)))
                for _ in range(128):
                    entry.write(bytes(2**20))
    assert path.stat().st_size < 2**21
    monkeypatch.setattr(npz_files, "MAX_UNPACKED_BYTES", 2**27)
    before = peak()
    check_refused(path, "256 MiB", "128 MiB")
    assert peak() - before < 2**25


def test_the_limit_has_room_for_grasps():
    assert MAX_UNPACKED_BYTES == 8 * 2**20 * 32 * 8


def grasp_file(path: Path, count: int, dtype: str, name: str = "ball", seed: int | None = None, pack: bool = True):
    """Write grasps of a hand with 16 joints, all of them zeros unless there is a seed."""
    pose, q = np.zeros((count, 7), dtype), np.zeros((count, 16), dtype)
    pose[:, 3] = 1
    if seed is not None:
        rng = np.random.default_rng(seed)
        pose[:, :3], q[:] = rng.normal(size=(count, 3)), rng.normal(size=(count, 16))
    (np.savez_compressed if pack else np.savez)(
        path,
        hand="hand",
        base_link="palm",
        joint_names=[str(number) for number in range(16)],
        object=name,
        scale=1.0,
        hand_pose=pose,
        q=q,
    )


PEAK_OF_LOADING = """
import resource, sys
from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.grasp_set import load_grasps
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    print(len(load_grasps(sys.argv[1])), end=" ")
except GraspFileError:
    print("refused", end=" ")
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


@pytest.mark.parametrize(
    ("count", "dtype", "name"),
    [(3_000_000, "int8", "ball"), (400_000, "int8", "ball"), (300_000, "f2", "x" * 2000)],
)
def test_a_small_file_does_not_fill_the_memory(tmp_path: Path, count: int, dtype: str, name: str):
    """259 kB of zeros, ten million rows of them, once took 3.5 GB as float64."""
    path = tmp_path / "grasps.npz"
    grasp_file(path, count, dtype, name)
    assert path.stat().st_size < 2**20
    done = subprocess.run([sys.executable, "-c", PEAK_OF_LOADING, path], capture_output=True, text=True, check=True)
    found, grown = done.stdout.split()
    assert found == "refused" and int(grown) < 100


def test_what_may_be_large_without_a_large_file_takes_little(tmp_path: Path):
    path = tmp_path / "grasps.npz"
    grasp_file(path, 350_000, "int8")
    done = subprocess.run([sys.executable, "-c", PEAK_OF_LOADING, path], capture_output=True, text=True, check=True)
    found, grown = done.stdout.split()
    assert found == "350000" and int(grown) < 300


@pytest.mark.parametrize(("dtype", "seed", "pack"), [("f4", 1, True), ("f2", 1, False), ("int8", None, False)])
def test_honest_files_of_many_grasps_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dtype: str, seed: int | None, pack: bool
):
    """As the file grows, so does what may come of it: here all of it is beyond what is free."""
    monkeypatch.setattr(npz_files, "MEMORY_ALLOWANCE_BYTES", 2**16)
    path = tmp_path / "grasps.npz"
    grasp_file(path, 20_000, dtype, "core-bottle-1ef68777bfdb7d6ba7a07ee616e34cd7", seed, pack)
    grasps = load_grasps(path)
    assert len(grasps) == 20_000 and grasps.q.dtype == float and (grasps.object == grasps.object[0]).all()


def test_what_would_take_too_much_says_how_much_and_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(npz_files, "MEMORY_ALLOWANCE_BYTES", 2**20)
    path = tmp_path / "grasps.npz"
    np.savez_compressed(path, q=np.zeros((2**18, 1), "int8"))
    times = round(2**21 / path.stat().st_size)
    check_refused(path, "2 MiB", f"{times} times", "1 MiB", "16 times", "compression")
    assert load_npz(path, only=("other",)).entries == {}, "what is not asked for takes nothing"


@pytest.mark.parametrize("shape", [(10**11,), (10**6, 10**6), (2,)])
def test_an_array_that_says_more_than_there_is_takes_no_room(shape: tuple[int, ...], tmp_path: Path):
    path = tmp_path / "grasps.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("hand_pose.npy", npy(np.zeros((1, 7))))
        archive.writestr("q.npy", claiming(shape) + bytes(8))
    before = peak()
    needed = int(np.prod(shape, dtype=float)) * 8 + len(claiming(shape))
    check_refused(path, "'q'", shape, "float64", f"{needed} bytes", len(claiming(shape)) + 8)
    assert peak() - before < 2**26


def test_a_directory_that_says_less_than_there_is_is_found_out(tmp_path: Path):
    path = tmp_path / "grasps.npz"
    array = npy(np.zeros(10**6))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("q.npy", array)
    lying = path.read_bytes().replace(len(array).to_bytes(4, "little"), (128 + 8).to_bytes(4, "little"))
    path.write_bytes(lying)
    check_refused(path, ".npz", "Bad CRC-32")
    small = claiming((1,))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("q.npy", small + bytes(10**6))
    total = (len(small) + 10**6).to_bytes(4, "little")
    path.write_bytes(path.read_bytes().replace(total, (len(small) + 8).to_bytes(4, "little")))
    check_refused(path, ".npz", "Bad CRC-32")


@pytest.mark.parametrize("header", [b"\x93NUMPY\x01\x00\x01\x00[", b"\x93NUMPY\x01\x00\xff\xff", b"\x93NUMPY\x09\x00"])
def test_a_damaged_header_is_named(header: bytes, tmp_path: Path):
    path = tmp_path / "grasps.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("q.npy", header)
    check_refused(path, "'q'")


def test_which_numbers_may_stand_in_an_entry_is_said_in_one_word(tmp_path: Path):
    np.savez(tmp_path / "a.npz", whole=[1, 2], absent=[1.0, np.nan], endless=[1.0, np.inf])
    file = load_npz(tmp_path / "a.npz")
    for key, allowed in (("whole", "finite"), ("absent", "nan"), ("endless", "any"), ("absent", "any")):
        np.testing.assert_array_equal(file.numbers(key, allowed=allowed), file.entries[key])
    for key, allowed in (("absent", "finite"), ("endless", "finite"), ("endless", "nan")):
        with refused(GraspFileError, key, "finite", "row 1"):
            file.numbers(key, allowed=allowed)


def test_a_header_says_shape_type_and_where_the_numbers_begin():
    shape, dtype, start = array_header(npy(np.arange(6.0).reshape(2, 3)))
    assert (shape, dtype) == ((2, 3), np.dtype(float))
    assert npy(np.arange(6.0).reshape(2, 3))[start:] == np.arange(6.0).tobytes()
    with refused(ValueError, "(-1,)"):
        array_header(claiming((-1,)))


@pytest.mark.parametrize("codes", [[0x1B, 0x63], [0x110000], [0x7F], [0x9B, 0x63], [0xD800], [0x61, 0, 0x61], [0x2028]])
def test_names_that_are_no_text_or_control_a_terminal_are_refused(tmp_path: Path, codes: list[int]):
    text = np.array(codes, dtype=np.uint32).view(f"U{len(codes)}")
    np.savez(tmp_path / "g.npz", object=text)
    with refused(GraspFileError, "object", "terminal"):
        load_npz(tmp_path / "g.npz").text("object")
    np.savez(tmp_path / "g.npz", object=np.array(["Mus\u00e9e", "\u676f"]))
    assert load_npz(tmp_path / "g.npz").names("object") == ("Mus\u00e9e", "\u676f")


def test_only_some_entries_are_read(tmp_path: Path):
    np.savez(tmp_path / "g.npz", q=np.zeros(3), name=np.array("x"))
    assert set(load_npz(tmp_path / "g.npz", only=("q", "none")).entries) == {"q"}


def test_a_file_of_python_2_is_read_without_a_word(tmp_path: Path):
    # NumPy warns of whole numbers such as 3L; warnings are errors here.
    content = npy(np.arange(3.0)).replace(b"(3,), }  ", b"(3L,), } ")
    with zipfile.ZipFile(tmp_path / "g.npz", "w") as archive:
        archive.writestr("q.npy", content)
    assert load_npz(tmp_path / "g.npz").entries["q"].tolist() == [0, 1, 2]
    assert array_header(content)[0] == (3,)
    odd = content.replace(b"(3L,), } ", b"(3,), }\\_")
    with pytest.raises(ValueError):  # and not a warning of an escape that Python does not know
        array_header(odd)


def test_a_name_that_is_too_long_is_no_file(tmp_path: Path):
    with refused(GraspFileError, "a" * 300):
        load_npz(tmp_path / ("a" * 300))
