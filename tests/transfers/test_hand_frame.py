"""Frames of hands: the thumb, the order of the other fingers and the side, by geometry, whatever the names are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.transfers.hand_frame import HandFrame
from tripod import tripod


def nameless(hand: Hand, seed: int) -> tuple[Hand, dict[str, str]]:
    """The same hand with random names of links, joints and fingers, and new name -> old name of each finger."""
    rng = np.random.default_rng(seed)
    words = {name: f"x{number}" for number, name in enumerate(rng.permutation([each.name for each in hand.links]))}
    turns = {each.name: f"y{number}" for number, each in enumerate(hand.joints)}
    fingers = {name: f"z{number}" for number, name in enumerate(rng.permutation(list(hand.fingers)))}

    def of(one: object) -> object:
        mimic = getattr(one, "mimic", None)
        names = {"name": turns[one.name], "parent": words[one.parent], "child": words[one.child]}
        return replace(one, **names, mimic=None if mimic is None else replace(mimic, joint=turns[mimic.joint]))

    renamed = replace(
        hand,
        links=tuple(replace(each, name=words[each.name]) for each in hand.links),
        joints=tuple(map(of, hand.joints)),
        joint_names=tuple(turns[name] for name in hand.joint_names),
        contacts=tuple(replace(one, link=words[one.link], group=fingers[one.group]) for one in hand.contacts),
        base_link=words[hand.base_link],
    )
    return renamed, {new: old for old, new in fingers.items()}


@pytest.mark.parametrize("name", ["shadow", "shadow_palm", "allegro", "leap"])
@pytest.mark.parametrize("seed", [0, 1])
def test_thumb_and_order_are_found_without_names(name: str, seed: int):
    hand, old = nameless(load_hand(name), seed)
    frame = HandFrame.of(hand)
    order = ["thumb", "index", "middle", "ring", "little"]
    assert [old[finger] for finger in frame.fingers] == order[: len(hand.fingers)]
    assert frame.thumb == "side"
    assert not frame.is_left


def test_jaws_have_no_thumb():
    frame = HandFrame.of(load_hand("franka_hand"))
    assert frame.thumb == "none"
    np.testing.assert_allclose(np.abs(frame.axes[:, 2]), [0, 0, 1], atol=0.05)


def test_the_side_of_the_thumb_orders_the_fingers_and_tells_left_from_right(tmp_path: Path):
    frames = []
    for at in (-0.03, 0.03, 0.0):
        (folder := tmp_path / str(at)).mkdir()
        frames.append(HandFrame.of(tripod(folder, thumb_at=at)))
    first, second, middle = frames
    assert first.fingers == ("d", "a", "b", "c")
    assert second.fingers == ("d", "c", "b", "a")
    assert first.is_left != second.is_left
    assert middle.thumb == "middle"
    assert not middle.is_left


def test_geometry_counts_more_than_a_misleading_name(tmp_path: Path):
    assert HandFrame.of(tripod(tmp_path, thumb_at=0.01, misnamed=True)).fingers[0] == "d"


def test_closing_directions_and_axes_are_those_of_the_geometry(tmp_path: Path):
    across, along, approach = HandFrame.of(tripod(tmp_path, thumb_at=-0.03)).axes.T
    np.testing.assert_allclose(along, [0, 1, 0], atol=1e-6)
    assert across @ [-1, 0, 0] > 0.95
    assert approach @ [0, 0, 1] > 0.95
