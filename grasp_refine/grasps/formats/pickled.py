"""What a pickle holds, without running it: numbers, text, plain containers and NumPy arrays, nothing else.

Python's own unpickler imports and calls whatever a pickle names. Here its opcodes are interpreted instead: the few
names that NumPy and plain containers need are understood, not imported, and every other name is refused. What comes
out is bounded by the size of what went in.
"""

from __future__ import annotations

import io
import pickletools
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, Literal

import numpy as np

DEPTH = 32
"""Containers may lie in each other this deep; grasp files need 5."""
SPREAD = 16
"""How much larger than a pickle its values may be, where it names one part several times."""
SMALLEST = 8
"""What any value counts, in bytes."""
MOST_STEPS = 5_000_000
"""Opcodes that are interpreted: about ten seconds, and a gigabyte if all make small lists."""
ALLOWANCE = 2**20
"""Values that may be there whatever the pickle's size, in bytes."""
KINDS = "biufUS"
"""Kinds of NumPy types that are read: truth values, numbers and text."""
CODE = re.compile(rf"[<>=|]?[{KINDS}O?][0-9]{{0,9}}")
"""How pickles call these, and objects."""
LARGEST_NUMBER = 2**64
"""Whole numbers beyond it are refused."""

BOMB = "is a pickle bomb: what it holds is far larger than the file"
READ = "only numbers, text, lists, dicts and NumPy arrays are read"
PUSHED = frozenset(
    "NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING "
    "BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8".split()
)
"""Opcodes whose argument is a value."""
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}


class Refused(Exception):
    """A pickle that is damaged, or holds what is not read; the message goes behind the path of the file."""


@dataclass(frozen=True)
class _Name:
    """Something that a pickle would import."""

    name: str


@dataclass(eq=False)
class _Dtype:
    """A NumPy type."""

    code: str
    order: Literal["<", ">", "|", "="] = "="

    def built(self, state: Any) -> None:
        """Take over the byte order."""
        if not (isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">", "|", "=")):
            raise Refused("a NumPy type in it is damaged")
        self.order = state[1]

    def dtype(self) -> np.dtype:
        """The type itself."""
        # Nothing else reaches NumPy, which would understand whole structures.
        if not CODE.fullmatch(self.code):
            raise Refused(f"holds an array of the type {self.code[:40]!r}, which is refused: {READ}")
        try:
            dtype = np.dtype(self.code)
        except (TypeError, ValueError):
            raise Refused(f"holds an array of the type {self.code!r}, which is no type of NumPy") from None
        return dtype if self.order in "|=" or dtype.kind == "O" else dtype.newbyteorder(self.order)


@dataclass(eq=False)
class _Array:
    """A NumPy array, or its entries where those are objects; None until the pickle has said all of it."""

    value: Any = None

    def built(self, state: Any) -> None:
        """Fill it."""
        if not (isinstance(state, tuple) and len(state) in (4, 5)):
            raise Refused("an array in it is damaged")
        shape, dtype, fortran, data = state[-4:]
        self.value = _filled(data, dtype, shape, "F" if fortran else "C")


def _filled(data: Any, of: Any, shape: Any, order: Literal["C", "F"]) -> Any:
    """The array of a shape that some bytes are, or the list of its objects."""
    if not isinstance(of, _Dtype) or not isinstance(shape, tuple):
        raise Refused("an array in it is damaged")
    if len(shape) > DEPTH or not all(type(length) is int and length >= 0 for length in shape):
        raise Refused("an array in it is damaged")
    dtype = of.dtype()
    if dtype.kind == "O":
        if len(shape) > 1 or not isinstance(data, list) or len(data) != prod(shape):
            raise Refused(f"holds an array of objects of shape {shape}; only lists of objects are read")
        return data if shape else data[0]
    if isinstance(data, str):
        # Python 2 had no other bytes than text.
        data = data.encode("latin-1", errors="replace")
    if not isinstance(data, bytes | bytearray) or len(data) != prod(shape) * dtype.itemsize or not dtype.itemsize:
        held = f"{len(data)} bytes" if isinstance(data, bytes | bytearray) else "no bytes"
        raise Refused(f"an array of shape {shape} and type {dtype} in it is damaged: it holds {held}")
    try:
        return np.frombuffer(data, dtype).reshape(shape, order=order)
    except ValueError as error:
        raise Refused(f"an array of shape {shape} in it is damaged ({error})") from None


def _dtype(code: Any, *_: Any) -> _Dtype:
    if not isinstance(code, str):
        raise Refused("a NumPy type in it is damaged")
    return _Dtype(code)


def _scalar(of: Any, data: Any = None) -> Any:
    value = _filled(data, of, (), "C")
    return value.item() if isinstance(value, np.ndarray) else value


