"""Film of a hand and an object for animations: frames with captions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, UInt8

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.camera import FirstCamera, first_camera_of
from grasp_refine_apps.viewer.colors import distance_colors
from grasp_refine_apps.viewer.contacts import contacts_of
from grasp_refine_apps.viewer.glyphs import segments
from grasp_refine_apps.viewer.pose import Pose, Target
from grasp_refine_apps.viewer.shapes import LinkPoses, Shape, object_shapes, visual_shapes
from grasp_refine_apps.viewer.shown_motion import ShownMotion
from grasp_refine_apps.viewer.state import State
from grasp_refine_apps.viewer.trace import Trace

MAX_FRAMES = 200
"""Maximum number of frames of a film."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a film."""

    pose: Pose
    """Pose of the hand."""
    caption: str
    """Caption of the frame."""
    lines: Float[np.ndarray, "N 2 3"] = field(default_factory=lambda: np.zeros((0, 2, 3)))
    """Line segments (N, 2, 3), metres."""
    colors: UInt8[np.ndarray, "N 3"] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.uint8))
    """Colours of the segments (N, 3), 0 to 255."""
    T_object: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose of the object (4, 4)."""


@dataclass(frozen=True, eq=False)
class Film:
    """At least one frame of a hand and an object; all in the initial frame of the object, metres."""

    title: str
    """Title."""
    hand: Sequence[Shape]
    """Shapes of the links."""
    poses: LinkPoses
    """Kinematics of the links."""
    object: Sequence[Shape]
    """Shapes of the object."""
    frames: Sequence[Frame]
    """Frames, evenly spaced in time."""
    camera: FirstCamera
    """Initial camera."""


def film_of(state: State) -> Film:
    """Return the film of a state: of the shown simulation, else of the last refinement.

    Raises:
        GraspRefineError: there is neither.
    """
    scene = state.scene
    if state.motion is not None:
        return motion_film(scene.hand, scene.object, state.motion)
    if state.trace is not None:
        return refinement_film(scene.hand, scene.object, state.trace, state.targets)
    raise GraspRefineError("there is nothing to animate yet: refine the grasp, or watch a simulation, first")


def refinement_film(hand: Hand, obj: Object, trace: Trace, targets: Sequence[Target] = ()) -> Film:
    """Return the film of at most `MAX_FRAMES` iterations of a refinement, with lines where links and object touch."""
    prepared = HandObject(hand, obj)
    frames, found = [], None
    for k in subsample(len(trace)):
        pose = trace.pose(k)
        found = contacts_of(prepared, pose.T_object_root, pose.q, touching=trace.touching[k], targets=targets)
        caption = (
            f"{trace.label[k]}: iteration {k + 1} of {len(trace)}\n"
            f"contact error {1e3 * trace.contact_error[k]:.2f} mm, penetration {1e3 * trace.penetration[k]:.2f} mm"
        )
        lines = segments(found.point_link, found.point_object)
        frames.append(Frame(pose, caption, lines.astype(float), distance_colors(found.distance)))
    assert found is not None, "a trace has an iteration"
    title = f"{hand.name} and {obj.name}: refinement"
    return Film(
        title, visual_shapes(hand), LinkPoses.of(hand), object_shapes(obj, "mesh"), frames, first_camera_of(found)
    )


def motion_film(hand: Hand, obj: Object, motion: ShownMotion) -> Film:
    """Return the film of at most `MAX_FRAMES` frames of a simulation."""
    frames = [
        Frame(motion.pose(k), motion.text(k), T_object=motion.T_object[k]) for k in map(int, subsample(len(motion)))
    ]
    first = contacts_of(HandObject(hand, obj), frames[0].pose.T_object_root, frames[0].pose.q)
    title = f"{hand.name} and {obj.name}: simulation, {motion.direction}, {motion.reason}"
    return Film(
        title, visual_shapes(hand), LinkPoses.of(hand), object_shapes(obj, "mesh"), frames, first_camera_of(first)
    )


def subsample(count: int, limit: int = MAX_FRAMES) -> Int[np.ndarray, " k"]:
    """Return at most `limit` of `count` indices from 0, evenly spaced, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, limit)).round().astype(int))
