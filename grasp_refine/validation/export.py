"""A replay as one MuJoCo XML file, meshes and key frames inside, for any MuJoCo 3 or 4 and its viewer."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.errors import GraspRefineError
from grasp_refine.validation.replay import OBJECT, Replay, Stage, qpos_names, written_whole

PUSH = "push"
"""Name of the actuator that pushes the object in an exported model: its control is 1 in key frames of the push."""

_JOINTS = ("free", "ball", "slide", "hinge")
_GEOMS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
_INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")
_CONES = ("pyramidal", "elliptic")
_JACOBIANS = ("dense", "sparse", "auto")
_SOLVERS = ("PGS", "CG", "Newton")
_DYNAMICS = ("none", "integrator", "filter", "filterexact")
_GAINS = ("fixed", "affine")
_BIASES = ("none", "affine")
"""Keywords of MuJoCo's XML by the numbers in its enumerations, which versions 3 and 4 share."""

_PHYSICS = (
    *("body_parentid", "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia"),
    *("body_gravcomp", "body_mocapid", "body_invweight0"),
    *("jnt_type", "jnt_pos", "jnt_axis", "jnt_limited", "jnt_range", "jnt_margin", "jnt_stiffness", "jnt_solref"),
    *("jnt_solimp", "jnt_actfrclimited", "jnt_actfrcrange", "jnt_stiffnesspoly", "jnt_actgravcomp"),
    *("qpos0", "qpos_spring", "dof_armature", "dof_damping", "dof_dampingpoly", "dof_frictionloss"),
    *("dof_solref", "dof_solimp", "dof_invweight0"),
    *("geom_type", "geom_bodyid", "geom_pos", "geom_size", "geom_contype", "geom_conaffinity", "geom_condim"),
    *("geom_friction", "geom_priority", "geom_solref", "geom_solimp", "geom_solmix", "geom_margin", "geom_gap"),
    *("geom_surfacevel", "geom_adhesion", "geom_fluid"),
    *("site_bodyid", "site_pos", "site_quat", "exclude_signature"),
    *("eq_type", "eq_obj1id", "eq_obj2id", "eq_active0", "eq_solref", "eq_solimp", "eq_data"),
    *("tendon_num", "wrap_type", "wrap_objid", "wrap_prm", "tendon_limited", "tendon_range", "tendon_margin"),
    *("tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_armature", "tendon_lengthspring"),
    *("tendon_stiffnesspoly", "tendon_dampingpoly", "tendon_solref_lim", "tendon_solimp_lim", "tendon_solref_fri"),
    *("tendon_solimp_fri", "tendon_actfrclimited", "tendon_actfrcrange"),
    *("actuator_trntype", "actuator_trnid", "actuator_gear", "actuator_dyntype", "actuator_dynprm"),
    *("actuator_gaintype", "actuator_gainprm", "actuator_biastype", "actuator_biasprm", "actuator_ctrllimited"),
    *("actuator_ctrlrange", "actuator_forcelimited", "actuator_forcerange", "actuator_damping", "actuator_armature"),
    "actuator_delay",
)
"""Arrays of a model that decide how it moves; those of meshes are left out, whose frames may be chosen anew."""


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
        spec: What `model` was compiled from: has the meshes as they were given.
        model: The model, whose values are written.
        replay: What was recorded of it.
        path: Where to write; missing folders are made.
        keyframes: At most so many key frames, and at least the ends of the stages.

    Raises:
        GraspRefineError: The replay is of another model; the model has something that is not written, such as
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
    frames = _write_meshes(assets, spec, model)
    pushed = bool(np.any(replay.force)) and Stage.PUSH in replay.stage
    _write_bodies(ET.SubElement(root, "worldbody"), model, frames, pushed=pushed)
    _write_contacts(root, model)
    _write_tendons(root, model)
    _write_equalities(root, model)
    _write_actuators(root, model, replay.force if pushed else None)
    _write_keyframes(ET.SubElement(root, "keyframe"), replay, keyframes, pushed=pushed)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode") + "\n"
    _check_same(model, text)
    with written_whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def check_replay(model: mujoco.MjModel, replay: Replay) -> None:
    """Nothing, when the replay can be of this model.

    Raises:
        GraspRefineError: It is not; names joints that only one of them has.
    """
    names = qpos_names(model)
    if names != replay.qpos_names or replay.qvel.shape[1] != model.nv or model.nmocap != 1:
        strange = sorted(set(names) ^ set(replay.qpos_names))[:4]
        raise GraspRefineError(
            f"replay {replay.name}: is of another model" + (f", {', '.join(strange)} is not in both" if strange else "")
        )


