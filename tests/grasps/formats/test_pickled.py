"""Pickles are read like Python reads them where they hold data, and refused by name, without running, elsewhere."""

import builtins
import os
import pickle
import struct
import subprocess
from collections import OrderedDict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grasp_refine.grasps.formats import pickled
from grasp_refine.grasps.formats.pickled import INTEGER_LIMIT, Refused, unpickle
from refusals import refused

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


def same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return type(one) is type(other) and len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and one == other


class Call:
    """Calls something when it is unpickled."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.reduced = function, arguments

    def __reduce__(self) -> Any:
        return self.reduced


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_what_grasp_files_hold_is_read_as_python_reads_it(protocol: int):
    held = {
        "obj_pose": np.arange(7.0),
        "float32": np.linspace(0, 1, 6, dtype=np.float32).reshape(2, 3),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(10)[::3],
        "swapped": np.arange(4, dtype=">f8"),
        "empty": np.zeros((0, 3)),
        "flags": np.array([True, False]),
        "names": np.array(["FFJ4", "γ"]),
        "scale": np.float64(0.06),
        "count": np.int64(7),
        "half": 0.5,
        "big": 2**40,
        "negative": -3,
        "path": "assets/γ",
        "bytes": b"\x00\xff",
        "nested": [{"a": (1, 2.0, None, True)}, [], (), {}],
        7: "seven",
    }
    read = unpickle(pickle.dumps(held, protocol))
    assert read.pop("scale") == 0.06
    assert read.pop("count") == 7
    del held["scale"], held["count"]
    assert same(read, held)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_sets_are_lists_and_ordered_dicts_are_dicts(protocol: int):
    read = unpickle(pickle.dumps([{3}, frozenset((4,)), OrderedDict(a=1)], protocol))
    assert read == [[3], [4], {"a": 1}]


@pytest.mark.parametrize("protocol", PROTOCOLS[2:])
def test_arrays_of_objects_are_lists(protocol: int):
    grasps = np.empty(2, dtype=object)
    grasps[:] = [{"scale": 0.1}, {"scale": 0.2}]
    assert unpickle(pickle.dumps(grasps, protocol)) == [{"scale": 0.1}, {"scale": 0.2}]
    assert unpickle(pickle.dumps(np.array({"a": 1}, dtype=object), protocol)) == {"a": 1}


def test_arrays_pickled_by_the_former_numpy_are_read():
    former = pickle.dumps({"q": np.arange(3.0)}, 2).replace(b"numpy._core.multiarray", b"numpy.core.multiarray")
    assert b"numpy.core" in former
    assert same(unpickle(former), {"q": np.arange(3.0)})


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(), inner, max_size=4)
        | st.lists(inner, max_size=4).map(tuple)
    ),
    max_leaves=15,
)


@pytest.mark.slow
@given(plain, st.sampled_from(PROTOCOLS))
@settings(deadline=None, max_examples=150)
def test_any_plain_value_comes_back(value: Any, protocol: int):
    assert same(unpickle(pickle.dumps(value, protocol)), value)


EVIL = {
    "a command": (lambda mark: Call(os.system, f"touch {mark}"), "posix.system"),
    "an evaluation": (lambda mark: Call(builtins.eval, f"open({str(mark)!r}, 'w')"), "eval"),
    "an execution": (lambda mark: Call(builtins.exec, f"open({str(mark)!r}, 'w')"), "exec"),
    "a file": (lambda mark: Call(open, str(mark), "w"), "open"),
    "a process": (lambda mark: Call(subprocess.Popen, ["touch", str(mark)]), "Popen"),
    "an attribute": (lambda mark: Call(getattr, str(mark), "upper"), "getattr"),
    "in a dict": (lambda mark: {"grasp_qpos": Call(os.system, f"touch {mark}")}, "posix.system"),
    "in an argument": (lambda mark: Call(OrderedDict, [["a", Call(os.system, f"touch {mark}")]]), "posix.system"),
    "in an array": (lambda mark: np.array([Call(os.system, f"touch {mark}")], dtype=object), "posix.system"),
    "loading": (lambda mark: Call(np.load, str(mark)), "load"),
}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", EVIL)
def test_what_would_run_is_refused_by_name_and_does_not_run(name: str, protocol: int, tmp_path: Path):
    make, called = EVIL[name]
    mark = tmp_path / "ran"
    data = pickle.dumps(make(mark), protocol)
    with refused(Refused, called):
        unpickle(data)
    assert not mark.exists()


KNOWN = {
    "builtins": {"bytes", "frozenset", "list", "set"},
    "collections": {"OrderedDict"},
    "_codecs": {"encode"},
    "numpy": {"dtype", "ndarray"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.numeric": {"_frombuffer"},
}
"""Module -> the names in it that arrays and plain containers need."""


@pytest.mark.parametrize("module", [*KNOWN, "copyreg", "functools", "operator", "os", "numpy.lib.npyio"])
def test_no_other_name_of_a_module_is_known(module: str):
    for name in set(dir(import_module(module))) - KNOWN.get(module, set()):
        with refused(Refused, f"'{module}.{name}'"):
            unpickle(f"c{module}\n{name}\n.".encode())


def test_a_pickle_of_too_many_steps_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pickled, "MAX_READS", 1000)
    assert unpickle(pickle.dumps(list(range(400)))) == list(range(400))
    with refused(Refused, "0.001 million steps"):
        unpickle(pickle.dumps([[] for _ in range(2000)]))


def test_an_escape_that_python_does_not_know_is_no_warning():
    # Warnings are errors here.
    assert unpickle(b"S'a\\q'\n.") == "a\\q"


class Thing:
    pass


def test_objects_of_classes_are_refused_by_name():
    for protocol in PROTOCOLS:
        with pytest.raises(Refused, match=r"copyreg\._reconstructor|copy_reg\._reconstructor|Thing"):
            unpickle(pickle.dumps(Thing(), protocol))


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (b"(ios\nsystem\n.", ("class",)),
        (b"(S'touch x'\nios\nsystem\n.", ("class",)),
        (b"(cnumpy\nndarray\nI1\no.", ("class",)),
        (b"cos\nsystem\n.", ("os.system",)),
        (b"cnumpy\nndarray\n.", ("function",)),
        (b"cnumpy\ndtype\n(S'V8'\ntR.", ("'V8'",)),
        (b"cnumpy\nndarray\nN\x85R.", ("damaged",)),
        (b"I1\n)R.", ("damaged", "callable")),
        (b"]}b.", ("state",)),
        (b"cnumpy\ndtype\n}b.", ("state",)),
        (b"P1\n.", ("elsewhere",)),
        (b"\x82\x01.", ("elsewhere",)),
        (b"cnumpy\nndarray\n)\x81.", ("class",)),
        (b"cnumpy\nndarray\n)}\x92.", ("class",)),
        (b"N\x51.", ("elsewhere",)),
        (b"\x97.", ("elsewhere",)),
        (b"c_codecs\nencode\n(S'x'\nS'zlib_codec'\ntR.", ("'zlib_codec'", "latin1")),
        (b"cnumpy\ndtype\n(S'f8'\ntRcnumpy.core.multiarray\nscalar\nh\x00.", ("damaged",)),
        (b"}]I1\ns.", ("keys",)),
        (b"cnumpy.core.multiarray\n_reconstruct\n)R.", ("array", "entries")),
        (b"\x80\x04NN\x93.", ("damaged",)),
        (b"\x80\x04\x8c\x01aN\x93.", ("damaged",)),
        (b"\x80\x04N\x93.", ("damaged",)),
        (b"0.", ("damaged",)),
        (b".", ("damaged",)),
        (b"K\x01", ("damaged",)),
        (b"\x80", ("damaged",)),
        (b"hello", ("damaged",)),
        (b"N}K\x01K\x02s.", None),
        (b"L" + b"9" * 5000 + b"L\n.", ("damaged",)),
        (b"\x8a\xff" + b"\x7f" * 255 + b".", ("64 bits",)),
    ],
)
def test_odd_pickles(data: bytes, named: tuple[str, ...] | None):
    if named is None:
        assert unpickle(data) == {1: 2}
        return
    with refused(Refused, *named) as raised:
        unpickle(data)
    assert len(str(raised.value)) < 300


def array_with(shape: tuple[int, ...], code: str = "f8", data: bytes = b"12345678") -> bytes:
    """A pickle of an array that says this shape and type of its bytes."""
    honest = pickle.dumps(np.frombuffer(b"12345678", dtype="f8"), 2)
    for old, new in (
        (pickle.dumps((1,), 2)[2:-3], pickle.dumps(shape, 2)[2:-3]),
        (b"X\x02\x00\x00\x00f8", b"X" + struct.pack("<I", len(code)) + code.encode()),
        (b"X\x08\x00\x00\x0012345678", b"X" + struct.pack("<I", len(data)) + data),
    ):
        assert old in honest
        honest = honest.replace(old, new)
    return honest


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (array_with((10**12,)), ("(1000000000000,)", "float64", "8 bytes")),
        (array_with((2,)), ("(2,)", "float64", "8 bytes")),
        (array_with((2**40, 2**40)), ("(1099511627776, 1099511627776)", "float64")),
        (array_with((1,) * 33), ("array",)),
        (array_with((1,), code="V8"), ("'V8'",)),
        (array_with((1,), code="c8"), ("'c8'",)),
        (array_with((1,), code="M8[ns]"), ("'M8[ns]'",)),
        (array_with((1,), code="(99999,99999)f8"), ("'(99999,99999)f8'",)),
        (array_with((1,), code="f3"), ("'f3'",)),
        (array_with((1,), code="O8"), ("objects", "(1,)")),
        (array_with((0,), code="U0", data=b""), ("array", "(0,)")),
    ],
)
def test_arrays_that_cannot_be(data: bytes, named: tuple[str, ...]):
    with refused(Refused, *named):
        unpickle(data)


def nested(depth: int, opening: bytes = b"]", closing: bytes = b"a") -> bytes:
    return opening * depth + b"N" + closing * depth + b"."


def repeated(count: int, times: int) -> list[Any]:
    """Lists, each with the one before it some times."""
    made: list[Any] = [0.0]
    for _ in range(count):
        made = [made] * times
    return made


LOOP: list[Any] = []
LOOP.append(LOOP)
LIST, COPY = b"](" + b"N" * 10**4 + b"eq\x00", b"cbuiltins\nlist\nh\x00\x85R"
FILLED = b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n)Rq\x000cnumpy\ndtype\nX\x02\x00\x00\x00S1\x85Rq\x01(K\x01"
FILLED += b"J\xa0\x86\x01\x00\x85h\x01\x89X\xa0\x86\x01\x00" + b"a" * 100000 + b"tq\x020"
"""An array of 100 kB of text, and its state, which fills it."""


def test_containers_and_copies_of_bounded_size_are_read():
    assert unpickle(nested(5)) == [[[[[None]]]]] and unpickle(LIST + COPY + b"0.") == [None] * 10**4
    assert unpickle(FILLED + b"h\x00h\x02b.").shape == (100000,)
    assert unpickle(b"Nr\xff\xff\xff\x7f.") is None and unpickle(b"Np4294967295\n.") is None


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (nested(40), ("32",)),
        (nested(10**4), ("32",)),
        (b"N" + b"\x85" * 10**4 + b".", ("32",)),
        (b"}" + b"N" + b"\x85" * 10**4 + b"Ns.", ("keys",)),
        (pickle.dumps(LOOP), ("32",)),
        (pickle.dumps(repeated(25, 10)), ("bomb",)),
        (pickle.dumps([np.zeros(10**6)] * 1000), ("bomb",)),
        # list(x) of one list of ten thousand entries, a thousand times; copies that are dropped at once count as well.
        (LIST + b"(" + COPY * 10**3 + b"l.", ("bomb",)),
        (LIST + (COPY + b"0") * 10**3 + b".", ("bomb",)),
        (FILLED + b"h\x00h\x02b0" * 10**4 + b"N.", ("bomb",)),
        # An encoding that is no text; each list holds the one before it twice.
        (b"c_codecs\nencode\nS'x'\n" + b"]" + b"q\x000](h\x00h\x00e" * 2000 + b"\x86R.", ("encoding",)),
        # 2000 pairs, each the same list of 2000 entries.
        (
            b"\x80\x02ccollections\nOrderedDict\n]q\x00(" + b"N" * 2000 + b"e0](" + b"h\x00" * 2000 + b"e\x85R.",
            ("dict",),
        ),
        (b"cbuiltins\nlist\n}\x85R.", ("damaged",)),
        *((b"Np" + place + b"\n.", ("damaged",)) for place in (b"4294967296", b"%d" % (2**61 - 1), b"-1", b"x")),
        # Bytes that are not there are not waited for.
        *((code + struct.pack("<Q", 2**62) + b"abc.", ()) for code in (b"\x8e", b"\x96")),
        (pickle.dumps(INTEGER_LIMIT), ("64 bits",)),
    ],
)
def test_bombs_and_places_that_cannot_be_are_refused(data: bytes, named: tuple[str, ...]):
    with refused(Refused, *named):
        unpickle(data)


def test_whole_numbers_have_up_to_64_bits():
    assert unpickle(pickle.dumps(INTEGER_LIMIT - 1)) == INTEGER_LIMIT - 1
