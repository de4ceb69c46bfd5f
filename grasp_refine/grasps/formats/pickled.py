"""Contents of a pickle, read without running it: numbers, text, plain containers and NumPy arrays, nothing else.

Python's unpickler imports and calls whatever a pickle names. This subclass imports nothing: it has stand-ins for the
few functions that NumPy and plain containers need, and refuses every other name and whatever makes an object. The
size of the result is bounded by the size of the pickle.
"""

from __future__ import annotations

import io
import pickle
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from typing import Any, ClassVar

import numpy as np

MAX_DEPTH = 32
"""Greatest depth of nested containers; grasp files need 5."""
MAX_GROWTH = 16
"""Greatest ratio of the size of the values to that of the pickle, which may name one part several times."""
FREE_BYTES, MAX_BYTES = 2**20, 2**30
"""Size of values in bytes that is allowed whatever the pickle's size, and the largest size at all."""
MIN_VALUE_BYTES = 8
"""Smallest size in bytes that a value counts as."""
MAX_READS = 10_000_000
"""Most opcodes and arguments that are read: about ten seconds, and a gigabyte if all make small lists."""
ARRAY_KINDS = "biufUS"
"""Kinds of NumPy types that are read: booleans, numbers and text."""
TYPE_CODE = re.compile(rf"[<>=|]?[{ARRAY_KINDS}O?][0-9]{{0,9}}")
"""Type codes of these, and of objects, in pickles."""
INTEGER_LIMIT = 2**64
"""Integers of this magnitude or more are refused."""
MEMO_LIMIT = 2**32
"""Places in the memo from here on are refused, as the opcodes other than PUT have none."""

READABLE = "only numbers, text, lists, dicts and NumPy arrays are read"
DAMAGED = (pickle.UnpicklingError, EOFError, LookupError, ValueError, TypeError, AttributeError, OverflowError)
"""Errors that Python's unpickler raises on a damaged pickle."""


class Refused(Exception):
    """A pickle that is damaged, or has refused contents; the message follows the path of the file."""


class Damaged(Refused):
    """A pickle that is cut off, or no pickle at all."""


@dataclass
class Budget:
    """Size of what a pickle may still copy or return."""

    size: int
    """Bytes."""
    values: int
    """Number of values, or of copies."""

    def spend(self, value: Any) -> None:
        """Subtract one value; of a container only the places of its entries."""
        self.values -= 1
        self.size -= MIN_VALUE_BYTES
        if isinstance(value, np.ndarray):
            self.size -= value.nbytes
        elif isinstance(value, str | bytes | list | tuple):
            self.size -= len(value) * (1 if isinstance(value, str | bytes) else MIN_VALUE_BYTES)
        if min(self.size, self.values) < 0:
            raise Refused("is a pickle bomb: its contents are far larger than the file")


@dataclass(eq=False)
class _Dtype:
    """A NumPy type."""

    dtype: np.dtype

    def set_state(self, state: Any) -> None:
        """Take over the byte order."""
        if not (isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">", "|", "=")):
            raise ValueError("a NumPy type")
        self.dtype = self.dtype.newbyteorder(state[1])


@dataclass(eq=False)
class Array:
    """A NumPy array, or its entries where they are objects; Ellipsis until the pickle has given all of it."""

    value: Any = ...

    def set_state(self, state: Any) -> None:
        """Fill it."""
        *_, shape, dtype, fortran, data = state
        self.value = _values(data, dtype, shape, "F" if fortran else "C")


class Stated(Array):
    """An object of another program that holds its state and nothing else, such as a transform that holds an array."""

    def set_state(self, state: Any) -> None:
        """Take the state as the value."""
        self.value = state


