"""Self-collision: balls on slides, of which it is known who can meet whom, and real hands."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import CollisionError, HandError
from grasp_refine.hands import link_pairs, self_collision
from grasp_refine.hands.clear_rest import clear_rest
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.self_collision import (
    Sampling,
    classify_pairs,
    ignored_overlaps,
    overlapping_pairs,
    self_penetration,
    touching_pairs,
)
from made_hands import joint, link, made_hand, solid
from refusals import assert_names, refused

RADIUS = 0.01
"""Of every ball, in metres."""

QUICK = Sampling(extreme=300)
"""Enough for hands of a few joints."""


def ball(name: str, radius: float | None = RADIUS) -> str:
    return link(name, solid(f"sphere {radius}") if radius else "")


def slide(
    parent: str, child: str, low: float, high: float, *, z: float = 0.0, radius: float | None = RADIUS, mimic: str = ""
) -> str:
    """A ball that moves along x from `low` to `high`, where it is seen from its parent."""
    settings = {"at": (0, 0, z), "axis": "1 0 0", "limits": (low, high), "follow": (mimic,) if mimic else None}
    return ball(child, radius) + joint(f"{child}_slide", parent, child, "prismatic", **settings)


def fixed(parent: str, child: str, z: float) -> str:
    """A ball at rest above its parent."""
    return ball(child) + joint(f"{child}_mount", parent, child, "fixed", at=(0, 0, z))


def turn(parent: str, child: str, reach: float, at: tuple | None = None) -> str:
    """A ball that turns about z without a limit, `reach` away from the axis; at 0 it is on the x axis."""
    part = link(child, solid(f"sphere {RADIUS}", (reach, 0, 0)))
    return part + joint(f"{child}_turn", parent, child, "continuous", axis="0 0 1", at=at)


def build(folder: Path, *parts: str, rest: dict[str, float] | None = None, base: str = ball("base")) -> Hand:
    pose = ", ".join(f"{child}_slide = {value}" for child, value in (rest or {}).items())
    return made_hand(folder, base, *parts, toml=f"rest_pose = {{ {pose} }}")


def found(hand: Hand, sampling: Sampling = QUICK) -> tuple[tuple[str, str], ...]:
    return touching_pairs(hand, sampling, cache=None)


def test_links_that_can_meet_are_found_and_rigid_ones_and_neighbours_are_not(tmp_path: Path) -> None:
    hand = build(
        tmp_path,
        fixed("base", "mount", 0.015),
        slide("base", "left", 0.015, 0.16),
        fixed("left", "pad", 0.015),
        slide("base", "right", 0.16, 0.24),
        slide("right", "end", -0.04, 0.04, z=0.015),
        slide("base", "nothing", -0.03, 0.03, radius=None),
    )
    closed = hand.lower[None]
    for pair in (("base", "mount"), ("base", "left"), ("mount", "pad")):
        assert self_penetration(hand, [pair], closed) > 0, "they overlap by design"
    assert found(hand) == (("left", "right"), ("left", "end"), ("pad", "right"), ("pad", "end"))


def test_links_over_a_joint_without_anything_solid_between_are_neighbours(tmp_path: Path) -> None:
    parts = slide("base", "between", -0.01, 0.01, radius=None), slide("between", "tip", 0.025, 0.06)
    assert found(build(tmp_path, *parts)) == (), "though they overlap where both are at their lower limits"
    solid = slide("base", "between", -0.01, 0.01, z=0.1), slide("between", "tip", 0.025, 0.06, z=-0.1)
    assert found(build(tmp_path, *solid)) == (("base", "tip"),)


@pytest.mark.parametrize(("apart", "pairs"), [(0.0, ()), (0.02, (("base", "finger"),))])
def test_links_over_joints_that_turn_about_one_point_are_neighbours(
    tmp_path: Path, apart: float, pairs: tuple[tuple[str, str], ...]
) -> None:
    """A knuckle of two joints is one joint; where the second sits elsewhere, it is none."""
    base = f"""<link name="base"><collision><origin xyz="-0.05 0.01 0"/><geometry><sphere radius="{RADIUS}"/></geometry>
      </collision></link>"""
    knuckle = turn("base", "knuckle", 0.0)
    finger = turn("knuckle", "finger", 0.045, (apart, 0, 0))
    assert found(build(tmp_path, knuckle, finger, base=base)) == pairs


def test_fingers_on_a_base_that_is_not_solid_are_no_neighbours(tmp_path: Path) -> None:
    fingers = slide("base", "a", 0.0, 0.1), slide("base", "b", 0.1, 0.2)
    assert found(build(tmp_path, *fingers, base=ball("base", None))) == (("a", "b"),)


def test_more_pairs_than_are_looked_at_are_refused_before_anything_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A URDF of 20,000 links once kept `hands --check` busy for minutes."""
    monkeypatch.setattr(link_pairs, "query", None)
    monkeypatch.setattr(self_collision, "MAX_PAIRS", 9)
    # Four moving balls and the base with a ball fixed to it: 4 x 3 / 2 pairs of them, 2 x 4 with the base.
    parts = [slide("base", name, 0.0, 0.1) for name in "abcd"]
    with refused(HandError, "14 pairs", " 9 "):
        found(build(tmp_path, *parts, fixed("base", "more", 0.5)))


