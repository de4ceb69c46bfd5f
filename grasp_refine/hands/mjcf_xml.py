"""The XML of an MJCF before MuJoCo reads it: whether it is one, its includes, and what no file of a hand may hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from grasp_refine.core.errors import HandError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_file

if TYPE_CHECKING:
    from lxml.etree import _Element

MJCF_SUFFIXES = (".xml", ".mjcf")
"""Suffixes of MJCF files."""

MAX_BODIES = 1000
"""Most bodies of a hand, as for links of a URDF."""

REFUSED = ("extension", "plugin", "flexcomp", "composite", "flex")
"""Elements that would load plugins, or make soft bodies."""

FILE_ADVICE = "it must be a MuJoCo XML file with its meshes where it names them"

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_FIRST = re.compile(rb"<\s*([A-Za-z]\w*)")


def is_mjcf(path: Path) -> bool:
    """Return True if the outermost element of a file is that of an MJCF; False if it cannot be read."""
    try:
        return path.suffix.lower() != ".urdf" and _outermost(path.read_bytes()) == b"mujoco"
    except OSError:
        return False


def check_xml(path: Path) -> None:
    """Refuse an MJCF that is no hand, or that would not be safe to read: its text, and those that it includes.

    Raises:
        HandError: it is missing, a URDF, holds one of `REFUSED`, or repeats bodies more than `MAX_BODIES` times.
    """
    if not path.is_file():
        raise HandError(f"{path}: no such MJCF file")
    refuse_lfs_pointer(path, "MJCF", HandError)
    outermost = _outermost(path.read_bytes())
    if outermost == b"robot":
        raise HandError(f"{path}: a URDF, not an MJCF; {FILE_ADVICE}")
    for file in included(path):
        for element in _elements(file):
            if element.tag in REFUSED:
                raise HandError(f"{file}: holds <{element.tag}>: plugins and soft bodies are not supported in a hand")
            if element.tag == "replicate":
                _check_count(element, file)


def included(path: Path) -> tuple[Path, ...]:
    """Return an MJCF and the files that it includes, directly or not; those that do not exist are left out."""
    found = [path]
    for file in found:
        for element in _elements(file):
            # As MuJoCo does, whatever the folder of the file that includes.
            inner = path.parent / element.get("file", "")
            if element.tag == "include" and is_file(inner) and not any(inner.samefile(other) for other in found):
                found.append(inner)
    return tuple(found)


def _outermost(data: bytes) -> bytes | None:
    first = _FIRST.search(_COMMENT.sub(b"", data))
    return None if first is None else first[1]


def _elements(path: Path) -> Iterator[_Element]:
    """Yield the elements of a file; none of one that is no XML, which MuJoCo reports."""
    from lxml import etree

    parser = etree.XMLParser(
        # MuJoCo reads bytes as UTF-8, whatever a file declares.
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        yield from etree.fromstring(path.read_bytes(), parser).iter()
    except etree.XMLSyntaxError:
        return


def _check_count(element: _Element, path: Path) -> None:
    """Refuse a <replicate> that, with those around it, makes too many copies."""
    total = 1
    for outer in (element, *element.iterancestors("replicate")):
        text = outer.get("count", "1")
        total *= int(text) if text.strip().isdecimal() else 1
    if total > MAX_BODIES:
        raise HandError(f"{path}: <replicate> makes {total} copies, more than the {MAX_BODIES} that a hand may have")
