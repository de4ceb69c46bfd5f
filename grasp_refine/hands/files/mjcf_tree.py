"""Links and joints of an MJCF as a tree, as MuJoCo compiles it.

A body is a link, in the same frame. Where a body has several joints, or one that turns beside its origin, each joint
carries a link of its own without geometry, which a fixed joint ties to the body. Joint values are as in MuJoCo,
whose reference (`ref`) is the value at which the bodies are placed as in the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.errors import HandError
from grasp_refine.core.names import is_valid
from grasp_refine.core.se3 import exp_so3, matrix_from_quaternion, transform
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.mjcf import compile_mjcf, read_mjcf
from grasp_refine.hands.files.shape import Geometry, Hull, Primitive, Shape, Surface
from grasp_refine.hands.files.tree import JointEntry, LinkEntry, Tree

Geom = mujoco.mjtGeom

SEEN_GROUPS = 3
"""Number of the groups of geoms that MuJoCo shows by default, the first ones."""


def mjcf_tree(path: Path) -> Tree:
    """Return the tree of bodies and joints in the MJCF file `path`.

    Collision geometry is what can touch something: geoms with a bit of contype or conaffinity, or in a contact pair.
    A mesh collides by its convex hull, as in MuJoCo. Pairs of bodies that the file excludes never collide.

    Raises:
        HandError: MuJoCo cannot read it, it holds no hand or several, or a geom that collides is no solid.
    """
    spec, model, notes = _compiled(path)
    geoms = _geoms(model)
    colliding = (model.geom_contype | model.geom_conaffinity) != 0
    colliding[[*model.pair_geom1, *model.pair_geom2]] = True
    bodies = [model.body(number).name for number in range(1, model.nbody)]
    for name in (*bodies, *(joint.name for joint in spec.joints)):
        if not is_valid(name):
            raise HandError(f"{path}: '{name!r}' holds characters that no name may have")
    if not colliding.any():
        raise HandError(
            f"{path}: none of its {model.ngeom} geoms can touch anything: their contype and conaffinity are 0, and no "
            "contact pair names one; give a contype to geoms that collide"
        )
    links, joints = [], []
    for number, name in enumerate(bodies, 1):
        shapes = [
            Shape(_solid(model, geom, path), _geom_pose(model, geom)) for geom in geoms[number] if colliding[geom]
        ]
        mass = float(model.body_mass[number])
        T_link_inertial = _pose(model.body_ipos[number], model.body_iquat[number])
        inertia = Inertia.about(mass, T_link_inertial, np.diag(model.body_inertia[number])) if mass else None
        links.append(LinkEntry(name, tuple(shapes), mass or None, inertia))
    taken = {link.name for link in links} | {joint.name for joint in spec.joints}
    for number in range(1, model.nbody):
        parent = model.body(int(model.body_parentid[number])).name
        if parent == "world" and not model.body_jntnum[number]:
            continue
        between, found = _joints(model, number, parent, taken)
        links += [LinkEntry(link) for link in between]
        joints += found
    if any(joint.parent == "world" for joint in joints):
        links.insert(0, LinkEntry("world"))
    names = set(bodies)
    excluded = tuple((pair.bodyname1, pair.bodyname2) for pair in spec.excludes)
    excluded = tuple(pair for pair in excluded if set(pair) <= names)
    return replace(Tree.of(path, links, joints), excluded=excluded, notes=tuple(notes))


def mjcf_visuals(path: Path) -> dict[str, list[Shape | HandError]]:
    """Return the visible geoms of each body in the MJCF file `path`: MuJoCo shows the first groups.

    Raises:
        HandError: it cannot be read.
    """
    _, model, _ = _compiled(path)
    found: dict[str, list[Shape | HandError]] = {}
    for number, geoms in _geoms(model).items():
        for geom in geoms:
            if model.geom_group[geom] >= SEEN_GROUPS or model.geom_rgba[geom, 3] == 0:
                continue
            material = model.geom_matid[geom]
            red, green, blue, _ = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).tolist()
            shape = Shape(_seen(model, geom, path), _geom_pose(model, geom), (red, green, blue))
            found.setdefault(model.body(number).name, []).append(shape)
    return found


def _compiled(path: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel, list[str]]:
    spec, _, notes = read_mjcf(path)
    return spec, compile_mjcf(spec, path), notes


def _geoms(model: mujoco.MjModel) -> Mapping[int, list[int]]:
    """Return number of a body -> numbers of its geoms."""
    return {
        body: list(range(first, first + count))
        for body, (first, count) in enumerate(zip(model.body_geomadr, model.body_geomnum, strict=True))
        if body > 0
    }


def _joints(model: mujoco.MjModel, body: int, parent: str, taken: set[str]) -> tuple[list[str], list[JointEntry]]:
    """Return the links without geometry between a body and its parent, and the joints between them all."""
    name = model.body(body).name
    numbers = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    between: list[str] = []
    joints: list[JointEntry] = []
    T = _pose(model.body_pos[body], model.body_quat[body])  # of the body in `parent`, before the next joint
    for number in numbers:
        joint = model.joint(number)
        kind = mujoco.mjtJoint(joint.type[0])
        slides = kind == mujoco.mjtJoint.mjJNT_SLIDE
        anchor = np.zeros(3) if slides else model.jnt_pos[number]
        last = number == numbers[-1] and not anchor.any()
        child = name if last else _new_name(f"{name}:{joint.name}", taken)
        axis, reference = model.jnt_axis[number], float(model.qpos0[model.jnt_qposadr[number]])
        turn = np.eye(3) if slides else exp_so3(-reference * axis)
        limited = bool(model.jnt_limited[number])
        lower, upper = model.jnt_range[number].tolist() if limited else (None, None)
        joints.append(
            JointEntry(
                name=joint.name,
                kind=_kind(kind, limited),
                parent=parent,
                child=child,
                T_parent_child=T @ transform(turn, anchor - reference * axis if slides else anchor),
                axis=axis.copy(),
                lower=lower,
                upper=upper,
                effort=_effort(model, number),
            )
        )
        between += [] if last else [child]
        parent, T = child, transform(np.eye(3), -anchor)
    if parent != name and (not joints or joints[-1].child != name):
        joints.append(JointEntry(_new_name(name, taken, "_fixed"), "fixed", parent, name, T))
    return between, joints


def _kind(kind: mujoco.mjtJoint, limited: bool) -> str:
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        return "revolute" if limited else "continuous"
    return {mujoco.mjtJoint.mjJNT_SLIDE: "prismatic", mujoco.mjtJoint.mjJNT_BALL: "ball"}.get(kind, "floating")


def _effort(model: mujoco.MjModel, joint: int) -> float | None:
    """Return the greatest torque or force on a joint: by its own limit, else by the limit of its actuators."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    own = np.isin(model.actuator_trntype, [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)])
    own &= model.actuator_trnid[:, 0] == joint
    # The force of a motor is its gain times its control.
    motor = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE) & model.actuator_ctrllimited.astype(bool)
    by_control = np.abs(model.actuator_gainprm[:, 0]) * np.abs(model.actuator_ctrlrange).max(axis=1)
    force = np.where(motor, by_control, np.inf)
    force = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(axis=1), force)
    effort = float((force * np.abs(model.actuator_gear[:, 0]))[own].sum())
    return effort if own.any() and np.isfinite(effort) else None