def _text(values: float | np.ndarray, single: bool = False) -> str:
    """Numbers as text that is read back exactly, as float64 or, where MuJoCo keeps no more, float32."""
    kind = np.float32 if single else np.float64
    # NumPy and Python write the fewest digits that identify a number.
    return " ".join(str(value) for value in np.atleast_1d(values).astype(kind).ravel())


def _name(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Name of a thing, made up where it has none."""
    return getattr(model, kind)(int(number)).name or f"{kind}_{number}"


def _flag(value: object) -> str:
    return "true" if value else "false"


def _write_options(root: ET.Element, model: mujoco.MjModel) -> None:
    """All options that are not MuJoCo's defaults, and those that a reader looks for."""
    option, default = model.opt, mujoco.MjModel.from_xml_string("<mujoco/>").opt
    node = ET.SubElement(
        root,
        "option",
        timestep=_text(option.timestep),
        integrator=_INTEGRATORS[option.integrator],
        cone=_CONES[option.cone],
        jacobian=_JACOBIANS[option.jacobian],
        solver=_SOLVERS[option.solver],
        impratio=_text(option.impratio),
        gravity=_text(option.gravity),
        iterations=str(option.iterations),
        tolerance=_text(option.tolerance),
        noslip_iterations=str(option.noslip_iterations),
        noslip_tolerance=_text(option.noslip_tolerance),
    )
    for name in ("ls_iterations", "ls_tolerance", "ccd_iterations", "ccd_tolerance", "wind", "density", "viscosity"):
        value = np.asarray(getattr(option, name))
        if (value != getattr(default, name)).any():
            node.set(name, str(value) if value.dtype.kind == "i" else _text(value))
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
    """Light for the viewer; nothing here moves anything."""
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.6 0.6 0.6", specular="0.1 0.1 0.1")
    ET.SubElement(visual, "global", azimuth="130", elevation="-25")


def _write_meshes(assets: ET.Element, spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[int, np.ndarray]:
    """Write all meshes; returns for each the pose (7,) of its compiled frame in that in which it was written."""
    given = {mesh.name: mesh for mesh in spec.meshes}
    frames = {}
    for number in range(model.nmesh):
        name = _name(model, "mesh", number)
        node = ET.SubElement(assets, "mesh", name=name)
        position, turn = model.mesh_pos[number], model.mesh_quat[number]
        frames[number] = np.concatenate([position, turn])
        source = given.get(model.mesh(number).name)
        if source is not None and _verbatim(source):
            node.set("vertex", _text(np.asarray(source.uservert), single=True))
            if len(source.userface):
                node.set("face", " ".join(map(str, np.asarray(source.userface).tolist())))
                # MuJoCo before 3.3 does not know the word, and the hull of vertices alone needs none.
                if source.inertia != mujoco.mjtMeshInertia.mjMESH_INERTIA_LEGACY:
                    node.set("inertia", source.inertia.name.rpartition("_")[2].lower())
        else:
            # From a file, maybe scaled: as it was compiled, put back into the frame of the file.
            rows = slice(model.mesh_vertadr[number], model.mesh_vertadr[number] + model.mesh_vertnum[number])
            points = model.mesh_vert[rows].astype(float) @ _matrix(turn).T + position
            faces = slice(model.mesh_faceadr[number], model.mesh_faceadr[number] + model.mesh_facenum[number])
            node.set("vertex", _text(points, single=True))
            node.set("face", " ".join(map(str, model.mesh_face[faces].ravel().tolist())))
    return frames


def _verbatim(mesh: mujoco.MjsMesh) -> bool:
    """Whether the vertices of a mesh in a specification are those that are compiled."""
    moved = np.any(mesh.refpos) or not np.array_equal(mesh.refquat, [1, 0, 0, 0])
    return len(mesh.uservert) > 0 and not moved and bool(np.all(np.asarray(mesh.scale) == 1))


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _write_bodies(world: ET.Element, model: mujoco.MjModel, frames: dict[int, np.ndarray], *, pushed: bool) -> None:
    ET.SubElement(world, "light", pos="0.5 -0.5 1", dir="-0.4 0.4 -0.8", directional="true", diffuse="0.4 0.4 0.4")
    if pushed:
        ET.SubElement(world, "site", name=f"{PUSH}_frame", size="0.001", rgba="0 0 0 0", group="5")
    nodes = [world]
    for body in range(model.nbody):
        if body:
            node = ET.SubElement(
                nodes[model.body_parentid[body]],
                "body",
                name=_name(model, "body", body),
                pos=_text(model.body_pos[body]),
                quat=_text(model.body_quat[body]),
            )
            nodes.append(node)
            if model.body_mocapid[body] >= 0:
                node.set("mocap", "true")
            if model.body_gravcomp[body]:
                node.set("gravcomp", _text(model.body_gravcomp[body]))
            if model.body_mass[body] > 0:
                ET.SubElement(
                    node,
                    "inertial",
                    pos=_text(model.body_ipos[body]),
                    quat=_text(model.body_iquat[body]),
                    mass=_text(model.body_mass[body]),
                    diaginertia=_text(model.body_inertia[body]),
                )
        node = nodes[body]
        for joint in np.flatnonzero(model.jnt_bodyid == body):
            _write_joint(node, model, joint)
        for geom in np.flatnonzero(model.geom_bodyid == body):
            _write_geom(node, model, geom, frames)
        for site in np.flatnonzero(model.site_bodyid == body):
            ET.SubElement(
                node,
                "site",
                name=_name(model, "site", site),
                pos=_text(model.site_pos[site]),
                quat=_text(model.site_quat[site]),
                group=str(model.site_group[site]),
            )
        if pushed and model.body(body).name == OBJECT:
            centre = _text(model.body_ipos[body])
            ET.SubElement(node, "site", name=PUSH, pos=centre, size="0.002", rgba="1 0 0 1")


def _write_joint(node: ET.Element, model: mujoco.MjModel, joint: int) -> None:
    kind, dof, at = _JOINTS[model.jnt_type[joint]], model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    joint_node = ET.SubElement(node, "joint", name=_name(model, "joint", joint), type=kind)
    values = {
        "armature": model.dof_armature[dof],
        "damping": model.dof_damping[dof],
        "frictionloss": model.dof_frictionloss[dof],
        "solreffriction": model.dof_solref[dof],
        "solimpfriction": model.dof_solimp[dof],
        "stiffness": model.jnt_stiffness[joint],
        "margin": model.jnt_margin[joint],
    }
    if kind != "free":
        values["pos"] = model.jnt_pos[joint]
        values |= {"solreflimit": model.jnt_solref[joint], "solimplimit": model.jnt_solimp[joint]}
        joint_node.set("limited", _flag(model.jnt_limited[joint]))
        if model.jnt_limited[joint]:
            values["range"] = model.jnt_range[joint]
    if kind in ("hinge", "slide"):
        values["axis"] = model.jnt_axis[joint]
        values |= {"ref": model.qpos0[at], "springref": model.qpos_spring[at]}
        joint_node.set("actuatorfrclimited", _flag(model.jnt_actfrclimited[joint]))
        if model.jnt_actfrclimited[joint]:
            values["actuatorfrcrange"] = model.jnt_actfrcrange[joint]
    for key, value in values.items():
        joint_node.set(key, _text(value))


def _write_geom(node: ET.Element, model: mujoco.MjModel, geom: int, frames: dict[int, np.ndarray]) -> None:
    kind = _GEOMS.get(int(model.geom_type[geom]))
    name = _name(model, "geom", geom)
    if kind is None:
        raise GraspRefineError(f"geom {name}: its type is not one of {', '.join(_GEOMS.values())}, and is not exported")
    position, turn = model.geom_pos[geom].copy(), model.geom_quat[geom].copy()
    geom_node = ET.SubElement(node, "geom", name=name, type=kind)
    if kind == "mesh":
        mesh = int(model.geom_dataid[geom])
        frame, back = frames[mesh], np.zeros(4)
        mujoco.mju_negQuat(back, frame[3:])
        mujoco.mju_mulQuat(turn, model.geom_quat[geom], back)
        position -= _matrix(turn) @ frame[:3]
        geom_node.set("mesh", _name(model, "mesh", mesh))
    else:
        geom_node.set("size", _text(model.geom_size[geom]))
    material = model.geom_matid[geom]
    values = {
        "pos": position,
        "quat": turn,
        "friction": model.geom_friction[geom],
        "solref": model.geom_solref[geom],
        "solimp": model.geom_solimp[geom],
        "solmix": model.geom_solmix[geom],
        "margin": model.geom_margin[geom],
        "gap": model.geom_gap[geom],
    }
    for key, value in values.items():
        geom_node.set(key, _text(value))
    geom_node.set("rgba", _text(model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom], single=True))
    for key in ("condim", "contype", "conaffinity", "priority", "group"):
        geom_node.set(key, str(getattr(model, f"geom_{key}")[geom]))


def _write_contacts(root: ET.Element, model: mujoco.MjModel) -> None:
    if model.npair:
        raise GraspRefineError("explicit contact pairs are not exported")
    contact = ET.SubElement(root, "contact")
    for signature in model.exclude_signature:
        one, two = (_name(model, "body", number) for number in (signature >> 16, signature & 0xFFFF))
        ET.SubElement(contact, "exclude", body1=one, body2=two)


def _write_tendons(root: ET.Element, model: mujoco.MjModel) -> None:
    tendons = ET.SubElement(root, "tendon")
    for tendon in range(model.ntendon):
        name = _name(model, "tendon", tendon)
        wraps = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if any(model.wrap_type[wrap] != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
            raise GraspRefineError(f"tendon {name}: only fixed tendons are exported")
        node = ET.SubElement(tendons, "fixed", name=name, limited=_flag(model.tendon_limited[tendon]))
        values = {
            "margin": model.tendon_margin[tendon],
            "stiffness": model.tendon_stiffness[tendon],
            "damping": model.tendon_damping[tendon],
            "frictionloss": model.tendon_frictionloss[tendon],
            "springlength": model.tendon_lengthspring[tendon],
            "solreflimit": model.tendon_solref_lim[tendon],
            "solimplimit": model.tendon_solimp_lim[tendon],
            "solreffriction": model.tendon_solref_fri[tendon],
            "solimpfriction": model.tendon_solimp_fri[tendon],
        }
        if model.tendon_limited[tendon]:
            values["range"] = model.tendon_range[tendon]
        for key, value in values.items():
            node.set(key, _text(value))
        for wrap in wraps:
            joint = _name(model, "joint", model.wrap_objid[wrap])
            ET.SubElement(node, "joint", joint=joint, coef=_text(model.wrap_prm[wrap]))


def _write_equalities(root: ET.Element, model: mujoco.MjModel) -> None:
    equality = ET.SubElement(root, "equality")
    for number in range(model.neq):
        kind, data = mujoco.mjtEq(model.eq_type[number]), model.eq_data[number]
        name = _name(model, "equality", number)
        one, two = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        bodies = model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
        if kind == mujoco.mjtEq.mjEQ_WELD and bodies:
            node = ET.SubElement(equality, "weld", body1=_name(model, "body", one), body2=_name(model, "body", two))
            node.set("anchor", _text(data[:3]))
            node.set("relpose", _text(data[3:10]))
            node.set("torquescale", _text(data[10]))
        elif kind == mujoco.mjtEq.mjEQ_CONNECT and bodies:
            node = ET.SubElement(equality, "connect", body1=_name(model, "body", one), body2=_name(model, "body", two))
            node.set("anchor", _text(data[:3]))
        elif kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON):
            what = "joint" if kind == mujoco.mjtEq.mjEQ_JOINT else "tendon"
            node = ET.SubElement(equality, what, {f"{what}1": _name(model, what, one)})
            if two >= 0:
                node.set(f"{what}2", _name(model, what, two))
            node.set("polycoef", _text(data[:5]))
        else:
            raise GraspRefineError(f"equality {name}: only weld and connect of bodies, joint and tendon are exported")
        node.set("name", name)
        node.set("active", _flag(model.eq_active0[number]))
        node.set("solref", _text(model.eq_solref[number]))
        node.set("solimp", _text(model.eq_solimp[number]))


def _write_actuators(root: ET.Element, model: mujoco.MjModel, force: np.ndarray | None) -> None:
    node = ET.SubElement(root, "actuator")
    transmission = mujoco.mjtTrn
    targets = {
        transmission.mjTRN_JOINT.value: ("joint", "joint"),
        transmission.mjTRN_JOINTINPARENT.value: ("jointinparent", "joint"),
        transmission.mjTRN_TENDON.value: ("tendon", "tendon"),
    }
    for number in range(model.nu):
        name = _name(model, "actuator", number)
        target = targets.get(int(model.actuator_trntype[number]))
        kinds = (
            (model.actuator_dyntype[number], _DYNAMICS),
            (model.actuator_gaintype[number], _GAINS),
            (model.actuator_biastype[number], _BIASES),
        )
        if target is None or any(kind >= len(known) for kind, known in kinds):
            raise GraspRefineError(
                f"actuator {name}: only those of joints and tendons with fixed or affine gain are exported"
            )
        attribute, what = target
        actuator = ET.SubElement(node, "general", name=name)
        actuator.set(attribute, _name(model, what, model.actuator_trnid[number, 0]))
        for key, (kind, known) in zip(("dyntype", "gaintype", "biastype"), kinds, strict=True):
            actuator.set(key, known[kind])
        actuator.set("gear", _text(model.actuator_gear[number]))
        # MuJoCo 3 has as many parameters as 4, of which fixed and affine use the first three.
        for key in ("dynprm", "gainprm", "biasprm"):
            actuator.set(key, _text(getattr(model, f"actuator_{key}")[number, :3]))
        for key in ("ctrl", "force"):
            limited = getattr(model, f"actuator_{key}limited")[number]
            actuator.set(f"{key}limited", _flag(limited))
            if limited:
                actuator.set(f"{key}range", _text(getattr(model, f"actuator_{key}range")[number]))
    if force is not None:
        # At a site with a reference site in the world, a force keeps its direction when the object turns.
        gear = np.concatenate([force, np.zeros(3)])
        push = ET.SubElement(node, "general", name=PUSH, site=PUSH, refsite=f"{PUSH}_frame", gear=_text(gear))
        push.set("ctrllimited", "true")
        push.set("ctrlrange", "0 1")


def _write_keyframes(node: ET.Element, replay: Replay, count: int, *, pushed: bool) -> None:
    since = replay.since_stage()
    for frame in replay.thinned(count):
        control = replay.ctrl[frame]
        stage = Stage(int(replay.stage[frame]))
        last = frame + 1 == len(replay) or replay.stage[frame + 1] != stage
        # At the end of a stage stands what the next one starts from.
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
            time=_text(replay.time[frame]),
            qpos=_text(replay.qpos[frame]),
            qvel=_text(replay.qvel[frame]),
            ctrl=_text(control),
            mpos=_text(replay.mocap_pos[frame]),
            mquat=_text(replay.mocap_quat[frame]),
        )


def _check_same(model: mujoco.MjModel, text: str) -> None:
    """Nothing, when the written model moves as the original; the price of a second compilation."""
    try:
        written = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise GraspRefineError(f"the exported model cannot be compiled: {error}") from None
    for name in _PHYSICS:
        ours = getattr(model, name, None)
        if ours is None:
            continue
        theirs = getattr(written, name)
        if name.startswith("actuator"):
            theirs = theirs[: len(ours)]
        if name.startswith("site"):
            # Those of the push stand among the others.
            theirs = theirs[[not written.site(i).name.startswith(PUSH) for i in range(written.nsite)]]
        if name in ("geom_pos", "geom_size") and ours.shape == theirs.shape:
            solid = model.geom_type != mujoco.mjtGeom.mjGEOM_MESH
            ours, theirs = ours[solid], theirs[solid]
        if ours.shape != theirs.shape or not np.allclose(ours, theirs, rtol=1e-6, atol=1e-9):
            raise GraspRefineError(f"the model has something that is not exported: {name} would differ")
