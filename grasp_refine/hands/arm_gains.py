"""Gains of the servos of an arm where no file gives them: guessed from effort, speed and inertia."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.defaults import LEVER_POWERS, SLIDE_LEVER_M
from grasp_refine.hands.files.hand_toml import ACTUATOR
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.hand import Hand, Link

ARMATURE = 0.1
"""Inertia in kg m^2 of the rotor of a joint that turns, as seen through its gears."""

BANDWIDTH_RAD_S = 100.0
"""Natural frequency of a joint on its servo, in rad/s: slower motion follows its set points."""

DEFAULT_SPEED_RAD_S = 1.0
"""Speed limit of joints in rad/s whose file gives none; slides move by `Hand.per_radian` of it, 0.1 m/s."""


def with_arm_gains(hand: Hand, which: Bool[np.ndarray, " n"]) -> Hand:
    """Return a hand whose arm holds its set points, where no file gives its stiffness, and a note on the guess.

    With the inertia I of all that a joint moves at the rest pose, and the armature, kp = I w^2 for `BANDWIDTH_RAD_S` w,
    and the damping is 2 I w, with which it does not overshoot, but at most effort / speed limit: at half of that speed,
    which trajectories use, it takes half of the effort. The default is for fingers, under which an arm would give way.

    Args:
        hand: The hand on its arm, or the arm.
        which: True (n,) for the joints of the arm.
    """
    actuator = hand.actuator
    lever = np.where(hand.slides, SLIDE_LEVER_M, 1.0)
    ours = np.isclose(actuator.kp * lever ** LEVER_POWERS["kp"], float(ACTUATOR["kp"] or 0.0)) & which
    if not ours.any():
        return hand
    armature = ARMATURE / lever ** LEVER_POWERS["armature"]
    inertia = moved_inertia(hand) + armature
    speed = np.array([hand.joints_by_name[name].velocity or np.nan for name in hand.joint_names])
    speed = np.where(np.isnan(speed), DEFAULT_SPEED_RAD_S * hand.per_radian, speed)
    guessed = {
        "kp": inertia * BANDWIDTH_RAD_S**2,
        "damping": np.minimum(2.0 * inertia * BANDWIDTH_RAD_S, actuator.force_limit / speed),
        "armature": armature,
        "frictionloss": np.zeros(len(ours)),
    }
    gains = {key: np.where(ours, values, getattr(actuator, key)) for key, values in guessed.items()}
    names = [name for name, guess in zip(hand.joint_names, ours, strict=True) if guess]
    note = (
        f"stiffness and damping of {count_text(len(names), 'joint')} of the arm are guessed from effort, speed and "
        "inertia: an arm.toml can give them ([actuator])"
    )
    return replace(hand, actuator=replace(actuator, **gains), notes=(*hand.notes, note))


def moved_inertia(hand: Hand) -> Float[np.ndarray, " n"]:
    """Return the inertia (n,) that each independent joint moves at the rest pose: kg m^2 about its axis, or kg.

    Followers count as if they stood still against the joint that they follow.
    """
    children = [hand.joints_by_name[name].child for name in hand.joint_names]
    links = [(link, inertia) for link in hand.links if (inertia := _inertia(link)) is not None]
    names = tuple(link.name for link in hand.links)
    at = dict(zip(names, Chain(hand, names)(np.eye(4)[None], hand.rest[None]).T_world_link[0], strict=True))
    above = {joint.child: joint.parent for joint in hand.joints}
    found = np.zeros(len(children))
    for number, (name, child) in enumerate(zip(hand.joint_names, children, strict=True)):
        axis = at[child][:3, :3] @ hand.joints_by_name[name].axis
        for link, inertia in links:
            if not _is_below(link.name, child, above):
                continue
            pose = at[link.name]
            arm = pose[:3, :3] @ inertia.centre + pose[:3, 3] - at[child][:3, 3]
            along = pose[:3, :3].T @ axis
            turned = along @ inertia.matrix @ along + inertia.mass * float(np.sum(np.cross(axis, arm) ** 2))
            found[number] += inertia.mass if hand.slides[number] else turned
    return found


def _is_below(link: str | None, above: str, parent: dict[str, str]) -> bool:
    while link is not None and link != above:
        link = parent.get(link)
    return link == above


def _inertia(link: Link) -> Inertia | None:
    """Return the mass distribution of a link, by the file or else its geometry; None where it has neither."""
    if link.inertia is not None and link.inertia.positive():
        return link.inertia
    if link.body is None:
        return None if not link.mass else Inertia(link.mass, np.zeros(3), np.zeros((3, 3)))
    solid = Inertia.of(link.body.pieces)
    share = link.mass / solid.mass if link.mass else 1.0
    return Inertia(share * solid.mass, solid.centre, share * solid.matrix)
