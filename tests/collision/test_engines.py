"""The compiled engine against the one in Python, and which of them is used."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import fields
from hashlib import sha256
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision import engine
from grasp_refine.collision.engine import VARIABLE, chosen, engines, why_not_native
from grasp_refine.collision.python_search import PythonSearch
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query, query_items
from grasp_refine.core.errors import CollisionError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, cylinder, hull, sphere
from refusals import assert_names, refused
from running_processes import PATIENCE_S
from shapes_for_tests import convex_body, ring_body
from twists import random_poses

native = pytest.mark.skipif(bool(why_not_native()), reason=f"no compiled engine: {why_not_native()}")


def mixed_body(seed: int, pieces: int) -> Body:
    """Spheres, capsules, hulls, boxes and hulls with a radius."""
    rng = np.random.default_rng(seed)
    parts: list[Piece] = []
    for index, center in enumerate(rng.normal(size=(pieces, 3)) * 0.04):
        points, T = rng.normal(size=(24, 3)) * 0.012 + center, np.eye(4)
        T[:3, 3] = center
        thick = hull(points)
        parts.append(
            [
                sphere(0.012, center),
                capsule(0.006, center, center + rng.normal(size=3) * 0.02),
                Piece(thick.vertices, thick.faces, radius=0.004),
                box([0.02, 0.03, 0.01], T),
                hull(points),
            ][index % 5]
        )
    return build_body(f"mixed {seed}", parts, candidates=16)


BODIES = [
    mixed_body(0, 8), mixed_body(1, 23), mixed_body(2, 1), convex_body(3, 300), ring_body(),
    build_body("disc", [cylinder(0.03, 0.02, sides=400)], candidates=16),
]  # fmt: skip

SIDES = tuple(zip(*product(BODIES, BODIES), strict=True))


@pytest.fixture(scope="module")
def both() -> tuple[Pairs, Pairs]:
    """All pairs of these bodies, for the compiled and for the Python engine."""
    return Pairs(*SIDES, engine="native"), Pairs(*SIDES, engine="python")


def scattered(batch: int, spread: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Poses of all pairs."""
    count = len(SIDES[0])
    return tuple(
        random_poses(batch * count, 2 * seed + side, (0.02, spread)[side]).reshape(batch, count, 4, 4)
        for side in range(2)
    )


def assert_same_answers(found: Witness, other: Witness) -> None:
    """The answers of the compiled engine, and those of the one in Python up to rounding.

    Neighbours that share a vertex are equally far, and so are two faces that lie equally deep: which of them wins is a
    matter of rounding, which differs between processors. So is the normal of pieces that touch exactly.
    """
    np.testing.assert_array_equal(other.valid, found.valid)
    np.testing.assert_allclose(other.distance, found.distance, rtol=0, atol=1e-10)
    clear = ~found.valid | (np.abs(found.distance) > 1e-8)
    np.testing.assert_array_equal(other.status[clear], found.status[clear])
    same = clear & (other.winner == found.winner)
    assert same.sum() >= 0.9 * clear.sum()
    tied = np.zeros_like(same)
    for name, atol in (("point_a", 1e-12), ("point_b", 1e-12), ("normal", 1e-8)):
        tied |= ~np.isclose(getattr(other, name), getattr(found, name), rtol=0, atol=atol, equal_nan=True).all(axis=-1)
    assert (tied & same).sum() <= 0.02 * same.sum()
    for each in (found, other):
        gap = each.distance[same & each.valid, None] * each.normal[same & each.valid]
        np.testing.assert_allclose((each.point_b - each.point_a)[same & each.valid], gap, rtol=0, atol=1e-8)


@native
@pytest.mark.parametrize("spread", [0.02, 0.06, 0.2])
@pytest.mark.parametrize("cutoff", [np.inf, 0.01, -0.002])
def test_both_engines_give_the_same_answers_cold_and_warm(
    both: tuple[Pairs, Pairs], spread: float, cutoff: float
) -> None:
    T_a, T_b = scattered(5, spread)
    previous = None
    for _ in range(3):
        found, other = (query(pairs, T_a, T_b, cutoff=cutoff, previous=previous) for pairs in both)
        assert_same_answers(found, other)
        previous, T_b = other, T_b.copy()
        T_b[..., :3, 3] += 1e-3
    assert other.valid.any() and np.isinf(cutoff) == other.valid.all()


