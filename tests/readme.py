"""README.md and the pages of the documentation: their blocks, and running those of Python."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
GUIDES = "docs/pages/guides"

PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs" / "pages").rglob("*.md")))
}
"""Path of each page -> its text."""

TEXT = "\n".join(PAGES.values())


def blocks(language: str, text: str = TEXT) -> list[str]:
    """Fenced blocks in a language, of all pages or of a text; those that several pages share come once."""
    found = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return list(dict.fromkeys(found))


def section(page: str, heading: str) -> str:
    """Text of a page below a heading of the second level."""
    return PAGES[page].partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


PYTHON = ("Config(starts=6", "T_ball.grad", "sum().backward()", "optimizer.step", "my_poses.npy")
"""Parts of the blocks of Python that a test runs by themselves."""


def extension_blocks() -> list[str]:
    """Blocks of Python of the guide on extensions, each of which runs by itself."""
    return blocks("python", PAGES[f"{GUIDES}/extend.md"])


def facade_blocks() -> list[str]:
    """The other blocks of Python, which run one after the other, in the order of the pages."""
    alone = extension_blocks()
    return [block for block in blocks("python") if block not in alone and not any(mark in block for mark in PYTHON)]


def python_block(mark: str) -> str:
    """The one block of Python that contains `mark`."""
    (block,) = (block for block in blocks("python") if mark in block)
    return block


def run_python(mark: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Names that the block of Python that contains `mark` leaves behind; `names` are known before."""
    names = {} if names is None else names
    exec(compile(python_block(mark), mark, "exec"), names)
    return names
