"""Export of a replay as one MuJoCo XML file, meshes and key frames inside, for MuJoCo from 3.3 on and its viewer."""

from __future__ import annotations

import ctypes
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.files.mujoco_messages import compiled, one_line, unlogged
from grasp_refine.validation.replay.replay import OBJECT, Replay, Stage, check_replay

PUSH = "push"
"""Name of the actuator that pushes the object in an exported model, and of its site; its control is 1 in key frames
of the push."""

_NEW_WORDS = ("autoreset", "input")
"""Attributes of MuJoCo 4 that MuJoCo 3 refuses; without them the motion is the same until a simulation diverges."""

_PHYSICS = re.compile(
    r"(body|jnt|dof|geom|exclude|pair|eq|tendon|wrap|actuator)_(?!.*(group|user|rgba|matid|aabb|rbound|sameframe|bvh|spec"
    r"|objtype))|qpos"
)
"""Names of the arrays of a model that determine its motion; not of its looks, of shortcuts, and of units."""
_OF_MESH_FRAMES = ("geom_pos", "geom_quat", "geom_size")
"""Of these, the arrays that depend for meshes on a frame that MuJoCo chooses anew."""

_OF_POLYNOMIALS = (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON)
_BEHIND = np.arange(mujoco.mjNEQDATA) >= 5
"""Numbers of a constraint behind its polynomial, which it does not use."""


