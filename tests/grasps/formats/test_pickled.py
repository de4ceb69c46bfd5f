"""Pickles are read like Python reads them where they hold data, and refused by name, without running, elsewhere."""

from __future__ import annotations

import builtins
import io
import os
import pickle
import pickletools
import struct
import subprocess
from collections import OrderedDict
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
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


def test_the_refused_really_run_where_python_reads_them(tmp_path: Path):
    mark = tmp_path / "ran"
    pickle.loads(pickle.dumps(Call(os.system, f"touch {mark}")))
    assert mark.exists()


def test_a_pickle_of_too_many_steps_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pickled, "MAX_READS", 1000)
    assert unpickle(pickle.dumps(list(range(400)))) == list(range(400))
    with refused(Refused, "0.001 million steps"):
        unpickle(pickle.dumps([[] for _ in range(2000)]))


def test_an_escape_that_python_does_not_know_is_no_warning():
    # Warnings are errors here.
    assert unpickle(b"S'a\\q'\n.") == "a\\q"


def test_a_dict_made_of_long_pairs_is_no_bomb():
    # 2000 times the same list of 2000 entries, in 10 kB.
    many = b"\x80\x02ccollections\nOrderedDict\n]q\x00(" + b"N" * 2000 + b"e0](" + b"h\x00" * 2000 + b"e\x85R."
    with refused(Refused, "dict"):
        unpickle(many)


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


def test_the_crafted_array_is_an_array():
    assert same(unpickle(array_with((1,))), np.frombuffer(b"12345678", dtype="f8"))


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


def test_containers_deep_in_each_other_are_refused_and_do_not_crash():
    assert unpickle(nested(5)) == [[[[[None]]]]]
    for data in (nested(40), nested(10**4), b"N" + b"\x85" * 10**4 + b".", b"}" + b"N" + b"\x85" * 10**4 + b"Ns."):
        with refused(Refused) as caught:
            unpickle(data)
        assert "32" in str(caught.value) or "keys" in str(caught.value)


def test_a_list_in_itself_is_refused():
    loop: list[Any] = []
    loop.append(loop)
    with refused(Refused, "32"):
        unpickle(pickle.dumps(loop))


def test_a_part_named_many_times_is_no_bomb():
    # 25 lists, each with the one before it ten times.
    bomb: list[Any] = [0.0]
    for _ in range(25):
        bomb = [bomb] * 10
    data = pickle.dumps(bomb)
    assert len(data) < 10_000
    with refused(Refused, "bomb"):
        unpickle(data)


def test_an_encoding_that_is_a_bomb_is_not_formatted():
    # Each list holds the one before it twice.
    doubled = b"]" + b"q\x000](h\x00h\x00e" * 2000
    with refused(Refused, "encoding"):
        unpickle(b"c_codecs\nencode\nS'x'\n" + doubled + b"\x86R.")


def test_a_large_array_named_many_times_is_no_bomb():
    data = pickle.dumps([np.zeros(10**6)] * 1000)
    with refused(Refused, "bomb"):
        unpickle(data)


def test_a_list_copied_many_times_is_no_bomb():
    # list(x) of one list of ten thousand entries, a thousand times.
    first, copy = b"](" + b"N" * 10**4 + b"eq\x00", b"cbuiltins\nlist\nh\x00\x85R"
    with refused(Refused, "bomb"):
        unpickle(first + b"(" + copy * 10**3 + b"l.")
    # Copies that are dropped at once count as well.
    with refused(Refused, "bomb"):
        unpickle(first + (copy + b"0") * 10**3 + b".")
    assert unpickle(first + copy + b"0.") == [None] * 10**4


def test_a_state_set_many_times_is_no_bomb():
    # An array of 100 kB of text, filled ten thousand times in 130 kB: each time the text is encoded.
    array = b"cnumpy.core.multiarray\n_reconstruct\n)Rq\x000cnumpy\ndtype\nX\x02\x00\x00\x00S1\x85Rq\x01"
    state = b"(K\x01M\xa0\x86\x85h\x01\x89X\xa0\x86\x01\x00" + b"a" * 100000 + b"tq\x020"
    data = b"\x80\x02" + array + state.replace(b"M\xa0\x86", b"J\xa0\x86\x01\x00")
    assert unpickle(data + b"h\x00h\x02b.").shape == (100000,)
    with refused(Refused, "bomb"):
        unpickle(data + b"h\x00h\x02b0" * 10**4 + b"N.")


def test_a_dict_is_not_copied_as_a_list():
    with refused(Refused, "damaged"):
        unpickle(b"cbuiltins\nlist\n}\x85R.")


def test_a_memo_at_a_giant_place_takes_no_room():
    assert unpickle(b"Nr\xff\xff\xff\x7f.") is None


@pytest.mark.parametrize("place", [b"4294967296", b"%d" % (2**61 - 1), b"-1", b"x"])
def test_a_place_in_the_memo_that_needs_more_than_32_bits_is_refused(place: bytes):
    assert unpickle(b"Np4294967295\n.") is None
    with refused(Refused, "damaged"):
        unpickle(b"Np" + place + b"\n.")


def test_bytes_that_are_not_there_are_not_waited_for():
    for opcode in (pickletools.code2op["\x8e"], pickletools.code2op["\x96"]):
        with refused(Refused):
            unpickle(opcode.code.encode("latin-1") + struct.pack("<Q", 2**62) + b"abc.")


def test_whole_numbers_to_64_bits():
    assert unpickle(pickle.dumps(INTEGER_LIMIT - 1)) == INTEGER_LIMIT - 1
    with refused(Refused, "64 bits"):
        unpickle(pickle.dumps(INTEGER_LIMIT))


SEED = pickle.dumps({"q": np.arange(4.0), "names": ["a", "b"], "scale": np.float32(0.5), "path": "x"}, 2)
SEED_5 = pickle.dumps({"q": np.arange(4.0), "names": ["a", "b"], "scale": np.float32(0.5), "path": "x"}, 5)


@given(
    st.sampled_from([SEED, SEED_5]),
    st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), min_size=1, max_size=6),
    st.integers(0, 400),
)
@settings(deadline=None, max_examples=600)
@example(SEED, [(0, 0)], 400)
def test_damaged_bytes_are_read_or_refused(seed: bytes, changes: list[tuple[int, int]], end: int):
    data = bytearray(seed)
    for place, byte in changes:
        data[place % len(data)] = byte
    try:
        unpickle(bytes(data[: max(1, end)]))
    except Refused as error:
        assert "\n" not in str(error)


@given(st.binary(max_size=200))
@settings(deadline=None, max_examples=400)
def test_any_bytes_are_read_or_refused(data: bytes):
    try:
        unpickle(data)
    except Refused:
        pass
    assert io.BytesIO(data).read() == data
