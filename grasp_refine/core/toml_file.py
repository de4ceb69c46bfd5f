"""TOML files: from untrusted sources, read with bounded memory, and written."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
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
    return parse_toml(path.read_text(encoding="utf-8"))


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables and values of a TOML text of bounded length.

    Raises:
        ValueError: it is not TOML, or nested too deep; the message names which.
    """
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


def toml_text(entry: Mapping[str, Any], table: str = "") -> str:
    """Return an entry as TOML: values, which are numbers, strings and lists as in JSON, and then tables."""
    entry = {key: value for key, value in entry.items() if value is not None}
    flat = {key: value for key, value in entry.items() if not isinstance(value, Mapping)}
    lines = [f"[{table}]"] if table else []
    lines += [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in flat.items()]
    inner = [toml_text(value, f"{table}.{key}" if table else key) for key, value in entry.items() if key not in flat]
    return "\n".join(["\n".join(lines), *inner]) + ("\n" if lines and not inner else "")
