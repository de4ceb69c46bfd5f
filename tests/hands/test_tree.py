"""Kinematic trees: order, subtrees, joints, and what files whose links form no tree say."""

from pathlib import Path

import numpy as np
import pytest

import made_hands
from grasp_refine.core.errors import HandError
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.tree import Tree
from made_hands import write_urdf
from refusals import refused

LIMIT = '<limit lower="-1" upper="2" effort="3"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def tree(folder: Path, links: str, *joints: str) -> Tree:
    return read_tree(write_urdf(folder, made_hands.links(*links), *joints))


def test_parents_come_before_children_whatever_the_file_order(tmp_path: Path) -> None:
    hand = tree(tmp_path, "dcba", joint("3", "c", "d"), joint("2", "b", "c"), joint("1", "a", "b"))
    links, joints = hand.below("a")
    assert hand.root == "a" and list(hand.joints) == ["3", "2", "1"]
    assert [j.name for j in joints] == ["1", "2", "3"] and [link.name for link in links] == list("abcd")


def test_joints_are_read_with_unit_axes_and_limits(tmp_path: Path) -> None:
    turn = '<origin xyz="1 2 3"/><axis xyz="0 3 4"/><limit lower="-1" upper="2" effort="3"/>'
    hand = tree(
        tmp_path,
        "abcde",
        joint("r", "a", "b", inside=turn),
        joint("p", "b", "c", "prismatic", '<limit lower="0" upper="0.1" effort="0"/>'),
        joint("c", "c", "d", "continuous", '<limit lower="-1" upper="1"/>'),
        joint("f", "d", "e", "fixed", '<axis xyz="0 0 0"/><mimic joint="r"/>'),
    )
    r, p, c, f = hand.below("a")[1]
    np.testing.assert_allclose(r.axis, [0, 0.6, 0.8])
    np.testing.assert_array_equal(r.T_parent_child, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert (r.lower, r.upper, r.effort, r.mimic, r.movable) == (-1, 2, 3, None, True)
    np.testing.assert_array_equal(p.axis, [1, 0, 0])
    assert p.effort is None, "an effort of 0 means that it is unknown"
    assert (c.lower, c.upper) == (-np.inf, np.inf)
    assert (f.lower, f.upper, f.mimic, f.movable) == (0, 0, None, False)
    np.testing.assert_array_equal(f.axis, 0)


def test_a_subtree_leaves_out_what_is_above_and_beside_it_with_its_defects(tmp_path: Path) -> None:
    hand = tree(
        tmp_path,
        "abcd",
        joint("1", "a", "b", "floating"),
        joint("2", "a", "c", inside='<limit lower="1" upper="0"/>'),
        joint("3", "b", "d"),
    )
    links, joints = hand.below("b")
    assert [link.name for link in links] == ["b", "d"] and [j.name for j in joints] == ["3"]
    with refused(HandError, "'z'", "a, b, c, d"):
        hand.below("z")


@pytest.mark.parametrize(
    ("links", "joints", "named"),
    [
        ("", [], ("links",)),
        ("ab", [], ("2 links", "a, b")),
        ("aab", [joint("1", "a", "b")], ("link", "'a'")),
        ("abc", [joint("1", "a", "b"), joint("1", "b", "c")], ("joint", "'1'")),
        ("ab", [joint("1", "a", "z")], ("'1'", "child", "'z'", "a, b")),
        ("ab", [joint("1", "z", "b")], ("'1'", "parent", "'z'", "a, b")),
        ("abc", [joint("1", "a", "c"), joint("2", "b", "c")], ("'c'", "'1'", "'2'")),
        ("ab", [joint("1", "a", "b"), joint("2", "b", "a")], ("a -> b -> a",)),
        ("ab", [joint("1", "a", "a"), joint("2", "a", "b")], ("a -> a",)),
        ("abcd", [joint("1", "b", "c"), joint("2", "c", "d"), joint("3", "d", "b")], ("b -> c -> d -> b",)),
    ],
)
def test_links_that_form_no_tree(tmp_path: Path, links: str, joints: list[str], named: tuple[str, ...]) -> None:
    with refused(HandError, "hand.urdf", *named):
        tree(tmp_path, links, *joints)


@pytest.mark.parametrize(
    ("kind", "inside", "named"),
    [
        ("floating", "", ("floating", "base_link", "'b'")),
        ("planar", "", ("planar", "base_link", "'b'")),
        ("hinge", "", ("'hinge'", "revolute, continuous, prismatic, fixed")),
        ("revolute", "", ("revolute", "limits", "lower", "upper", "continuous")),
        ("revolute", '<limit upper="1"/>', ("revolute", "limits", "lower", "upper")),
        ("prismatic", '<limit lower="0" effort="1"/>', ("prismatic", "limits", "lower", "upper")),
        ("revolute", '<limit lower="1" upper="-1"/>', ("lower 1", "upper -1")),
        ("continuous", '<axis xyz="0 0 0"/>', ("axis", "[0.0, 0.0, 0.0]")),
        ("continuous", '<axis xyz="1e300 0 0"/>', ("axis", "[1e+300, 0.0, 0.0]")),
    ],
)
def test_joints_that_no_hand_can_have(tmp_path: Path, kind: str, inside: str, named: tuple[str, ...]) -> None:
    hand = tree(tmp_path, "ab", joint("1", "a", "b", kind, inside))
    with refused(HandError, "hand.urdf", "'1'", *named) as caught:
        hand.below("a")
    # No slide goes on for ever.
    assert kind != "prismatic" or "continuous" not in str(caught.value)


@pytest.mark.parametrize(
    ("follows", "base", "named"),
    [
        ({"2": "9"}, "a", ("'2'", "'9'", "1, 2, 3, 4")),
        ({"2": "2"}, "a", ("'2'", "2 -> 2")),
        ({"2": "3", "3": "2"}, "a", ("'2'", "2 -> 3 -> 2")),
        ({"1": "2", "2": "3", "3": "2"}, "a", ("'2'", "1 -> 2 -> 3 -> 2")),
        ({"3": "1"}, "b", ("'3'", "'1'", "'b'")),
        ({"2": "4"}, "a", ("'2'", "'4'", "fixed")),
    ],
)
def test_mimics_that_follow_nothing(tmp_path: Path, follows: dict[str, str], base: str, named: tuple[str, ...]) -> None:
    def inside(name: str) -> str:
        return LIMIT + (f'<mimic joint="{follows[name]}"/>' if name in follows else "")

    chain = [joint(name, p, c, inside=inside(name)) for name, p, c in ("1ab", "2bc", "3cd")]
    hand = tree(tmp_path, "abcde", *chain, joint("4", "d", "e", "fixed"))
    with refused(HandError, *named):
        hand.below(base)
