"""FRoGGeR: one pickle per object, with the grasps of an Allegro hand on a Franka Research 3; read, not written.

`q_stars` (N, 23) are the joints of the arm, followed by the joints of the hand, whose base stands in the world's
origin; `obj_settings` has the object's name and its pose `X_WO` in the world; its mesh is in metres. `pick_success`
(N,) is 1 or 0, NaN where it was not tried.

Its arm is the maker's arm, but the zero of the sixth joint is a quarter turn off. Computed with it, poses of 140
published grasps agree within 1e-7 m with FRoGGeR's model.

Source: github.com/alberthli/frogger, models/fr3_algr/fr3_algr_rh.sdf; for the arm, the Denavit-Hartenberg parameters of
the Franka Research 3 in Franka Robotics' documentation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import inverse, pose_from_transform
from grasp_refine.grasps.formats.format import SUCCESS, Format
from grasp_refine.grasps.formats.layout import ALLEGRO, Layout, check_hand
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

LAYOUT = Layout("allegro", "base_link", ALLEGRO)
MODEL = "fr3_arm_algr_rh"
"""Name of the only model that published files have."""
ARM = (
    (0.0, 0.333, 0.0, 0.0),
    (0.0, 0.0, -90.0, 0.0),
    (0.0, 0.316, 90.0, 0.0),
    (0.0825, 0.0, 90.0, 0.0),
    (-0.0825, 0.384, -90.0, 0.0),
    (0.0, 0.0, 90.0, 90.0),
    (0.088, 0.0, 90.0, 0.0),
)
"""Of each joint of the arm: a and d (metres), alpha and the zero of theta (degrees), modified Denavit-Hartenberg."""
MOUNT = (0.0, 0.0, 0.215, 0.0, 0.0, -45.0)
"""Pose of the hand's base link in the last link of the arm: x y z (metres), roll pitch yaw (degrees)."""


@dataclass(frozen=True)
class Frogger(Format):
    """Pickles of the folders data/OBJECT."""

    name: str = "frogger"
    what: str = "FRoGGeR: one pickle per object, an Allegro on an arm; read only"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, ("q_stars", "obj_settings", "model_settings"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        check_hand(source, LAYOUT, hand)
        model, obj = source.content["model_settings"], source.content["obj_settings"]
        for settings, keys in ((model, ("name",)), (obj, ("name", "X_WO"))):
            lacking = missing_keys(settings, keys)
            if lacking:
                raise source.error(f"of its settings, {lacking}")
        if model["name"] != MODEL:
            raise source.error(f"is of the model {source.text(model['name'], 'name of the model')!r}; {MODEL} is read")
        q = source.numbers(source.content["q_stars"], "q_stars", (None, len(ARM) + len(ALLEGRO)))
        T_world_object = np.eye(4)
        T_world_object[:3] = source.numbers(obj["X_WO"], "X_WO", (3, 4))
        T_object_world = inverse(source.transforms(T_world_object[None], "X_WO")[0])
        tried = source.content.get("pick_success")
        labels = {} if tried is None else {SUCCESS: _success(source, tried, len(q))}
        poses = pose_from_transform(T_object_world @ hand_transforms(q[:, : len(ARM)]))
        name = source.object_name(obj["name"], "name of the object")
        grasps = LAYOUT.grasps(hand, poses, q[:, len(ARM) :], object=name, labels=labels)
        return grasps, ["the joints of the arm give the poses of the hand, and are left out"]


def _success(source: Source, value: Any, count: int) -> np.ndarray:
    """Return results of trials (N,) as 1 or 0."""
    values = np.asarray(value)
    return source.numbers(values.astype(float) if values.dtype == bool else values, "pick_success", (count,))


def hand_transforms(q: Float[np.ndarray, "N 7"]) -> Float[np.ndarray, "N 4 4"]:
    """Transforms of the hand's base link in the world (N, 4, 4), with the joints of the arm (N, 7) in radians."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (a, d, alpha, zero), angle in zip(ARM, q.T, strict=True):
        cos, sin = np.cos(angle + np.radians(zero)), np.sin(angle + np.radians(zero))
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cos, -sin, sin, cos
        turn[:, 2, 3] = d
        T = T @ transform_from_rpy([a, 0.0, 0.0, alpha, 0.0, 0.0]) @ turn
    return T @ transform_from_rpy(list(MOUNT))
