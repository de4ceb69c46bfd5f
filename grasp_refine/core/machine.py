"""Machine that computes: results are the same to the last bit on processors of one kind only."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any


def host() -> str:
    """Return the name of this machine."""
    return platform.node() or "localhost"


def machine() -> dict[str, Any]:
    """Return number and name of the processors, and the system."""
    return {"cpus": os.cpu_count(), "cpu": _processor(), "system": platform.platform()}


def _processor() -> str:
    """Return the model name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())
