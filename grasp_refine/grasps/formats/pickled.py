"""Contents of a pickle, read without running it: numbers, text, plain containers and NumPy arrays, nothing else.

Python's own unpickler imports and calls whatever a pickle names. Here its opcodes are interpreted instead: the few
names that NumPy and plain containers need are understood, not imported, and every other name is refused. The size
of the result is bounded by that of the pickle.
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

MAX_DEPTH = 32
"""Greatest depth of nested containers; grasp files need 5."""
MAX_GROWTH = 16
"""Greatest ratio of the size of the values to that of the pickle, which may name one part several times."""
MIN_VALUE_BYTES = 8
"""Smallest size in bytes that a value counts as."""
MAX_STEPS = 5_000_000
"""Most opcodes that are interpreted: about ten seconds, and a gigabyte if all make small lists."""
FREE_BYTES = 2**20
"""Size of values in bytes that is allowed whatever the pickle's size."""
ARRAY_KINDS = "biufUS"
"""Kinds of NumPy types that are read: booleans, numbers and text."""
TYPE_CODE = re.compile(rf"[<>=|]?[{ARRAY_KINDS}O?][0-9]{{0,9}}")
"""Type codes of these, and of objects, in pickles."""
INTEGER_LIMIT = 2**64
"""Integers of this magnitude or more are refused."""

BOMB_MESSAGE = "is a pickle bomb: what it holds is far larger than the file"
READABLE = "only numbers, text, lists, dicts and NumPy arrays are read"
VALUE_OPCODES = frozenset(
    "NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING "
    "BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8".split()
)
"""Opcodes whose argument is a value."""
CONSTANT_OPCODES = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}


class Refused(Exception):
    """A pickle that is damaged, or holds what is not read; the message follows the path of the file."""


@dataclass(frozen=True)
class _Name:
    """Something that a pickle would import."""

    name: str


@dataclass(eq=False)
class _Dtype:
    """A NumPy type."""

    code: str
    order: Literal["<", ">", "|", "="] = "="

    def set_state(self, state: Any) -> None:
        """Take over the byte order."""
        if not (isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">", "|", "=")):
            raise Refused("a NumPy type in it is damaged")
        self.order = state[1]

    def dtype(self) -> np.dtype:
        """The type itself."""
        # Nothing else reaches NumPy, which would understand whole structures.
        if not TYPE_CODE.fullmatch(self.code):
            raise Refused(f"holds an array of the type {self.code[:40]!r}, which is refused: {READABLE}")
        try:
            dtype = np.dtype(self.code)
        except (TypeError, ValueError):
            raise Refused(f"holds an array of the type {self.code!r}, which is no type of NumPy") from None
        return dtype if self.order in "|=" or dtype.kind == "O" else dtype.newbyteorder(self.order)


@dataclass(eq=False)
class _Array:
    """A NumPy array, or its entries where those are objects; None until the pickle has given all of it."""

    value: Any = None

    def set_state(self, state: Any) -> None:
        """Fill it."""
        if not (isinstance(state, tuple) and len(state) in (4, 5)):
            raise Refused("an array in it is damaged")
        shape, dtype, fortran, data = state[-4:]
        self.value = _make_array(data, dtype, shape, "F" if fortran else "C")


def _make_array(data: Any, of: Any, shape: Any, order: Literal["C", "F"]) -> Any:
    """The array of a shape with some bytes as data, or the list of its objects."""
    if not isinstance(of, _Dtype) or not isinstance(shape, tuple):
        raise Refused("an array in it is damaged")
    if len(shape) > MAX_DEPTH or not all(type(length) is int and length >= 0 for length in shape):
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
    value = _make_array(data, of, (), "C")
    return value.item() if isinstance(value, np.ndarray) else value


def _from_buffer(data: Any, of: Any, shape: Any, order: Any) -> _Array:
    return _Array(_make_array(data, of, shape, "F" if order == "F" else "C"))


def _encode(text: Any, encoding: Any) -> bytes:
    # Bytes are written so where there is no opcode for them; other encodings could be bombs.
    if not (isinstance(text, str) and encoding in ("latin1", "latin-1")):
        raise Refused(f"holds text in the encoding {encoding!r}; only latin1 is read")
    return text.encode("latin-1", errors="replace")


def _list(items: Any = ()) -> list[Any]:
    if not isinstance(items, list | tuple):
        raise Refused("a set in it is damaged")
    return list(items)


def _dict(pairs: Any = ()) -> dict[Any, Any]:
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


NUMPY_MODULES = ("numpy.core.", "numpy._core.")
ALLOWED_CALLS: dict[str, Callable[..., Any]] = {
    **{f"{module}multiarray._reconstruct": lambda *_: _Array() for module in NUMPY_MODULES},
    **{f"{module}multiarray.scalar": _scalar for module in NUMPY_MODULES},
    **{f"{module}numeric._frombuffer": _from_buffer for module in NUMPY_MODULES},
    "numpy.dtype": _dtype,
    "_codecs.encode": _encode,
    "collections.OrderedDict": _dict,
    **{f"{module}.bytes": lambda: b"" for module in ("builtins", "__builtin__")},
    **{f"{module}.{name}": _list for module in ("builtins", "__builtin__") for name in ("set", "frozenset", "list")},
}
"""Functions that a pickle may call, and their replacements."""
ALLOWED_NAMES = {*ALLOWED_CALLS, "numpy.ndarray"}
"""Names that a pickle may import."""


