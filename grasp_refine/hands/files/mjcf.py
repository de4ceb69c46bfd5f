"""MJCF files of hands: reading, the hand in them, names, and joints that are matched by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.files.alignment import Mechanism
from grasp_refine.hands.files.mjcf_trial import try_out
from grasp_refine.hands.files.mjcf_xml import FILE_ADVICE, MAX_BODIES, check_xml, is_plain, named_xml
from grasp_refine.hands.files.mujoco_messages import MUJOCO_ERRORS, compiled, one_line, unlogged
from grasp_refine.hands.files.prefixed_names import prefixed_names

MAX_RADIANS = 2 * math.pi
"""Largest limit of a hinge that may be meant in radians."""


def read_mjcf(path: Path) -> tuple[mujoco.MjSpec, str, list[str]]:
    """Return the hand in the MJCF file `path`, with the bodies of the file; all bodies and joints have names.

    Everything else is left out: bodies beside it, its free joint, cameras, lights, sensors, keyframes and textures.

    Returns:
        The hand, the name of its root body, and notes on left-out parts, and on suspected errors.

    Raises:
        HandError: it is missing, no MJCF, holds what no hand may have, no hand, or several.
    """
    spec = _read(path)
    root, notes = _keep_hand(spec, path)
    _name_all(spec)
    return spec, root, notes


def _read(path: Path) -> mujoco.MjSpec:
    check_xml(path)
    if not is_plain(path):
        try_out(path)
    file, text = named_xml(path)
    try:
        with unlogged():
            spec = mujoco.MjSpec.from_file(file, include=text)
    except MUJOCO_ERRORS as error:
        raise HandError(f"{path}: {one_line(error)}; {FILE_ADVICE}") from None
    for mesh in spec.meshes:
        refuse_lfs_pointer(path.parent / spec.meshdir / mesh.file, "mesh", HandError)
    if (count := len(spec.bodies) - 1) > MAX_BODIES:
        raise HandError(f"{path}: has {count} bodies, more than the {MAX_BODIES} that a hand may have")
    # Bodies and their frames must equal the file's.
    spec.compiler.fusestatic = False
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    delete(spec, list(spec.textures))
    return spec


def compile_mjcf(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Return the model of an MJCF that was read from `path`.

    Raises:
        HandError: MuJoCo cannot compile it, or a number in it is not finite.
    """
    try:
        model = compiled(spec)
    except MUJOCO_ERRORS as error:
        raise HandError(f"{path}: MuJoCo cannot compile it: {one_line(error)}; {FILE_ADVICE}") from None
    for name in dir(model):
        values = getattr(model, name)
        if isinstance(values, np.ndarray) and values.dtype.kind == "f" and not np.isfinite(values).all():
            raise HandError(f"{path}: holds a number that is not finite, in {name} of the compiled model")
    return model


def _keep_hand(spec: mujoco.MjSpec, path: Path) -> tuple[str, list[str]]:
    """Delete everything but the hand; return the name of its root body, and notes on left-out parts."""
    for things in (
        spec.keys,
        spec.sensors,
        spec.cameras,
        spec.lights,
        spec.skins,
        spec.numerics,
        spec.texts,
        spec.tuples,
    ):
        delete(spec, list(things))
    tops = list(spec.worldbody.bodies)
    jointed = [body for body in tops if _moving_below(body)]
    # Objects of a scene have all their joints on one body.
    hands = [body for body in jointed if _num_moving(body) > 1]
    jointed = hands or jointed
    if len(jointed) != 1:
        found = ", ".join(f"'{body.name}'" for body in jointed) or "none"
        free = ", ".join(f"'{body.name}'" for body in tops if body.joints and not jointed)
        why = f" ({free} has no joints but a free one)" if free else ""
        raise HandError(
            f"{path}: one body with joints, the hand, must hang from <worldbody>, here: {found}{why}; fingers need a "
            "body that holds them, and several hands a file each"
        )
    (root,) = jointed
    others = [body for body in tops if body is not root]
    beside = [*others, *spec.worldbody.geoms, *spec.worldbody.sites]
    notes = _unit_notes(spec, path)
    if others or spec.worldbody.geoms:
        left_out = count_text(len(others) + len(spec.worldbody.geoms), "thing")
        notes.append(f"{path.name}: beside the hand, {left_out} left out")
    gone = {"", "world", *(below.name for body in others for below in [body, *body.find_all("body")])}
    rigid = (mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT)
    tied = [e for e in spec.equalities if e.type in rigid and e.objtype == mujoco.mjtObj.mjOBJ_BODY]
    delete(spec, [equality for equality in tied if {equality.name1, equality.name2} & gone])
    delete(spec, [pair for pair in spec.excludes if {pair.bodyname1, pair.bodyname2} & gone])
    geoms = {geom.name for body in (root, *root.find_all("body")) for geom in body.geoms}
    delete(spec, [pair for pair in spec.pairs if not {pair.geomname1, pair.geomname2} <= geoms])
    delete(spec, beside)
    root.mocap = False
    root.name = root.name or "hand"
    delete(spec, [joint for joint in root.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE])
    return root.name, notes


