"""Export of the bodies of a model as XML: their meshes, joints, shapes and sites."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.export_values import flag_of, name_of, set_values, text_of
from grasp_refine.validation.replay.replay import OBJECT

PUSH = "push"
"""Name of the actuator that pushes the object in an exported model, and of its site; its control is 1 in key frames
of the push."""

_JOINTS = ("free", "ball", "slide", "hinge")
_GEOMS = {0: "plane", 2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
"""Keywords of MuJoCo's XML by the numbers in its enumerations, which versions 3 and 4 share."""


def write_meshes(assets: ET.Element, spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[int, np.ndarray]:
    """Write all meshes; return for each the pose (7,) of its compiled frame in its written frame."""
    given = {mesh.name: mesh for mesh in spec.meshes}
    frames = {}
    for number in range(model.nmesh):
        name = name_of(model, "mesh", number)
        node = ET.SubElement(assets, "mesh", name=name)
        position, turn = model.mesh_pos[number], model.mesh_quat[number]
        frames[number] = np.concatenate([position, turn])
        source = given.get(model.mesh(number).name)
        if source is not None and _verbatim(source):
            node.set("vertex", text_of(np.asarray(source.uservert), single=True))
            if len(source.userface):
                node.set("face", " ".join(map(str, np.asarray(source.userface).tolist())))
                # MuJoCo before 3.3 does not know this attribute, and the hull of vertices alone does not need it.
                if source.inertia != mujoco.mjtMeshInertia.mjMESH_INERTIA_LEGACY:
                    node.set("inertia", source.inertia.name.rpartition("_")[2].lower())
        else:
            # From a file, maybe scaled: the compiled mesh, in the frame of the file.
            rows = slice(model.mesh_vertadr[number], model.mesh_vertadr[number] + model.mesh_vertnum[number])
            points = model.mesh_vert[rows].astype(float) @ _matrix(turn).T + position
            faces = slice(model.mesh_faceadr[number], model.mesh_faceadr[number] + model.mesh_facenum[number])
            node.set("vertex", text_of(points, single=True))
            node.set("face", " ".join(map(str, model.mesh_face[faces].ravel().tolist())))
    return frames


def _verbatim(mesh: mujoco.MjsMesh) -> bool:
    """Return True if the vertices of a mesh in a specification are those that are compiled."""
    moved = np.any(mesh.refpos) or not np.array_equal(mesh.refquat, [1, 0, 0, 0])
    return len(mesh.uservert) > 0 and not moved and bool(np.all(np.asarray(mesh.scale) == 1))


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def write_bodies(world: ET.Element, model: mujoco.MjModel, frames: dict[int, np.ndarray], *, pushed: bool) -> None:
    """Write all bodies with their parts, given the result of `write_meshes`; if `pushed`, with sites for the push.

    Raises:
        GraspRefineError: A shape is of a type that is not exported.
    """
    ET.SubElement(world, "light", pos="0.5 -0.5 1", dir="-0.4 0.4 -0.8", directional="true", diffuse="0.4 0.4 0.4")
    if pushed:
        ET.SubElement(world, "site", name=f"{PUSH}_frame", size="0.001", rgba="0 0 0 0", group="5")
    nodes = [world]
    for body in range(model.nbody):
        if body:
            node = ET.SubElement(
                nodes[model.body_parentid[body]],
                "body",
                name=name_of(model, "body", body),
                pos=text_of(model.body_pos[body]),
                quat=text_of(model.body_quat[body]),
            )
            nodes.append(node)
            if model.body_mocapid[body] >= 0:
                node.set("mocap", "true")
            if model.body_gravcomp[body]:
                node.set("gravcomp", text_of(model.body_gravcomp[body]))
            if model.body_mass[body] > 0:
                ET.SubElement(
                    node,
                    "inertial",
                    pos=text_of(model.body_ipos[body]),
                    quat=text_of(model.body_iquat[body]),
                    mass=text_of(model.body_mass[body]),
                    diaginertia=text_of(model.body_inertia[body]),
                )
        node = nodes[body]
        for joint in np.flatnonzero(model.jnt_bodyid == body).tolist():
            _write_joint(node, model, joint)
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            _write_geom(node, model, geom, frames)
        for site in np.flatnonzero(model.site_bodyid == body).tolist():
            ET.SubElement(
                node,
                "site",
                name=name_of(model, "site", site),
                pos=text_of(model.site_pos[site]),
                quat=text_of(model.site_quat[site]),
                group=str(model.site_group[site]),
            )
        if pushed and model.body(body).name == OBJECT:
            centre = text_of(model.body_ipos[body])
            ET.SubElement(node, "site", name=PUSH, pos=centre, size="0.002", rgba="1 0 0 1")


def _write_joint(node: ET.Element, model: mujoco.MjModel, joint: int) -> None:
    kind, dof, at = _JOINTS[model.jnt_type[joint]], model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    joint_node = ET.SubElement(node, "joint", name=name_of(model, "joint", joint), type=kind)
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
        joint_node.set("limited", flag_of(model.jnt_limited[joint]))
        if model.jnt_limited[joint]:
            values["range"] = model.jnt_range[joint]
    if kind in ("hinge", "slide"):
        values["axis"] = model.jnt_axis[joint]
        values |= {"ref": model.qpos0[at], "springref": model.qpos_spring[at]}
        joint_node.set("actuatorfrclimited", flag_of(model.jnt_actfrclimited[joint]))
        if model.jnt_actfrclimited[joint]:
            values["actuatorfrcrange"] = model.jnt_actfrcrange[joint]
    set_values(joint_node, values)


def _write_geom(node: ET.Element, model: mujoco.MjModel, geom: int, frames: dict[int, np.ndarray]) -> None:
    kind = _GEOMS.get(int(model.geom_type[geom]))
    name = name_of(model, "geom", geom)
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
        geom_node.set("mesh", name_of(model, "mesh", mesh))
    else:
        geom_node.set("size", text_of(model.geom_size[geom]))
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
    set_values(geom_node, values)
    geom_node.set("rgba", text_of(model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom], single=True))
    for key in ("condim", "contype", "conaffinity", "priority", "group"):
        geom_node.set(key, str(getattr(model, f"geom_{key}")[geom]))
