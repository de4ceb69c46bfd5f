"""Protocols out of files: TOML of a user, or the fields in a JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from grasp_refine.core.arguments import check_values, is_number
from grasp_refine.core.errors import GraspRefineError, quote_value
from grasp_refine.core.names import expand_user
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.registry import DEFAULT, PROTOCOLS

SUFFIX = ".toml"
"""Suffix of the file of a protocol."""

BASE_KEY, TYPE_KEY = "based_on", "type"
"""Key of the name of the protocol whose fields count where a file says nothing; key of a dataclass's name in JSON."""

MAX_MAGNITUDE = 1e12
"""Bound of the magnitude of numbers in SI units."""


def load_protocol(name: str) -> Protocol:
    """Return the protocol of a name, or in a TOML file.

    Args:
        name: Key of `PROTOCOLS`, or the path of a file that ends with .toml.

    Raises:
        GraspRefineError: there is none, or the file has a wrong key or value: names file, key and choices.
    """
    if name in PROTOCOLS:
        return PROTOCOLS[name]
    if not name.lower().endswith(SUFFIX):
        raise GraspRefineError(f"no protocol '{name}': there are {', '.join(PROTOCOLS)}, or a FILE{SUFFIX}")
    path = expand_user(Path(name))
    try:
        values = read_toml(path)
    except FileNotFoundError:
        raise GraspRefineError(f"{path}: no such file") from None
    except UNREADABLE as error:
        raise GraspRefineError(f"{path}: cannot be read as TOML ({error})") from None
    found = protocol_of_table({"name": path.stem, **values}, f"{path}: ")
    if found.name in PROTOCOLS:
        raise GraspRefineError(f"{path}: name must differ from {', '.join(PROTOCOLS)}, got {quote_value(found.name)}")
    return found


def protocol_of_table(values: Mapping[str, Any], where: str) -> Protocol:
    """Return the protocol of a table with some of its fields, and the name of the one that it is based on.

    Args:
        values: Field -> value, as for `protocol_of`, and `BASE_KEY`.
        where: Prefix of messages, such as the name of a file.

    Raises:
        GraspRefineError: as `protocol_of`, or there is no such protocol to base it on.
    """
    values = dict(values)
    base = values.pop(BASE_KEY, DEFAULT)
    if base not in list(PROTOCOLS):
        raise GraspRefineError(f"{where}{BASE_KEY} must be among {', '.join(PROTOCOLS)}, got {quote_value(base)}")
    # The soft weld of DexGraspBench belongs to its published outcomes, which another test does not reproduce.
    return protocol_of({"palm": "rigid", **values}, PROTOCOLS[base], where=where)


def protocol_of(values: Mapping[str, Any], base: Protocol = PROTOCOLS[DEFAULT], *, where: str = "") -> Protocol:
    """Return a protocol with the given fields, and another's where nothing is given.

    Args:
        values: Field -> value; `contact` and `noise` have a mapping.
        base: The other protocol.
        where: Prefix of messages, such as the name of a file.

    Raises:
        GraspRefineError: an unknown key, or a value of another type or out of range; names key and choices.
    """
    return _with_fields(base, values, where, "")


def _with_fields(base: Any, table: Mapping[str, Any], where: str, prefix: str) -> Any:
    """Return a dataclass with the given fields; `prefix` is the key of the dataclass itself, with a dot."""
    known = [field.name for field in fields(base)]
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in table.items() if key != TYPE_KEY
    }
    for key, value in values.items():
        if key not in known:
            choices = [*known, *([] if prefix else [BASE_KEY])]
            raise GraspRefineError(f"{where}no key '{prefix}{key}': there are {', '.join(choices)}")
        if not is_dataclass(getattr(base, key)):
            continue
        if not isinstance(value, Mapping):
            inner = ", ".join(field.name for field in fields(getattr(base, key)))
            raise GraspRefineError(f"{where}{prefix}{key} must be a table of {inner}, got {quote_value(value)}")
        values[key] = _with_fields(getattr(base, key), value, where, f"{prefix}{key}.")
    check_values(type(base), values, f"{where}{prefix}")
    for key, value in values.items():
        if is_number(value) and not abs(value) < MAX_MAGNITUDE:
            raise GraspRefineError(f"{where}{prefix}{key} must be below {MAX_MAGNITUDE:g}, got {quote_value(value)}")
    try:
        return replace(base, **values)
    except GraspRefineError as error:
        message = str(error).removeprefix(f"{type(base).__name__}: ")
        raise GraspRefineError(f"{where}{prefix}{message}") from None
