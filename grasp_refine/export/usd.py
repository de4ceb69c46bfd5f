"""Target `usd`: hand and object with the physics of OpenUSD, for Isaac Sim, Isaac Lab, Newton and others.

Lengths are in metres, masses in kilograms, z is up. As USD has it, angles of revolute joints are in degrees, and the
stiffness and damping of their drives per degree. Couplings and the inertia of drives, which UsdPhysics has no schema
for, are attributes of PhysX's (`physxMimicJoint`, `physxJoint:armature`).

Source: openusd.org, api/usd_physics_page_front.html; docs.omniverse.nvidia.com, PhysX schema, PhysxMimicJointAPI:
joint + gearing * reference + offset = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, frame_along, quaternion_from_matrix, transform, transform_from_pose
from grasp_refine.export.bodies import Bodies, BodyLink
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.schedule import ENDS, simulated
from grasp_refine.export.target import Readme
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.simulation import Course

HAND, OBJECT, GRASPS, MATERIAL = "/World/Hand", "/World/Object", "/World/Grasps", "/World/Looks/Contact"


@dataclass(frozen=True)
class Usd:
    """Stage for Isaac Sim, Isaac Lab, Newton and whatever reads UsdPhysics."""

    name: str = "usd"
    what: str = "a USD stage with hand, drives, limits and couplings, object in convex pieces, and all grasps"
    extra: str = "usd"

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write the stage.

        Raises:
            GraspRefineError: usd-core is not installed, or the hand has a part that USD has no counterpart of.
        """
        try:
            import pxr  # noqa: F401
        except ModuleNotFoundError:
            raise GraspRefineError("USD is not installed: pip install 'grasp-refine[usd]'") from None
        world, course = simulated(grasps)
        _Writer(grasps, world, course, Bodies.of(world), str(folder / "scene.usda")).write()
        return Readme(
            {"scene.usda": f"{HAND} (an articulation), {OBJECT}, and the stages of grasp K at {GRASPS}/grasp_K"},
            use="usdview scene.usda",
            notes=(
                "Lengths are in metres, z is up; the object's frame is the world's; the hand is at the first pregrasp.",
                "Angles are in degrees in joints and drives, as USD has them, and in radians at the grasps.",
                "Poses at the grasps are of the hand's root, x y z qw qx qy qz; set points are those of a squeeze.",
            ),
        )


