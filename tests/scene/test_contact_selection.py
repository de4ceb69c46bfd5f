"""Which links should touch, when nobody says: those that are near, of two groups at least."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import made_hands
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.core.errors import GraspRefineError, HandError
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.objects.region import ContactRegions, HalfSpace
from grasp_refine.scene.contact_selection import FLUSH_M, PALM, ContactSelection, link_groups, nearest_points
from made_hands import BALL, joint, made_hand
from plate_gripper import URDF
from refusals import refused
from twists import random_poses

PAIRS = Pairs((build_body("a", [sphere(0.02)]),), (build_body("b", [sphere(0.03)]),))


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro", candidates=16)


def links_of(hand: Hand) -> tuple[str, ...]:
    first = [contact.link for contact in hand.contacts]
    return (*first, *(link.name for link in hand.links if link.body is not None and link.name not in first))


def at(hand: Hand, distances: dict[str, float], links: tuple[str, ...] | None = None) -> Witness:
    """Witness points (1, L) of which only the distances matter; links that are not named are FAR."""
    links = links or links_of(hand)
    d = np.array([[distances.get(link, np.nan) for link in links]])
    status = np.where(np.isnan(d), QueryStatus.FAR, np.where(d > 0, QueryStatus.SEPARATED, QueryStatus.PENETRATING))
    zero = np.zeros(d.shape, dtype=np.int64)
    # A pair that is FAR carries its cutoff as distance, which may well be within reach.
    points = np.zeros((3, *d.shape, 3))
    return Witness(*points, np.where(np.isnan(d), 0.0, d), status, zero, zero)


def chosen(hand: Hand, touching: ContactSelection, distances: dict[str, float]) -> set[str]:
    links = links_of(hand)
    found = touching.choose(hand, links, at(hand, distances))
    return {link for link, on in zip(links, found[0], strict=True) if on}


INDEX, MIDDLE, RING, THUMB = (f"link_{number}.0_tip" for number in (3, 7, 11, 15))


def test_groups_are_fingers_and_what_carries_several_of_them(hand: Hand) -> None:
    groups = dict(zip(links_of(hand), link_groups(hand, links_of(hand)), strict=True))
    assert groups[INDEX] == groups["link_1.0"] == "index" and groups[THUMB] == groups["link_13.0"] == "thumb"
    assert groups["base_link"] == PALM and set(groups.values()) == {"index", "middle", "ring", "thumb", PALM}


def test_fingertips_reach_farther_than_other_links(hand: Hand) -> None:
    touching = ContactSelection(reach=0.01, other_link_distance=0.003)
    near = {INDEX: 0.01, MIDDLE: 0.0100001, THUMB: -0.02, "link_1.0": 0.003, "link_5.0": 0.0030001, "base_link": -1e-3}
    assert chosen(hand, touching, near) == {INDEX, THUMB, "link_1.0", "base_link"}
    assert chosen(hand, replace(touching, reach=0.011), near) == {INDEX, MIDDLE, THUMB, "link_1.0", "base_link"}
    assert chosen(hand, replace(touching, other_link_distance=0.0), near) == {INDEX, THUMB, "base_link"}


def test_there_are_two_groups_if_they_are_anywhere_near(hand: Hand) -> None:
    touching = ContactSelection()
    # The second group is the nearest tip of another finger, and only that one.
    assert chosen(hand, touching, {INDEX: 0.005, MIDDLE: 0.02, THUMB: 0.025}) == {INDEX, MIDDLE}
    # Two links of one finger are one group; links other than tips do not count beyond their reach.
    far = {INDEX: 0.005, "link_2.0": 0.001, "link_9.0": 0.011, THUMB: 0.03}
    assert chosen(hand, touching, far) == {INDEX, "link_2.0", THUMB}
    # Nobody within reach: the two nearest.
    assert chosen(hand, touching, {INDEX: 0.012, MIDDLE: 0.02, RING: 0.015, THUMB: 0.029}) == {INDEX, RING}
    # Of a finger with two contact links that are nearest, one is added.
    pair = replace(hand, contacts=(*hand.contacts, replace(hand.contacts[-1], link="link_14.0")))
    assert chosen(pair, touching, {THUMB: 0.012, "link_14.0": 0.013, INDEX: 0.02}) == {THUMB, INDEX}
    # The palm is a group.
    assert chosen(hand, touching, {INDEX: 0.005, "base_link": 0.001, THUMB: 0.02}) == {INDEX, "base_link"}
    assert chosen(hand, touching, {INDEX: 0.005, MIDDLE: 0.0301}) == {INDEX}
    assert chosen(hand, touching, {INDEX: 0.0301, MIDDLE: 0.0302}) == set()
    assert chosen(hand, replace(touching, farthest=0.0), {INDEX: 0.005, MIDDLE: 0.02}) == {INDEX}


def test_without_an_answer_nothing_touches(hand: Hand) -> None:
    links = links_of(hand)
    witness = at(hand, {INDEX: 0.001, MIDDLE: 0.001, RING: 0.001, THUMB: 0.001})
    status = witness.status.copy()
    status[0, :3] = QueryStatus.FAR, QueryStatus.FAILED, QueryStatus.NOT_FINITE
    found = ContactSelection().choose(hand, links, replace(witness, status=status))
    assert found.sum() == 1 and found[0, links.index(THUMB)]


def test_grasps_are_judged_one_by_one(hand: Hand) -> None:
    near = [{INDEX: 0.001, THUMB: 0.002}, {}, {RING: 0.02, MIDDLE: 0.021}]
    every = [at(hand, one) for one in near]
    together = Witness(*(np.concatenate([getattr(w, f) for w in every]) for f in every[0].__dataclass_fields__))
    found = ContactSelection().choose(hand, links_of(hand), together)
    for row, one in zip(found, every, strict=True):
        np.testing.assert_array_equal(row, ContactSelection().choose(hand, links_of(hand), one)[0])
    np.testing.assert_array_equal(found.sum(axis=1), [2, 0, 2])


def test_links_given_by_name_touch_however_far_and_no_others(hand: Hand) -> None:
    touching = ContactSelection(links=("link_5.0", THUMB))
    links = links_of(hand)
    assert chosen(hand, touching, {THUMB: 0.5, "link_5.0": 0.2, INDEX: 0.0}) == {THUMB, "link_5.0"}
    cutoff = touching.cutoff(hand, links)
    np.testing.assert_array_equal(np.isinf(cutoff), np.ones(len(links), dtype=bool))
    np.testing.assert_array_equal(cutoff > 0, np.isin(links, touching.links))


def test_a_link_that_comes_twice_touches_once(hand: Hand) -> None:
    """As with a hand that has two contact points on a link."""
    links = (INDEX, INDEX, THUMB, THUMB, "base_link")
    near = dict.fromkeys(links, 0.001)
    for touching in (ContactSelection(), ContactSelection(links=(THUMB, INDEX))):
        found = touching.choose(hand, links, at(hand, near, links))
        np.testing.assert_array_equal(found[0, :4], [True, False, True, False])


def test_what_could_matter_is_asked_and_what_cannot_is_not(hand: Hand) -> None:
    links = links_of(hand)
    tips = np.isin(links, [contact.link for contact in hand.contacts])
    cutoff = ContactSelection(reach=0.01, other_link_distance=0.004, farthest=0.02).cutoff(hand, links)
    np.testing.assert_allclose(cutoff, np.where(tips, 0.02, 0.004), rtol=1e-12)
    assert (cutoff > np.where(tips, 0.02, 0.004)).all(), "what is exactly at the limit is asked"
    assert ContactSelection(reach=0.05).cutoff(hand, links).max() == pytest.approx(0.05)


@pytest.mark.parametrize("name", ["reach", "other_link_distance", "farthest"])
@pytest.mark.parametrize("value", [-0.001, float("nan")])
def test_distances_below_zero_are_refused(name: str, value: float) -> None:
    with refused(GraspRefineError, name, f" {value:g}"):
        ContactSelection(**{name: value})


def test_unknown_links_are_refused_with_the_known_ones(hand: Hand) -> None:
    links = links_of(hand)
    with refused(HandError, "allegro", "knee", "thumb", f"{INDEX}, ", "base_"):
        ContactSelection(links=(INDEX, "knee")).cutoff(hand, links)


def test_a_finger_stands_for_its_contact_links(hand: Hand) -> None:
    links = links_of(hand)
    assert ContactSelection(links=("thumb", "link_1.0", THUMB)).named(hand, links) == (THUMB, "link_1.0")
    near = {INDEX: 0.5, THUMB: 0.5, "link_1.0": 0.5, "base_link": 0.001}
    assert chosen(hand, ContactSelection(links=("thumb", "link_1.0")), near) == {THUMB, "link_1.0"}
    cutoff = dict(zip(links, ContactSelection(links=("thumb",)).cutoff(hand, links), strict=True))
    assert cutoff[THUMB] == np.inf and cutoff[INDEX] == cutoff["base_link"] == -np.inf
    # All of them, where a finger has several.
    pair = replace(hand, contacts=(*hand.contacts, replace(hand.contacts[-1], link="link_14.0")))
    assert set(ContactSelection(links=(hand.contacts[-1].group,)).named(pair, links)) >= {"link_14.0"}


def test_a_palm_that_carries_two_fingers_or_an_arm_touches_nothing(hand: Hand, tmp_path: Path) -> None:
    """Nothing presses the object against either."""
    jaws = tmp_path / "jaws.urdf"
    jaws.write_text(URDF)
    gripper, arm = load_hand(jaws, candidates=16), mount(load_hand("ur5e", candidates=16), hand)
    for one, idle in ((gripper, {"palm"}), (arm, set(arm.arm.links))):
        links = links_of(one)
        found = ContactSelection().choose(one, links, at(one, dict.fromkeys(links, 0.001)))[0]
        assert {link for link, touches in zip(links, found, strict=True) if not touches} == idle & set(links)


def test_of_contact_links_fixed_together_those_flush_with_the_nearest_touch(tmp_path: Path) -> None:
    """Where they were guessed: a nail does not touch behind a pad."""
    turn = {"at": "0.1 0 0", "axis": "0 0 1", "limits": (-1, 1)}
    gripper = made_hand(
        tmp_path,
        made_hands.links("palm", "finger", "pad", "nail", "thumb", inside=BALL),
        joint("f", "palm", "finger", **turn) + joint("t", "palm", "thumb", **turn),
        joint("p", "finger", "pad", "fixed") + joint("n", "finger", "nail", "fixed"),
    )
    near = {"finger": 0.002 + 0.5 * FLUSH_M, "pad": 0.002, "nail": 0.002 + 1.5 * FLUSH_M, "thumb": 0.003, "palm": 0.02}
    assert chosen(gripper, ContactSelection(), near) == {"finger", "pad", "thumb"}


def test_targets_are_points_of_the_bodies_in_closed_form() -> None:
    T_a, T_b = random_poses(3, 1), random_poses(3, 2)
    along = np.random.default_rng(3).normal(size=(3, 1, 3))
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    T_b[..., :3, 3] = T_a[..., :3, 3] + (0.05 + np.array([-0.01, 0.005, 0.02]))[:, None, None] * along
    touching = np.array([[True], [True], [False]])
    on_a, on_b = nearest_points(query(PAIRS, T_a, T_b), T_a, T_b, touching)
    # On the balls' surfaces, in the frame of the ball, towards the other one.
    n = np.where(touching[..., None], along, np.nan)
    np.testing.assert_allclose(on_a, 0.02 * np.einsum("bpji,bpj->bpi", T_a[..., :3, :3], n), atol=1e-9)
    np.testing.assert_allclose(on_b, -0.03 * np.einsum("bpji,bpj->bpi", T_b[..., :3, :3], n), atol=1e-9)
    # Moved with their bodies they stay where they are on them.
    M = random_poses(1, 4)[0, 0]
    gap = transform_points(M @ T_b, on_b) - transform_points(M @ T_a, on_a)
    np.testing.assert_allclose(np.linalg.norm(gap, axis=-1)[:, 0], [0.01, 0.005, np.nan], atol=1e-9)


def test_links_that_can_come_into_the_regions_are_preferred(hand: Hand) -> None:
    links, regions = links_of(hand), ContactRegions((HalfSpace("above", np.eye(3)[2], 0.0),))
    near = at(hand, dict.fromkeys((INDEX, MIDDLE, RING, THUMB), 0.002))

    def chosen_at(heights: dict[str, float], touching: ContactSelection) -> set[str]:
        points = near.point_b.copy()
        points[0, :, 2] = [heights.get(link, 0.0) for link in links]
        found = touching.choose_within(hand, links, replace(near, point_b=points), regions)
        return {link for link, on in zip(links, found[0], strict=True) if on}

    # 8 mm outside and 2 mm away are at the reach of 10 mm; of one group alone no region has contacts.
    assert chosen_at({RING: -0.0079, THUMB: -0.0081}, ContactSelection()) == {INDEX, MIDDLE, RING}
    far = {INDEX: -0.02, MIDDLE: -0.04, RING: -0.04}
    assert chosen_at(far, ContactSelection()) == {INDEX, THUMB}
    assert chosen_at({**far, INDEX: -0.04}, ContactSelection()) == {INDEX, MIDDLE, RING, THUMB}
    assert chosen_at(far, ContactSelection(links=(RING,))) == {RING}