def _from_buffer(data: Any, of: Any, shape: Any, order: Any) -> _Array:
    return _Array(_filled(data, of, shape, "F" if order == "F" else "C"))


def _encoded(text: Any, encoding: Any) -> bytes:
    # How bytes are written where there is no opcode for them; other encodings could be bombs.
    if not (isinstance(text, str) and encoding in ("latin1", "latin-1")):
        raise Refused(f"holds text in the encoding {encoding!r}; only latin1 is read")
    return text.encode("latin-1", errors="replace")


def _listed(items: Any = ()) -> list[Any]:
    if not isinstance(items, list | tuple):
        raise Refused("a set in it is damaged")
    return list(items)


def _ordered(pairs: Any = ()) -> dict[Any, Any]:
    if not isinstance(pairs, list | tuple):
        raise Refused("a dict in it is damaged")
    # Longer ones could be one long list many times over.
    if not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in pairs):
        raise Refused("a dict in it is damaged")
    return _entries([entry for pair in pairs for entry in pair])


def _entries(flat: Sequence[Any]) -> dict[Any, Any]:
    """The dict of keys and values that follow each other."""
    keys = flat[::2]
    # A hash of anything else could recurse without end.
    wrong = [key for key in keys if not isinstance(key, str | bytes | int | float | None)]
    if wrong or len(flat) % 2:
        raise Refused("holds a dict whose keys are not text or numbers")
    return dict(zip(keys, flat[1::2], strict=True))


NUMPY = ("numpy.core.", "numpy._core.")
CALLS: dict[str, Callable[..., Any]] = {
    **{f"{module}multiarray._reconstruct": lambda *_: _Array() for module in NUMPY},
    **{f"{module}multiarray.scalar": _scalar for module in NUMPY},
    **{f"{module}numeric._frombuffer": _from_buffer for module in NUMPY},
    "numpy.dtype": _dtype,
    "_codecs.encode": _encoded,
    "collections.OrderedDict": _ordered,
    **{f"{module}.bytes": lambda: b"" for module in ("builtins", "__builtin__")},
    **{f"{module}.{name}": _listed for module in ("builtins", "__builtin__") for name in ("set", "frozenset", "list")},
}
"""What a pickle may call, and what is done instead."""
NAMES = {*CALLS, "numpy.ndarray"}
"""What a pickle may name."""


class _Machine:
    """The stack and the memo of an unpickler."""

    def __init__(self, room: int) -> None:
        self.room = room
        """What may still be copied, in bytes or entries."""
        self.stack: list[Any] = []
        self.marked: list[list[Any]] = []
        self.memo: dict[int, Any] = {}

    def step(self, opcode: str, argument: Any) -> None:
        """Do what an opcode asks for."""
        stack = self.stack
        if opcode in PUSHED:
            if isinstance(argument, int) and abs(argument) >= LARGEST_NUMBER:
                raise Refused("holds a whole number of more than 64 bits")
            stack.append(CONSTANTS.get(opcode, argument))
        elif opcode == "MARK":
            self.marked.append(stack)
            self.stack = []
        elif opcode in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memo[argument] = stack[-1]
        elif opcode == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif opcode in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self.memo[argument])
        elif opcode in ("GLOBAL", "STACK_GLOBAL"):
            stack.append(_named(argument.split(" ") if opcode == "GLOBAL" else (stack.pop(), stack.pop())[::-1]))
        elif opcode == "REDUCE":
            arguments, called = stack.pop(), stack.pop()
            self._spend(arguments)
            stack.append(_called(called, arguments))
        elif opcode == "BUILD":
            state = stack.pop()
            self._spend(state)
            if not isinstance(stack[-1], _Array | _Dtype):
                raise Refused(f"holds an object with a state of its own, which is refused: {READ}")
            stack[-1].built(state)
        elif opcode == "DUP":
            stack.append(stack[-1])
        elif opcode == "POP":
            self._pop() if not stack else stack.pop()
        elif opcode == "POP_MARK":
            self._pop()
        elif opcode in ("INST", "OBJ", "NEWOBJ", "NEWOBJ_EX"):
            # INST names its class itself; the others would have met a name that is refused.
            named = _named(argument.split(" ")).name if opcode == "INST" else "a class"
            raise Refused(f"holds an object of {named}, which is refused: {READ}")
        else:
            self._contain(opcode)

    def _spend(self, parts: Any) -> None:
        """Take what is about to be copied from what may be: a pickle can name one part many times."""
        if isinstance(parts, tuple):
            self.room -= sum(len(part) for part in parts if isinstance(part, str | bytes | bytearray | list | tuple))
        if self.room < 0:
            raise Refused(BOMB)

    def _contain(self, opcode: str) -> None:
        """Make or fill a container."""
        if opcode.startswith("EMPTY_"):
            empty: dict[str, Any] = {"EMPTY_LIST": [], "EMPTY_SET": [], "EMPTY_DICT": {}, "EMPTY_TUPLE": ()}
            self.stack.append(empty[opcode])
        elif opcode in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(opcode[-1])
            entries = tuple(self.stack[-count:])
            if len(entries) < count:
                raise IndexError
            self.stack[-count:] = [entries]
        elif opcode in ("LIST", "TUPLE", "DICT", "FROZENSET"):
            items = self._pop()
            self.stack.append(_entries(items) if opcode == "DICT" else tuple(items) if opcode == "TUPLE" else items)
        elif opcode in ("APPEND", "APPENDS", "ADDITEMS"):
            items = [self.stack.pop()] if opcode == "APPEND" else self._pop()
            self._top(list).extend(items)
        elif opcode in ("SETITEM", "SETITEMS"):
            value = self.stack.pop() if opcode == "SETITEM" else None
            items = [self.stack.pop(), value] if opcode == "SETITEM" else self._pop()
            self._top(dict).update(_entries(items))
        else:
            raise Refused(f"holds the pickle opcode {opcode}, which is refused: {READ}")

    def _pop(self) -> list[Any]:
        """What was pushed since the last mark, which is gone then."""
        items, self.stack = self.stack, self.marked.pop()
        return items

    def _top(self, kind: type) -> Any:
        if type(self.stack[-1]) is not kind:
            raise Refused("is a damaged pickle: it fills what is no container")
        return self.stack[-1]


