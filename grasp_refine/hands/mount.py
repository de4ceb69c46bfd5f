"""Hands on arms: one kinematic tree of two robots, or of one whose file has both."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import replace

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.array_records import join, take
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import inverse, is_rigid
from grasp_refine.hands.arm import Arm
from grasp_refine.hands.arm_gains import with_arm_gains
from grasp_refine.hands.files.base_link import guess_base
from grasp_refine.hands.files.description import read_tree
from grasp_refine.hands.files.source import ON_ARM
from grasp_refine.hands.files.tree import Joint
from grasp_refine.hands.hand import Actuator, Hand

MOUNT_JOINT = "mount"
"""Name of the fixed joint between the arm and the hand; with a number where that is taken."""


def mount(arm: Hand, hand: Hand, link: str | None = None, T_link_hand: Float[np.ndarray, "4 4"] | None = None) -> Hand:
    """Return a hand on an arm: one `Hand` whose base is the base of the arm, and stands still.

    Joints of the arm come first, then joints of the hand; contacts, patches and files are the hand's. Names of
    links and joints that both have get the name of the arm as a prefix in the arm, as in ur5e_base_link.

    Args:
        arm: The arm, read by `load_arm`.
        hand: The hand.
        link: Link of the arm that the hand is fixed to; by default the link in the arm's arm.toml, else its last link.
        T_link_hand: Pose (4, 4) of the hand's base link in that link; by default the pose in its hand.toml (`flange`),
            else the identity.

    Raises:
        HandError: the arm has no such link or no joint that moves it, the hand is on an arm already, or the pose is not
            rigid.
    """
    check_kind("arm", arm, Hand)
    check_kind("hand", hand, Hand)
    check_kind("link", link, str | None)
    if hand.arm is not None or arm.arm is not None:
        raise HandError(f"{(hand if hand.arm is not None else arm).name} is a hand on an arm already")
    default, notes = np.eye(4) if hand.T_base_flange is None else inverse(hand.T_base_flange), list(hand.notes)
    T = default if T_link_hand is None else as_numbers("T_link_hand", T_link_hand)
    if T.shape != (4, 4) or not is_rigid(T):
        raise HandError(f"T_link_hand must be a rigid transform (4, 4), got {np.array2string(T, precision=3)}")
    link = link or arm.mount or _last_link(arm)
    if link not in arm.links_by_name:
        listing = ", ".join(arm.links_by_name)
        tree = read_tree(arm.urdf)
        above = link in tree.links and arm.base_link != tree.root
        hint = "; load_arm reads an arm from its base on, without its gripper" if above else ""
        raise HandError(f"arm {arm.name} has no link '{link}' to mount a hand on; its links: {listing}{hint}")
    carrying = [joint.name for joint in arm.joints_to([link]) if joint.movable]
    if not carrying:
        raise HandError(f"no joint of arm {arm.name} moves link '{link}': a hand there would not be on an arm")
    if T_link_hand is None and hand.T_base_flange is None:
        notes.append(
            f"no flange of hand {hand.name} is known (flange in its hand.toml): its base link '{hand.base_link}' is "
            f"mounted in the frame of '{link}', not turned; `mount_pose` gives another pose"
        )
    renamed = _renamed(arm, hand)
    link = _other_names(arm.links_by_name, hand.links_by_name, arm.name)[link]
    taken = {*renamed.joints_by_name, *hand.joints_by_name}
    name = next(name for name in (MOUNT_JOINT, *(f"{MOUNT_JOINT}_{k}" for k in range(2, 99))) if name not in taken)
    fixed = Joint(name, "fixed", link, hand.base_link, T, np.zeros(3), 0.0, 0.0, None, None)
    links = (*renamed.links, *hand.links)
    solids = tuple(part.name for part in links if part.body is not None)
    arm_notes = [f"arm {arm.name}: {note}" for note in arm.notes if not note.startswith("contact link")]
    whole = replace(
        hand,
        name=f"{hand.name}{ON_ARM}{arm.name}",
        base_link=renamed.base_link,
        links=tuple(replace(part, solids=solids) for part in links),
        joints=(*renamed.joints, fixed, *hand.joints),
        joint_names=(*renamed.joint_names, *hand.joint_names),
        lower=np.concatenate([arm.lower, hand.lower]),
        upper=np.concatenate([arm.upper, hand.upper]),
        rest=np.concatenate([arm.rest, hand.rest]),
        notes=tuple(dict.fromkeys((*arm_notes, *notes))),
        actuator=both(arm.actuator, hand.actuator),
        coupled=(*renamed.coupled, *hand.coupled),
        excluded=_excluded(renamed, hand),
        compliance=None if hand.compliance is None else np.pad(hand.compliance, (len(arm.joint_names), 0)),
        base_why=f"it is the base of the arm, {arm.name}",
        mount=None,
        T_base_flange=None,
        arm=Arm(
            palm=hand.base_link,
            joints=np.arange(len(arm.joint_names) + len(hand.joint_names)) < len(arm.joint_names),
            links=frozenset(renamed.links_by_name),
            standing=renamed.fixed_to(renamed.base_link),
        ),
    )
    whole = with_arm_gains(whole, whole.arm_joints)
    # The arm is simulated by itself where the hand is from an MJCF.
    return replace(whole, parts=(replace(renamed, actuator=take(whole.actuator, whole.arm_joints)), hand))


def standing(hand: Hand, palm: str | None = None) -> Hand:
    """Return the hand of a file that has an arm too, with the joints above the palm as the arm's: its base stands.

    Args:
        hand: The whole, loaded with the base of the arm as its `base_link`.
        palm: Link that is the palm; by default the one at which the hand would begin by itself.

    Raises:
        HandError: there is no such link, or no joint moves it.
    """
    check_kind("hand", hand, Hand)
    check_kind("palm", palm, str | None)
    palm = palm or guess_base(read_tree(hand.urdf)).link
    above = {joint.name for joint in hand.joints_to([palm]) if joint.movable}
    if not above:
        raise HandError(
            f"hand {hand.name} has no arm: no joint between its base '{hand.base_link}' and its palm '{palm}'; give an "
            "arm with `arm`, or the base of the arm in the hand's file with `base_link`"
        )
    names = np.array([name in above for name in hand.joint_names])
    followers = [name for name in above if name not in hand.joint_names]
    if followers:
        raise HandError(f"hand {hand.name}: joint '{followers[0]}' of its arm follows another, which no arm's may")
    below = {palm}
    for joint in hand.joints:  # parents before children
        below |= {joint.child} if joint.parent in below else set()
    touching = tuple(contact for contact in hand.contacts if contact.link in below)
    links = frozenset(link.name for link in hand.links) - below
    hand = with_arm_gains(hand, names)
    return replace(hand, contacts=touching, arm=Arm(palm, names, links, hand.fixed_to(hand.base_link)))


def _last_link(arm: Hand) -> str:
    """Return the only link of an arm that nothing hangs from.

    Raises:
        HandError: there are several.
    """
    ends = {link.name for link in arm.links} - {joint.parent for joint in arm.joints}
    if len(ends) > 1:
        raise HandError(f"arm {arm.name} ends at several links: give the one to mount on, of {', '.join(sorted(ends))}")
    return ends.pop()


def _other_names(names: Iterable[str], taken: Container[str], prefix: str) -> dict[str, str]:
    """Return names with a prefix where they are taken, by name."""
    return {name: f"{prefix}_{name}" if name in taken else name for name in names}


def _renamed(arm: Hand, hand: Hand) -> Hand:
    """Return the arm with names that the hand does not have.

    Raises:
        HandError: a name has a prefix already, and is the hand's.
    """
    link = _other_names(arm.links_by_name, hand.links_by_name, arm.name)
    theirs = hand.joints_by_name
    joint = _other_names(arm.joints_by_name, theirs, arm.name)
    for names, ours in ((link, hand.links_by_name), (joint, theirs)):
        twice = [name for name in names.values() if name in ours or list(names.values()).count(name) > 1]
        if twice:
            raise HandError(f"arm {arm.name} and hand {hand.name} both have '{twice[0]}': rename it in one of them")
    joints = tuple(
        replace(
            one,
            name=joint[one.name],
            parent=link[one.parent],
            child=link[one.child],
            mimic=None if one.mimic is None else replace(one.mimic, joint=joint[one.mimic.joint]),
        )
        for one in arm.joints
    )
    excluded = None if arm.excluded is None else tuple((link[a], link[b]) for a, b in arm.excluded)
    return replace(
        arm,
        base_link=link[arm.base_link],
        links=tuple(replace(one, name=link[one.name]) for one in arm.links),
        joints=joints,
        joint_names=tuple(joint[name] for name in arm.joint_names),
        coupled=tuple(replace(group, joints=tuple(joint[name] for name in group.joints)) for group in arm.coupled),
        excluded=excluded,
        modes=(),  # nothing of an arm holds the object
        contacts=(),
    )


def _excluded(arm: Hand, hand: Hand) -> tuple[tuple[str, str], ...] | None:
    """Return the pairs that never collide by either file; None where neither file has any."""
    if arm.excluded is None and hand.excluded is None:
        return None
    return (*(arm.excluded or ()), *(hand.excluded or ()))


def both(arm: Actuator, hand: Actuator) -> Actuator:
    """Return the actuators of an arm, followed by the actuators of a hand."""
    if arm.set_points is None and hand.set_points is None:
        return join(arm, hand)
    return join(*map(_with_set_points, (arm, hand)))


def _with_set_points(actuator: Actuator) -> Actuator:
    if actuator.set_points is not None:
        return actuator
    return replace(actuator, set_points=np.tile([-np.inf, np.inf], (len(actuator.kp), 1)))