def delete(spec: mujoco.MjSpec, things: Sequence[object]) -> None:
    """Delete parts of a specification."""
    for thing in things:
        spec.delete(thing)


def _moving_below(body: mujoco.MjsBody) -> bool:
    """Return True if a body has joints, or one below it, other than a free one, which objects and hands may have."""
    free = mujoco.mjtJoint.mjJNT_FREE
    return any(joint.type != free for joint in body.joints) or any(_moving_below(child) for child in body.bodies)


def _num_moving(body: mujoco.MjsBody) -> int:
    """Return the number of bodies with joints, at and below a body."""
    return sum(bool(each.joints) for each in (body, *body.find_all("body")))


def _unit_notes(spec: mujoco.MjSpec, path: Path) -> list[str]:
    """Return a note where the limits of all hinges, which count as degrees, look like radians."""
    hinges = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
    largest = max((abs(end) for joint in hinges for end in joint.range), default=0.0)
    if not spec.compiler.degree or not 0.0 < largest <= MAX_RADIANS:
        return []
    return [
        f"{path.name}: no hinge has a limit beyond {largest:.3g} degrees, the unit of an MJCF unless its compiler has "
        'angle="radian"; if radians are meant, add that'
    ]


def _name_all(spec: mujoco.MjSpec) -> None:
    """Name all bodies and joints without a name."""
    for kind, things in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {thing.name for thing in things}
        number = 0
        for thing in things:
            while not thing.name:
                number += 1
                if f"{kind}_{number}" not in taken:
                    thing.name = f"{kind}_{number}"


def matched_joints(mechanism: Mechanism, named: Mapping[str, str], spec: mujoco.MjSpec, path: Path) -> dict[str, str]:
    """Return joint of the hand -> joint of the file, in the order of the hand's joints.

    Given names are matched first, then equal names, then names up to a prefix. Mimic joints may be missing.

    Args:
        mechanism: Joints of the hand.
        named: Joint of the hand -> its name in an MJCF, where given, as in `Hand.mjcf_joints`.
        spec: The MJCF.
        path: Its file, for messages.

    Raises:
        HandError: an independent joint is not found, or two are found as the same one.
    """
    there = [joint.name for joint in spec.joints]
    matched: dict[str, str] = {}
    for joint in mechanism.joints:
        if not joint.movable:
            continue
        preferred = named.get(joint.name)
        # Another MJCF of the same hand may have other names than the MJCF that hand.toml was written for.
        found = [preferred] if preferred is not None and preferred in there else prefixed_names(joint.name, there)
        if len(found) == 1:
            matched[joint.name] = found[0]
    missing = [name for name in mechanism.independent if name not in matched]
    if missing:
        wanted = [f"{name} ({named[name]})" if name in named else name for name in missing]
        left = [name for name in there if name not in matched.values()]
        raise HandError(
            f"{path}: joints {', '.join(wanted)} of hand '{mechanism.name}' are not found by name among "
            f"{', '.join(left) or 'no others'}; a table [mjcf_joints] in its hand.toml can map them, and a "
            "base_link beyond them leaves them out"
        )
    twice = [name for name in matched.values() if list(matched.values()).count(name) > 1]
    if twice:
        both = " and ".join(name for name, other in matched.items() if other == twice[0])
        raise HandError(f"{path}: joint '{twice[0]}' is found for {both}; [mjcf_joints] must map them")
    return matched


def joints_of(tendon: mujoco.MjsTendon) -> dict[str, float]:
    """Return joint -> coefficient of the joints of a fixed tendon."""
    wraps = [tendon.path[i] for i in range(len(tendon.path))]
    return {wrap.target.name: wrap.coef for wrap in wraps if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT}
