"""A parallel gripper for MuJoCo whose normal force is known: two plates that slide together."""

import mujoco
import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.files.defaults import Actuator
from grasp_refine.objects.object import Object, load_object
from grasp_refine.validation.engines.mujoco.hand_model import HandModel

KP = 500.0
RADIUS = 0.03

XML = """
<mujoco>
  <worldbody>
    <body name="palm">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <body name="left" pos="0 0 0.1">
        <joint name="left" type="slide" axis="1 0 0" damping="5"/>
        <geom type="box" size="0.005 0.04 0.04" pos="-0.005 0 0" mass="0.05"/>
      </body>
      <body name="right" pos="0 0 0.1">
        <joint name="right" type="slide" axis="1 0 0" damping="5"/>
        <geom type="box" size="0.005 0.04 0.04" pos="0.005 0 0" mass="0.05"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="left" kp="{kp}"/>
    <position joint="right" kp="{kp}"/>
  </actuator>
</mujoco>
"""


def gripper(kp: float = KP) -> HandModel:
    """The gripper: one value, the opening between the plates."""
    return HandModel(
        spec=mujoco.MjSpec.from_string(XML.format(kp=kp)),
        root="palm",
        T_base_root=np.eye(4),
        joints=("left", "right"),
        matrix=np.array([[-0.5], [0.5]]),
        offset=np.zeros(2),
        links={"palm": "palm", "left": "left plate", "right": "right plate"},
        notes=(),
        actuator=Actuator(*(np.array([value]) for value in (kp / 2, np.inf, 5.0, 0.0, 0.0))),
    )


def weighing(kilograms: float) -> HandModel:
    """The gripper with another mass, 80 % of it in the palm; rotors of 0.1 kg keep the plates as fast."""
    made = gripper()
    palm = made.spec.body("palm")
    palm.mass, palm.inertia = 0.8 * kilograms, 0.008 * kilograms * np.ones(3)
    for geom, joint in zip(made.spec.geoms, made.spec.joints, strict=True):
        geom.mass, joint.armature = 0.1 * kilograms, 0.1
    return made


def ball(radius: float = RADIUS) -> Object:
    return load_object(f"sphere:{radius}", unit="m", candidates=16)


def two_balls(first: tuple[float, float] = (0.02, -0.02), second: tuple[float, float] = (0.02, 0.02)) -> Object:
    """Two balls that touch, so that there are several pieces; of each its radius, and its place along y."""
    mesh = load_object(f"sphere:{RADIUS}", candidates=16).mesh
    none = np.zeros((0, 3), dtype=int)
    pieces = [Piece(np.array([[0.0, y, 0.0]]), none, radius) for radius, y in (first, second)]
    return Object("two balls", mesh, convex=False, supplied=tuple(pieces), candidates=16)


def lifted(motion: Motion, height: float = 0.015, y: float = 0.0) -> Motion:
    """The hand higher, so that the plates, which reach 4 cm down, stay above the table of a ball of 3 cm; and aside."""
    T = motion.T_world_root.copy()
    T[..., 1:3, 3] += y, height
    return Motion(T, motion.q)


def around(force: float, *, count: int = 1, opening: float = 2 * RADIUS + 0.01, grasp: float = 2 * RADIUS) -> Motion:
    """Closing on a ball at the origin from `opening` over `grasp` until each plate presses with `force` (newtons)."""
    T = np.tile(np.eye(4), (count, 3, 1, 1))
    T[..., 2, 3] = -0.1
    q = np.tile(np.array([[opening], [grasp], [2 * RADIUS - 2 * force / KP]]), (count, 1, 1))
    return Motion(T, q)
