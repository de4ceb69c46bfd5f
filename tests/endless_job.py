"""A job of a benchmark for tests of its end; the processes import this file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class EndlessJob:
    """Compiled code that never ends, and lets no other thread of Python run."""

    begun: Path
    """Written when it begins."""
    work: float = 1.0
    label: str = "endless"

    def do(self, progress: Callable[[float], None]) -> None:
        self.begun.touch()
        re.match("(a+)+$", "a" * 60 + "b")
