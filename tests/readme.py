"""What tests of README.md share: its blocks, and running those of Python."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str, text: str = TEXT) -> list[str]:
    """The fenced blocks of README.md in a language, or those of a part of it."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def section(heading: str) -> str:
    """What stands below a heading of the second level."""
    return TEXT.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def python_block(mark: str) -> str:
    """The one block of Python that contains `mark`."""
    (block,) = (block for block in blocks("python") if mark in block)
    return block


def run_python(mark: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """What the block of Python that contains `mark` has named in the end; `names` are known before."""
    names = {} if names is None else names
    exec(compile(python_block(mark), "README.md", "exec"), names)
    return names
