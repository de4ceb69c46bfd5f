"""Plain values as TOML, also those that no reader expects."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from random import Random
from typing import Any

from fuzz.mutations import VALUES, changed_value

WORDS = tuple(b"[ ] [[ ]] { } = . , # \"\"\" ''' \\u0000 1979-05-27T07:32:00Z 07:32:00 0x 0b1 1e9 inf nan true".split())
"""What TOML consists of."""


def toml(document: Mapping[str, Any]) -> bytes:
    """A document as TOML, all its tables inline."""
    return "\n".join(f"{_text(key)} = {_value(value)}" for key, value in document.items()).encode(errors="replace")


def changed_toml(values: tuple[Any, ...] = ()) -> Callable[[Random, str, bytes], bytes]:
    """A change of the values of a TOML file; `values` are tried besides those of `mutations`."""

    def change(random: Random, name: str, content: bytes) -> bytes:
        if random.random() < 0.02:
            deep = random.choice((50, 5000, 30000))
            return content + random.choice(
                (b"\nx = " + b"[" * deep, b"\nx=" + b"{a=" * deep, b"\nx" + b".a" * deep + b"=1")
            )
        try:
            document = tomllib.loads(content.decode())
        except (ValueError, RecursionError):
            return content
        return toml(changed_value(random, document, (*VALUES, *values, *values)))

    return change


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_text(key)} = {_value(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int) and abs(value) > 2**64:
        return hex(value)  # which may be longer than decimal numbers
    return str(value).lower() if isinstance(value, bool | float) else str(value)


def _text(text: Any) -> str:
    return json.dumps(str(text)).replace("\x7f", "\\u007f")
