"""Rest poses in which no links overlap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.clear_rest import clear_rest
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs

RADIUS = 0.01


def balls(folder: Path, **ranges: tuple[float, float]) -> Hand:
    """A hand of balls that slide along one line."""
    parts = "".join(
        f"""<link name="{name}"><collision><geometry><sphere radius="{RADIUS}"/></geometry></collision></link>
        <joint name="{name}" type="prismatic"><parent link="palm"/><child link="{name}"/><axis xyz="1 0 0"/>
        <limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>"""
        for name, (low, high) in ranges.items()
    )
    path = folder / "balls.urdf"
    path.write_text(f'<robot name="balls"><link name="palm"/>{parts}</robot>')
    return load_hand(path, candidates=16)


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
