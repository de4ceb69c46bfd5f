"""Hands in USD, as Isaac Sim and Newton have them: written as a URDF with meshes, from which they are read.

The URDF is kept in the user's cache folder, by the contents of all layers of the stage. Bodies are prims with
`PhysicsRigidBodyAPI`; lengths, scales of prims, angles in degrees and the units of the stage are converted.

Source: openusd.org, api/usd_physics_page_front.html.
"""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from math import isfinite, radians
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.json_files import save_text
from grasp_refine.core.se3 import inverse, matrix_from_quaternion, transform, transform_points
from grasp_refine.geometry.cache import default_cache
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.urdf_text import UNLIMITED, add_ends, add_inertia, numbers, save_obj, save_xml

SUFFIXES = (".usd", ".usda", ".usdc")
"""Suffixes of stages."""

SCHEMA = 2
"""Version of the conversion."""

FAULTS = "faults.txt"
"""File beside the URDF, with a line for each fault of the stage."""

AXES = {"X": np.array([1.0, 0.0, 0.0]), "Y": np.array([0.0, 1.0, 0.0]), "Z": np.array([0.0, 0.0, 1.0])}


def is_usd(path: Path) -> bool:
    """Return whether a file is a stage of USD, by its suffix."""
    return path.suffix.lower() in SUFFIXES


def urdf_of_usd(path: Path) -> Path:
    """Return the URDF of the hand in a stage, which is written if it is not there yet.

    Raises:
        HandError: usd-core is not installed, or the stage cannot be read, has no bodies, or joints that URDF has no
            counterpart of.
    """
    try:
        from pxr import Tf, Usd, UsdUtils
    except ModuleNotFoundError:
        raise HandError(f"{path}: USD is not installed: pip install 'grasp-refine[usd]'") from None
    # Warnings of USD, which it would print, are part of errors.
    warnings = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].rpartition(" : ")[2].strip("'")
        raise HandError(f"{path}: cannot be read as USD: {reason}") from None
    digest = hashlib.sha256(f"{SCHEMA}".encode())
    for layer in stage.GetUsedLayers():
        digest.update(layer.ExportToString().encode())
    folder = default_cache("usd") / digest.hexdigest()[:32]
    urdf = folder / f"{path.stem}.urdf"
    if not urdf.is_file():
        _Converter(path, stage, folder, warnings).write(urdf)
    return urdf


def usd_faults(urdf: Path) -> tuple[str, ...]:
    """Return the faults of the stage that a URDF was made of, each with its consequence; none of another URDF."""
    file = urdf.parent / FAULTS
    made = urdf.is_relative_to(default_cache("usd")) and file.is_file()
    return tuple(file.read_text(encoding="utf-8").splitlines()) if made else ()