def _new_name(name: str, taken: set[str], suffix: str = "") -> str:
    name += suffix
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _pose(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    return transform(matrix_from_quaternion(quaternion), position)


def _geom_pose(model: mujoco.MjModel, geom: int) -> np.ndarray:
    return _pose(model.geom_pos[geom], model.geom_quat[geom])


def _solid(model: mujoco.MjModel, geom: int, path: Path) -> Geometry:
    """Return the geometry of a geom in its own frame, as it collides."""
    kind, size = Geom(model.geom_type[geom]), model.geom_size[geom].tolist()
    if kind == Geom.mjGEOM_MESH:
        return Hull(_hull_points(model, int(model.geom_dataid[geom])), f"geom '{model.geom(geom).name}'")
    if kind == Geom.mjGEOM_BOX:
        return Primitive("box", tuple(2 * half for half in size))
    if kind == Geom.mjGEOM_ELLIPSOID:
        return Primitive("ellipsoid", tuple(size))
    if kind == Geom.mjGEOM_SPHERE:
        return Primitive("sphere", (size[0],))
    if kind == Geom.mjGEOM_CAPSULE:
        return Primitive("capsule", (size[0], 2 * size[1]))
    if kind == Geom.mjGEOM_CYLINDER:
        return Primitive("cylinder", (size[0], 2 * size[1]))
    body = model.body(int(model.geom_bodyid[geom])).name
    raise HandError(
        f"{path}: body '{body}' has a geom of the type {kind.name.removeprefix('mjGEOM_').lower()}, which is no solid; "
        "a hand has boxes, spheres, capsules, cylinders, ellipsoids and meshes"
    )


def _seen(model: mujoco.MjModel, geom: int, path: Path) -> Geometry:
    """Return the geometry of a geom in its own frame, as it looks."""
    if Geom(model.geom_type[geom]) != Geom.mjGEOM_MESH:
        return _solid(model, geom, path)
    mesh = model.mesh(int(model.geom_dataid[geom]))
    vertices = slice(mesh.vertadr[0], mesh.vertadr[0] + mesh.vertnum[0])
    faces = slice(mesh.faceadr[0], mesh.faceadr[0] + mesh.facenum[0])
    return Surface(model.mesh_vert[vertices].astype(float), model.mesh_face[faces].astype(np.int64))


def _hull_points(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Return the points (k, 3) of a mesh by whose hull it collides."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(float)
    graph = model.mesh_graphadr[mesh]
    if graph < 0:
        return points
    # The hull may have fewer points (maxhullvert): their number, that of its faces, places in the graph, and points.
    hull_count = model.mesh_graph[graph]
    chosen = model.mesh_graph[graph + 2 + hull_count : graph + 2 + 2 * hull_count]
    return points[chosen]
