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


def facade_blocks() -> list[str]:
    """Blocks of Python that use `import grasp_refine as gr`, in the order of the pages."""
    return [block for block in blocks("python") if re.search(r"\bgr\.", block)]


def python_block(mark: str) -> str:
    """The one block of Python that contains `mark`, those of the facade left out."""
    (block,) = (block for block in blocks("python") if mark in block and block not in facade_blocks())
    return block


def run_python(mark: str, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Names that the block of Python that contains `mark` leaves behind; `names` are known before."""
    names = {} if names is None else names
    exec(compile(python_block(mark), mark, "exec"), names)
    return names
