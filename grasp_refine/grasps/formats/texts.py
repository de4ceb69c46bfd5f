"""Contents of a JSON, TOML or YAML file: plain values of bounded depth and size."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import yaml

from grasp_refine.core.toml_file import parse_toml
from grasp_refine.grasps.formats.pickled import MAX_DEPTH, Refused

MAX_TEXT_BYTES = 2**26
"""Largest size of a text in bytes; its values take up to twenty times as much."""
YAML_SUFFIXES = (".yaml", ".yml")
"""Endings of YAML files."""
TOML_SUFFIX = ".toml"
"""Ending of TOML files."""
YAML_START = re.compile(rb"(?:\xef\xbb\xbf)?(?:\s|#[^\n]*\n|%YAML[^\n]*\n|---\s)*[A-Za-z_][\w -]*:\s")
"""Start of a YAML file with a mapping: a key, behind comments."""
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def is_json(data: bytes) -> bool:
    """Return True where a file begins as JSON does, and no pickle: with a brace or a bracket."""
    return data.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in (b"{", b"[")


def is_yaml(data: bytes) -> bool:
    """Return True where a file begins as a YAML mapping does."""
    return YAML_START.match(data[:4096]) is not None


def load_json(data: bytes) -> Any:
    """Return the values of a JSON file.

    Raises:
        Refused: it is damaged, too large or too deep.
    """
    return _parsed(data, "JSON", json.loads)


def load_toml(data: bytes) -> Any:
    """Return the values of a TOML file.

    Raises:
        Refused: it is damaged, too large or too deep.
    """
    return _parsed(data, "TOML", parse_toml)


def _parsed(data: bytes, kind: str, parse: Callable[[str], Any]) -> Any:
    try:
        value = parse(_decoded(data, kind))
    except RecursionError:
        raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep") from None
    except ValueError as error:
        raise Refused(f"is no valid {kind} ({' '.join(str(error).split())[:80]})") from None
    _check_depth(value)
    return value


def load_yaml(data: bytes) -> Any:
    """Return the values of a YAML file, read by the safe loader; anchors, which can be bombs, are refused.

    Raises:
        Refused: it is damaged, too large or too deep.
    """
    text = _decoded(data, "YAML")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise Refused(f"refers to another part of itself (*{str(event.anchor)[:20]}), which is not read")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep")
        return yaml.load(text, Loader=LOADER)
    except yaml.YAMLError as error:
        if "nesting depth" in str(error):  # libyaml's own limit, which its scanner may meet before the events above
            raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep") from None
        raise Refused(f"is no valid YAML ({' '.join(str(error).split())[:120]})") from None
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        # Of the loader, on values that look like dates or numbers.
        raise Refused(f"holds a value that is not read ({' '.join(str(error).split())[:80]})") from None


def dump_json(content: Any) -> bytes:
    """Return the text of a JSON file."""
    return json.dumps(content).encode() + b"\n"


def dump_yaml(content: Any) -> bytes:
    """Return the text of a YAML file, keys in their order, short lists in one line."""
    return yaml.dump(content, Dumper=DUMPER, sort_keys=False, default_flow_style=None, width=120, encoding="utf-8")


def _decoded(data: bytes, kind: str) -> str:
    if len(data) > MAX_TEXT_BYTES:
        raise Refused(f"has {len(data) / 2**20:.0f} MiB of {kind}; at most {MAX_TEXT_BYTES / 2**20:.0f} are read")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refused(f"is no text in UTF-8 ({error.reason} at byte {error.start})") from None


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(MAX_DEPTH):
        level = [
            part
            for one in level
            if isinstance(one, dict | list)
            for part in (one.values() if isinstance(one, dict) else one)
            if isinstance(part, dict | list)
        ]
        if not level:
            return
    raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep")
