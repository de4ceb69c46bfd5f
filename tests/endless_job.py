"""A job of a benchmark for tests of its end; the processes import this file."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

from grasp_refine_apps.bench.jobs import Job, Progress


def _run(begun: Path, progress: Progress) -> None:
    """Write a file, and run compiled code that never ends, and lets no other thread of Python run."""
    begun.touch()
    re.match("(a+)+$", "a" * 60 + "b")


def endless_job(begun: Path) -> Job:
    """Return a job that writes the file `begun` when it begins, and never ends."""
    return Job("endless", partial(_run, begun))
