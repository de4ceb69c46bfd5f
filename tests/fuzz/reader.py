"""What is fuzzed: a reader of files, with sound files to begin with and a way to change them that keeps their form."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

Change = Callable[[Random, str, bytes], bytes]
"""Changes a file of a name so that its form, such as XML, stays."""


def plain(text: str) -> str:
    """The text, which is one line of letters that a terminal only shows."""
    assert not any(unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") for letter in text), ascii(text[:80])
    return text


def nothing(folder: Path) -> None:
    """Prepare nothing."""


@dataclass(frozen=True)
class Reader:
    """A reader and what it is fed."""

    name: str
    """What it is called on the command line."""
    seeds: Callable[[], Sequence[tuple[str, bytes]]]
    """Sound files: name and content; the reader finds each under its name."""
    read: Callable[[Path], Hashable]
    """Reads a file and checks what came of it by `assert`; what it returns tells inputs of different kinds apart."""
    change: Change
    """A change that keeps the form; changed bytes come on top, now and then."""
    words: tuple[bytes, ...] = ()
    """What the format consists of."""
    prepare: Callable[[Path], None] = nothing
    """Puts beside the file what it may name."""
    cpu_limit: float = 10.0
    """Seconds of CPU that one input may take; inputs have at most 64 KiB."""
    beyond: Callable[[Path], bool] = lambda path: False
    """Whether a file outside of the folder may be read all the same."""
    starts_programs: bool = False
    """Whether it may read in a child process."""


def secrets(folder: Path) -> None:
    """Put files of all kinds into a folder that nothing may read."""
    folder.mkdir(parents=True, exist_ok=True)
    triangle = "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    for suffix in ("", ".stl", ".obj", ".mtl", ".npz", ".npy", ".toml", ".urdf", ".xml", ".bin", ".png"):
        (folder / f"secret{suffix}").write_text(triangle)


def written(folder: Path, files: Mapping[str, bytes | str]) -> None:
    """Write files below a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