def test_a_joint_that_cannot_move_is_rigid(tmp_path: Path) -> None:
    def hand(low: float) -> Hand:
        return build(tmp_path, slide("base", "a", 0, 0.1, z=0.1), slide("a", "b", low, 0), slide("b", "c", 0.015, 0.06))

    assert found(hand(-0.01)) == (("a", "c"),)
    assert found(hand(0.0)) == ()


def test_the_margin_decides_about_links_that_only_come_near(tmp_path: Path) -> None:
    gap = 0.003
    hand = build(tmp_path, slide("base", "a", 0.05, 0.1), slide("base", "b", 0.1 + 2 * RADIUS + gap, 0.2))
    assert found(hand, Sampling(extreme=300, margin=gap + 1e-4)) == (("a", "b"),), "both at a limit: one time in 16"
    assert found(hand, Sampling(extreme=300, margin=gap - 1e-4)) == ()
    assert found(hand, Sampling(extreme=0, margin=gap + 1e-4)) == (), "inside the limits they never meet"


def test_links_that_overlap_at_rest_are_kept_apart(tmp_path: Path) -> None:
    """Real hands whose fingers cross at mid-range ended with fingers in each other, and no number showed it."""
    hand = build(tmp_path, slide("base", "a", 0.05, 0.1), slide("base", "b", 0.05, 0.1))
    assert self_penetration(hand, [("a", "b")], hand.rest[None]) == pytest.approx(2 * RADIUS)
    assert found(hand) == (("a", "b"),)
    classes = classify_pairs(hand, QUICK, cache=None)
    assert (classes.at_rest, classes.checked, classes.nearly_always) == ((("a", "b"),), (("a", "b"),), ())


@pytest.mark.parametrize(("reach", "pairs"), [(0.0201, ()), (0.0212, (("a", "b"),))])
def test_links_that_overlap_in_nearly_all_configurations_are_left_out(
    tmp_path: Path, reach: float, pairs: tuple[tuple[str, str], ...]
) -> None:
    """Apart beyond 20 mm: in 0.1 / 20.1 and 1.2 / 21.2 of the range, 0.5 and 5.7 % of it."""
    hand = build(tmp_path, slide("base", "a", 0.05, 0.0500001), slide("base", "b", 0.05, 0.05 + reach))
    assert found(hand) == pairs
    assert found(hand, Sampling(extreme=300, always=0.9)) == ()
    ignored = overlapping_pairs(hand, QUICK, cache=None)
    assert set(ignored) == {("a", "b")} - set(pairs)


def test_overlaps_of_ignored_links_are_noted_beyond_what_every_configuration_has(tmp_path: Path) -> None:
    """Balls whose centres are 5 to 15 mm apart overlap by 5 to 15 mm: their least overlap is 5 mm."""
    hand = build(tmp_path, slide("base", "a", 0.05, 0.0500001), slide("base", "b", 0.055, 0.065))
    ((pair, least),) = overlapping_pairs(hand).items()
    assert pair == ("a", "b") and least == pytest.approx(0.005, abs=1e-4)
    assert ignored_overlaps(hand, np.array([[0.05, 0.0645]])) == ""
    note = ignored_overlaps(hand, np.array([[0.05, 0.065], [0.05, 0.06], [np.nan, 0.05]]))
    assert_names(note, "a and b", "10.0 mm", hand.name)
    assert ignored_overlaps(build(tmp_path, slide("base", "a", 0.05, 0.1)), np.array([[0.06]])) == ""