class _Machine:
    """The stack and the memo of an unpickler."""

    def __init__(self, budget: int) -> None:
        self.budget = budget
        """Bytes or entries that may still be copied."""
        self.stack: list[Any] = []
        self.marked: list[list[Any]] = []
        self.memo: dict[int, Any] = {}

    def step(self, opcode: str, argument: Any) -> None:
        """Execute an opcode."""
        stack = self.stack
        if opcode in VALUE_OPCODES:
            if isinstance(argument, int) and abs(argument) >= INTEGER_LIMIT:
                raise Refused("holds an integer of more than 64 bits")
            stack.append(CONSTANT_OPCODES.get(opcode, argument))
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
            stack.append(_global(argument.split(" ") if opcode == "GLOBAL" else (stack.pop(), stack.pop())[::-1]))
        elif opcode == "REDUCE":
            arguments, called = stack.pop(), stack.pop()
            self._spend(arguments)
            stack.append(_call(called, arguments))
        elif opcode == "BUILD":
            state = stack.pop()
            self._spend(state)
            if not isinstance(stack[-1], _Array | _Dtype):
                raise Refused(f"holds an object with a state of its own, which is refused: {READABLE}")
            stack[-1].set_state(state)
        elif opcode == "DUP":
            stack.append(stack[-1])
        elif opcode == "POP":
            self._pop() if not stack else stack.pop()
        elif opcode == "POP_MARK":
            self._pop()
        elif opcode in ("INST", "OBJ", "NEWOBJ", "NEWOBJ_EX"):
            # INST names its class itself; the others would have met a name that is refused.
            named = _global(argument.split(" ")).name if opcode == "INST" else "a class"
            raise Refused(f"holds an object of {named}, which is refused: {READABLE}")
        else:
            self._contain(opcode)

    def _spend(self, parts: Any) -> None:
        """Subtract a copy from the budget: a pickle can name one part many times."""
        if isinstance(parts, tuple):
            self.budget -= sum(len(part) for part in parts if isinstance(part, str | bytes | bytearray | list | tuple))
        if self.budget < 0:
            raise Refused(BOMB_MESSAGE)

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
            raise Refused(f"holds the pickle opcode {opcode}, which is refused: {READABLE}")

    def _pop(self) -> list[Any]:
        """Return the values pushed since the last mark, and drop that mark."""
        items, self.stack = self.stack, self.marked.pop()
        return items

    def _top(self, kind: type) -> Any:
        if type(self.stack[-1]) is not kind:
            raise Refused("is a damaged pickle: it fills something other than a container")
        return self.stack[-1]


def _global(words: Sequence[Any]) -> _Name:
    if len(words) != 2 or not all(isinstance(word, str) for word in words):
        raise Refused("is a damaged pickle: it names something without a name")
    name = ".".join(words)
    if name not in ALLOWED_NAMES:
        raise Refused(f"holds a call of {name[:80]!r}, which is refused and was not run: {READABLE}".replace("'", ""))
    return _Name(name)


def _call(called: Any, arguments: Any) -> Any:
    if not (isinstance(called, _Name) and called.name in ALLOWED_CALLS and isinstance(arguments, tuple)):
        raise Refused(f"holds a call of something other than a function, which is refused: {READABLE}")
    try:
        return ALLOWED_CALLS[called.name](*arguments)
    except TypeError:
        raise Refused(f"holds a call of {called.name} with {len(arguments)} arguments, which is damaged") from None


def unpickle(data: bytes) -> Any:
    """Return what a pickle holds: None, booleans, numbers, text, bytes, lists (also for sets), tuples, dicts, arrays.

    Arrays have numbers or text; an array of objects is a list of them, or its only one.

    Raises:
        Refused: it is damaged, names anything else, or would become much larger than it is.
    """
    budget = MAX_GROWTH * len(data) + FREE_BYTES
    machine = _Machine(budget)
    try:
        with warnings.catch_warnings():
            # Text of the oldest protocol may have escapes that Python does not know.
            warnings.simplefilter("ignore", DeprecationWarning)
            for step, (opcode, argument, _) in enumerate(pickletools.genops(io.BytesIO(data))):
                if step > MAX_STEPS:
                    raise Refused(f"holds too much: it takes more than {MAX_STEPS / 1e6:g} million steps to read")
                if opcode.name == "STOP":
                    return _plain(machine.stack.pop(), [budget])
                if opcode.name not in ("PROTO", "FRAME"):
                    machine.step(opcode.name, argument)
    except (IndexError, KeyError):
        raise Refused("is a damaged pickle: it uses values that it did not make") from None
    except (ValueError, OverflowError) as error:
        raise Refused(f"is a damaged or cut off pickle ({str(error)[:80]})") from None
    raise Refused("is a cut off pickle")


def _plain(value: Any, budget: list[int], depth: int = 0) -> Any:
    """The value with arrays in place; a part that is named several times counts each time."""
    size = value.nbytes if isinstance(value, np.ndarray) else MIN_VALUE_BYTES
    budget[0] -= size + (len(value) if isinstance(value, str | bytes | bytearray) else 0)
    if budget[0] < 0:
        raise Refused(BOMB_MESSAGE)
    if depth > MAX_DEPTH:
        raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep")
    if isinstance(value, _Array):
        return _plain(value.value, budget, depth + 1)
    if isinstance(value, list | tuple):
        return type(value)(_plain(item, budget, depth + 1) for item in value)
    if isinstance(value, dict):
        return {key: _plain(item, budget, depth + 1) for key, item in value.items()}
    if isinstance(value, _Name | _Dtype):
        raise Refused(f"holds {value.name if isinstance(value, _Name) else 'a NumPy type'} itself: {READABLE}")
    return value
