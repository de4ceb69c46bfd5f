"""A gripper whose fingers adapt: five-bar linkages, each with a joint more than it closes, which a spring holds."""

from pathlib import Path

SPRING_NM_PER_RAD, SPRING_RAD = 0.05, 2.6
"""Stiffness of the spring of each finger, and angle from which it pulls, in rad."""

PIVOT_M, COUPLER_M, BAR_M = (0.01, 0.03), (0.06, 0.03), (0.03, 0.05)
"""Pivot (x, z) of the inner bar, that of the coupler while the gripper is open, and the inner bar, metres."""


def _finger(name: str, turn: str, spring: float) -> str:
    (x, z), (u, w) = PIVOT_M, BAR_M
    sign = 1 if name == "right" else -1
    return f"""
      <body name="{name}_driver" pos="{sign * 0.03} 0 0.03" {turn}>
        <joint name="{name}_driver" range="0 0.5" armature="0.002" damping="0.1"/>
        <geom type="box" pos="0.015 0 0" size="0.012 0.004 0.003" mass="0.01"/>
        <body name="{name}_coupler" pos="0.03 0 0">
          <joint name="{name}_coupler" range="0 1.5"/>
          <geom type="capsule" size="0.003" fromto="0 0 0.005 0 0 0.045" mass="0.02"/>
        </body>
      </body>
      <body name="{name}_bar" pos="{sign * x} 0 {z}" {turn}>
        <joint name="{name}_bar" range="-1 0.6" stiffness="{spring}" springref="{-SPRING_RAD}" damping="0.001"/>
        <geom type="capsule" size="0.003" fromto="0.003 0 0.005 {u - 0.003} 0 {w - 0.005}" mass="0.02"/>
        <body name="{name}_finger" pos="{u} 0 {w}">
          <joint name="{name}_finger" range="-1 1" damping="0.001"/>
          <geom type="box" pos="0.004 0 0.004" size="0.004 0.006 0.004" mass="0.02"/>
          <body name="{name}_pad" pos="0 0 0.03">
            <geom type="box" size="0.004 0.012 0.022" mass="0.03" solref="0.004 1" solimp="0.95 0.99 0.001"
              priority="1"/>
          </body>
        </body>
      </body>"""


def adaptive_gripper(spring: float = SPRING_NM_PER_RAD, solref: str = "0.005 1") -> str:
    """Return the MJCF; `solref` is that of the equalities that close the chains."""
    mirrored = 'quat="0 0 0 1"'
    return f"""<mujoco model="adaptive_gripper">
  <compiler angle="radian"/>
  <default><joint axis="0 -1 0"/><equality solref="{solref}" solimp="0.98 0.995 0.001"/></default>
  <worldbody>
    <body name="palm">
      <geom type="box" pos="0 0 0.012" size="0.05 0.02 0.012" mass="0.4"/>{_finger("right", "", spring)}{
        _finger("left", mirrored, spring)
    }
    </body>
  </worldbody>
  <contact>
    <exclude body1="palm" body2="right_driver"/><exclude body1="palm" body2="left_driver"/>
    <exclude body1="palm" body2="right_bar"/><exclude body1="palm" body2="left_bar"/>
    <exclude body1="right_finger" body2="right_coupler"/><exclude body1="left_finger" body2="left_coupler"/>
    <exclude body1="right_driver" body2="right_bar"/><exclude body1="left_driver" body2="left_bar"/>
    <exclude body1="right_coupler" body2="right_bar"/><exclude body1="left_coupler" body2="left_bar"/>
  </contact>
  <tendon>
    <fixed name="split"><joint joint="right_driver" coef="0.5"/><joint joint="left_driver" coef="0.5"/></fixed>
  </tendon>
  <equality>
    <connect body1="right_finger" body2="right_coupler" anchor="0.02 0 0"/>
    <connect body1="left_finger" body2="left_coupler" anchor="0.02 0 0"/>
    <joint joint1="left_driver" joint2="right_driver"/>
  </equality>
  <actuator><position name="close" tendon="split" kp="100" kv="4" ctrlrange="0 0.5" forcerange="-10 10"/></actuator>
</mujoco>"""


def write_adaptive_gripper(folder: Path, **settings: float | str) -> Path:
    """Write the file to a folder; settings are those of `adaptive_gripper`."""
    path = folder / "adaptive_gripper.xml"
    path.write_text(adaptive_gripper(**settings))  # type: ignore[arg-type]
    return path
