"""Check of a hand: how its files were read and why, and what in them deserves a second look."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.core.plurals import count_text, names_text
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.description import joints_fixed_and_mimicking, links_with_visuals
from grasp_refine.hands.files.file_faults import file_faults
from grasp_refine.hands.files.mujoco_messages import compiled, one_line
from grasp_refine.hands.hand import Hand, Joint
from grasp_refine.hands.self_collision import PairClasses, classify_pairs
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.validate import model_of

MAX_TURN_RAD, MAX_SLIDE_M = 4 * np.pi, 1.0
"""Joint limits, rad and m, beyond which they look like degrees or millimetres."""

SIZE_RANGE_M = (0.02, 1.0)
"""Range of plausible hand sizes, metres."""

MAX_MASS_KG = 20.0
"""Mass above which a hand is implausible, kg."""

MAX_TORQUE_NM, MAX_FORCE_N = 1e3, 1e4
"""Efforts of joints that turn and slide, Nm and N, above which they are implausible."""


@dataclass(frozen=True)
class HandCheck:
    """Findings about a hand beyond its joints and links."""

    contacts: tuple[str, ...]
    """Contact links, each with the reason why it is one."""
    pairs: PairClasses
    """Link pairs that are checked for self-collision, and pairs that are not."""
    simulation: tuple[str, ...]
    """Differences in simulation."""
    refused: str
    """Reason why MuJoCo rejects the hand; "" if it accepts it."""
    suspicious: tuple[str, ...]
    """Missing or suspicious values."""
    size: tuple[float, ...]
    """Extent (3,) in metres along the axes of the base link, at the rest pose; empty if no link has geometry."""
    jaws: tuple[float, ...]
    """Least and greatest width (2,) in metres of a gripper with two jaws; empty for other hands."""

    def document(self) -> dict[str, Any]:
        """Return the check as a JSON object."""
        return asdict(self)


def check_hand(hand: Hand) -> HandCheck:
    """Check a hand.

    Raises:
        HandError: it has an MJCF that cannot be used.
    """
    notes, refused = _simulated(hand)
    size = _size(hand)
    return HandCheck(
        _contacts(hand), classify_pairs(hand), notes, refused, tuple(_suspicious(hand, size)), size, _jaws(hand)
    )


def _jaws(hand: Hand) -> tuple[float, ...]:
    try:
        jaws = jaw_frame(hand, closure_frame(hand))
    except HandError:  # no joint moves a contact link
        return ()
    return () if jaws is None else (float(jaws.width[-1]), float(jaws.width[0]))


def _simulated(hand: Hand) -> tuple[tuple[str, ...], str]:
    notes = simulation_notes(hand)
    try:
        model = compiled(model_of(hand).spec)
    except (ValueError, mujoco.FatalError) as error:
        return notes, one_line(error)
    sizes = {"joints": model.njnt, "followers": model.neq, "geoms": model.ngeom, "actuators": model.nu}
    listed = ", ".join(f"{what} {number}" for what, number in sizes.items())
    return (f"MuJoCo accepts the hand: {listed}", *notes), ""


def simulation_notes(hand: Hand) -> tuple[str, ...]:
    """Return notes on how the hand is simulated.

    Raises:
        HandError: its MJCF cannot be used.
    """
    if hand.mjcf is None:
        return urdf_model(hand).notes
    model = mjcf_model(hand, hand.mjcf)
    joints = count_text(len(model.joints), "joint")
    how = f"{hand.mjcf.name} moves like {hand.urdf.name}: {joints} matched by name and place"
    if hand.mjcf == hand.urdf:
        how = f"{hand.mjcf.name} is simulated as it is: {joints}"
    return (how, *model.notes)


def _contacts(hand: Hand) -> tuple[str, ...]:
    above = {joint.child: joint for joint in hand.joints}
    joints_to: dict[str, list[Joint]] = {}
    for contact in hand.contacts:
        link, chain = contact.link, []
        while link in above:
            chain.append(above[link])
            link = above[link].parent
        joints_to[contact.link] = [joint for joint in chain if joint.movable]
    moves = Counter(joint.name for chain in joints_to.values() for joint in chain)
    lines = []
    for contact in hand.contacts:
        # The topmost joint that moves no other contact link.
        own = [joint.name for joint in joints_to[contact.link] if moves[joint.name] == 1]
        own = own or [joint.name for joint in joints_to[contact.link][:1]] or ["none"]
        guess = f"the outermost solid link of the branch that joint '{own[-1]}' moves"
        why = guess if hand.contacts_guessed else "named in hand.toml"
        finger = "" if contact.group == contact.link else f", finger '{contact.group}'"
        lines.append(f"{contact.link}{finger}: {why}")
    return tuple(lines)


def _suspicious(hand: Hand, size: tuple[float, ...]) -> list[str]:
    """List missing or suspicious values, each with its consequence."""
    independent = [hand.joints_by_name[name] for name in hand.joint_names]
    unlimited = [hand.joint_names[i] for i in np.flatnonzero(np.isinf(hand.actuator.force_limit))]
    bound = np.where(hand.slides, MAX_FORCE_N, MAX_TORQUE_NM)
    force = hand.actuator.force_limit
    strong = {hand.joint_names[i]: force[i] for i in np.flatnonzero(np.isfinite(force) & (force > bound))}
    limp = [hand.joint_names[i] for i in np.flatnonzero(hand.actuator.kp == 0.0)]
    turning = [j.name for j in independent if j.kind != "prismatic" and max(abs(j.lower), j.upper) > MAX_TURN_RAD]
    far = [j.name for j in hand.joints if j.kind == "prismatic" and max(abs(j.lower), j.upper) > MAX_SLIDE_M]
    visible = links_with_visuals(hand.urdf)
    unseen = [link.name for link in hand.links if link.body is None and link.name in visible]
    endless = [j.name for j in independent if j.kind == "continuous"]
    fixed = [name for name in joints_fixed_and_mimicking(hand.urdf) if name in hand.joints_by_name]
    mass = sum(link.mass or 0.0 for link in hand.links)
    from_mjcf = hand.mjcf == hand.urdf
    limit = "forcerange in the MJCF" if from_mjcf else "force_limit in hand.toml"
    visuals = "give their geoms a contype" if from_mjcf else "--collision visual uses their visuals"
    found = {
        "no joint moves: there is nothing to refine but the pose of the palm": [""]
        * all(j.lower == j.upper for j in independent),
        f"no effort limit for {{}}: they push as hard as their error times kp; set {limit}": unlimited,
        f"no joint of a hand is as strong as {{}}, beyond {MAX_TORQUE_NM:g} Nm or {MAX_FORCE_N:g} N: nothing limits "
        f"how hard they push; set {limit}": [f"{name} ({value:g})" for name, value in strong.items()],
        "no actuator moves {}: they give way to any push": limp,
        "{} can turn by more than two revolutions: are the limits degrees? They must be radians": [
            name for name in turning if name not in endless
        ],
        "{} can slide more than a metre: are the limits millimetres? They must be metres": far,
        "continuous joints, which rest at 0: {}": endless,
        "fixed though mimic joints, so that they do not move: {}": fixed,
        f"nothing keeps links with visuals but without collision geometry out of the object: {{}}; {visuals}": unseen,
        "no link with collision geometry is moved by {}": _idle_joints(hand),
        f"the hand is {max(size, default=0):.3g} m large: are the meshes millimetres? Lengths are metres, a mesh has a "
        "scale": [""] * bool(size and max(size) > SIZE_RANGE_M[1]),
        f"the hand is only {max(size, default=0) * 1e3:.3g} mm large: is a mesh's scale wrong?": [""]
        * bool(size and max(size) < SIZE_RANGE_M[0]),
        f"the hand weighs {mass:.3g} kg": [""] * (mass > MAX_MASS_KG),
        "no moving link has collision geometry: no link could touch an object": [""] * (not hand.contacts),
    }
    files = [hand.urdf] + ([hand.mjcf] if hand.mjcf not in (None, hand.urdf) else [])
    faults = [fault for file in files for fault in file_faults(file)]
    return [text.format(names_text(names)) for text, names in found.items() if names] + faults


def _idle_joints(hand: Hand) -> list[str]:
    """Independent joints that move no link with collision geometry, not even by followers."""
    carries = {link.name for link in hand.links if link.body is not None}
    for joint in reversed(hand.joints):  # children before parents
        if joint.child in carries:
            carries.add(joint.parent)
    matrix, _, names = hand.mimic_map()
    useful = np.array([hand.joints_by_name[name].child in carries for name in names], dtype=bool)
    return [name for name, column in zip(hand.joint_names, matrix.T, strict=True) if not column[useful].any()]


def _size(hand: Hand) -> tuple[float, ...]:
    solid = [link for link in hand.links if link.body is not None]
    if not solid:
        return ()
    chain = Chain(hand, [link.name for link in solid])
    poses = chain(np.eye(4)[None], hand.rest[None]).T_world_link[0]
    ends = []
    for link, T in zip(solid, poses, strict=True):
        for piece in link.solid.pieces:
            points = transform_points(T, piece.vertices)
            ends += [points.min(axis=0) - piece.radius, points.max(axis=0) + piece.radius]
    return tuple(np.ptp(ends, axis=0).tolist())
