"""Export of a replay as one MuJoCo XML file, meshes and key frames inside, for any MuJoCo 3 or 4 and its viewer."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.export_bodies import PUSH, write_bodies, write_meshes
from grasp_refine.validation.replay.export_check import check_same_physics
from grasp_refine.validation.replay.export_couplings import (
    write_actuators,
    write_contacts,
    write_equalities,
    write_tendons,
)
from grasp_refine.validation.replay.export_values import text_of
from grasp_refine.validation.replay.replay import Replay, Stage, check_replay

_INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")
_CONES = ("pyramidal", "elliptic")
_JACOBIANS = ("dense", "sparse", "auto")
_SOLVERS = ("PGS", "CG", "Newton")
"""Keywords of MuJoCo's XML by the numbers in its enumerations, which versions 3 and 4 share."""


def export_xml(
    spec: mujoco.MjSpec, model: mujoco.MjModel, replay: Replay, path: str | Path, keyframes: int = 60
) -> None:
    """Write the world of a replay as one MuJoCo XML file without defaults, classes or other files beside it.

    Its key frames are frames of the replay: `pregrasp`, `grasp` and `squeeze` are the ends of the stages, the
    others are named after their stage and the seconds since it began ("push 0.200 s"). A further actuator, named
    "push", is the force on the object, as its control is 1 in key frames of the push: from such a key frame on, the
    simulation goes on as it was recorded.

    Numbers are written so that they are read back exactly; only meshes from files, and those whose frame MuJoCo
    chooses anew, may come back 1e-8 of a metre off. MuJoCo's own writer rounds to six digits, and uses words that
    MuJoCo 3 refuses.

    Args:
        spec: Specification of `model`, with the original meshes.
        model: Model whose values are written.
        replay: Recording of the model.
        path: File to write; missing folders are made.
        keyframes: Largest number of key frames; the ends of the stages are always among them.

    Raises:
        GraspRefineError: The replay is of another model; the model has a feature that is not exported, such as
            plugins, which the error names; or the file cannot be written.
    """
    check_replay(model, replay)
    if replay.ctrl.shape[1] != model.nu:
        raise GraspRefineError(f"replay {replay.name}: has {replay.ctrl.shape[1]} controls, the model {model.nu}")
    root = ET.Element("mujoco", model=replay.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="false", inertiafromgeom="false")
    _write_options(root, model)
    _write_looks(root)
    assets = ET.SubElement(root, "asset")
    frames = write_meshes(assets, spec, model)
    pushed = bool(np.any(replay.force)) and Stage.PUSH in replay.stage
    write_bodies(ET.SubElement(root, "worldbody"), model, frames, pushed=pushed)
    write_contacts(root, model)
    write_tendons(root, model)
    write_equalities(root, model)
    write_actuators(root, model, replay.force if pushed else None)
    _write_keyframes(ET.SubElement(root, "keyframe"), replay, keyframes, pushed=pushed)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    check_same_physics(model, text, added=PUSH)
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _write_options(root: ET.Element, model: mujoco.MjModel) -> None:
    """Write all options that are not MuJoCo's defaults, and the common ones."""
    option, default = model.opt, mujoco.MjModel.from_xml_string("<mujoco/>").opt
    node = ET.SubElement(
        root,
        "option",
        timestep=text_of(option.timestep),
        integrator=_INTEGRATORS[option.integrator],
        cone=_CONES[option.cone],
        jacobian=_JACOBIANS[option.jacobian],
        solver=_SOLVERS[option.solver],
        impratio=text_of(option.impratio),
        gravity=text_of(option.gravity),
        iterations=str(option.iterations),
        tolerance=text_of(option.tolerance),
        noslip_iterations=str(option.noslip_iterations),
        noslip_tolerance=text_of(option.noslip_tolerance),
    )
    for name in ("ls_iterations", "ls_tolerance", "ccd_iterations", "ccd_tolerance", "wind", "density", "viscosity"):
        value = np.asarray(getattr(option, name))
        if (value != getattr(default, name)).any():
            node.set(name, str(value) if value.dtype.kind == "i" else text_of(value))
    flags = {}
    for members, values, default_values, word in (
        (mujoco.mjtDisableBit, option.disableflags, default.disableflags, "disable"),
        (mujoco.mjtEnableBit, option.enableflags, default.enableflags, "enable"),
    ):
        other = {"disable": "enable", "enable": "disable"}[word]
        for label, bit in members.__members__.items():
            if not label.startswith("mjN") and (values ^ default_values) & bit:
                flags[label.partition("_")[2].lower()] = word if values & bit else other
    # Not known before 3.2, and without it a person who watches sees a diverged simulation start again.
    flags.pop("autoreset", None)
    # On by default in 4, off by default in 3.
    multi = getattr(mujoco.mjtDisableBit, "mjDSBL_MULTICCD", None)
    if multi is not None:
        flags["multiccd"] = "disable" if option.disableflags & multi else "enable"
    if flags:
        ET.SubElement(node, "flag", dict(sorted(flags.items())))


def _write_looks(root: ET.Element) -> None:
    """Write the light of the viewer, which has no effect on physics."""
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6", specular="0.1 0.1 0.1")
    ET.SubElement(visual, "global", azimuth="130", elevation="-25")


def _write_keyframes(node: ET.Element, replay: Replay, count: int, *, pushed: bool) -> None:
    since = replay.since_stage()
    for frame in replay.subsample(count):
        control = replay.ctrl[frame]
        stage = Stage(int(replay.stage[frame]))
        last = frame + 1 == len(replay) or replay.stage[frame + 1] != stage
        # The last frame of a stage is the start of the next one.
        following = stage if frame + 1 == len(replay) else Stage(int(replay.stage[frame + 1]))
        name = f"{stage.label} {since[frame]:.3f} s"
        if frame == 0:
            name = "pregrasp"
        elif last and stage == Stage.CLOSE:
            name = "grasp"
        elif last and stage == Stage.SQUEEZE:
            name = "squeeze"
        if pushed:
            control = np.append(control, float(following == Stage.PUSH))
        ET.SubElement(
            node,
            "key",
            name=name,
            time=text_of(replay.time[frame]),
            qpos=text_of(replay.qpos[frame]),
            qvel=text_of(replay.qvel[frame]),
            ctrl=text_of(control),
            mpos=text_of(replay.mocap_pos[frame]),
            mquat=text_of(replay.mocap_quat[frame]),
        )
