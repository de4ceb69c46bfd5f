"""Rows of nested dataclasses: taking, joining, choosing."""

from dataclasses import dataclass

import numpy as np
import pytest

from grasp_refine.batch import choose, join, take


@dataclass(frozen=True, eq=False)
class Inner:
    numbers: np.ndarray
    poses: np.ndarray


@dataclass(frozen=True, eq=False)
class Outer:
    flags: np.ndarray
    inner: Inner


def rows(count: int, seed: int) -> Outer:
    rng = np.random.default_rng(seed)
    return Outer(rng.random(count) < 0.5, Inner(rng.normal(size=count), rng.normal(size=(count, 2, 3))))


def parts(of: Outer) -> tuple[np.ndarray, ...]:
    return of.flags, of.inner.numbers, of.inner.poses


@pytest.mark.parametrize(
    "index", [np.array([3, 0, 0]), np.array([True, False, True, False, False]), np.zeros(0, dtype=int)]
)
def test_taking_rows_takes_them_from_every_array(index: np.ndarray) -> None:
    whole = rows(5, 0)
    found = take(whole, index)
    assert isinstance(found, Outer) and isinstance(found.inner, Inner)
    for part, expected in zip(parts(found), parts(whole), strict=True):
        np.testing.assert_array_equal(part, expected[index])


def test_what_was_split_is_joined_again() -> None:
    whole = rows(6, 1)
    for cut in (0, 2, 6):
        found = join(take(whole, np.arange(cut)), take(whole, np.arange(cut, 6)))
        for part, expected in zip(parts(found), parts(whole), strict=True):
            np.testing.assert_array_equal(part, expected)
            assert part.dtype == expected.dtype


def test_choosing_is_by_rows_whatever_the_shape() -> None:
    one, two, mask = rows(4, 2), rows(4, 3), np.array([True, False, False, True])
    for part, first, second in zip(parts(choose(mask, one, two)), parts(one), parts(two), strict=True):
        np.testing.assert_array_equal(part[mask], first[mask])
        np.testing.assert_array_equal(part[~mask], second[~mask])
    # A row that is not chosen may hold NaN.
    spoilt = Inner(np.full(4, np.nan), np.full((4, 2, 3), np.nan))
    assert np.isfinite(choose(mask, one.inner, spoilt).poses[mask]).all()


def test_what_is_not_there_has_no_rows() -> None:
    assert take(None, np.array([0])) is None
    assert join(None, None) is None
    assert choose(np.array([True]), None, None) is None


def test_several_are_joined_at_once_and_what_all_share_is_kept() -> None:
    whole = rows(6, 1)
    found = join(*(take(whole, np.array([row])) for row in range(6)))
    for part, expected in zip(parts(found), parts(whole), strict=True):
        np.testing.assert_array_equal(part, expected)
    names = ("a", "b")
    assert take(names, np.array([1])) == join(names, names) == names
