"""The XML of an MJCF before MuJoCo reads it: recognition, includes, and elements that no hand may have."""

from __future__ import annotations

import re
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

UNBOUNDED_TAGS = ("replicate", "attach", "model", "include", "hfield", "size", "skin")
"""Elements that can demand more than the length of a file: such files are compiled in a child process first."""

UNBOUNDED_ATTRIBUTES = ("builtin", "actdim", "nsample", "maxhullvert")
"""Attributes that can do so in other elements."""

MAX_PLAIN_NUMBER = 1e5
"""Largest number in a file that is compiled at once."""

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_FIRST = re.compile(rb"<\s*([A-Za-z]\w*)")
_NUMBER = re.compile(r"\d+\.?\d*(?:[eE][+-]?\d+)?")


def is_mjcf(path: Path) -> bool:
    """Return True if the outermost element of a file is that of an MJCF; False if it cannot be read."""
    try:
        return path.suffix.lower() != ".urdf" and _outermost(path.read_bytes()) == b"mujoco"
    except OSError:
        return False


def named_xml(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return the name by which MuJoCo reads an MJCF, and the text in memory that it includes.

    MuJoCo goes by the suffix: text that has the name of the file with another suffix is read like it.
    """
    if path.suffix == ".xml":
        return str(path), {}
    file = str(path.with_name(f"{path.name}.xml"))
    return file, {file: path.read_bytes()}


def check_xml(path: Path) -> None:
    """Refuse an MJCF that is no hand, or that would not be safe to read: its text, and the files that it includes.

    Raises:
        HandError: it is missing, a URDF, no XML, holds one of `REFUSED`, or has more than `MAX_BODIES` bodies.
    """
    if not path.is_file():
        raise HandError(f"{path}: no such MJCF file")
    refuse_lfs_pointer(path, "MJCF", HandError)
    outermost = _outermost(path.read_bytes())
    if outermost == b"robot":
        raise HandError(f"{path}: a URDF, not an MJCF; {FILE_ADVICE}")
    for file in included(path):
        elements = _elements(file)
        for element in elements:
            if element.tag in REFUSED:
                raise HandError(f"{file}: holds <{element.tag}>: plugins and soft bodies are not supported in a hand")
            if element.tag == "replicate":
                _check_count(element, file)
        if (count := sum(element.tag == "body" for element in elements)) > MAX_BODIES:
            raise HandError(f"{file}: has {count} bodies, more than the {MAX_BODIES} that a hand may have")


def is_plain(path: Path) -> bool:
    """Return True if nothing in an MJCF that `check_xml` accepts can demand more than the length of its text."""
    return all(
        element.tag not in UNBOUNDED_TAGS
        and not any(name in UNBOUNDED_ATTRIBUTES for name in element.attrib)
        and not any(_largest(text) > MAX_PLAIN_NUMBER for text in element.attrib.values())
        for element in _elements(path)
    )


def included(path: Path) -> tuple[Path, ...]:
    """Return an MJCF and the MJCFs that it names, by <include> or <model>, directly or not.

    Files that do not exist are left out.

    Raises:
        HandError: one of them is no XML, or has another suffix than an MJCF.
    """
    found = [path]
    for file in found:
        elements = _elements(file)
        folders = {element.get("assetdir", "") for element in elements if element.tag == "compiler"} | {""}
        for element in elements:
            if element.tag not in ("include", "model") or not element.get("file"):
                continue
            # Relative to the outermost file, or to the one that names it.
            for place in (path.parent, file.parent, *(path.parent / folder for folder in sorted(folders))):
                inner = place / element.get("file", "")
                if not is_file(inner):
                    continue
                if inner.suffix.lower() not in MJCF_SUFFIXES:
                    raise HandError(f"{file}: <{element.tag}> names {inner.name}, which is no MJCF by its suffix")
                if not any(inner.samefile(other) for other in found):
                    found.append(inner)
    return tuple(found)


def _outermost(data: bytes) -> bytes | None:
    first = _FIRST.search(_COMMENT.sub(b"", data))
    return None if first is None else first[1]


def _elements(path: Path) -> list[_Element]:
    """Return the elements of a file.

    Raises:
        HandError: it is no XML in UTF-8, to a reader that is stricter than that of MuJoCo.
    """
    from lxml import etree

    parser = etree.XMLParser(
        # MuJoCo reads bytes as UTF-8, whatever a file declares.
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        remove_comments=True,
        remove_pis=True,
        # Comments with "--" are common; all other faults are refused.
        recover=True,
    )
    try:
        root = etree.fromstring(path.read_bytes(), parser)
    except etree.XMLSyntaxError as error:
        fault = str(error.msg)
    else:
        harmless = etree.ErrorTypes.ERR_HYPHEN_IN_COMMENT
        faults = [entry.message for entry in parser.error_log if entry.type != harmless]
        if root is not None and not faults:
            return list(root.iter(etree.Element))
        fault = faults[0] if faults else "it is empty"
    raise HandError(f"{path}: is no XML in UTF-8 ({' '.join(fault.split())}); {FILE_ADVICE}")


def _largest(text: str) -> float:
    """Return the largest size of the numbers in a text, as a lenient reader finds them."""
    numbers = _NUMBER.findall(text)
    return max((abs(float(number)) for number in numbers), default=0.0)


def _check_count(element: _Element, path: Path) -> None:
    """Refuse a <replicate> that makes too many copies, including the <replicate>s around it."""
    total = 1.0
    for outer in (element, *element.iterancestors("replicate")):
        total *= max(_largest(outer.get("count", "1")), 1.0)
    if total > MAX_BODIES:
        raise HandError(
            f"{path}: <replicate> makes {total:.0f} copies, more than the {MAX_BODIES} that a hand may have"
        )