def _values(data: Any, of: Any, shape: Any, order: Any) -> Any:
    """The array of a shape with some bytes as data, or the list of its objects."""
    dtype = of.dtype
    if len(shape) > MAX_DEPTH or not all(type(length) is int and 0 <= length < INTEGER_LIMIT for length in shape):
        raise ValueError("an array")
    if dtype.kind == "O":
        if len(shape) > 1 or not isinstance(data, list) or len(data) != prod(shape):
            raise Refused(f"holds an array of objects of shape {shape}; only lists of objects are read")
        return data if shape else data[0]
    # Python 2 had no other bytes than text.
    data = data.encode("latin-1", errors="replace") if isinstance(data, str) else data
    if not isinstance(data, bytes) or len(data) != prod(shape) * dtype.itemsize or not dtype.itemsize:
        held = f"{len(data)} bytes" if isinstance(data, bytes) else "no bytes"
        raise Refused(f"an array of shape {shape} and type {dtype} in it is damaged: it holds {held}")
    check_text(data, dtype)
    return np.frombuffer(data, dtype).reshape(shape, order="F" if order == "F" else "C")


def check_text(data: bytes, dtype: np.dtype) -> None:
    """Refuse an array of text with codes that are no characters: Python ends in errors of its own on them.

    Args:
        data: Bytes of the array.
        dtype: Type of the array; only text is checked.

    Raises:
        Refused: There is such a code.
    """
    if dtype.kind != "U":
        return
    codes = np.frombuffer(data, np.dtype(np.uint32).newbyteorder(dtype.byteorder))
    if codes.max(initial=0) > sys.maxunicode:
        raise Refused("holds text that is damaged: some of its characters do not exist")


def _dtype(code: Any, *_: Any) -> _Dtype:
    # Nothing else reaches NumPy, which would understand whole structures.
    if not TYPE_CODE.fullmatch(code):
        raise Refused(f"holds an array of the type {code[:40]!r}, which is refused: {READABLE}")
    return _Dtype(np.dtype(code))


def _scalar(of: Any, data: Any = None) -> Any:
    value = _values(data, of, (), "C")
    return value.item() if isinstance(value, np.ndarray) else value


def _encode(text: Any, encoding: Any) -> bytes:
    # Bytes are written so where there is no opcode for them; other encodings could be bombs.
    if encoding not in ("latin1", "latin-1"):
        # Lists in lists would take exponentially long to format.
        named = f"the encoding {encoding[:40]!r}" if isinstance(encoding, str) else "an encoding without a name"
        raise Refused(f"holds text in {named}; only latin1 is read")
    return str.encode(text, "latin-1", errors="replace")


def _list(items: Any = ()) -> list[Any]:
    if not isinstance(items, list | tuple):
        raise ValueError("a set")
    return list(items)


def _dict(pairs: Any = ()) -> dict[Any, Any]:
    # Longer ones could be one long list many times over.
    if not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in pairs):
        raise ValueError("a dict")
    return _entries([entry for pair in pairs for entry in pair])


def _entries(flat: Sequence[Any]) -> dict[Any, Any]:
    """The dict of keys and values that follow each other."""
    keys = flat[::2]
    # A hash of anything else could recurse without end; many large integers could have the same.
    if len(flat) % 2 or not all(isinstance(_small(key), str | bytes | int | float | None) for key in keys):
        raise Refused("holds a dict whose keys are not text or numbers")
    return dict(zip(keys, flat[1::2], strict=True))


def _small(value: Any) -> Any:
    """The value, unless it is an integer of more than 64 bits."""
    if isinstance(value, int) and abs(value) >= INTEGER_LIMIT:
        raise Refused("holds an integer of more than 64 bits")
    return value