@dataclass(frozen=True, eq=False)
class _Writer:
    grasps: ExportedGrasps
    world: World
    course: Course
    bodies: Bodies
    path: str

    def write(self) -> None:
        from pxr import Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

        stage = Usd.Stage.CreateNew(self.path)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        stage.SetMetadata("documentation", f"{self.grasps.hand.name} on {self.grasps.name}, by grasp-refine")
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
        scene = UsdPhysics.Scene.Define(stage, "/World/PhysicsScene")
        gravity = self.world.model.opt.gravity
        strength = float(np.linalg.norm(gravity))
        scene.CreateGravityDirectionAttr(_vector(gravity / strength if strength else [0.0, 0.0, -1.0]))
        scene.CreateGravityMagnitudeAttr(strength)
        material = UsdShade.Material.Define(stage, MATERIAL)
        rough = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        rough.CreateStaticFrictionAttr(self.bodies.friction)
        rough.CreateDynamicFrictionAttr(self.bodies.friction)
        rough.CreateRestitutionAttr(0.0)
        hand = UsdGeom.Xform.Define(stage, HAND)
        UsdPhysics.ArticulationRootAPI.Apply(hand.GetPrim())
        poses = self._poses()
        names = _prim_names([link.name for link in self.bodies.links])
        for link in self.bodies.links:
            self._add_body(stage, f"{HAND}/{names[link.name]}", link, poses[link.name], material, disable_gravity=True)
        for pair in sorted(map(sorted, self.bodies.separate)):
            first, second = (f"{HAND}/{names[name]}" for name in pair)
            filtered = UsdPhysics.FilteredPairsAPI.Apply(stage.GetPrimAtPath(first))
            filtered.CreateFilteredPairsRel().AddTarget(Sdf.Path(second))
        UsdGeom.Scope.Define(stage, f"{HAND}/joints")
        labels = _prim_names([link.joint for link in self.bodies.links if link.parent])
        for link in self.bodies.links:
            if link.parent:
                self._add_joint(stage, link, names, labels)
        self._add_body(stage, OBJECT, self.bodies.object, np.eye(4), material, disable_gravity=False)
        self._add_visual(stage)
        self._add_grasps(stage)
        stage.GetRootLayer().Save()

    def _poses(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return the pose of each link at the first pregrasp."""
        values = self._joints(0, 0)
        poses = {self.bodies.links[0].name: transform_from_pose(self.course.root(0, 0.0)[0])}
        for link in self.bodies.links[1:]:
            value = values.get(link.joint, 0.0)
            slides = link.kind == "prismatic"
            along, about = (value, 0.0) if slides else (0.0, value)
            moved = transform(exp_so3(about * link.axis), along * link.axis)
            poses[link.name] = poses[link.parent] @ link.T_parent_link @ moved
        return poses

    def _joints(self, row: int, stage: int) -> dict[str, float]:
        """Return the values of the joints of a grasp at a stage, rad or m."""
        values = self.course.joints[row, stage] - self.bodies.shift
        return dict(zip(self.world.hand.joints, values.tolist(), strict=True))

    def _add_body(
        self, stage: Any, path: str, link: BodyLink, T: np.ndarray, material: Any, *, disable_gravity: bool
    ) -> None:
        from pxr import Gf, Sdf, UsdGeom, UsdPhysics, UsdShade

        body = UsdGeom.Xform.Define(stage, path)
        _place(body, T)
        prim = body.GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        if disable_gravity:
            prim.CreateAttribute("physxRigidBody:disableGravity", Sdf.ValueTypeNames.Bool, True).Set(True)
        moments, axes = link.inertia.principal()
        mass = UsdPhysics.MassAPI.Apply(prim)
        mass.CreateMassAttr(float(link.inertia.mass))
        mass.CreateCenterOfMassAttr(_vector(link.inertia.centre))
        mass.CreateDiagonalInertiaAttr(_vector(moments))
        mass.CreatePrincipalAxesAttr(_quaternion(axes))
        for number, hull in enumerate(link.hulls):
            mesh = _mesh(stage, f"{path}/piece_{number}", hull.vertices, hull.faces)
            UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
            UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
            bound = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
            bound.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
            if not disable_gravity:
                mesh.CreatePurposeAttr(UsdGeom.Tokens.guide)
            mesh.CreateDisplayColorAttr([Gf.Vec3f(0.45, 0.5, 0.58)])

    def _add_joint(self, stage: Any, link: BodyLink, names: dict[str, str], labels: dict[str, str]) -> None:
        from pxr import Sdf, UsdPhysics

        kinds = {"fixed": UsdPhysics.FixedJoint, "prismatic": UsdPhysics.PrismaticJoint}
        path = f"{HAND}/joints/{labels[link.joint]}"
        joint = kinds.get(link.kind, UsdPhysics.RevoluteJoint).Define(stage, path)
        joint.CreateBody0Rel().SetTargets([Sdf.Path(f"{HAND}/{names[link.parent]}")])
        joint.CreateBody1Rel().SetTargets([Sdf.Path(f"{HAND}/{names[link.name]}")])
        # The joint moves along or about x of these frames.
        frame = transform(frame_along(link.axis), np.zeros(3))
        for number, T in enumerate((link.T_parent_link @ frame, frame)):
            getattr(joint, f"CreateLocalPos{number}Attr")(_vector(T[:3, 3]))
            getattr(joint, f"CreateLocalRot{number}Attr")(_quaternion(T[:3, :3]))
        if link.kind == "fixed":
            return
        slides = link.kind == "prismatic"
        unit = 1.0 if slides else degrees(1.0)
        joint.CreateAxisAttr("X")
        if link.kind != "continuous":
            joint.CreateLowerLimitAttr(unit * link.limits[0])
            joint.CreateUpperLimitAttr(unit * link.limits[1])
        prim = joint.GetPrim()
        prim.AddAppliedSchema("PhysxJointAPI")
        prim.CreateAttribute("physxJoint:armature", Sdf.ValueTypeNames.Float, True).Set(link.armature)
        if (speed := self.grasps.speed_limits.get(link.joint)) is not None:
            prim.CreateAttribute("physxJoint:maxJointVelocity", Sdf.ValueTypeNames.Float, True).Set(unit * speed)
        if link.stiffness or link.damping:
            drive = UsdPhysics.DriveAPI.Apply(prim, "linear" if slides else "angular")
            drive.CreateTypeAttr("force")
            drive.CreateStiffnessAttr(link.stiffness / unit)
            drive.CreateDampingAttr(link.damping / unit)
            drive.CreateTargetPositionAttr(unit * self._joints(0, 0).get(link.joint, 0.0))
            if isfinite(link.force_limit):
                drive.CreateMaxForceAttr(link.force_limit)
        if link.leader is not None:
            leader, multiplier, offset = link.leader
            axis = "transX" if slides else "rotX"
            prim.AddAppliedSchema(f"PhysxMimicJointAPI:{axis}")
            name = f"physxMimicJoint:{axis}"
            prim.CreateAttribute(f"{name}:gearing", Sdf.ValueTypeNames.Float, True).Set(-multiplier)
            prim.CreateAttribute(f"{name}:offset", Sdf.ValueTypeNames.Float, True).Set(-unit * offset)
            prim.CreateRelationship(f"{name}:referenceJoint", True).SetTargets(
                [Sdf.Path(f"{HAND}/joints/{labels[leader]}")]
            )

    def _add_visual(self, stage: Any) -> None:
        from pxr import Gf

        mesh = self.grasps.object.mesh
        shown = _mesh(stage, f"{OBJECT}/visual", np.asarray(mesh.vertices), np.asarray(mesh.faces))
        shown.CreateDisplayColorAttr([Gf.Vec3f(0.6, 0.7, 0.8)])

    def _add_grasps(self, stage: Any) -> None:
        from pxr import Sdf, UsdGeom, Vt

        types, grasps = Sdf.ValueTypeNames, self.grasps
        UsdGeom.Scope.Define(stage, GRASPS)
        for row in range(len(grasps)):
            prim = UsdGeom.Scope.Define(stage, f"{GRASPS}/grasp_{row}").GetPrim()
            prim.CreateAttribute("joints", types.StringArray, True).Set(Vt.StringArray(list(self.world.hand.joints)))
            for at, name in enumerate(STAGES):
                root = self.course.root(*ENDS[name])[row].tolist()
                prim.CreateAttribute(f"{name}:pose", types.DoubleArray, True).Set(Vt.DoubleArray(root))
                values = list(self._joints(row, at).values())
                prim.CreateAttribute(f"{name}:positions", types.DoubleArray, True).Set(Vt.DoubleArray(values))


def _place(body: Any, T: Float[np.ndarray, "4 4"]) -> None:
    from pxr import Gf

    body.AddTranslateOp().Set(Gf.Vec3d(*T[:3, 3].tolist()))
    body.AddOrientOp().Set(_quaternion(T[:3, :3]))


def _mesh(stage: Any, path: str, vertices: np.ndarray, faces: np.ndarray) -> Any:
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    points = np.ascontiguousarray(vertices, dtype=np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(np.ravel(faces).tolist()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


def _prim_names(names: list[str]) -> dict[str, str]:
    """Return valid and distinct names of prims: letters, digits and underscores, none of them first a digit."""
    from pxr import Tf

    made: dict[str, str] = {}
    for name in names:
        valid, number = Tf.MakeValidIdentifier(name), 1
        while valid in made.values():
            number += 1
            valid = f"{Tf.MakeValidIdentifier(name)}_{number}"
        made[name] = valid
    return made


def _vector(values: Any) -> Any:
    from pxr import Gf

    return Gf.Vec3f(*(float(value) for value in values))


def _quaternion(R: np.ndarray) -> Any:
    from pxr import Gf

    w, x, y, z = quaternion_from_matrix(R).tolist()
    return Gf.Quatf(w, x, y, z)
