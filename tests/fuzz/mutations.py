"""What becomes of a sound input: bytes and plain values changed at random, towards what readers trip over."""

from __future__ import annotations

import copy
import re
import string
import struct
from collections.abc import Sequence
from random import Random
from typing import Any

LARGEST_INPUT = 2**16
"""Bytes of an input, so that what is slow or large is the reader's doing."""

INTEGERS = (0, 1, 2, 3, 7, 127, 128, 255, 256, 2**15, 2**16 - 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
NUMBERS = b"0 -0 1 -1 2 3 99 -99999 1e-300 5e-324 1e300 -1e308 1e400 nan inf -inf NaN 1_0 0x10 1e 1.2.3 -".split() + [
    b"4294967295",
    b"18446744073709551616",
    b"9" * 400,
    b"9" * 5000,
    "\u0663".encode(),
]
"""As text."""
LETTERS = (b"", b"\0", b"\n", b"\r", b"\t", b" ", b"\\", b'"', b"'", b"%s", b"{}", b"\x1b[2J", b"\xff", b"\xed\xa0\x80")
PATHS = (b"..", b"../outside/secret", b"/etc/passwd", b"//server/share", b"http://127.0.0.1:9/x", b"file:///etc/passwd")
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


def changed_bytes(random: Random, data: bytes, words: Sequence[bytes], others: Sequence[bytes]) -> bytes:
    """`data` after one to eight changes; `words` are of its format, `others` are inputs to borrow from."""
    for _ in range(random.choice((1, 1, 1, 2, 3, 5, 8))):
        data = random.choice(CHANGES)(random, data, words, others)[:LARGEST_INPUT]
    return data


def _flip(random: Random, data: bytes, *_: Any) -> bytes:
    if not data:
        return data
    at = random.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << random.randrange(8))]) + data[at + 1 :]


def _set(random: Random, data: bytes, *_: Any) -> bytes:
    at = random.randrange(len(data) + 1)
    return data[:at] + bytes([random.randrange(256)]) + data[at + 1 :]


def _integer(random: Random, data: bytes, *_: Any) -> bytes:
    form = random.choice(("<B", "<H", ">H", "<I", ">I", "<Q", ">Q"))
    size = struct.calcsize(form)
    word = struct.pack(form, random.choice(INTEGERS) % 256**size)
    at = random.randrange(len(data) + 1)
    return data[:at] + word + data[at + size :]


def _real(random: Random, data: bytes, *_: Any) -> bytes:
    form = random.choice(("<f", ">f", "<d", ">d"))
    word = struct.pack(form, random.choice((0.0, -0.0, 1e38, -1e-38, float("nan"), float("inf"), 1e-45)))
    at = random.randrange(0, len(data) + 1, 4)
    return data[:at] + word + data[at + len(word) :]


def _part(random: Random, data: bytes) -> tuple[int, int]:
    start = random.randrange(len(data) + 1)
    return start, min(len(data), start + random.choice((1, 2, 4, 8, 16, 50, 84, 256, 4096)))


def _delete(random: Random, data: bytes, *_: Any) -> bytes:
    start, end = _part(random, data)
    return data[:start] + data[end:]


def _repeat(random: Random, data: bytes, *_: Any) -> bytes:
    start, end = _part(random, data)
    return data[:end] + data[start:end] * random.choice((1, 2, 10, 300)) + data[end:]


def _cut(random: Random, data: bytes, *_: Any) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _borrow(random: Random, data: bytes, words: Sequence[bytes], others: Sequence[bytes]) -> bytes:
    other = random.choice(others) if others else data
    start, end = _part(random, other)
    at = random.randrange(len(data) + 1)
    return data[:at] + other[start:end] + data[at:]


def _word(random: Random, data: bytes, words: Sequence[bytes], others: Sequence[bytes]) -> bytes:
    at = random.randrange(len(data) + 1)
    return data[:at] + random.choice((*words, *LETTERS, *PATHS)) + data[at + random.choice((0, 0, 1, 4)) :]


def _number(random: Random, data: bytes, *_: Any) -> bytes:
    found = list(NUMBER.finditer(data[:4096]))
    if not found:
        return data
    match = random.choice(found)
    return data[: match.start()] + random.choice(NUMBERS) + data[match.end() :]


def _line(random: Random, data: bytes, *_: Any) -> bytes:
    lines = data.split(b"\n")
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    kind = random.randrange(3)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(at, lines[other])
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


CHANGES = (_flip, _set, _integer, _real, _delete, _repeat, _cut, _borrow, _word, _number, _number, _line)

VALUES: tuple[Any, ...] = (
    *(0, 1, -1, 2, 255, 2**31, 16**9000, 2**53 + 1, 2**63, 2**64, -(2**63), 10**400),
    *(0.0, -0.0, 0.5, 1e-12, 1e-300, 5e-324, 1e6, 1e30, 1e300, -1e308, float("nan"), float("inf"), -float("inf")),
    *(True, False, "", " ", "x", "\n", "a\nb", "\t", "\0", "\x1b[2J", "\x9b2J", "\u202e", "\ud7ff", "\u00e9", "nan"),
    *(
        "..",
        ".",
        "/",
        "../outside/secret",
        "/etc/passwd",
        "~",
        "~root/x",
        "~nobody-here/x",
        "http://127.0.0.1:9/x",
        "file:///etc/passwd",
    ),
    *("package://outside/secret.stl", "a" * 300, "a/" * 3000, "*", "**", "[", "x:1,2,3", "box:1,1,1", "default"),
)
"""Values that readers may not expect."""


def changed_value(random: Random, value: Any, values: Sequence[Any] = VALUES) -> Any:
    """A copy of dicts, lists and plain values with one to three parts replaced, left out, nested or exchanged."""
    value = copy.deepcopy(value)
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        value = _changed_once(random, value, values)
    return value


def _changed_once(random: Random, value: Any, values: Sequence[Any]) -> Any:
    places = list(_places(value))
    if not places:
        return random.choice(values)
    inside, key = random.choice(places)
    kind = random.randrange(9)
    if kind < 4:
        inside[key] = random.choice(values)
    elif kind == 4:
        del inside[key]
    elif kind == 5 and isinstance(inside, dict):
        name = random.choice([text for text in values if isinstance(text, str)])
        inside[random.choice((name, f"{key}x", str(key).upper()))] = inside.pop(key)
    elif kind == 5:
        inside.insert(key, copy.deepcopy(inside[random.randrange(len(inside))]))
    elif kind == 6:
        inside[key] = random.choice(([], {}, [inside[key]], {"x": inside[key]}, [inside[key]] * 3))
    elif kind == 7:
        other, where = random.choice(places)
        if not any(part is inside for part, _ in _places(other[where])):
            inside[key] = copy.deepcopy(other[where])
    else:
        inside[key] = _near(random, inside[key])
    return value


def _near(random: Random, value: Any) -> Any:
    """A number or a text that is much like one."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int | float):
        return value * random.choice((-1, 2, 10, 1000, 0.001)) + random.choice((0, 0, 1, 1e-9))
    if isinstance(value, str) and value:
        at = random.randrange(len(value))
        return value[:at] + random.choice(string.printable) + value[at + random.randrange(2) :]
    return value


def _places(value: Any) -> Any:
    """Each dict or list in a value with each of its keys."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from _places(value[key])
