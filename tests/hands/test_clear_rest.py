"""Rest poses in which no links overlap."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.clear_rest import clear_rest
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from made_hands import link, made_hand, slide, solid

RADIUS = 0.01


def balls(folder: Path, **ranges: tuple[float, float]) -> Hand:
    """A hand of balls that slide along one line."""
    parts = (
        link(name, solid(f"sphere {RADIUS}")) + slide(name, "palm", name, axis="1 0 0", limits=limits)
        for name, limits in ranges.items()
    )
    return made_hand(folder, link("palm"), *parts, name="balls")


def test_crossed_fingers_part_and_other_joints_stay(tmp_path: Path) -> None:
    hand = balls(tmp_path, a=(0.0, 0.1), b=(0.0, 0.1), far=(0.5, 0.6))
    assert self_penetration(hand, touching_pairs(hand), hand.rest[None])[0] == pytest.approx(2 * RADIUS)
    q = clear_rest(hand)
    assert abs(q[0] - q[1]) >= 2 * RADIUS
    assert (hand.lower <= q).all() and (q <= hand.upper).all()
    assert q[2] == hand.rest[2]
    np.testing.assert_array_equal(q, clear_rest(hand))


def test_a_clear_rest_stays(tmp_path: Path) -> None:
    hand = balls(tmp_path, a=(0.0, 0.1), b=(0.05, 0.2))
    assert touching_pairs(hand) == (("a", "b"),)
    np.testing.assert_array_equal(clear_rest(hand), hand.rest)
