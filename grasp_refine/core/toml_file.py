"""TOML files from untrusted sources, read with bounded memory."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

MAX_FILE_BYTES = 2**24
"""Most bytes of a file: 16 MiB, or 100,000 jobs."""

MAX_KEY_PARTS = 64
"""Most parts of a key like a.b.c. Memory and time of Python's parser grow with their square: 3 GB for a line of
60 KB."""

KEY_END_CHARACTERS = frozenset(",=[]{}\n")
"""Characters that end a key."""

QUOTED_TEXT = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\\?\Z)|"(?:[^"\\\n]|\\.)*+"?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
"""Strings, multi-line ones first, and comments. An unterminated string extends to the end: parsing fails there."""

UNREADABLE = (OSError, ValueError)
"""Errors that `read_toml` raises."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables and values of a TOML file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is not TOML, too large, or nested too deep; the message names which.
    """
    if (size := path.stat().st_size) > MAX_FILE_BYTES:
        raise ValueError(f"has {size / 2**20:.0f} MiB; at most {MAX_FILE_BYTES // 2**20} are read")
    text = path.read_text(encoding="utf-8")
    parts = 0
    for part in QUOTED_TEXT.sub(lambda found: "" if found[0][0] == "#" else "quoted", text).split("."):
        parts += 1
        if parts > MAX_KEY_PARTS:
            raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts")
        if KEY_END_CHARACTERS & set(part):
            parts = 1
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists or tables are nested too deep") from None
