"""Structures that are built once for each hand."""

import gc
import weakref
from pathlib import Path

from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from made_hands import BALL, joint, link, made_hand


def test_what_is_kept_is_built_once_for_each_hand_and_dropped_with_it(tmp_path: Path) -> None:
    built: list[tuple[str, int]] = []

    class Built:
        pass

    @kept
    def structure(hand: Hand, number: int) -> Built:
        built.append((hand.name, number))
        return Built()

    parts = link("base", BALL), link("a", BALL), joint("turns", "base", "a", limits=(0, 1), effort=1)
    one, other = (made_hand(tmp_path / name, *parts, name=name) for name in ("one", "other"))
    first = structure(one, 1)
    assert structure(one, 1) is first and structure(one, 2) is not first and structure(other, 1) is not first
    assert built == [("one", 1), ("one", 2), ("other", 1)]
    known = weakref.ref(first)
    del one, first
    gc.collect()
    assert known() is None
