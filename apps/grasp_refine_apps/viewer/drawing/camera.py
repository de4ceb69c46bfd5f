"""Initial camera: hand and object fully in view, and contacts not hidden by the hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import tangents, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.drawing.shapes import forearm
from grasp_refine_apps.viewer.model.contacts import Contacts

ELEVATIONS_DEG = (20.0, 35.0, 50.0)
"""Candidate elevations of the camera above the horizon in degrees, the preferred one first."""

AZIMUTHS_DEG = tuple(range(0, 360, 20))
"""Candidate azimuths of the camera in degrees from the x axis, counterclockwise seen from above."""

OCCLUSION_RADIUS_M = 0.008
"""Distance in metres from the line of sight of a contact below which a point hides it."""

OCCLUSION_DEPTH_M = 0.004
"""Distance in metres in front of a contact below which a point does not hide it."""

OBJECT_OCCLUSION_WEIGHT = 0.35
"""Weight of occlusion by the object, relative to the hand: it is drawn transparent, and should be in view, too."""

ELEVATION_COST = 0.05
"""Cost of each step along `ELEVATIONS_DEG`, as a share of hidden contacts."""

DISTANCE_COST = 0.5
"""Cost, likewise, of a camera twice as far from the contacts as the nearest one with everything in view."""

BACK_COST = 0.3
"""Cost, likewise, of a camera behind the hand, from where neither palm nor contacts are seen; none from its side."""

TURN_COST = 0.2
"""Cost, likewise, of a camera opposite to the one before."""

VIEWS: Mapping[str, tuple[float, float, float] | None] = {
    "front": (1.0, 0.0, 0.2),
    "side": (0.0, 1.0, 0.2),
    "palm": None,
    "contacts": None,
}
"""Name of a view -> direction towards its camera; None: it depends on the grasp."""

CLOSE_M = 0.025
"""Distance in metres around contacts that a view of them has in its picture."""

ABOVE, LEAST_SLANT = (1.0, 0.0, 0.5), 1e-3
"""Direction towards a camera where none is known, and sine of the angle to the vertical below which one is vertical."""

POINT_SPACING_M = 0.006
"""Approximate spacing of surface points in metres: less than the width that hides a contact."""

FILLED_SHARE = 0.9
"""Share of the picture that is filled."""

FIELD_OF_VIEW_RAD = np.radians(45.0)
"""Vertical opening of the camera in radians."""

UP = (0.0, 0.0, 1.0)
"""Up direction of the picture."""


@dataclass(frozen=True, eq=False)
class FirstCamera:
    """Pose of a camera with `FIELD_OF_VIEW_RAD`, and z up."""

    position: Float[np.ndarray, " 3"]
    """Position (3,), metres."""
    look_at: Float[np.ndarray, " 3"]
    """The point in the middle of the picture (3,), metres."""

    @property
    def towards(self) -> Float[np.ndarray, " 3"]:
        """Unit vector (3,) from the middle of the picture towards the camera."""
        return slanted(self.position - self.look_at)


def first_camera(
    hand: Float[np.ndarray, "N 3"],
    obj: Float[np.ndarray, "M 3"],
    contacts: Float[np.ndarray, "K 3"],
    *,
    aspect: float = 1.4,
    before: Float[np.ndarray, " 3"] | None = None,
) -> FirstCamera:
    """Return the camera that sees palm and most contacts, from slightly above, with hand and object fully in view.

    Args:
        hand: Points all over the hand's surface, in the frame of the scene, z up.
        obj: Points all over the object's surface.
        contacts: Points where they touch or nearly do; empty: points of the object are used.
        aspect: Width of the picture over its height.
        before: Direction towards the camera before (3,), which should not turn much; None: there is none.
    """
    wanted = contacts if len(contacts) else obj[:: max(1, len(obj) // 16)]
    every, middle = np.concatenate([hand, obj]), wanted.mean(axis=0)
    palm = facing(hand, wanted)
    cameras, cost = [], []
    for (step, elevation), azimuth in product(enumerate(ELEVATIONS_DEG), AZIMUTHS_DEG):
        towards = _direction(azimuth, elevation)
        hidden = _occlusion(wanted, hand, towards) + OBJECT_OCCLUSION_WEIGHT * _occlusion(wanted, obj, towards)
        cameras.append(fit_camera(every, middle, towards, aspect))
        turn = 0.0 if before is None else TURN_COST * (1.0 - float(towards @ before)) / 2
        back = BACK_COST * max(-float(towards @ palm), 0.0)
        cost.append(hidden.mean() + ELEVATION_COST * step + turn + back)
    distance = np.array([np.linalg.norm(camera.position - middle) for camera in cameras])
    total = np.array(cost) + DISTANCE_COST * (distance / distance.min() - 1.0)
    # Rounded, so that rounding errors do not break ties.
    return cameras[int(total.round(9).argmin())]


def first_camera_of(
    contacts: Contacts,
    T_world_object: Float[np.ndarray, "4 4"] | None = None,
    *,
    aspect: float = 1.4,
    before: Float[np.ndarray, " 3"] | None = None,
) -> FirstCamera:
    """Return `first_camera` of a grasp, the object at `T_world_object` (4, 4) in the scene; None: at its origin."""
    return first_camera(*scene_points(contacts, T_world_object), aspect=aspect, before=before)


def scene_points(
    contacts: Contacts, T_world_object: Float[np.ndarray, "4 4"] | None = None
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "M 3"], Float[np.ndarray, "K 3"]]:
    """Return points all over hand and object, and their contacts; of a pose that cannot be drawn, of the object alone.

    Args:
        contacts: Contacts of the grasp.
        T_world_object: Pose of the object (4, 4) in the scene; None: at its origin.
    """
    T, T_link = np.eye(4) if T_world_object is None else T_world_object, contacts.frames.T_world_link[0]
    obj, hand, touched = surface_points(contacts.prepared.object.body), np.zeros((0, 3)), contacts.point_object
    if np.isfinite(T_link).all():
        hand = hand_points(contacts.prepared, T_link)
    else:
        touched = touched[:0]
    hand, obj, touched = (transform_points(T, points) for points in (hand, obj, touched))
    return hand, obj, touched


def facing(hand: Float[np.ndarray, "N 3"], wanted: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " 3"]:
    """Return the direction (3,) from a hand to what it holds, the normal of its palm; 0 without a hand."""
    away = wanted.mean(axis=0) - hand.mean(axis=0) if len(hand) else np.zeros(3)
    return away / max(float(np.linalg.norm(away)), np.finfo(np.float64).tiny)


def slanted(towards: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return a direction (3,) as a unit vector; a vertical one, from which no side is up, is replaced by `ABOVE`."""
    length = float(np.linalg.norm(towards))
    if np.linalg.norm(np.cross(UP, towards)) <= LEAST_SLANT * length:
        towards, length = np.array(ABOVE), float(np.linalg.norm(ABOVE))
    return np.asarray(towards) / length


