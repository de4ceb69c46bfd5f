"""Model for MuJoCo of a hand from its MJCF on an arm from its URDF."""

from __future__ import annotations

import mujoco
import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import quaternion_from_matrix
from grasp_refine.hands.files.mimics import Curves
from grasp_refine.hands.files.mujoco_messages import one_line, unlogged
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.mount import both
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model


def mounted_model(hand: Hand) -> HandModel:
    """Return the model of a hand that was mounted on an arm: the arm from its links, the hand from its MJCF.

    Links of arm and hand collide in pairs of `touching_pairs`; the hand's own pairs come from its file.

    Raises:
        HandError: the MJCF cannot be used, or is of another hand, or the arm is simulated from an MJCF.
    """
    arm, own = hand.parts
    assert own.mjcf is not None and hand.arm is not None
    if arm.collision == "mjcf":
        raise HandError(f"arm {arm.name} is simulated from {arm.urdf.name}: give its URDF with `arm`")
    below, above = urdf_model(arm), mjcf_model(own, own.mjcf)
    joint = next(joint for joint in hand.joints if joint.child == hand.arm.palm)
    T, prefix = joint.T_parent_child @ above.T_base_root, f"{own.name}/"
    spec, body_of = below.spec, {link: body for body, link in below.links.items()}
    frame = spec.body(body_of[joint.parent]).add_frame(pos=T[:3, 3], quat=quaternion_from_matrix(T[:3, :3]))
    spec.copy_during_attach = True
    try:
        with unlogged():
            spec.attach(above.spec, prefix=prefix, frame=frame)
    except ValueError as error:
        raise HandError(f"MuJoCo cannot mount {own.mjcf.name} on {arm.name}: {one_line(error)}") from None
    links = {**below.links, **{f"{prefix}{body}": link for body, link in above.links.items()}}
    _exclude(spec, hand, links)
    m, n = below.matrix.shape
    matrix = np.zeros((m + len(above.joints), n + above.matrix.shape[1]))
    matrix[:m, :n], matrix[m:, n:] = below.matrix, above.matrix
    return HandModel(
        spec=spec,
        root=below.root,
        T_base_root=below.T_base_root,
        joints=(*below.joints, *(f"{prefix}{name}" for name in above.joints)),
        matrix=matrix,
        offset=np.concatenate([below.offset, above.offset]),
        links=links,
        notes=(*below.notes, *above.notes),
        actuator=both(below.actuator, above.actuator),
        curves=_curves(below.curves, above.curves, n),
        patches=hand.patches,
        on_arm=hand,
    )


def _exclude(spec: mujoco.MjSpec, hand: Hand, links: dict[str, str]) -> None:
    """Let links of arm and hand collide only where they can."""
    assert hand.arm is not None
    touching = {frozenset(pair) for pair in touching_pairs(hand)}
    of_arm = [body for body, link in links.items() if link in hand.arm.links]
    others = [body for body, link in links.items() if link not in hand.arm.links]
    for a in of_arm:
        for b in others:
            if frozenset((links[a], links[b])) not in touching:
                spec.add_exclude(bodyname1=a, bodyname2=b)


def _curves(below: Curves | None, above: Curves | None, shift: int) -> Curves | None:
    """Return the curves of both; the upper ones use the joints after the first `shift`."""
    if below is None or above is None:
        return None
    width = max(below.higher.shape[1], above.higher.shape[1])
    higher = [np.pad(part.higher, ((0, 0), (0, width - part.higher.shape[1]))) for part in (below, above)]
    return Curves(np.concatenate([below.leader, above.leader + shift]), np.concatenate(higher))
