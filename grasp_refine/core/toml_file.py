"""What a TOML file holds, read with bounded memory whoever wrote it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

LARGEST = 2**24
"""Bytes of a file: 16 MiB, or 100,000 jobs."""

DEEPEST = 64
"""Parts of a key like a.b.c. Python's reader takes memory and time with their square: 3 GB for a line of 60 KB."""

ENDS = frozenset(",=[]{}\n")
"""What a key does not go on behind."""

QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\\?\Z)|"(?:[^"\\\n]|\\.)*+"?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
"""Texts, of several lines first, and comments. Behind a text without end nothing counts: reading ends there."""

UNREADABLE = (OSError, ValueError)
"""What `read_toml` raises."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables and values of a TOML file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no TOML, too large, or nested too deep; says which.
    """
    if (size := path.stat().st_size) > LARGEST:
        raise ValueError(f"has {size / 2**20:.0f} MiB; at most {LARGEST // 2**20} are read")
    text = path.read_text(encoding="utf-8")
    parts = 0
    for part in QUOTED.sub(lambda found: "" if found[0][0] == "#" else "quoted", text).split("."):
        parts += 1
        if parts > DEEPEST:
            raise ValueError(f"a key has more than {DEEPEST} parts")
        if ENDS & set(part):
            parts = 1
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists or tables are nested too deep") from None