@native
@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 0.0, -1e-9, -1e-6, -1e-3])
def test_both_engines_give_the_same_answers_at_contact(both: tuple[Pairs, Pairs], gap: float) -> None:
    T_a, T_b = scattered(3, 0.2, seed=5)
    for _ in range(5):
        w = query(both[0], T_a, T_b)
        T_b[..., :3, 3] += (gap - w.distance)[..., None] * w.normal
    assert (np.abs(query(both[0], T_a, T_b).distance - gap) < 1e-8).mean() > 0.5
    assert_same_answers(*(query(pairs, T_a, T_b) for pairs in both))


@native
def test_both_engines_take_listed_items_limits_of_their_own_and_poses_that_are_not_finite(
    both: tuple[Pairs, Pairs],
) -> None:
    T_a, T_b = (T.reshape(-1, 4, 4) for T in scattered(4, 0.08))
    rng = np.random.default_rng(0)
    pair, cutoff = rng.integers(len(SIDES[0]), size=len(T_a)), rng.choice([np.inf, -np.inf, 0.03, 0.0], len(T_a))
    T_a[3, 1, 1], T_b[7, 0, 3], T_a[9], T_b[9] = np.nan, np.inf, np.inf, np.inf
    found, other = (query_items(pairs, pair, T_a, T_b, cutoff=cutoff) for pairs in both)
    assert_same_answers(found, other)
    assert (found.status[[3, 7, 9]] == QueryStatus.NOT_FINITE).all() and set(found.status) == {0, 1, 2, 4}
    # Rows that are not next to each other in memory, and other number types.
    again = query_items(both[0], pair[::2], T_a[::2].astype(np.float32), T_b[::2], cutoff=cutoff[::2])
    np.testing.assert_allclose(again.distance, found.distance[::2], atol=1e-7)


@native
def test_threads_change_nothing(both: tuple[Pairs, Pairs]) -> None:
    pairs = both[0]
    T_a, T_b = (T.reshape(-1, 4, 4) for T in scattered(12, 0.06))
    limit, pair = np.full(len(T_a), np.inf), np.tile(np.arange(len(pairs)), 12)
    one = pairs.search.query(pair, T_a, T_b, limit, None, 1)
    warm = pairs.search.query(pair, T_a, T_b, limit, (one[5], one[0], one[1], one[4]), 1)
    for threads in (1, 2, 4, 7):
        for previous, expected in ((None, one), ((one[5], one[0], one[1], one[4]), warm)):
            for field, value, known in zip(
                fields(Witness), pairs.search.query(pair, T_a, T_b, limit, previous, threads), expected, strict=True
            ):
                np.testing.assert_array_equal(value, known, err_msg=f"{field.name} with {threads} threads")