@pytest.mark.parametrize("at", [(-0.035, 0.035, 0), (-0.035, -0.035, 0), (0.035, 0.035, 0), (0.035, -0.035, 0)])
def test_joints_without_limits_turn_all_around(tmp_path: Path, at: tuple[float, float, float]) -> None:
    post = ball("post") + joint("post_j", "base", "post", "prismatic", at=at, axis="0 0 1", limits=(0, 1e-3))
    assert found(build(tmp_path, turn("base", "hand", 0.05), post)) == (("hand", "post"),)


def test_mimic_joints_follow(tmp_path: Path) -> None:
    def hand(mimic: str) -> Hand:
        return build(tmp_path, slide("base", "a", 0.1, 0.2), slide("base", "b", 0.1, 0.2, z=0.015, mimic=mimic))

    # The middle of both ranges is the rest pose, where free slides would overlap as well.
    assert self_penetration(hand(""), [("a", "b")], np.array([[0.1, 0.2]])) == 0.0
    assert self_penetration(hand("a_slide"), [("a", "b")], np.array([[0.1]])) == pytest.approx(0.005, abs=1e-9)
    apart = slide("base", "a", 0.1, 0.2), slide("a", "c", 0.04, 0.05), slide("base", "b", 0.1, 0.2)
    assert ("c", "b") in found(build(tmp_path, *apart, rest={"a": 0.2, "b": 0.1}))
    following = (*apart[:2], slide("base", "b", 0.1, 0.2, mimic="a_slide"))
    assert ("c", "b") not in found(build(tmp_path, *following)), "40 mm apart wherever they are"


@pytest.mark.parametrize(
    "setting",
    [
        {"uniform": 0},
        {"more": -1},
        {"extreme": -1},
        {"seed": -1},
        {"margin": -0.001},
        {"margin": np.inf},
        {"always": 1.1},
    ],
)
def test_settings_out_of_range_are_refused(setting: dict[str, float]) -> None:
    ((name, value),) = setting.items()
    # The settings as they are, and which of them may not be so.
    with refused(CollisionError, f"{name}={value}") as caught:
        Sampling(**setting)
    assert str(caught.value).count(name) >= 2


@pytest.fixture
def pliers(tmp_path: Path) -> Hand:
    return build(tmp_path / "pliers", slide("base", "a", 0.05, 0.1), slide("base", "b", 0.1, 0.2))


PLIERS = (("a", "b"),)