STAND_INS: dict[str, Callable[..., Any]] = {
    **{f"numpy.{core}.multiarray._reconstruct": lambda *_: Array() for core in ("core", "_core")},
    **{f"numpy.{core}.multiarray.scalar": _scalar for core in ("core", "_core")},
    **{f"numpy.{core}.numeric._frombuffer": lambda *parts: Array(_values(*parts)) for core in ("core", "_core")},
    "numpy.dtype": _dtype,
    "numpy.ndarray": lambda: None,
    "_codecs.encode": _encode,
    "pydrake.math.RigidTransform_[float]": Stated,
    "collections.OrderedDict": _dict,
    **{f"{module}.bytes": lambda: b"" for module in ("builtins", "__builtin__")},
    **{f"{module}.{name}": _list for module in ("builtins", "__builtin__") for name in ("set", "frozenset", "list")},
}
"""Names that a pickle may import -> functions that it calls instead."""
DILL_ARRAY = "dill._dill._create_array"
"""Name that a pickle of the package dill calls for each array."""
OBJECT_OPCODES = "PERSID BINPERSID INST OBJ NEWOBJ_EX EXT1 EXT2 EXT4 NEXT_BUFFER READONLY_BUFFER".split()
"""Opcodes that make an object, or take one from elsewhere."""


class _Bytes(io.BytesIO):
    """A pickle that never returns fewer bytes than requested, and counts the requests."""

    left = 0

    def read(self, size: int | None = -1) -> bytes:
        """Return `size` bytes."""
        self.left -= 1
        if self.left < 0:
            raise Refused(f"holds too much: it takes more than {MAX_READS / 1e6:g} million steps to read")
        found = super().read(size)
        if len(found) != size:
            raise EOFError("it ends too early")
        return found


