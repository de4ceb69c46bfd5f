"""JSON document of a command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from grasp_refine.core.json_files import SCHEMA, save_json
from grasp_refine.core.versions import versions


def save_document(path: Path | None, command: str, entries: Mapping[str, Any]) -> None:
    """Write the document of a command to the file that its option --json names, if it does.

    Args:
        path: The file; None: nothing is written.
        command: Words of the command, such as "assets list".
        entries: Entries after the schema, the command and the versions of the program and its packages.

    Raises:
        GraspRefineError: it cannot be written.
    """
    if path is not None:
        save_json(path, {"schema": SCHEMA, "command": command, "versions": versions(), **entries})