def named_view(
    view: str,
    hand: Float[np.ndarray, "N 3"],
    obj: Float[np.ndarray, "M 3"],
    contacts: Float[np.ndarray, "K 3"],
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "P 3"] | None]:
    """Return the direction towards the camera of one of `VIEWS`, and points (P, 3) that it should see; None: all.

    Any other name, and a view of contacts where there are none, is `first_camera`.
    """
    if fixed := VIEWS.get(view):
        return slanted(np.array(fixed)), None
    if view == "palm" and len(hand):
        return slanted(facing(hand, contacts if len(contacts) else obj)), None
    towards = first_camera(hand, obj, contacts).towards
    if view != "contacts" or not len(contacts):
        return towards, None
    around = CLOSE_M * np.array(list(product((-1.0, 1.0), repeat=3)))
    return towards, (contacts[:, None] + around).reshape(-1, 3)


def hand_points(prepared: HandObject, T_link: Float[np.ndarray, "L 4 4"]) -> Float[np.ndarray, "N 3"]:
    """Return points (N, 3) all over a hand without its forearm, its links at poses (L, 4, 4)."""
    behind = forearm(prepared.hand)
    parts = zip(prepared.chain.links, prepared.bodies, T_link, strict=True)
    shown = [transform_points(T, surface_points(body)) for link, body, T in parts if link not in behind]
    return np.concatenate(shown or [np.zeros((0, 3))])


def surface_points(body: Body) -> Float[np.ndarray, "N 3"]:
    """Return points (N, 3) all over the surface of a body, in its frame."""
    return body.candidates.points[: max(16, round(body.area / POINT_SPACING_M**2))]


def _direction(azimuth: float, elevation: float) -> Float[np.ndarray, " 3"]:
    """Unit vector towards a camera."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _occlusion(
    contacts: Float[np.ndarray, "K 3"], things: Float[np.ndarray, "N 3"], towards: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " K"]:
    """Occlusion of each contact (K,), 0 to 1, by points near its line of sight."""
    axes = np.concatenate([tangents(towards), towards[:, None]], axis=1)
    away = (things @ axes).T[:, None] - (contacts @ axes).T[..., None]
    near = np.maximum(1.0 - np.hypot(away[0], away[1]) / OCCLUSION_RADIUS_M, 0.0)
    return np.minimum((near * (away[2] > OCCLUSION_DEPTH_M)).sum(axis=1), 1.0)


def fit_camera(
    points: Float[np.ndarray, "N 3"],
    middle: Float[np.ndarray, " 3"],
    towards: Float[np.ndarray, " 3"],
    aspect: float,
) -> FirstCamera:
    """Fit a camera that looks against `towards` so that points (N, 3) just fill its picture, at `middle`'s depth.

    `towards` (3,) is a unit vector that is not vertical.
    """
    right = np.cross(UP, towards)
    right /= np.linalg.norm(right)
    above = np.cross(towards, right)
    seen = points @ np.stack([right, above, towards], axis=1)
    slope = FILLED_SHARE * np.tan(FIELD_OF_VIEW_RAD / 2) * np.array([aspect, 1.0])
    # In each of the two directions, the two sides of the field of view just hold all points.
    low, high = (seen[:, :2] - slope * seen[:, 2:]), (seen[:, :2] + slope * seen[:, 2:])
    low, high = low.min(axis=0), high.max(axis=0)
    place, depth = (low + high) / 2, ((high - low) / (2 * slope)).max()
    axes = np.stack([right, above, towards])
    position, look_at = np.array([*place, depth]) @ axes, np.array([*place, middle @ towards]) @ axes
    return FirstCamera(position, look_at)
