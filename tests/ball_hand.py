"""A gripper of three balls around a ball, among balls: poses, distances and overlaps are known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import transform
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece, sphere
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import link, links, made_hand, slide, solid

PALM, TIP, BALL, AHEAD, WIDEST = 0.02, 0.01, 0.03, 0.06, 0.09
"""Radii of palm, fingertips and object, distance of the tips from the palm, and largest joint value, metres."""

FROM_ABOVE = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, AHEAD]))
"""Pose of the palm with the tips beside the origin: they slide along -y and y."""


def ball_hand(folder: Path, *more: str, velocity: float | None = 1.0) -> Hand:
    """Return the gripper, with further links and joints: two tips that slide apart, each on its own."""
    opens = {"limits": (0, WIDEST), "velocity": velocity, "at": (0, 0, AHEAD)}
    return made_hand(
        folder,
        link("palm", solid(f"sphere {PALM}")) + links("left", "right", inside=solid(f"sphere {TIP}")),
        slide("l", "palm", "left", axis=(0, 1, 0), **opens) + slide("r", "palm", "right", axis=(0, -1, 0), **opens),
        *more,
        name="balls",
    )


def balls(*places: tuple[float, float, float, float]) -> list[Piece]:
    """Return balls of x, y, z and radius in metres."""
    return [sphere(radius).transformed(transform(np.eye(3), np.array(place))) for *place, radius in places]


def body(name: str, *places: tuple[float, float, float, float]) -> EnvironmentBody:
    """Return a body of balls, where the world is the frame of the object."""
    return EnvironmentBody(name, build_body(name, balls(*places), candidates=16), np.eye(4))


def thing(*more: tuple[float, float, float, float]) -> Object:
    """Return the ball at the origin, with further balls."""
    return load_object(f"sphere:{BALL}", candidates=16).with_body(
        build_body("thing", balls((0.0, 0.0, 0.0, BALL), *more), candidates=16)
    )


def grasp(
    hand: Hand, *bodies: EnvironmentBody, stages: tuple[float, float, float] = (0.055, 0.04, 0.035), **task: object
) -> tuple[Scene, Motion]:
    """Return the grasp of the ball from above, and its motion, by the joint value of both tips at each stage.

    A `thing` and what else a `Task` has may be given; in the world the object's frame is turned by `turn` (4, 4).
    """
    obj, turn = task.pop("thing", None) or thing(), np.asarray(task.pop("turn", np.eye(4)))
    q = np.zeros((3, len(hand.joint_names)))
    q[:, :2] = np.array(stages)[:, None]
    moved = [EnvironmentBody(one.name, one.body, turn @ one.T_world_body) for one in bodies]
    around = Environment(tuple(moved), turn) if bodies else None
    scene = Scene(hand, obj, FROM_ABOVE, q[1], task=Task(scene=around, **task))
    return scene, Motion(np.tile(FROM_ABOVE, (1, 3, 1, 1)), q[None])