@native
@pytest.mark.parametrize(("variable", "threads"), [("1", 1), ("2", 2), ("3,1", 3)])
def test_the_number_of_threads_is_that_of_openmp_and_few_items_take_one(
    variable: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from grasp_refine.collision import native_search

    monkeypatch.setenv("OMP_NUM_THREADS", variable)
    native_search._available.cache_clear()
    try:
        assert [native_search.threads_for(items) for items in (1, 1000, 10**6)] == [1, 1, threads]
    finally:
        native_search._available.cache_clear()


@native
def test_two_threads_of_python_may_ask_at_once(both: tuple[Pairs, Pairs]) -> None:
    pairs = both[0]
    poses = [scattered(6, spread) for spread in (0.02, 0.1)]
    alone = [query(pairs, *T) for T in poses]
    found: dict[int, Witness] = {}

    def ask(i: int) -> None:
        for _ in range(5):
            found[i] = query(pairs, *poses[i])

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(2):
        np.testing.assert_array_equal(found[i].point_a, alone[i].point_a)


@native
def test_arrays_for_other_items_are_refused(both: tuple[Pairs, Pairs]) -> None:
    T_a, T_b = scattered(2, 0.06)
    last = query(both[0], T_a, T_b)
    for arguments in ((T_a[:1], T_b, None), (T_a, T_b[:1], None), (T_a, T_b, last.rows(slice(1)))):
        with refused(CollisionError, "shape"):
            query(both[0], *arguments[:2], previous=arguments[2])
    for pair in ([0, len(both[0])], [-1, 0], [0]):
        with refused(ValueError, "shapes"):
            query_items(both[0], np.array(pair), T_a[0, :2], T_b[0, :2], cutoff=np.full(2, np.inf)[: len(pair)])


@native
def test_a_forked_process_does_not_wait_for_threads_that_it_lost() -> None:
    code = """
import os, signal, sys
import numpy as np
from grasp_refine.collision.query import Pairs
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
ball = build_body("ball", [sphere(0.01)], candidates=16)
pairs, T = Pairs((ball,), (ball,), engine="native"), np.tile(np.eye(4), (2000, 1, 1))
ask = lambda: pairs.search.query(np.zeros(2000, np.int64), T, T, np.full(2000, np.inf), None, 2)[3].sum()
before, child = ask(), os.fork()
if child == 0:
    signal.alarm(600)
    os._exit(0 if ask() == before else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=PATIENCE_S).returncode == 0


# which engine


@pytest.fixture
def forgotten() -> Iterator[None]:
    """What is known of the compiled engine is found out again."""
    why_not_native.cache_clear()
    yield
    why_not_native.cache_clear()


def test_the_engines_that_are_there_are_listed_the_fastest_first() -> None:
    assert engines() == (("python",) if why_not_native() else ("native", "python"))
    assert chosen("python") == "python"


def test_auto_is_what_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert chosen("auto") == engines()[0]
    monkeypatch.setenv(VARIABLE, "auto")
    assert chosen("auto") == engines()[0]
    monkeypatch.setenv(VARIABLE, "python")
    assert chosen("auto") == "python"
    pairs = Pairs((BODIES[2],), (BODIES[2],))
    assert isinstance(pairs.search, PythonSearch)
    assert pairs.take(np.array([0])).engine == "auto"
    monkeypatch.setenv(VARIABLE, "fast")
    with refused(CollisionError, VARIABLE, "fast", "auto, native, python"):
        Pairs((BODIES[2],), (BODIES[2],))


def test_an_engine_that_does_not_exist_is_an_error() -> None:
    with refused(CollisionError, "gpu", "auto, native, python"):
        chosen("gpu")


def test_an_engine_that_was_not_built_is_left_alone(monkeypatch: pytest.MonkeyPatch, forgotten: None) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(engine, "NATIVE_MODULE", "grasp_refine.collision._nowhere")
    assert_names(why_not_native(), "C++", "grasp-refine")
    assert engines() == ("python",) and chosen("auto") == "python"
    with refused(CollisionError, "native", why_not_native(), "auto", "python"):
        Pairs((BODIES[2],), (BODIES[2],), engine="native")
    monkeypatch.setenv(VARIABLE, "native")
    with refused(CollisionError, VARIABLE, "native", why_not_native()):
        chosen("auto")


def test_an_engine_that_does_not_load_is_left_alone(tmp_path: os.PathLike) -> None:
    """A file that is no library of this system: what is left of another installation."""
    code = f"""
import importlib.machinery, importlib.util, sys
suffix = importlib.machinery.EXTENSION_SUFFIXES[0]
class Broken:
    def find_spec(name, path=None, target=None):
        if name == "grasp_refine.collision._native":
            return importlib.util.spec_from_file_location(name, {str(tmp_path)!r} + "/_native" + suffix)
open({str(tmp_path)!r} + "/_native" + suffix, "wb").write(b"no library")
sys.meta_path.insert(0, Broken)
from grasp_refine.collision.engine import engines, why_not_native
print(engines(), why_not_native())
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.startswith("('python',) ") and "_native" in result.stdout


@native
def test_an_engine_for_another_coal_is_left_alone(monkeypatch: pytest.MonkeyPatch, forgotten: None) -> None:
    from importlib.metadata import version

    from grasp_refine.collision import native_search

    here = version("coal")
    assert native_search.built_for() == native_search.coal_version() == here
    monkeypatch.setattr(native_search._native, "coal_version", "3.0.0")
    assert_names(
        why_not_native(),
        "coal 3.0.0",
        f"coal {here}",
        "pip install coal==3.0.0",
        "grasp-refine",
        "--no-build-isolation",
    )
    assert engines() == ("python",)


@native
def test_an_engine_of_other_sources_is_left_alone(monkeypatch: pytest.MonkeyPatch, forgotten: None) -> None:
    from grasp_refine.collision import native_search

    assert native_search.sources() == native_search._native.sources
    monkeypatch.setattr(native_search._native, "sources", "0" * 64)
    assert_names(why_not_native(), "sources", "grasp-refine")
    # Before there was such a hash.
    monkeypatch.delattr(native_search._native, "sources")
    assert_names(native_search.mismatch(), "sources", "grasp-refine")
    # In a wheel there are none.
    monkeypatch.setattr(native_search, "sources", lambda: None)
    assert native_search.mismatch() == ""


@native
def test_the_hash_of_sources_is_that_of_their_contents(tmp_path: Path) -> None:
    from grasp_refine.collision.native_search import sources

    assert sources(tmp_path) is None
    (tmp_path / "a.h").write_text("one")
    (tmp_path / "CMakeLists.txt").write_text("no source")
    assert sources(tmp_path) == sha256(sha256(b"one").hexdigest().encode()).hexdigest()
    before = sources(tmp_path)
    (tmp_path / "a.h").write_text("two")
    assert sources(tmp_path) != before