@dataclass(eq=False)
class _Converter:
    path: Path
    stage: Any
    folder: Path
    warnings: Any
    _names: dict[str, str] = field(default_factory=dict)
    """Path of a body -> name of its link."""

    def write(self, urdf: Path) -> None:
        """Write the URDF, and its meshes before."""
        from pxr import Usd, UsdGeom, UsdPhysics

        self.metres = UsdGeom.GetStageMetersPerUnit(self.stage)
        self.kilograms = UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        self._cache = UsdGeom.XformCache()
        prims = list(self.stage.Traverse(Usd.TraverseInstanceProxies()))
        bodies = [prim for prim in prims if prim.HasAPI(UsdPhysics.RigidBodyAPI)]
        if not bodies:
            said = [one.commentary for one in self.warnings.TakeUncoalescedDiagnostics()]
            why = f": {said[0].partition('@ of layer')[0].replace('@', '')}" if said else ""
            raise HandError(f"{self.path}: has no body with PhysicsRigidBodyAPI{why}")
        self._names = _distinct({str(prim.GetPath()): prim.GetName() for prim in bodies})
        joints = [UsdPhysics.Joint(prim) for prim in prims if prim.IsA(UsdPhysics.Joint)]
        ends = {str(joint.GetPath()): self._ends(joint) for joint in joints}
        hand = self._largest([pair for pair in ends.values() if pair is not None])
        beside = {path.rpartition("/")[0] for path in hand}
        loose = [path for path in self._names if path not in hand and path.rpartition("/")[0] in beside]
        bodies = [prim for prim in bodies if str(prim.GetPath()) in hand]
        joints = [joint for joint in joints if (pair := ends[str(joint.GetPath())]) and str(pair[0].GetPath()) in hand]
        self._names = {path: name for path, name in self._names.items() if path in hand}
        labels = _distinct({str(joint.GetPath()): joint.GetPrim().GetName() for joint in joints})
        robot = ET.Element("robot", name=self.path.stem)
        for prim in bodies:
            self._add_link(robot, prim)
        for joint in joints:
            self._add_joint(robot, joint, labels)
        save_text(self.folder / FAULTS, "".join(f"{line}\n" for line in self._faults(joints, bodies, loose)))
        save_xml(robot, urdf)

    def _faults(self, joints: list[Any], bodies: list[Any], loose: list[str]) -> list[str]:
        """Return the faults of the hand, each with its consequence.

        Args:
            joints: Its joints.
            bodies: Its bodies.
            loose: Paths of bodies beside them that no joint connects to it.
        """
        from pxr import Usd, UsdPhysics, UsdShade

        limp, fast = [], []
        for joint in joints:
            prim = joint.GetPrim()
            kind = {"PhysicsRevoluteJoint": "angular", "PhysicsPrismaticJoint": "linear"}.get(prim.GetTypeName())
            if kind is None or any(name.startswith("physxMimicJoint") for name in prim.GetPropertyNames()):
                continue
            drive = UsdPhysics.DriveAPI.Get(prim, kind)
            gains = (drive.GetStiffnessAttr().Get(), drive.GetDampingAttr().Get()) if drive else (0.0,)
            limp += [] if any(gains) else [prim.GetName()]
            fast += [] if prim.GetAttribute("physxJoint:maxJointVelocity").Get() else [prim.GetName()]
        slippery: dict[str, None] = {}
        for prim in (part for body in bodies for part in Usd.PrimRange(body, Usd.TraverseInstanceProxies())):
            material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
            if not material or not prim.HasAPI(UsdPhysics.CollisionAPI):
                continue
            physics = UsdPhysics.MaterialAPI(material.GetPrim())
            if physics and not (physics.GetStaticFrictionAttr().Get() and physics.GetDynamicFrictionAttr().Get()):
                slippery[material.GetPrim().GetName()] = None
        found = {
            "{} have no drive, or one without stiffness and damping: in Isaac Sim and Newton they hang loose": limp,
            "{} have no physxJoint:maxJointVelocity: nothing limits their speed in Isaac Sim": fast,
            "material {} has no friction, which is the default of PhysicsMaterialAPI: what it is bound to holds "
            "nothing": list(slippery),
            "no joint connects {} to the hand: they fall off, and are left out here": [
                path.rpartition("/")[2] for path in loose
            ],
            f"lengths are in units of {self.metres:g} m: a stage in metres that refers to it needs the scale "
            f"{self.metres:g}": [""] * (self.metres != 1.0),
        }
        return [text.format(", ".join(names)) for text, names in found.items() if names]

    def _ends(self, joint: Any) -> tuple[Any, Any] | None:
        """Return the bodies of a joint; None: it closes a loop of a linkage, or holds the hand in the world."""
        if joint.GetExcludeFromArticulationAttr().Get() or joint.GetJointEnabledAttr().Get() is False:
            return None
        targets = [rel().GetTargets() for rel in (joint.GetBody0Rel, joint.GetBody1Rel)]
        first, second = (self._body_of(self.stage.GetPrimAtPath(one[0])) if one else None for one in targets)
        return None if first is None or second is None else (first, second)

    def _largest(self, pairs: list[tuple[Any, Any]]) -> set[str]:
        """Return the paths of the bodies that joints connect to one hand, the largest; objects have no joints."""
        groups = [{path} for path in self._names]
        for pair in pairs:
            ends = {str(body.GetPath()) for body in pair}
            touched = [group for group in groups if group & ends]
            groups = [group for group in groups if not group & ends] + [set().union(*touched)]
        groups.sort(key=len, reverse=True)
        if len(groups) > 1 and len(groups[0]) == len(groups[1]) > 1:
            some = ", ".join(min(group) for group in groups[:2])
            raise HandError(f"{self.path}: has several hands, with {some}; give a file with one")
        return groups[0]

    def _pose(self, prim: Any) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, " 3"]]:
        """Return the pose of a prim in the world, metres, and its scale in metres per unit along its axes."""
        M = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        scale = np.linalg.norm(M[:3, :3], axis=0)
        if not (scale > 0).all():
            raise HandError(f"{self.path}: {prim.GetPath()} has a scale of 0")
        return transform(M[:3, :3] / scale, self.metres * M[:3, 3]), self.metres * scale

    def _body_of(self, prim: Any) -> Any:
        """Return the body that a prim belongs to; None: it belongs to none."""
        while prim and str(prim.GetPath()) not in self._names:
            prim = prim.GetParent()
        return prim if prim and prim.GetPath() != prim.GetPath().absoluteRootPath else None

    def _add_link(self, robot: ET.Element, body: Any) -> None:
        from pxr import Usd, UsdGeom

        name, (T, scale) = self._names[str(body.GetPath())], self._pose(body)
        node = ET.SubElement(robot, "link", name=name)
        self._add_mass(node, body, scale)
        number = 0
        for prim in Usd.PrimRange(body, Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Gprim) or self._body_of(prim) != body:
                continue
            solid = _is_solid(prim, body)
            looks = UsdGeom.Imageable(prim).ComputePurpose() in ("default", "render") or not solid
            shape = self._shape(prim, T)
            if shape is None:
                continue
            number += 1
            file = f"meshes/{name}_{number}.obj"
            save_obj(self.folder / file, *shape)
            for kind in (["collision"] if solid else []) + (["visual"] if looks else []):
                geometry = ET.SubElement(ET.SubElement(node, kind), "geometry")
                ET.SubElement(geometry, "mesh", filename=file)

    def _add_mass(self, node: ET.Element, body: Any, scale: np.ndarray) -> None:
        from pxr import UsdPhysics

        api = UsdPhysics.MassAPI(body)
        mass = api.GetMassAttr().Get() if body.HasAPI(UsdPhysics.MassAPI) else None
        moments = np.array(api.GetDiagonalInertiaAttr().Get() or np.zeros(3), dtype=float) if mass else np.zeros(3)
        if not mass or not (moments > 0).all():
            return  # computed from the geometry, as for a URDF without
        center = np.array(api.GetCenterOfMassAttr().Get() or np.zeros(3), dtype=float)
        center = scale * np.where(np.isfinite(center), center, 0.0)
        turn = _rotation(api.GetPrincipalAxesAttr().Get())
        matrix = self.kilograms * self.metres**2 * (turn * moments) @ turn.T
        add_inertia(node, Inertia(self.kilograms * float(mass), center, matrix))

    def _shape(self, prim: Any, T_world_body: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return vertices and triangles of a prim in the frame of its body, metres; None: it has none."""
        import trimesh
        from pxr import UsdGeom

        kind = prim.GetTypeName()
        if kind == "Mesh":
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get() or np.zeros((0, 3)), dtype=float)
            faces = _triangles(mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get())
        elif kind == "Cube":
            made = trimesh.creation.box(np.full(3, float(UsdGeom.Cube(prim).GetSizeAttr().Get())))
            points, faces = np.asarray(made.vertices), np.asarray(made.faces)
        elif kind == "Sphere":
            made = trimesh.creation.icosphere(subdivisions=3, radius=float(UsdGeom.Sphere(prim).GetRadiusAttr().Get()))
            points, faces = np.asarray(made.vertices), np.asarray(made.faces)
        elif kind in ("Cylinder", "Capsule"):
            shape = UsdGeom.Cylinder(prim) if kind == "Cylinder" else UsdGeom.Capsule(prim)
            radius, height = float(shape.GetRadiusAttr().Get()), float(shape.GetHeightAttr().Get())
            make = trimesh.creation.cylinder if kind == "Cylinder" else trimesh.creation.capsule
            made = make(radius=radius, height=height)
            made.apply_translation(-made.bounds.mean(axis=0))
            along = "XYZ".index(shape.GetAxisAttr().Get())
            points = np.roll(np.asarray(made.vertices), along - 2, axis=1)
            faces = np.asarray(made.faces)
        else:
            return None
        if not len(points) or not len(faces):
            return None
        M = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        world = self.metres * (points @ M[:3, :3].T + M[:3, 3])
        if np.linalg.det(M[:3, :3]) < 0:
            faces = faces[:, ::-1]
        return transform_points(inverse(T_world_body), world), faces

    def _add_joint(self, robot: ET.Element, joint: Any, labels: dict[str, str]) -> None:
        from pxr import UsdPhysics

        prim, name = joint.GetPrim(), labels[str(joint.GetPath())]
        bodies = self._ends(joint)
        assert bodies is not None  # others are left out
        kind, axis = "fixed", AXES["X"]
        if prim.IsA(UsdPhysics.RevoluteJoint) or prim.IsA(UsdPhysics.PrismaticJoint):
            slides = prim.IsA(UsdPhysics.PrismaticJoint)
            moving = UsdPhysics.PrismaticJoint(prim) if slides else UsdPhysics.RevoluteJoint(prim)
            kind, axis = "prismatic" if slides else "revolute", AXES[moving.GetAxisAttr().Get()]
        elif not prim.IsA(UsdPhysics.FixedJoint):
            raise HandError(
                f"{self.path}: joint {prim.GetPath()} is of type {prim.GetTypeName()}; joints of hands turn, slide or "
                "are fixed"
            )
        frames = [self._frame(joint, number, body) for number, body in enumerate(bodies)]
        parent, child = (self._names[str(body.GetPath())] for body in bodies)
        T = frames[0] @ inverse(frames[1])
        about = frames[1][:3, :3] @ axis
        if kind != "fixed" and np.linalg.norm(np.cross(frames[1][:3, 3], about)) > 1e-9:
            # A joint of URDF runs through the origin of its child.
            between = f"{child}_at_{name}"
            ET.SubElement(robot, "link", name=between)
            at = transform(np.eye(3), frames[1][:3, 3])
            fixed = ET.SubElement(robot, "joint", name=f"{name}_offset", type="fixed")
            add_ends(fixed, between, child, inverse(at))
            child, T = between, T @ at
        node = ET.SubElement(robot, "joint", name=name)
        add_ends(node, parent, child, T)
        if kind != "fixed":
            kind = self._add_limits(node, prim, kind, about)
            self._add_mimic(node, prim, labels, kind)
        node.set("type", kind)

    def _frame(self, joint: Any, number: int, body: Any) -> Float[np.ndarray, "4 4"]:
        """Return a frame of a joint in the frame of its body."""
        position = np.array(getattr(joint, f"GetLocalPos{number}Attr")().Get(), dtype=float)
        turn = _rotation(getattr(joint, f"GetLocalRot{number}Attr")().Get())
        end = self.stage.GetPrimAtPath((joint.GetBody1Rel if number else joint.GetBody0Rel)().GetTargets()[0])
        (T_end, scale), (T_body, _) = self._pose(end), self._pose(body)
        return inverse(T_body) @ T_end @ transform(turn, scale * position)

    def _add_limits(self, node: ET.Element, prim: Any, kind: str, about: np.ndarray) -> str:
        from pxr import UsdPhysics

        unit = self.metres if kind == "prismatic" else radians(1.0)
        low, high = (prim.GetAttribute(f"physics:{end}Limit").Get() for end in ("lower", "upper"))
        drive = UsdPhysics.DriveAPI.Get(prim, "linear" if kind == "prismatic" else "angular")
        effort = drive.GetMaxForceAttr().Get() if drive else None
        force = self.kilograms * self.metres * (1.0 if kind == "prismatic" else self.metres)
        effort = UNLIMITED if effort is None or not isfinite(effort) else force * effort
        speed = prim.GetAttribute("physxJoint:maxJointVelocity").Get()
        speed = UNLIMITED if speed is None or not isfinite(speed) else unit * speed
        limit = {"effort": repr(float(effort)), "velocity": repr(float(min(speed, UNLIMITED)))}
        ET.SubElement(node, "axis", xyz=numbers(about))
        if low is None or high is None or not (isfinite(low) and isfinite(high)):
            ET.SubElement(node, "limit", limit)
            if kind == "prismatic":
                raise HandError(f"{self.path}: joint {prim.GetPath()} slides without limits")
            return "continuous"
        ET.SubElement(node, "limit", {**limit, "lower": repr(unit * low), "upper": repr(unit * high)})
        return kind

    def _add_mimic(self, node: ET.Element, prim: Any, labels: dict[str, str], kind: str) -> None:
        """Add the coupling of PhysX's schema: joint + gearing * reference + offset = 0."""
        for name in prim.GetAttributes():
            words = name.GetName().split(":")
            if words[0] != "physxMimicJoint" or words[-1] != "gearing":
                continue
            before = ":".join(words[:-1])
            targets = prim.GetRelationship(f"{before}:referenceJoint").GetTargets()
            leader = labels.get(str(targets[0])) if targets else None
            if leader is None:
                raise HandError(f"{self.path}: joint {prim.GetPath()} follows a joint that is not there")
            other = self.stage.GetPrimAtPath(targets[0])
            if other.GetTypeName() != prim.GetTypeName():
                raise HandError(
                    f"{self.path}: joint {prim.GetPath()} follows {targets[0]}, one turns and one slides: the "
                    "unit of its gearing is not known"
                )
            offset = prim.GetAttribute(f"{before}:offset").Get() or 0.0
            unit = self.metres if kind == "prismatic" else radians(1.0)
            ET.SubElement(
                node, "mimic", joint=leader, multiplier=repr(-float(name.Get())), offset=repr(-unit * float(offset))
            )


def _is_solid(prim: Any, body: Any) -> bool:
    """Return whether a prim collides: it, or a prim between it and its body, has the API and is not disabled."""
    from pxr import UsdPhysics

    while prim and prim != body.GetParent():
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            return UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is not False
        prim = prim.GetParent()
    return False


def _triangles(counts: Any, indices: Any) -> np.ndarray:
    """Return the triangles (f, 3) of polygons, as fans."""
    faces, start = [], 0
    corners = list(indices or [])
    for count in counts or []:
        faces += [(corners[start], corners[start + k], corners[start + k + 1]) for k in range(1, count - 1)]
        start += count
    return np.array(faces, dtype=np.int64).reshape(-1, 3)


def _rotation(quaternion: Any) -> Float[np.ndarray, "3 3"]:
    """Return the rotation (3, 3) of a quaternion of USD; without length, as it is where nothing is given, none."""
    if quaternion is None:
        return np.eye(3)
    values = np.array([quaternion.GetReal(), *quaternion.GetImaginary()], dtype=float)
    length = np.linalg.norm(values)
    return matrix_from_quaternion(values / length) if length > 0 else np.eye(3)


def _distinct(names: dict[str, str]) -> dict[str, str]:
    """Return the names, with the path in place of a name that several have."""
    listed = list(names.values())
    return {
        path: name if listed.count(name) == 1 else path.strip("/").replace("/", "_") for path, name in names.items()
    }
