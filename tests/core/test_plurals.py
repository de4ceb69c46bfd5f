"""Counts as people read them."""

from __future__ import annotations

from grasp_refine.core.plurals import count_text, names_text, whole


def test_a_noun_is_in_the_plural_but_for_one():
    assert [count_text(number, "convex piece") for number in (0, 1, 2)] == [
        "0 convex pieces", "1 convex piece", "2 convex pieces"
    ]  # fmt: skip


def test_thousands_are_apart():
    assert whole(999) == "999" and whole(1_234_567) == "1\u202f234\u202f567"
    assert count_text(12_345, "grasp") == "12\u202f345 grasps"


def test_of_many_names_the_first_are_listed():
    assert names_text(list("abc")) == "a, b, c" and names_text(list("abcdefg")) == "a, b, c, d, e, f, and 1 more"
