"""Provenance of the grasps in a result file: with what, and for what, they were refined."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from grasp_refine.core.npz_files import load_npz


def read_provenance(path: Path) -> dict[str, Any]:
    """Return the provenance of the grasps in a result file; empty for another grasp file.

    Raises:
        GraspFileError: it is damaged.
    """
    if path.suffix != ".npz" or path.is_dir():
        return {}
    text = str(load_npz(path, only=("provenance",)).entries.get("provenance", ""))
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
