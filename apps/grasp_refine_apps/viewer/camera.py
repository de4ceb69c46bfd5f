"""Where the camera stands first: hand and object whole in the picture, and the contacts not behind the hand."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from grasp_refine.core.se3 import tangents, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine_apps.viewer.contacts import Contacts

ELEVATIONS = (20.0, 35.0, 50.0)
"""How far above the horizon the camera may stand, degrees, the preferred one first."""

AZIMUTHS = tuple(range(0, 360, 20))
"""Seen from above, on which sides, degrees from the x axis counterclockwise."""

BESIDE = 0.008
"""What passes the line of sight of a contact by less than this (metres) hides it."""

IN_FRONT = 0.004
"""What is nearer to the camera than the contact by less than this (metres) does not."""

OBJECT_HIDES = 0.35
"""How much the object hides, compared with the hand: it is drawn a little transparent, and seen it should be too."""

STEEP = 0.05
"""What a step of `ELEVATIONS` costs, as a share of the contacts hidden."""

FAR = 0.5
"""What it costs, likewise, where the camera must be twice as far from the contacts as it can be to see the whole."""

SPACING = 0.006
"""Metres between the points that stand for surfaces, about: less than what hides something is wide."""

MARGIN = 0.9
"""Share of the picture that is filled."""

FIELD_OF_VIEW = np.radians(45.0)
"""Vertical opening of the camera in radians."""


@dataclass(frozen=True, eq=False)
class FirstCamera:
    """Where a camera stands and looks."""

    position: Float[np.ndarray, " 3"]
    """Where it stands (3,), metres."""
    look_at: Float[np.ndarray, " 3"]
    """The point in the middle of the picture (3,), metres."""
    up: Float[np.ndarray, " 3"]
    """What is up in the picture (3,): z."""
    field_of_view: float
    """Vertical opening in radians."""


def first_camera(
    hand: Float[np.ndarray, "N 3"],
    obj: Float[np.ndarray, "M 3"],
    contacts: Float[np.ndarray, "K 3"],
    *,
    aspect: float = 1.4,
    field_of_view: float = FIELD_OF_VIEW,
) -> FirstCamera:
    """The camera that sees most of the contacts, from slightly above, with hand and object whole in the picture.

    Args:
        hand: Points all over the hand's surface, in the frame of the scene, z up.
        obj: Points all over the object's surface.
        contacts: Where they touch or nearly do; none: the object's points stand for them.
        aspect: Width of the picture over its height.
        field_of_view: Vertical opening in radians.
    """
    wanted = contacts if len(contacts) else obj[:: max(1, len(obj) // 16)]
    every, middle = np.concatenate([hand, obj]), wanted.mean(axis=0)
    cameras, cost = [], []
    for (step, elevation), azimuth in product(enumerate(ELEVATIONS), AZIMUTHS):
        towards = _direction(azimuth, elevation)
        hidden = _hidden(wanted, hand, towards) + OBJECT_HIDES * _hidden(wanted, obj, towards)
        cameras.append(fitted(every, middle, towards, aspect, field_of_view))
        cost.append(hidden.mean() + STEEP * step)
    distance = np.array([np.linalg.norm(camera.position - middle) for camera in cameras])
    total = np.array(cost) + FAR * (distance / distance.min() - 1.0)
    # Rounding decides nothing.
    return cameras[int(total.round(9).argmin())]


def first_camera_of(
    contacts: Contacts,
    T_world_object: Float[np.ndarray, "4 4"] | None = None,
    *,
    aspect: float = 1.4,
    field_of_view: float = FIELD_OF_VIEW,
) -> FirstCamera:
    """`first_camera` of a grasp, the object standing at `T_world_object` (4, 4) in the scene; None: at its origin."""
    T = np.eye(4) if T_world_object is None else T_world_object
    bodies, T_link = contacts.prepared.bodies, contacts.frames.T_world_link[0]
    hand = [transform_points(pose, _points(body)) for pose, body in zip(T_link, bodies, strict=True)]
    return first_camera(
        transform_points(T, np.concatenate(hand)),
        transform_points(T, _points(contacts.prepared.object.body)),
        transform_points(T, contacts.point_object),
        aspect=aspect,
        field_of_view=field_of_view,
    )


def _points(body: Body) -> Float[np.ndarray, "N 3"]:
    """Points all over the surface of a body."""
    return body.candidates.points[: max(16, round(body.area / SPACING**2))]


def _direction(azimuth: float, elevation: float) -> Float[np.ndarray, " 3"]:
    """Unit vector towards a camera."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _hidden(
    contacts: Float[np.ndarray, "K 3"], things: Float[np.ndarray, "N 3"], towards: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " K"]:
    """How much each contact is hidden (K,), 0 to 1, by what lies near its line of sight."""
    axes = np.concatenate([tangents(towards), towards[:, None]], axis=1)
    away = (things @ axes).T[:, None] - (contacts @ axes).T[..., None]
    near = np.maximum(1.0 - np.hypot(away[0], away[1]) / BESIDE, 0.0)
    return np.minimum((near * (away[2] > IN_FRONT)).sum(axis=1), 1.0)


def fitted(
    points: Float[np.ndarray, "N 3"],
    middle: Float[np.ndarray, " 3"],
    towards: Float[np.ndarray, " 3"],
    aspect: float,
    field_of_view: float,
) -> FirstCamera:
    """From where points (N, 3) just fill the picture of a camera that looks against `towards`, at `middle`'s depth.

    `towards` (3,) is a unit vector that is not vertical.
    """
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    above = np.cross(towards, right)
    seen = points @ np.stack([right, above, towards], axis=1)
    slope = MARGIN * np.tan(field_of_view / 2) * np.array([aspect, 1.0])
    # In each of the two directions, the two sides of the field of view just hold all points.
    low, high = (seen[:, :2] - slope * seen[:, 2:]), (seen[:, :2] + slope * seen[:, 2:])
    low, high = low.min(axis=0), high.max(axis=0)
    place, depth = (low + high) / 2, ((high - low) / (2 * slope)).max()
    axes = np.stack([right, above, towards])
    position, look_at = np.array([*place, depth]) @ axes, np.array([*place, middle @ towards]) @ axes
    return FirstCamera(position, look_at, np.array([0.0, 0.0, 1.0]), field_of_view)
