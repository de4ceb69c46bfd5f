"""Mimic joints: what they follow in the end, and how they limit it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.mimics import followed, limit_by_followers
from grasp_refine.hands.files.tree import Joint, Mimic
from refusals import assert_names, refused

URDF = Path("hand.urdf")


def joint(
    name: str, lower: float, upper: float, mimic: tuple[str, float, float] | None = None, kind: str = "revolute"
) -> Joint:
    follow = None if mimic is None else Mimic(*mimic)
    return Joint(name, kind, "base", f"{name}_link", np.eye(4), np.array([0.0, 0.0, 1.0]), lower, upper, follow, None)


def limits(*joints: Joint) -> dict[str, tuple[float, float]]:
    return {j.name: (j.lower, j.upper) for j in limit_by_followers(joints, URDF)[0]}


def test_limits_keep_all_followers_within_theirs() -> None:
    """Whatever the signs and offsets, both ends of the range are ends of some joint's own, and none is left."""
    joints = [
        joint("a", -1, 2),
        joint("b", -1, 0.5, ("a", -0.5, 0.25)),  # a from -0.5 to 2.5
        joint("c", -0.02, 0.015, ("b", 0.02, 0.0), "prismatic"),  # b from -1 to 0.75
        joint("d", -3, 1.5, ("c", 100.0, -0.5), "revolute"),  # c at most 0.02
        joint("e", -np.inf, np.inf, ("a", 7.0, 0.0), "continuous"),
        joint("other", -1, 1),
    ]
    narrow, (note,) = limit_by_followers(joints, URDF)
    assert [(j.lower, j.upper) for j in narrow] == [(-0.5, 2), *((j.lower, j.upper) for j in joints[1:])]
    assert_names(note, "'a'", "-0.5 to 2 rad", "-1 to 2", " b ")
    by_name = {j.name: j for j in narrow}
    for follower in narrow[1:]:
        leads = followed(follower, by_name)
        ends = leads.multiplier * np.array([by_name[leads.joint].lower, by_name[leads.joint].upper]) + leads.offset
        assert follower.lower - 1e-12 <= ends.min() and ends.max() <= follower.upper + 1e-12


def test_couplings_on_curves_are_put_into_each_other() -> None:
    b, c = Mimic("a", 0.5, 0.1, (0.3,)), Mimic("b", -2.0, 0.25, (0.7,))
    joints = {
        "a": joint("a", -1, 1),
        "b": replace(joint("b", -9, 9), mimic=b),
        "c": replace(joint("c", -9, 9), mimic=c),
    }
    found, x = followed(joints["c"], joints), np.linspace(-1, 1, 5)
    y = 0.1 + 0.5 * x + 0.3 * x**2
    assert found.joint == "a"
    np.testing.assert_allclose(np.polynomial.polynomial.polyval(x, found.coefficients), 0.25 - 2.0 * y + 0.7 * y**2)


def test_limits_that_were_rounded_are_kept_without_a_word() -> None:
    joints = [joint("a", 0, 1.5708), joint("b", 0, 1.57, ("a", 1, 0))]
    narrow, notes = limit_by_followers(joints, URDF)
    assert notes == [] and narrow[0].upper == 1.57


def test_a_continuous_joint_turns_as_far_as_its_followers_let_it() -> None:
    joints = [joint("a", -np.inf, np.inf, kind="continuous"), joint("b", -1, 1, ("a", 0.5, 0.0))]
    (a, _), (note,) = limit_by_followers(joints, URDF)
    assert (a.kind, a.lower, a.upper) == ("revolute", -2, 2)
    assert_names(note, "'a'", "-2 to 2 rad", "-inf to inf")
    joints = [joint("a", -np.inf, np.inf, kind="continuous"), joint("b", -np.inf, np.inf, ("a", 1, 0), "continuous")]
    assert limit_by_followers(joints, URDF) == (joints, [])


@pytest.mark.parametrize(
    ("follower", "named"),
    [
        (joint("b", 0, 0.8, ("a", -1, 0)), ("-1 x 'a' + 0", "0 to 0.8")),
        (joint("b", 2, 3, ("a", 1, 0.5)), ("2 to 3", "1 x 'a' + 0.5", "0 to 0.8")),
        (joint("b", 0, 1, ("a", 0, 2)), ("0 to 1", "2", "multiplier is 0")),
    ],
)
def test_limits_that_leave_nothing_are_refused(follower: Joint, named: tuple[str, ...]) -> None:
    with refused(HandError, URDF, "'b'", *named):
        limit_by_followers([joint("a", 0, 0.8), follower], URDF)


def test_a_follower_that_never_moves_limits_nothing() -> None:
    assert limits(joint("a", 0, 1), joint("b", 0, 1, ("a", 0, 0.5)))["a"] == (0, 1)


@pytest.mark.parametrize("seed", range(20))
def test_limits_that_meet_in_one_value_may_be_rounded(seed: int) -> None:
    value, offset = np.random.default_rng(seed).uniform(-1, 1, 2)
    where = round(0.7 * value + offset, 3)
    lower, upper = limits(joint("a", value, value), joint("b", where, where, ("a", 0.7, offset)))["a"]
    assert lower == upper == value


def test_followers_may_take_their_limits_from_the_joint_that_they_follow() -> None:
    """A left hand mirrored by its signs, whose limits are still those of the right one."""
    joints = [joint("a", 0.2, 0.8), joint("b", 0, 0.8, ("a", -0.5, 0.1)), joint("c", 0, 1, ("b", 2.0, 0.0))]
    with refused(HandError, URDF, "'b'", "follower_limits"):
        limit_by_followers(joints, URDF)
    (a, b, c), notes = limit_by_followers(joints, URDF, "leader")
    assert notes == [] and (a.lower, a.upper) == (0.2, 0.8)
    assert (b.lower, b.upper) == pytest.approx((-0.3, 0.0)) and (c.lower, c.upper) == pytest.approx((-0.6, 0.0))