def export_xml(
    spec: mujoco.MjSpec, model: mujoco.MjModel, replay: Replay, path: str | Path, keyframes: int = 60
) -> None:
    """Write the world of a replay as one MuJoCo XML file without other files beside it.

    Its key frames are frames of the replay: `pregrasp`, `grasp` and `squeeze` are the ends of the stages, the
    others are named after their stage and the seconds since it began ("push 0.200 s"). A further actuator, named
    "push", is the force on the object, as its control is 1 in key frames of the push: from such a key frame on, the
    simulation goes on as it was recorded.

    Args:
        spec: Specification of `model`.
        model: Compiled model.
        replay: Recording of the model.
        path: File to write; missing folders are made.
        keyframes: Largest number of key frames; the ends of the stages are always among them.

    Raises:
        GraspRefineError: The replay is of another model; MuJoCo does not write all of the model, where the error names
            what differs; or the file cannot be written.
    """
    check_replay(model, replay)
    if replay.ctrl.shape[1] != model.nu:
        raise GraspRefineError(f"replay {replay.name}: has {replay.ctrl.shape[1]} controls, the model {model.nu}")
    spec = spec.copy()
    spec.modelname = replay.name
    spec.compiler.saveinertial = True
    add_light(spec)
    pushed = bool(np.any(replay.force)) and Stage.PUSH in replay.stage
    if pushed:
        _add_push(spec, model, replay.force)
    _add_keyframes(spec, replay, keyframes, pushed=pushed)
    text = model_text(spec, model)
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def model_text(spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    """Return the XML of a model, without other files beside it, for MuJoCo from 3.3 on.

    Numbers are written so that they are read back exactly; only meshes from files may come back 1e-8 of a metre off.

    Args:
        spec: Specification: of `model`, or with sites, actuators and key frames behind its own.
        model: Compiled model.

    Raises:
        GraspRefineError: MuJoCo does not write all of the model, where the error names what differs.
    """
    with unlogged(), _all_digits():
        compiled(spec)
        root = ET.fromstring(spec.to_xml())
    _embed_files(root, model)
    for node in root.iter():
        for word in _NEW_WORDS:
            node.attrib.pop(word, None)
    # MuJoCo 3.3.0 to 3.3.2 know no types of lights.
    for light in root.iterfind(".//light[@type='directional']"):
        del light.attrib["type"]
        light.set("directional", "true")
    text = ET.tostring(root, encoding="unicode") + "\n"
    _check_same_physics(model, text)
    return text


def add_light(spec: mujoco.MjSpec) -> None:
    """Add a light, so that MuJoCo's viewer shows more than a silhouette."""
    spec.visual.headlight.ambient[:], spec.visual.headlight.diffuse[:] = 0.4, 0.6
    spec.worldbody.add_light(pos=[0.5, -0.5, 1.0], dir=[-0.4, 0.4, -0.8], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)


@contextmanager
def _all_digits() -> Iterator[None]:
    """Let MuJoCo write numbers within the context with the 17 digits that identify them, instead of 6.

    The setting is one for MuJoCo's own tests; where a version lacks it, `_check_same_physics` refuses what is rounded.
    """
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    files = (file for name in names for file in Path(mujoco.__file__).parent.glob(name))
    library = next(map(str, files), None)
    set_digits = getattr(ctypes.CDLL(library), "_mjPRIVATE__set_xml_precision", lambda digits: None)
    set_digits(17)
    try:
        yield
    finally:
        set_digits(6)


def _add_push(spec: mujoco.MjSpec, model: mujoco.MjModel, force: np.ndarray) -> None:
    """Add the actuator that pushes the object's centre of mass with a force (3,)."""
    # At a site with a reference site in the world, a force keeps its direction when the object turns.
    spec.worldbody.add_site(name=f"{PUSH}_frame", size=[0.001] * 3, rgba=[0, 0, 0, 0], group=5)
    spec.body(OBJECT).add_site(name=PUSH, size=[0.002] * 3, rgba=[1, 0, 0, 1], pos=model.body(OBJECT).ipos)
    push = spec.add_actuator(name=PUSH, trntype=mujoco.mjtTrn.mjTRN_SITE, target=PUSH, refsite=f"{PUSH}_frame")
    push.gear = [*force, 0.0, 0.0, 0.0]
    push.ctrllimited, push.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, [0.0, 1.0]


def _add_keyframes(spec: mujoco.MjSpec, replay: Replay, count: int, *, pushed: bool) -> None:
    since, ends = replay.since_stage(), {Stage.CLOSE: "grasp", Stage.SQUEEZE: "squeeze"}
    for frame in replay.subsample(count):
        # The last frame of a stage is the start of the next one.
        stage, following = (Stage(int(replay.stage[min(at, len(replay) - 1)])) for at in (frame, frame + 1))
        name = "pregrasp" if frame == 0 else f"{stage.label} {since[frame]:.3f} s"
        if frame > 0 and (stage != following or frame + 1 == len(replay)):
            name = ends.get(stage, name)
        spec.add_key(
            name=name,
            time=replay.time[frame],
            qpos=replay.qpos[frame],
            qvel=replay.qvel[frame],
            ctrl=[*replay.ctrl[frame], *[float(following == Stage.PUSH)] * pushed],
            mpos=replay.mocap_pos[frame],
            mquat=replay.mocap_quat[frame],
        )


def _embed_files(root: ET.Element, model: mujoco.MjModel) -> None:
    """Replace meshes from files by their vertices and faces."""
    for node in root.findall("asset/mesh[@file]"):
        mesh, turn = model.mesh(node.attrib["name"]), np.zeros(9)
        number = mesh.id
        # The compiled mesh has a frame of its own: this is the frame of the file.
        mujoco.mju_quat2Mat(turn, model.mesh_quat[number])
        begin, face = model.mesh_vertadr[number], model.mesh_faceadr[number]
        points = model.mesh_vert[begin : begin + model.mesh_vertnum[number]].astype(float) @ turn.reshape(3, 3).T
        points = (points + model.mesh_pos[number]).astype(np.float32)
        faces = model.mesh_face[face : face + model.mesh_facenum[number]]
        node.attrib = {key: node.attrib[key] for key in ("name", "inertia") if key in node.attrib}
        node.set("vertex", " ".join(map(str, points.ravel())))
        node.set("face", " ".join(map(str, faces.ravel())))


def _check_same_physics(model: mujoco.MjModel, text: str) -> None:
    """Refuse an exported model that does not move as the original; it costs a second compilation.

    Raises:
        GraspRefineError: It does not, naming the array that differs; or it cannot be compiled.
    """
    try:
        with unlogged():
            written = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise GraspRefineError(f"the exported model cannot be compiled: {one_line(error)}") from None
    for name in filter(_PHYSICS.match, dir(model)):
        # The last site and actuators belong to the push.
        ours, theirs = getattr(model, name), getattr(written, name)[: len(getattr(model, name))]
        if name in _OF_MESH_FRAMES and ours.shape == theirs.shape:
            solid = model.geom_type != mujoco.mjtGeom.mjGEOM_MESH
            ours, theirs = ours[solid], theirs[solid]
        if name == "eq_data" and ours.shape == theirs.shape:
            polynomial = np.isin(model.eq_type, _OF_POLYNOMIALS)
            ours, theirs = (np.where(polynomial[:, None] & _BEHIND, 0.0, data) for data in (ours, theirs))
        if ours.shape != theirs.shape or not np.allclose(ours, theirs, rtol=1e-6, atol=1e-9):
            raise GraspRefineError(f"the model has something that is not exported: {name} would differ")
