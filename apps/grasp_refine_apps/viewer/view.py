"""View of the newest state in a 3D scene, with its cameras."""

from __future__ import annotations

import numpy as np
import viser

from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.viewer.camera import FirstCamera, first_camera_of, fit_camera
from grasp_refine_apps.viewer.contacts import Contacts, contacts_of
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.parts import Parts
from grasp_refine_apps.viewer.state import Showing, State

NEAR_PLANE_M, FAR_PLANE_M = 0.005, 50.0
"""Clipping planes of the cameras, metres."""

ASPECT_RATIO = 1.1
"""Width of the scene over its height, beside the panel on a common screen."""


class View:
    """The 3D scene; `draw` is called by one thread."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Start with an empty scene."""
        self.server, self._controller = server, controller
        self.parts: Parts | None = None
        self._made: tuple[Hand, Object, Showing] | None = None
        self._camera: FirstCamera | None = None
        self._beside = False

    @property
    def contacts(self) -> Contacts | None:
        """Drawn contacts, for panels that report on them."""
        return None if self.parts is None else self.parts.contacts

    def draw(self, state: State) -> None:
        """Update the scene to a state."""
        made, parts = (state.scene.hand, state.scene.object, state.showing), self.parts
        with self.server.atomic():
            if parts is None or self._made != made:
                same = parts is not None and self._made is not None and self._made[:2] == made[:2]
                if parts is not None:
                    parts.remove()
                    self.parts = self._made = None
                parts = self.parts = Parts(self.server.scene, self._controller, state, parts if same else None)
                self._made = made
                if not same:
                    self._set_first_camera(state, parts)
            if state.side_by_side != self._beside:
                self._beside = state.side_by_side
                self._point_cameras(state, parts)
            parts.draw(state)

    def _set_first_camera(self, state: State, parts: Parts) -> None:
        """Place all cameras so that hand and object are fully in view."""
        shown = state.shown
        if not (np.isfinite(shown.T_object_root).all() and np.isfinite(shown.q).all()):
            return
        found = contacts_of(parts.prepared, shown.T_object_root, shown.q)
        self._camera = first_camera_of(found, state.T_world_object, aspect=ASPECT_RATIO)
        across = np.cross(self._camera.look_at - self._camera.position, self._camera.up)
        parts.right = across / np.linalg.norm(across)
        self._point_cameras(state, parts)

    def _point_cameras(self, state: State, parts: Parts) -> None:
        """Place all cameras for one grasp, or for two side by side."""
        camera = self._camera
        if camera is None:
            return
        if state.side_by_side:
            points = transform_points(state.T_world_object, parts.corners(state.shown))
            other = transform_points(state.T_world_object, parts.corners(state.initial)) + parts.beside(state)
            back = camera.position - camera.look_at
            back /= np.linalg.norm(back)
            both = np.concatenate([points, other])
            camera = fit_camera(both, both.mean(axis=0), back, ASPECT_RATIO, camera.field_of_view)
        first = self.server.initial_camera
        first.fov, first.near, first.far, first.up = camera.field_of_view, NEAR_PLANE_M, FAR_PLANE_M, camera.up
        first.position, first.look_at = camera.position, camera.look_at
        for client in self.server.get_clients().values():
            here = client.camera
            here.fov, here.near, here.far, here.up_direction = (
                camera.field_of_view,
                NEAR_PLANE_M,
                FAR_PLANE_M,
                camera.up,
            )
            here.position, here.look_at = camera.position, camera.look_at
