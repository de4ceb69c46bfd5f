"""View of the newest state in a 3D scene, with its cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.environment import Environment
from grasp_refine_apps.viewer.drawing.camera import (
    FIELD_OF_VIEW_RAD,
    UP,
    FirstCamera,
    first_camera,
    first_camera_of,
    fit_camera,
    surface_points,
)
from grasp_refine_apps.viewer.drawing.grasp_nodes import GraspNodes
from grasp_refine_apps.viewer.drawing.ground import ABOVE, LEAST_SLANT, light
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.comparison import compared_pose
from grasp_refine_apps.viewer.model.contacts import Contacts
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.state import DisplayOptions, State

NEAR_PLANE_M, FAR_PLANE_M = 0.005, 50.0
"""Clipping planes of the cameras, metres."""

ASPECT_RATIO = 1.1
"""Width of the scene over its height, beside the panel on a common screen."""


Drawn = tuple[Hand, Object, DisplayOptions, Environment | None]
"""Hand, object, display options and surroundings for which nodes are made."""


class View:
    """The 3D scene; `draw` is called by one thread."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Start with an empty scene."""
        self.server, self._controller = server, controller
        self.nodes: GraspNodes | None = None
        self._made: Drawn | None = None
        self._camera: FirstCamera | None = None
        self._beside = False
        self._aspects: dict[int, float] = {}
        self._motion: Recording | None = None
        light(server.scene)

    @property
    def contacts(self) -> Contacts | None:
        """Drawn contacts, for panels that report on them."""
        return None if self.nodes is None else self.nodes.contacts

    def draw(self, state: State) -> None:
        """Update the scene to a state."""
        scene, nodes = state.scene, self.nodes
        made = scene.hand, scene.object, state.display, scene.environment
        with self.server.atomic():
            if nodes is None or self._made != made:
                same = nodes is not None and self._made is not None and _looks_same(self._made, made)
                if nodes is not None:
                    nodes.remove()
                    self.nodes = self._made = None
                nodes = self.nodes = GraspNodes(self.server.scene, self._controller, state, nodes if same else None)
                self._made = made
                if not same:
                    self._choose_camera(state, nodes)
            if state.side_by_side != self._beside:
                self._beside = state.side_by_side
                self._place_cameras(state, nodes)
            if state.motion is not self._motion:
                self._motion = state.motion
                if state.motion is not None and state.motion.travels:
                    self._place_cameras(state, nodes)
            nodes.draw(state)

    def _choose_camera(self, state: State, nodes: GraspNodes) -> None:
        """Place all cameras so that hand and object are fully in view."""
        T = state.T_world_object
        if state.shown.posed:
            self._camera = first_camera_of(self._controller.contacts(state), T, aspect=ASPECT_RATIO)
        else:
            obj = transform_points(T, surface_points(nodes.prepared.object.body))
            self._camera = first_camera(obj[:0], obj, obj[:0], aspect=ASPECT_RATIO)
        light(self.server.scene, self._camera)
        across = np.cross(self._camera.look_at - self._camera.position, UP)
        nodes.right = across / np.linalg.norm(across)
        self._place_cameras(state, nodes)

    def fit(self, client: viser.ClientHandle, aspect: float, *, first: bool = False) -> None:
        """Fit the camera of one page to hand and object.

        Args:
            client: The page.
            aspect: Aspect ratio of its scene.
            first: Whether it looks as the first camera does, not from where it is.
        """
        nodes, state = self.nodes, self._controller.state
        self._aspects[client.client_id] = aspect
        if nodes is None:
            return
        camera = client.camera
        seen: Any = self._camera if first and self._camera is not None else camera
        back = np.array(seen.position) - np.array(seen.look_at)
        back /= max(float(np.linalg.norm(back)), 1e-9)
        if np.linalg.norm(np.cross(back, UP)) < LEAST_SLANT:
            back = np.array(ABOVE) / np.linalg.norm(ABOVE)
        points = self._points(state, nodes)
        found = fit_camera(points, points.mean(axis=0), back, aspect)
        with client.atomic():
            camera.up_direction = UP
            camera.fov, camera.near, camera.far = FIELD_OF_VIEW_RAD, NEAR_PLANE_M, FAR_PLANE_M
            camera.position, camera.look_at = found.position, found.look_at

    def _points(self, state: State, nodes: GraspNodes) -> np.ndarray:
        """Points (N, 3) on all that is shown, world frame."""
        points = transform_points(state.T_world_object, nodes.corners(state.shown))
        motion, ends = state.motion, []
        if motion is not None and motion.carries:
            ends = [nodes.corners(motion.pose(k), motion.object_pose(k), arm=True) for k in (0, -1)]
        elif motion is not None and motion.travels:
            # Objects that are lost may be anywhere.
            ends = [nodes.corners(pose) for pose in map(motion.pose, (0, -1)) if pose.posed]
        points = np.concatenate([points, *(transform_points(state.T_world_object, end) for end in ends)])
        compared = compared_pose(state)
        if compared is not None:
            points = np.concatenate([points, transform_points(state.T_world_object, nodes.corners(compared))])
        if not state.side_by_side:
            return points
        other = transform_points(state.T_world_object, nodes.corners(state.initial)) + nodes.input_offset(state)
        return np.concatenate([points, other])

    def _place_cameras(self, state: State, nodes: GraspNodes) -> None:
        """Place all cameras for one grasp, for two side by side or overlaid, or for a whole trajectory or lift."""
        camera = self._camera
        if camera is None:
            return
        points = None
        travels = state.motion is not None and state.motion.travels
        if state.side_by_side or travels or compared_pose(state) is not None:
            points = self._points(state, nodes)
        back = camera.position - camera.look_at
        back /= np.linalg.norm(back)
        self.server.initial_camera.up = UP
        places: list[tuple[Any, float]] = [(self.server.initial_camera, ASPECT_RATIO)]
        for number, client in self.server.get_clients().items():
            client.camera.up_direction = UP
            places.append((client.camera, self._aspects.get(number, ASPECT_RATIO)))
        for place, aspect in places:
            found = camera if points is None else fit_camera(points, points.mean(axis=0), back, aspect)
            place.fov, place.near, place.far = FIELD_OF_VIEW_RAD, NEAR_PLANE_M, FAR_PLANE_M
            place.position, place.look_at = found.position, found.look_at


def _looks_same(one: Drawn, other: Drawn) -> bool:
    """Return whether hand and object are the same, apart from convex pieces that were cut meanwhile."""
    return one[0] is other[0] and one[1].mesh is other[1].mesh
