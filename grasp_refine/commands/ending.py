"""How commands end: with an exit code, and with what they cost."""

from __future__ import annotations

from grasp_refine.stopwatch import cpu_seconds as cpu_seconds

NOTHING_USABLE = 1
"""Exit code when nothing usable came out."""
