"""MJCF files of hands: reading, names, and joints that are matched by name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco

from grasp_refine.core.errors import HandError
from grasp_refine.hands.alignment import Mechanism
from grasp_refine.hands.mujoco_messages import one_line, unlogged

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_FIRST = re.compile(rb"<\s*([A-Za-z]\w*)")

FILE_ADVICE = "it must be a MuJoCo XML file with its meshes where it names them"


def read_mjcf(path: Path) -> mujoco.MjSpec:
    """Return the MJCF file `path`, in which bodies stay those of the file.

    Raises:
        HandError: it is missing, or no MJCF.
    """
    if not path.is_file():
        raise HandError(f"{path}: no such MJCF file")
    try:
        with unlogged():
            spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise HandError(f"{path}: {one_line(error)}; {FILE_ADVICE}") from None
    # MuJoCo reads URDF files too, but such a hand is made from its URDF.
    outermost = _FIRST.search(_COMMENT.sub(b"", path.read_bytes()))
    if outermost and outermost[1] == b"robot":
        raise HandError(f"{path}: a URDF, not an MJCF; {FILE_ADVICE}")
    # Bodies and their frames must be those of the file.
    spec.compiler.fusestatic = False
    return spec


def compile_mjcf(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Return the model of an MJCF that was read from `path`.

    Raises:
        HandError: MuJoCo cannot compile it.
    """
    try:
        with unlogged():
            return spec.compile()
    except ValueError as error:
        raise HandError(f"{path}: MuJoCo cannot compile it: {one_line(error)}; {FILE_ADVICE}") from None


def name_all(spec: mujoco.MjSpec) -> None:
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

    Names that are given are matched first, then equal names, then names up to a prefix. Mimic joints may be missing.

    Args:
        mechanism: Joints of the hand.
        named: Joint of the hand -> its name in an MJCF, where that is given, as in `Hand.mjcf_joints`.
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
        given = named.get(joint.name)
        # Another MJCF of the same hand may have other names than the MJCF that hand.toml was written for.
        found = [given] if given is not None and given in there else prefixed_names(joint.name, there)
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


def prefixed_names(name: str, there: Sequence[str]) -> list[str]:
    """Return the name itself where it is `there`, else the names with a prefix, such as rh_FFJ4 or hand/FFJ4."""
    if name in there:
        return [name]
    return [other for other in there if other.endswith(name) and not other.removesuffix(name)[-1].isalnum()]


def joints_of(tendon: mujoco.MjsTendon) -> dict[str, float]:
    """Return joint -> coefficient of the joints of a fixed tendon."""
    wraps = [tendon.path[i] for i in range(len(tendon.path))]
    return {wrap.target.name: wrap.coef for wrap in wraps if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT}
