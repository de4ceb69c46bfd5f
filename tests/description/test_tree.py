"""Kinematic trees: order, subtrees, joints, and what files whose links form no tree say."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.description.tree import Tree, read_tree
from grasp_refine.errors import HandError

LIMIT = '<limit lower="-1" upper="2" effort="3"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def tree(folder: Path, links: str, *joints: str) -> Tree:
    path = folder / "hand.urdf"
    elements = "".join(f'<link name="{name}"/>' for name in links)
    path.write_text(f'<robot name="r">{elements}{"".join(joints)}</robot>')
    return read_tree(path)


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
    with pytest.raises(HandError, match="no link 'z'; its links: a, b, c, d"):
        hand.below("z")


@pytest.mark.parametrize(
    ("links", "joints", "message"),
    [
        ("", [], "has no links"),
        ("ab", [], "2 links have no parent, one is allowed: a, b"),
        ("aab", [joint("1", "a", "b")], "several links have the name 'a'"),
        ("abc", [joint("1", "a", "b"), joint("1", "b", "c")], "several joints have the name '1'"),
        (
            "ab",
            [joint("1", "a", "z")],
            "joint '1' has the child link 'z', which does not exist; its links: a, b",
        ),
        (
            "ab",
            [joint("1", "z", "b")],
            "joint '1' has the parent link 'z', which does not exist; its links: a, b",
        ),
        (
            "abc",
            [joint("1", "a", "c"), joint("2", "b", "c")],
            "link 'c' is the child of two joints, '1' and '2'",
        ),
        ("ab", [joint("1", "a", "b"), joint("2", "b", "a")], "links form a cycle: a -> b -> a"),
        ("ab", [joint("1", "a", "a"), joint("2", "a", "b")], "links form a cycle: a -> a"),
        (
            "abcd",
            [joint("1", "b", "c"), joint("2", "c", "d"), joint("3", "d", "b")],
            "links form a cycle: b -> c -> d -> b",
        ),
    ],
)
def test_links_that_form_no_tree(tmp_path: Path, links: str, joints: list[str], message: str) -> None:
    with pytest.raises(HandError, match=f"hand.urdf: {message}$"):
        tree(tmp_path, links, *joints)


@pytest.mark.parametrize(
    ("kind", "inside", "message"),
    [
        ("floating", "", "is floating, which is not supported; .* choose a base_link below it, such as 'b'"),
        ("planar", "", "is planar, which is not supported; .* choose a base_link below it, such as 'b'"),
        ("hinge", "", "has the type 'hinge'; valid: revolute, continuous, prismatic, fixed"),
        (
            "revolute",
            "",
            "is revolute and needs <limit> with lower and upper; without limits its type would be cont",
        ),
        ("revolute", '<limit upper="1"/>', "is revolute and needs <limit> with lower and upper"),
        (
            "prismatic",
            '<limit lower="0" effort="1"/>',
            "is prismatic and needs <limit> with lower and upper$",
        ),
        ("revolute", '<limit lower="1" upper="-1"/>', "has reversed limits: lower 1 is above upper -1"),
        ("continuous", '<axis xyz="0 0 0"/>', r"has the axis \[0.0, 0.0, 0.0\], which is no direction"),
        ("continuous", '<axis xyz="1e300 0 0"/>', r"has the axis \[1e\+300, 0.0, 0.0\], which is no direction"),
    ],
)
def test_joints_that_no_hand_can_have(tmp_path: Path, kind: str, inside: str, message: str) -> None:
    hand = tree(tmp_path, "ab", joint("1", "a", "b", kind, inside))
    with pytest.raises(HandError, match=f"hand.urdf: joint '1' {message}"):
        hand.below("a")


@pytest.mark.parametrize(
    ("follows", "base", "message"),
    [
        ({"2": "9"}, "a", "joint '2' mimics '9', which does not exist; its joints: 1, 2, 3, 4"),
        ({"2": "2"}, "a", "joint '2' mimics '2', which makes a cycle: 2 -> 2"),
        ({"2": "3", "3": "2"}, "a", "mimics '2', which makes a cycle: 2 -> 3 -> 2"),
        ({"1": "2", "2": "3", "3": "2"}, "a", "mimics '2', which makes a cycle: 1 -> 2 -> 3 -> 2"),
        ({"3": "1"}, "b", "joint '3' mimics '1', which is not below the base link 'b'"),
        ({"2": "4"}, "a", "joint '2' mimics '4', which is fixed"),
    ],
)
def test_mimics_that_follow_nothing(tmp_path: Path, follows: dict[str, str], base: str, message: str) -> None:
    def inside(name: str) -> str:
        return LIMIT + (f'<mimic joint="{follows[name]}"/>' if name in follows else "")

    chain = [joint(name, p, c, inside=inside(name)) for name, p, c in ("1ab", "2bc", "3cd")]
    hand = tree(tmp_path, "abcde", *chain, joint("4", "d", "e", "fixed"))
    with pytest.raises(HandError, match=message):
        hand.below(base)
