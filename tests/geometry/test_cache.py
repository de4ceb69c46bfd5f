"""Entries of the cache that something else has written: they are as good as not there, whatever is in them."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.geometry.cache import load_arrays


def stored(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def put(folder: Path, content: bytes) -> Path:
    with zipfile.ZipFile(folder / "entry.npz", "w") as archive:
        archive.writestr("x.npy", content)
    return folder / "entry.npz"


SOUND = stored(np.arange(3.0))


def test_a_sound_entry_is_read(tmp_path: Path):
    (found,) = load_arrays(put(tmp_path, SOUND), "x") or []
    assert found.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    "content",
    [
        b"no array",
        SOUND.replace(b"(3,), }" + b" " * 20, b"(1000000000000,), }" + b" " * 8),
        SOUND.replace(b"'shape'", b"'shape\n"),
        SOUND.replace(b"{'descr'", b"((((((((("),
        SOUND.replace(b"<f8", b"|O "),
        SOUND[:-1],
        SOUND[:20],
        b"",
    ],
)
def test_a_broken_entry_is_none(tmp_path: Path, content: bytes):
    assert content != SOUND
    assert load_arrays(put(tmp_path, content), "x") is None


@pytest.mark.parametrize(("place", "byte"), [(8, 99), (4, 200)])
def test_an_entry_that_is_packed_in_an_unknown_way_is_none(tmp_path: Path, place: int, byte: int):
    entry = put(tmp_path, SOUND)
    data = bytearray(entry.read_bytes())
    data[place] = byte  # of the entry itself
    data[data.rindex(b"PK\x01\x02") + place + 2] = byte  # and of the list of entries
    entry.write_bytes(bytes(data))
    assert load_arrays(entry, "x") is None