def _named(words: Sequence[Any]) -> _Name:
    if len(words) != 2 or not all(isinstance(word, str) for word in words):
        raise Refused("is a damaged pickle: it names something without a name")
    name = ".".join(words)
    if name not in NAMES:
        raise Refused(f"holds a call of {name[:80]!r}, which is refused and was not run: {READ}".replace("'", ""))
    return _Name(name)


def _called(called: Any, arguments: Any) -> Any:
    if not (isinstance(called, _Name) and called.name in CALLS and isinstance(arguments, tuple)):
        raise Refused(f"holds a call of what is no function, which is refused: {READ}")
    try:
        return CALLS[called.name](*arguments)
    except TypeError:
        raise Refused(f"holds a call of {called.name} with {len(arguments)} arguments, which is damaged") from None


def unpickled(data: bytes) -> Any:
    """What a pickle holds: None, truth values, numbers, text, bytes, lists (also for sets), tuples, dicts and arrays.

    Arrays have numbers or text; an array of objects is a list of them, or its only one.

    Raises:
        Refused: it is damaged, names something that is no part of these, or would become much larger than it is.
    """
    room = SPREAD * len(data) + ALLOWANCE
    machine = _Machine(room)
    try:
        with warnings.catch_warnings():
            # Text of the oldest protocol may have escapes that Python does not know.
            warnings.simplefilter("ignore", DeprecationWarning)
            for step, (opcode, argument, _) in enumerate(pickletools.genops(io.BytesIO(data))):
                if step > MOST_STEPS:
                    raise Refused(f"holds too much: it takes more than {MOST_STEPS / 1e6:g} million steps to read")
                if opcode.name == "STOP":
                    return _plain(machine.stack.pop(), [room])
                if opcode.name not in ("PROTO", "FRAME"):
                    machine.step(opcode.name, argument)
    except (IndexError, KeyError):
        raise Refused("is a damaged pickle: it uses what it did not make") from None
    except (ValueError, OverflowError) as error:
        raise Refused(f"is a damaged or cut off pickle ({str(error)[:80]})") from None
    raise Refused("is a cut off pickle")


def _plain(value: Any, budget: list[int], depth: int = 0) -> Any:
    """The value with arrays in place; what is named several times is counted as often."""
    size = value.nbytes if isinstance(value, np.ndarray) else SMALLEST
    budget[0] -= size + (len(value) if isinstance(value, str | bytes | bytearray) else 0)
    if budget[0] < 0:
        raise Refused(BOMB)
    if depth > DEPTH:
        raise Refused(f"holds lists or dicts more than {DEPTH} deep in each other")
    if isinstance(value, _Array):
        return _plain(value.value, budget, depth + 1)
    if isinstance(value, list | tuple):
        return type(value)(_plain(item, budget, depth + 1) for item in value)
    if isinstance(value, dict):
        return {key: _plain(item, budget, depth + 1) for key, item in value.items()}
    if isinstance(value, _Name | _Dtype):
        raise Refused(f"holds {value.name if isinstance(value, _Name) else 'a NumPy type'} itself: {READ}")
    return value
