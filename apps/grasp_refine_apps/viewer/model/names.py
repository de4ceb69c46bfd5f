"""Names of objects for people, and names of files."""

from __future__ import annotations

import re

HASH = re.compile(r"(?<![0-9A-Za-z])([0-9a-f]{6})[0-9a-f]{10,}(?![0-9A-Za-z])", re.IGNORECASE)
"""Hash in the name of an object, and its beginning."""

MAX_FILE_BYTES = 200
"""Maximum bytes of a file's name without suffix; file systems take 255 with it."""


def shortened(name: str) -> str:
    """Return a name with hashes cut to their beginnings, for narrow places."""
    return HASH.sub(r"\1…", name)


def file_stem(name: str) -> str:
    """Return a name as that of a file without suffix: letters of any script, digits, and . _ - stay."""
    kept = "".join(char if char.isalnum() or char in "._-" else "_" for char in name)
    return kept.encode()[:MAX_FILE_BYTES].decode(errors="ignore").lstrip(".")
