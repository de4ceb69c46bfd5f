"""Hands with all kinds of geoms, joints, servos and ties, for engines that translate MuJoCo's model."""

import re

import mujoco
import numpy as np

from grasp_refine.core.se3 import exp_se3, pose_from_transform
from grasp_refine.hands.files.defaults import Actuator
from grasp_refine.validation.engines.mujoco.hand_model import HandModel

MESH = '<asset><mesh name="wedge" vertex="0 0 0  0.04 0 0  0 0.03 0  0 0 0.03  0.02 0.02 0.02"/></asset>'
TREE = """<body name="palm"><inertial pos="0 0 0" mass="1e4" diaginertia="1e3 1e3 1e3"/>
  <geom name="palm" type="box" size="0.02 0.03 0.01"/>
  <body name="mount" pos="0.03 0.01 0.02" euler="20 30 40"><geom type="mesh" mesh="wedge" mass="0.02" pos="0 0.01 0"/>
    <body name="first" pos="0.01 0.02 0.1" euler="10 -20 30">
      <joint name="turn" axis="1 2 0.5" pos="0.01 0 -0.01" ref="20" stiffness="0.3" springref="50" damping="0.004"
        armature="2e-5"/>
      <geom name="capsule" type="capsule" size="0.008" fromto="0.01 0 0 0.05 0.01 0" mass="0.03"/>
      <body name="cap" pos="0.06 0.01 0" euler="0 60 0"><geom type="ellipsoid" size=".01 .02 .015"/>
        <inertial pos="0.01 0 0" mass="0.02" diaginertia="6e-5 5.5e-5 1e-5"/></body>
      <body name="second" pos="0.05 0 0.01">
        <joint name="push" type="slide" axis="0 1 1" ref="0.004" damping="0.5" armature="0.01" stiffness="40"/>
        <joint name="bend" axis="0 1 0" pos="0 0 0.01" damping="0.002" armature="{armature}"/>
        <geom type="cylinder" size="0.01 0.02" pos="0.02 0 0.01" euler="70 0 0" mass="0.03"/>
        <body name="tip" pos="0.04 0 0.02"><geom type="sphere" size="0.012" mass="0.01"/></body>
      </body></body></body>
  <body name="other" pos="-0.08 0 0.05"><joint name="other" axis="0 0 1" damping="0.002" armature="{armature}" {most}/>
    <geom name="other" type="box" size="0.01 0.01 0.03" pos="0.02 0.01 0" mass="0.03"/></body></body>"""
"""A hand with all kinds of geoms, welded bodies, two joints of one body, and reference positions; degrees."""

TENDON = """<tendon><fixed name="sum" stiffness="{force}" springlength="0.3" damping="0.1" actuatorfrcrange="-12 12">
  <joint joint="bend" coef="-0.7"/><joint joint="other" coef="1.5"/></fixed></tendon>"""
SERVOS = """<actuator>
    <position joint="turn" kp="0.2" kv="0.002" gear="-3" ctrlrange="-1 0.7"/>
    <position joint="turn" kp="5" gear="0.5" forcerange="-0.3 0.3"/>
    <position joint="push" kp="150" kv="1" gear="2"/>
    <position {on} kp="{kp}" gear="-2" forcerange="-{force} {force}"/>
    <position joint="other" kp="0.3"/>
  </actuator>"""
JOINTS = ("other", "bend", "turn", "push")


def rich(*, tendon: bool = False) -> HandModel:
    """The hand, its joints in another order than in the tree; with a tendon so heavy that its chain weighs little."""
    armature, on, force = (0.02, 'tendon="sum"', 20.0) if tendon else (2e-5, 'joint="bend"', 0.05)
    tree = TREE.format(armature=armature, most="" if tendon else 'actuatorfrcrange="-0.1 0.1"')
    servos = SERVOS.format(on=on, kp=10 * force, force=force)
    return model(tree, JOINTS, MESH, TENDON.format(force=force) * tendon, servos)


def unlimited() -> HandModel:
    """The hand with all kinds of joints, whose servos have no limits of force."""
    tree = TREE.format(armature=2e-5, most="")
    servos = re.sub(r'forcerange="[^"]*"', "", SERVOS.format(on='joint="bend"', kp=0.5, force=0.0))
    return model(tree, JOINTS, MESH, servos)


def model(tree: str, joints: tuple[str, ...], *others: str) -> HandModel:
    """Return a hand of a tree of bodies, with one value for each joint."""
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{tree}</worldbody>{''.join(others)}</mujoco>")
    names, m = {body.name: body.name for body in spec.bodies[1:]}, len(joints)
    return HandModel(spec, "palm", np.eye(4), joints, np.eye(m), np.zeros(m), names, (), Actuator(*np.zeros((5, m))))


def random_poses(count: int, seed: int) -> np.ndarray:
    return pose_from_transform(exp_se3(np.random.default_rng(seed).normal(size=(count, 6)) * [0.1, 0.1, 0.1, 1, 1, 1]))


TIED = """<body name="palm"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
  <body name="left"><joint name="left" axis="0 1 0" damping="0.05" ref="-20"/><geom size="0.01" pos="0 0 0.02"/>
    <body name="bar" pos="0 0 0.05"><joint name="bar" axis="0 1 0" damping="0.01"/><geom size="0.005"/></body></body>
  <body name="right" pos="0.04 0 0"><joint name="right" axis="0 1 0" damping="0.05" {more}/><geom size="0.01"/>
    <body name="end" pos="0.01 0.02 0.05" euler="0 30 60"><geom size="0.004"/></body></body>
  <body name="twin" pos="0 0.04 0" euler="0 30 0"><joint name="twin" axis="0 1 0" damping="0.01"/>
    <geom size="0.01" pos="0 0 0.02"/></body>
  <body name="follower" pos="0 -0.05 0"><joint name="follower" axis="0 1 0" ref="10" damping="0.01"/>
    <geom size="0.01" pos="0 0 0.02"/></body></body>"""
LEFT = '<actuator><position joint="left" kp="20"/></actuator>'
TIES = f"""<contact><exclude body1="left" body2="bar"/><exclude body1="bar" body2="right"/></contact>
  <equality><connect body1="bar" body2="end" anchor="0.04 0 0"/><weld body1="left" body2="twin"/>
    <joint joint1="follower" joint2="left" polycoef="0.1 0.5"/>
    <joint joint1="twin" polycoef="1" active="false"/></equality>{LEFT}"""
NAMES = ("left", "bar", "right", "twin", "follower")
