"""A gripper of two four-bar linkages, closed by connect equalities, that one actuator drives; an MJCF of our own."""

from pathlib import Path

import numpy as np

DRIVER_M, INNER_M, FINGER_M = (0.025, 0.0433), (0.025, 0.0453), 0.02
"""Vectors (x, z) of the outer and the inner bar while the gripper is open, and distance of their ends, metres."""

PIVOTS_M = ((0.035, 0.05), (0.015, 0.048))
"""Pivots (x, z) of both bars on the palm, metres."""


def _side(name: str, sign: int) -> str:
    x, z = DRIVER_M
    u, w = INNER_M
    (bx, bz), (ax, az) = PIVOTS_M
    joint = f'axis="0 {-sign} 0"'
    return f"""
      <body name="{name}_driver" pos="{sign * bx} 0 {bz}">
        <joint name="{name}_driver_joint" {joint} range="0 0.9" armature="0.002" damping="0.1"/>
        <geom type="capsule" size="0.003" fromto="0 0 0 {sign * x} 0 {z}" mass="0.01"/>
        <body name="{name}_finger" pos="{sign * x} 0 {z}">
          <joint name="{name}_finger_joint" {joint} range="-1.6 1.6"/>
          <geom name="{name}_pad" type="box" pos="{-sign * 0.01} 0 0.03" size="0.005 0.012 0.025" mass="0.02"/>
        </body>
      </body>
      <body name="{name}_inner" pos="{sign * ax} 0 {az}">
        <joint name="{name}_inner_joint" {joint} range="-1.6 1.6"/>
        <geom type="capsule" size="0.003" fromto="0 0 0 {sign * u} 0 {w}" mass="0.01"/>
      </body>"""


STIFF = 'solref="0.005 1" solimp="0.99 0.999 0.001"'
"""Parameters of equalities that hardly give way."""

XML = f"""<mujoco model="linkage_gripper">
  <compiler angle="radian"/>
  <worldbody>
    <body name="palm">
      <geom type="box" pos="0 0 0.02" size="0.045 0.02 0.02" mass="0.4"/>{_side("right", 1)}{_side("left", -1)}
    </body>
  </worldbody>
  <contact>
    <exclude body1="palm" body2="right_driver"/><exclude body1="palm" body2="left_driver"/>
    <exclude body1="palm" body2="right_inner"/><exclude body1="palm" body2="left_inner"/>
    <exclude body1="right_finger" body2="right_inner"/><exclude body1="left_finger" body2="left_inner"/>
    <exclude body1="right_driver" body2="right_inner"/><exclude body1="left_driver" body2="left_inner"/>
  </contact>
  <tendon>
    <fixed name="split">
      <joint joint="right_driver_joint" coef="0.5"/><joint joint="left_driver_joint" coef="0.5"/>
    </fixed>
  </tendon>
  <equality>
    <connect body1="right_inner" body2="right_finger" anchor="{INNER_M[0]} 0 {INNER_M[1]}" {STIFF}/>
    <connect body1="left_inner" body2="left_finger" anchor="{-INNER_M[0]} 0 {INNER_M[1]}" {STIFF}/>
    <joint joint1="left_driver_joint" joint2="right_driver_joint" {STIFF}/>
  </equality>
  <actuator>
    <general name="close" tendon="split" biastype="affine" gainprm="0.176470588" biasprm="0 -50 -2" ctrlrange="0 255"
      forcerange="-5 5"/>
  </actuator>
</mujoco>"""
"""Its passive joints have no equality of their own; the control of its servo goes from 0 to 255, which is 0.9 rad."""


def write_gripper(folder: Path) -> Path:
    """The file in a folder."""
    path = folder / "linkage.xml"
    path.write_text(XML)
    return path


def passive_angles(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a finger joint and of an inner joint at values of the driven one, by the law of cosines.

    Positive values turn z towards -x, on the right side.
    """
    (x, z), (u, w) = DRIVER_M, INNER_M
    (bx, bz), (ax, az) = PIVOTS_M

    def turned(vector: tuple[float, float], angle: np.ndarray) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]], axis=-1)

    end = np.array([bx, bz]) + turned((x, z), q)
    line = end - np.array([ax, az])
    d, bar = np.linalg.norm(line, axis=-1), np.hypot(u, w)
    # The end of the inner bar is FINGER_M from `end`, to the left of the line from the pivot.
    cosine = (d**2 + bar**2 - FINGER_M**2) / (2 * d * bar)
    inner = np.arctan2(line[..., 1], line[..., 0]) + np.arccos(cosine)
    tip = np.array([ax, az]) + bar * np.stack([np.cos(inner), np.sin(inner)], axis=-1)
    to_tip = np.arctan2(*(tip - end)[..., ::-1].T)
    finger = np.mod(to_tip, 2 * np.pi) - np.pi - q
    return finger, inner - np.arctan2(w, u)
