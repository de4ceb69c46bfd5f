"""Simulate the grasps of this folder in Drake: the hand closes, then the object is pushed, or lifted."""

import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, HalfSpace, ProximityProperties, SceneGraphConfig
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    ExternallyAppliedSpatialForce,
)
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

Task = dict[str, np.ndarray]
"""Arrays of task.npz."""

ROOT_INERTIA = np.repeat([100.0, 10.0], 3)
"""Inertia that is added to the joints of the root, which conditions their stiff drives."""


def main(folder: Path) -> int:
    """Print whether each grasp holds the object; return 0 if all do."""
    task = dict(np.load(folder / "task.npz", allow_pickle=False))
    world = World(folder, task)
    held = [world.holds(grasp) for grasp in range(len(task["start"]))]
    for grasp, success in enumerate(held):
        print(f"grasp {grasp}: {'held' if success else 'lost'}")
    print(f"{sum(held)} of {len(held)} held")
    return 0 if all(held) else 1


class World:
    """Hand and object in Drake."""

    def __init__(self, folder: Path, task: Task) -> None:
        """Load hand and object."""
        self.task = task
        builder = DiagramBuilder()
        self.plant, scene = AddMultibodyPlantSceneGraph(builder, float(task["timestep"]))
        plant, friction = self.plant, float(task["friction"])
        config = SceneGraphConfig()
        config.default_proximity_properties.static_friction = friction
        config.default_proximity_properties.dynamic_friction = friction
        scene.set_config(config)
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        plant.set_stiction_tolerance(1e-4)
        plant.set_sap_near_rigid_threshold(0.1)
        plant.SetUseSampledOutputPorts(False)
        (self.hand,) = Parser(plant).AddModels(str(folder / "hand.urdf"))
        (thing,) = Parser(plant).AddModels(str(folder / "object.urdf"))
        self.object = plant.GetBodyByName("object", thing)
        self._start = plant.AddFrame(FixedOffsetFrame("start", plant.world_frame(), RigidTransform(), self.hand))
        plant.WeldFrames(self._start, plant.GetFrameByName("hand_start", self.hand))
        plant.set_gravity_enabled(self.hand, False)
        plant.mutable_gravity_field().set_gravity_vector(task["gravity"])
        numbers = zip(task["joints"], task["stiffness"], task["damping"], task["force_limit"], strict=True)
        inertia = np.concatenate([ROOT_INERTIA, task["armature"][6:]])
        self._joints = []
        for (name, stiffness, damping, limit), armature in zip(numbers, inertia, strict=True):
            joint = plant.GetJointByName(str(name), self.hand)
            actuator = plant.AddJointActuator(str(name), joint, limit if limit < 1e30 else np.inf)
            actuator.set_controller_gains(PdControllerGains(p=stiffness, d=damping))
            actuator.set_default_gear_ratio(1.0)
            actuator.set_default_rotor_inertia(armature)
            self._joints.append(joint)
        normal, offset = task["table"][:3], float(task["table"][3])
        if not np.isnan(offset):
            surface = ProximityProperties()
            surface.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
            X = HalfSpace.MakePose(normal, offset * normal)
            plant.RegisterCollisionGeometry(plant.world_body(), X, HalfSpace(), "table", surface)
        plant.Finalize()
        manager = scene.collision_filter_manager()
        for pair in ET.parse(folder / "hand.srdf").iterfind("disable_collisions"):
            bodies = [plant.GetBodyByName(pair.get(side), self.hand) for side in ("link1", "link2")]
            parts = [GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in bodies]
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(*parts))
        self.diagram = builder.Build()

    def holds(self, grasp: int) -> bool:
        """Return whether a grasp holds the object in as many pushes as it must, or while it is lifted."""
        task, plant = self.task, self.plant
        self.simulator = Simulator(self.diagram)
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        start = task["start"][grasp]
        pose = RigidTransform(RotationMatrix(Quaternion(start[3:] / np.linalg.norm(start[3:]))), start[:3])
        self._start.SetPoseInParentFrame(self.context, pose)
        positions = plant.GetPositions(self.context).copy()
        positions[[joint.position_start() for joint in self._joints]] = task["close"][grasp, 0]
        plant.SetPositions(self.context, positions)
        self._push(np.zeros(3))
        for row in task["close"][grasp, 1:]:
            self._follow(row, int(task["steps"]))
        if self._is_lost(np.zeros(3)):
            return False
        if not len(task["push"]):
            return self._lifts(grasp)
        closed, held = plant.GetPositionsAndVelocities(self.context).copy(), 0
        for force in task["push"]:
            plant.SetPositionsAndVelocities(self.context, closed)
            self.simulator.Initialize()
            self._push(force)
            held += self._bears(grasp)
        return held >= int(task["required"])

    def _bears(self, grasp: int) -> bool:
        for _ in range(int(self.task["checks"])):
            self._follow(self.task["close"][grasp, -1], int(self.task["push_steps"]))
            if self._is_lost(np.zeros(3)):
                return False
        return True

    def _lifts(self, grasp: int) -> bool:
        rows = self.task["lift"][grasp]
        parts = len(rows) // int(self.task["checks"])
        for number, row in enumerate(rows, start=1):
            self._follow(row, int(self.task["push_steps"]) // parts)
            rise = float(self.task["lift_height"]) * number / len(rows) * self.task["up"]
            if number % parts == 0 and self._is_lost(rise):
                return False
        return True

    def _push(self, force: np.ndarray) -> None:
        """Push the object at its centre of mass."""
        push = ExternallyAppliedSpatialForce()
        push.body_index = self.object.index()
        push.p_BoBq_B = self.object.CalcCenterOfMassInBodyFrame(self.context)
        push.F_Bq_W = SpatialForce(np.zeros(3), force)
        port = self.plant.get_applied_spatial_force_input_port()
        port.FixValue(self.context, Value[list[ExternallyAppliedSpatialForce]]([push]))

    def _follow(self, targets: np.ndarray, steps: int) -> None:
        port = self.plant.get_desired_state_input_port(self.hand)
        port.FixValue(self.context, np.concatenate([targets, np.zeros(len(targets))]))
        end = self.simulator.get_context().get_time() + steps * float(self.task["timestep"])
        self.simulator.AdvanceTo(end)

    def _is_lost(self, rise: np.ndarray) -> bool:
        X = self.object.EvalPoseInWorld(self.context)
        moved, turned = np.linalg.norm(X.translation() - rise), abs(X.rotation().ToAngleAxis().angle())
        return not (moved < self.task["farthest"] and turned < self.task["steepest"])


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parent))