class Unpickler(pickle._Unpickler):
    """Python's unpickler with stand-ins for all that a pickle names, and lists for sets.

    It is the one in Python. That in C gives its memo 2^32 places for a pickle of 6 bytes, and hashes keys of any depth.
    """

    stack: list[Any]
    """Values that no other has taken up yet, from the last mark on."""
    append: Callable[[Any], None]
    """Puts a value on the stack."""
    pop_mark: Callable[[], list[Any]]
    """Takes all values from the last mark on."""
    read: Callable[[int], bytes]
    """Returns the next bytes."""
    readline: Callable[[], bytes]
    """Returns the next line, with its end."""
    memo: dict[int, Any]
    """Place -> value that may be named again."""

    def __init__(self, data: bytes, budget: Budget) -> None:
        """Start at the first of the bytes of a pickle."""
        file = _Bytes(data)
        file.left = MAX_READS
        super().__init__(file, encoding="latin-1")
        self.budget = budget

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for what a pickle names."""
        full = f"{module}.{name}"
        if full == DILL_ARRAY:
            return self.dill_array
        if full not in STAND_INS:
            raise Refused(f"holds a call of {full[:80]!a}, which is refused and was not run: {READABLE}")
        return STAND_INS[full]

    def load_reduce(self) -> None:
        """Call a stand-in; its copies count, because a pickle can name one part many times."""
        arguments, called = self.stack.pop(), self.stack.pop()
        self._spend(arguments)
        self.append(called(*arguments))

    def load_build(self) -> None:
        """Fill an array or a type; any other object, a stand-in above all, has no state."""
        state = self.stack.pop()
        if not isinstance(self.stack[-1], Array | _Dtype):
            raise Refused(f"holds an object with a state of its own, which is refused: {READABLE}")
        self._spend((state,) if isinstance(state, Array) else state)
        self.stack[-1].set_state(state)

    def load_newobj(self) -> None:
        """Make an object that holds its state only."""
        arguments, called = self.stack.pop(), self.stack.pop()
        if called is not Stated or arguments:
            self.refuse()
        self.append(Stated())

    def dill_array(self, _function: Any, _arguments: Any, state: Any, *_attributes: Any) -> Array:
        """Return an array that the package dill pickled."""
        self._spend(state)
        array = Array()
        array.set_state(state)
        return array

    def _spend(self, parts: Any) -> None:
        for part in parts:
            self.budget.spend(part)

    def load_dict(self) -> None:
        """Make a dict."""
        entries = self.pop_mark()
        self.append(_entries(entries))

    def load_setitem(self) -> None:
        """Put one entry into a dict."""
        value, key = self.stack.pop(), self.stack.pop()
        self.stack[-1].update(_entries((key, value)))

    def load_setitems(self) -> None:
        """Put entries into a dict."""
        entries = self.pop_mark()
        self.stack[-1].update(_entries(entries))

    def load_put(self) -> None:
        """Remember the last value at a place given in digits; many large places could have the same hash."""
        place = int(self.readline()[:-1])
        if not 0 <= place < MEMO_LIMIT:
            raise ValueError("a place in the memo")
        self.memo[place] = self.stack[-1]

    def load_frame(self) -> None:
        """Skip the size of a frame, so that all bytes are requested from `_Bytes`."""
        self.read(8)

    def refuse(self) -> None:
        """Refuse an opcode of `OBJECT_OPCODES`."""
        raise Refused(f"holds an object of a class, or one from elsewhere, which is refused: {READABLE}")

    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = pickle._Unpickler.dispatch | {
        pickle.REDUCE[0]: load_reduce,
        pickle.BUILD[0]: load_build,
        pickle.DICT[0]: load_dict,
        pickle.SETITEM[0]: load_setitem,
        pickle.SETITEMS[0]: load_setitems,
        pickle.PUT[0]: load_put,
        pickle.FRAME[0]: load_frame,
        pickle.NEWOBJ[0]: load_newobj,
        # A list is not hashed, and bytes are there before they get memory.
        pickle.EMPTY_SET[0]: pickle._Unpickler.dispatch[pickle.EMPTY_LIST[0]],
        pickle.ADDITEMS[0]: pickle._Unpickler.dispatch[pickle.APPENDS[0]],
        pickle.FROZENSET[0]: pickle._Unpickler.dispatch[pickle.LIST[0]],
        pickle.BYTEARRAY8[0]: pickle._Unpickler.dispatch[pickle.BINBYTES8[0]],
        **dict.fromkeys([getattr(pickle, name)[0] for name in OBJECT_OPCODES], refuse),
    }
    """Opcode -> method."""


def unpickle(data: bytes) -> Any:
    """Return what a pickle holds: None, booleans, numbers, text, bytes, lists (also for sets), tuples, dicts, arrays.

    Arrays have numbers or text; an array of objects is a list of them, or its only one.

    Raises:
        Refused: it is damaged, names anything else, or would become much larger than it is.
    """
    size = min(MAX_GROWTH * len(data) + FREE_BYTES, MAX_BYTES)
    with damaged_as_refused():
        return plain(Unpickler(data, Budget(size, MAX_READS)).load(), Budget(size, MAX_READS))


@contextmanager
def damaged_as_refused() -> Iterator[None]:
    """Raise Refused for errors of Python's unpickler in the block."""
    try:
        with warnings.catch_warnings():
            # Text of the oldest protocol may have escapes that Python does not know.
            warnings.simplefilter("ignore", DeprecationWarning)
            yield
    except DAMAGED as error:
        raise Damaged(f"is a damaged or cut off pickle ({' '.join(str(error).split())[:80]})") from None


def plain(value: Any, budget: Budget, depth: int = 0) -> Any:
    """The value with arrays in place; a part that is named several times counts each time."""
    budget.spend(value)
    if depth > MAX_DEPTH:
        raise Refused(f"holds lists or dicts nested more than {MAX_DEPTH} deep")
    if isinstance(value, Array):
        if value.value is ...:
            raise Refused("holds an array without its entries")
        return plain(value.value, budget, depth + 1)
    if isinstance(value, list | tuple):
        return type(value)(plain(item, budget, depth + 1) for item in value)
    if isinstance(value, dict):
        return {key: plain(item, budget, depth + 1) for key, item in value.items()}
    if not isinstance(value, np.ndarray | str | bytes | int | float | None):
        raise Refused(f"holds a function or a type: {READABLE}")
    return _small(value)
