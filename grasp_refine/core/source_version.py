"""Version of a source tree: the release and the commit; used while building, and by programs that run from a checkout.

Imports nothing of the program, so that the build backend can load this file alone.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

RELEASE = "0.2.0"
"""Release that the sources are, or become."""

GIT_TIMEOUT_S = 5.0


def dynamic_metadata(settings: Mapping[str, Any], project: Mapping[str, Any]) -> dict[str, str]:
    """Return the version for the build backend, which calls this in the root of the sources."""
    return {"version": source_version(Path.cwd())}


def source_version(root: Path) -> str:
    """Return the version of the sources in a folder: "0.2.0+g1234567", "0.2.0+g1234567.dirty" with uncommitted changes.

    An sdist keeps the version that it was built with. Without git, or a repository of its own, it is the release alone.

    Args:
        root: Folder with pyproject.toml.
    """
    try:
        with (root / "PKG-INFO").open(encoding="utf-8") as file:
            return next(line.partition(":")[2].strip() for line in file if line.startswith("Version:"))
    except (OSError, StopIteration):
        commit = _commit(root)
        return f"{RELEASE}+g{commit}" if commit else RELEASE


def _commit(root: Path) -> str:
    """Return the abbreviated commit of the repository whose root is `root`, with ".dirty" where files differ; or ""."""
    if not (root / ".git").exists():  # git itself would take a repository around it
        return ""
    # Variables of a hook would name another repository; the index is only read.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"
    command = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--abbrev=7", "--dirty=.dirty"]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, stdin=subprocess.DEVNULL
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