def test_the_second_time_the_answer_is_read(pliers: Hand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert touching_pairs(pliers, QUICK, cache=tmp_path / "cache") == PLIERS
    monkeypatch.setattr(link_pairs, "query", lambda *_, **__: pytest.fail("it was asked again"))
    assert touching_pairs(pliers, QUICK, cache=tmp_path / "cache") == PLIERS


@pytest.mark.parametrize("kind", ["cut short", "no archive", "other array", "other length", "other type", "pickled"])
def test_a_damaged_entry_is_replaced(pliers: Hand, tmp_path: Path, kind: str) -> None:
    cache = tmp_path / "cache"
    touching_pairs(pliers, QUICK, cache=cache)
    (entry,) = cache.iterdir()
    good = entry.read_bytes()
    arrays = {
        "other array": {"pairs": np.array([False])},
        "other length": {"touching": np.array([False, False]), "least_overlap": np.array([0.0, 0.0])},
        "other type": {"touching": np.array([0.0]), "least_overlap": np.array([0.0])},
        "pickled": {"touching": np.array([{}], dtype=object), "least_overlap": np.array([0.0])},
    }
    if kind in arrays:
        np.savez(entry, **arrays[kind])
    else:
        entry.write_bytes(good[: len(good) // 2] if kind == "cut short" else b"no archive")
    assert touching_pairs(pliers, QUICK, cache=cache) == PLIERS
    assert [file.read_bytes() for file in cache.iterdir()] == [good], "it is whole again"


def test_whatever_the_answer_depends_on_has_an_entry_of_its_own(tmp_path: Path) -> None:
    cache, a, b = tmp_path / "cache", slide("base", "a", 0.05, 0.1), slide("base", "b", 0.1, 0.2)
    variants = [
        (a, b),
        (a, slide("base", "b", 0.1, 0.21)),
        (a, slide("base", "b", 0.1, 0.2, z=0.001)),
        (a, slide("base", "b", 0.1, 0.2, radius=0.011)),
        (a, slide("a", "b", 0.1, 0.2)),
        (a, slide("base", "b", 0.05, 0.2, mimic="a_slide")),
        (a, b.replace("1 0 0", "0 1 0")),
        (a, slide("base", "b", 0.05, 0.2, mimic="a_slide").replace("<mimic ", '<mimic offset="0.001" ')),
        (a, b, fixed("b", "c", 0.01)),
    ]
    hands = [build(tmp_path, *parts) for parts in variants]
    hands += [build(tmp_path, a, slide("base", "b", *ends)) for ends in ((0.1, 0.3), (0.05, 0.2))]
    settings = {"seed": 1, "uniform": 127, "more": 9, "extreme": 9, "margin": 0.1, "always": 0.4}
    others = [Sampling(**{name: value}) for name, value in settings.items()]
    names = [self_collision._entry_name(hand, QUICK) for hand in hands]
    names += [self_collision._entry_name(hands[0], sampling) for sampling in others]
    assert len(set(names)) == len(names) == len(variants) + 2 + len(others)
    touching_pairs(hands[0], QUICK, cache=cache)
    renamed = build(tmp_path, slide("base", "left", 0.05, 0.1), slide("base", "right", 0.1, 0.2), rest={"left": 0.06})
    assert touching_pairs(renamed, QUICK, cache=cache) == (("left", "right"),)
    assert [file.name for file in cache.iterdir()] == names[:1], "neither names of links matter, nor paths, nor rest"


def test_penetration_is_that_of_the_deepest_pair(tmp_path: Path) -> None:
    hand = build(tmp_path, *(slide("base", name, -0.1, 0.1) for name in "abc"))
    pairs = list(combinations("abc", 2))
    q = np.array([[-0.05, 0.0, 0.05], [0.0, 0.015, 0.032], [0.0, 0.05, 0.001], [0.0, 2 * RADIUS + 1e-6, 0.06]])
    np.testing.assert_allclose(self_penetration(hand, pairs, q), [0, 0.005, 0.019, 0], atol=1e-9)
    np.testing.assert_allclose(self_penetration(hand, [("c", "b")], q), [0, 0.003, 0, 0], atol=1e-9)
    assert (self_penetration(hand, [], q) == 0.0).all()
    assert self_penetration(hand, pairs, q[:0]).shape == (0,)
    many = np.random.default_rng(0).uniform(-0.1, 0.1, (700, 3))
    gaps = np.abs(many[:, [0, 0, 1]] - many[:, [1, 2, 2]])
    np.testing.assert_allclose(self_penetration(hand, pairs, many), np.maximum(2 * RADIUS - gaps.min(1), 0), atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_penetration_of_what_is_not_finite_is_unknown_and_spoils_no_other(tmp_path: Path, bad: float) -> None:
    hand = build(tmp_path, *(slide("base", name, -0.1, 0.1) for name in "abc"))
    q = np.array([[0.0, 0.015, 0.1], [0.0, bad, 0.1], [0.0, 0.015, bad]])
    for pairs, depth in (([("a", "b")], 0.005), ([], 0.0)):
        np.testing.assert_allclose(self_penetration(hand, pairs, q), [depth, np.nan, np.nan], atol=1e-9)


THUMB_AND_FINGER = {
    "allegro": ("link_3.0_tip", "link_15.0_tip"),
    "leap": ("fingertip", "thumb_fingertip"),
    "barrett": ("finger_1_dist_link", "finger_3_dist_link"),
}


@pytest.mark.parametrize("name", THUMB_AND_FINGER)
def test_thumbs_meet_fingers_and_no_hand_is_in_itself_at_rest(name: str, shared_assets: Path) -> None:
    hand = load_hand(shared_assets / "hands" / name, candidates=16)
    pairs = found(hand, Sampling(extreme=1000))
    assert THUMB_AND_FINGER[name] in pairs
    assert not {frozenset((joint.parent, joint.child)) for joint in hand.joints} & {frozenset(pair) for pair in pairs}
    order = [link.name for link in hand.links]
    places = [(order.index(a), order.index(b)) for a, b in pairs]
    assert places == sorted(places) and all(a < b for a, b in places)
    assert self_penetration(hand, pairs, clear_rest(hand)[None]) == 0.0
