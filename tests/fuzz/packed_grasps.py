"""Grasps in tar archives, and in tables whose columns a TOML file names."""

from __future__ import annotations

import gzip
import io
import tarfile
from collections.abc import Hashable
from pathlib import Path
from random import Random

from fuzz import foreign_grasps
from fuzz.mutations import VALUES
from fuzz.reader import Reader, written
from fuzz.toml import WORDS, changed_toml, toml

BLOCK = 512
"""Bytes of a header in a tar archive."""
CHECKSUM = slice(148, 156)
"""Bytes of the checksum in it."""
FIELDS = (slice(0, 100), slice(100, 108), slice(124, 136), slice(156, 157), slice(157, 257), slice(257, 265))
"""Bytes of its name, mode, size, kind, link, and of the dialect."""
VALUES_OF_FIELDS = (
    b"",
    b"/etc/passwd",
    b"../../outside/secret.npy",
    b"a\0b",
    b"\xff" * 12,
    b"77777777777",
    b"-1",
    b"8",
)
VALUES_OF_FIELDS += (b"\x80" + b"\0" * 10 + b"\x01", *(bytes([kind]) for kind in b"0123456LKxgS"), b"ustar  \0")

MAPPING = {
    "table": "sound.csv", "hand": "mine", "base_link": "palm", "position": ["x", "y", "z"], "rotation": ["a", "b", "c"],
    "notation": "rotvec", "joints": {"knuckle": "j0"}, "episode": "e", "frame": "before_lift", "object_column": "o",
    "scale_column": "s", "labels": {"score": "j0"}, "length_unit": "mm", "joint_unit": "deg",
}  # fmt: skip
ROWS = "".join(f"{k},{k * k},{10 * k},0.1,0.2,{k},{5 * k},{k // 3},mug,0.1\n" for k in range(6))
CSV = f"x,y,z,a,b,c,j0,e,o,s\n{ROWS}".encode()
COLUMNS = ("x", "o", "e", "sound.csv", "../outside/secret.npz", "wxyz", "matrix", "all", ["x"], {"k": "x"})


def archives() -> list[tuple[str, bytes]]:
    """An archive of two grasp files, plain and compressed."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as tar:
        for name, content in foreign_grasps.seeds()[:1]:
            for folder in ("one", "two"):
                member = tarfile.TarInfo(f"{folder}/{name}")
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
    plain = stream.getvalue()
    return [("grasps.tar", plain), ("grasps.tgz", gzip.compress(plain, mtime=0))]


def changed_archive(random: Random, name: str, content: bytes) -> bytes:
    """Another value in a header, with the checksum that it takes."""
    try:
        data = bytearray(gzip.decompress(content) if name.endswith(".tgz") else content)
    except (OSError, EOFError):
        return content
    heads = [at for at in range(0, len(data) - BLOCK + 1, BLOCK) if data[at + 257 : at + 262] == b"ustar"]
    if not heads:
        return content
    at, field = random.choice(heads), random.choice(FIELDS)
    length = field.stop - field.start
    data[at + field.start : at + field.stop] = random.choice(VALUES_OF_FIELDS)[:length].ljust(length, b"\0")
    head = data[at : at + BLOCK]
    head[CHECKSUM] = b" " * 8
    data[at + CHECKSUM.start : at + CHECKSUM.stop] = b"%06o\0 " % sum(head)
    return gzip.compress(bytes(data), mtime=0) if name.endswith(".tgz") else bytes(data)


def tables() -> list[tuple[str, bytes]]:
    """A mapping, and a table; each is read with a sound one of the other."""
    return [("mapping.toml", toml(MAPPING)), ("changed.csv", CSV)]


def prepare_tables(folder: Path) -> None:
    """The other one of the two."""
    written(folder, {"sound.csv": CSV, "sound.toml": toml({**MAPPING, "table": "changed.csv"})})


def changed_table(random: Random, name: str, content: bytes) -> bytes:
    """Another value in the mapping, or in a cell."""
    if name.endswith(".toml"):
        return changed_toml(COLUMNS)(random, name, content)
    lines = [line.split(b",") for line in content.split(b"\n")]
    line = random.choice(lines)
    line[random.randrange(len(line))] = str(random.choice((*VALUES, "nan", "1e999"))).encode(errors="replace")
    return b"\n".join(map(b",".join, lines))


def read_table(path: Path) -> Hashable:
    """The grasps that a mapping names, this one or the sound one."""
    return foreign_grasps.read_any(path if path.suffix == ".toml" else path.with_name("sound.toml"))


ARCHIVES = Reader("archive", archives, foreign_grasps.read_any, changed_archive, (b"ustar", b"\x1f\x8b", b"0" * 11))
TABLES = Reader("table", tables, read_table, changed_table, (*WORDS, b",", b'"', b"\r\n"), prepare_tables)
