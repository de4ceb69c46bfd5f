"""View of the newest state in a 3D scene, with its cameras."""

from __future__ import annotations

from collections.abc import Callable
from threading import Timer
from typing import Any

import numpy as np
import viser

from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine_apps.viewer.drawing.camera import (
    FIELD_OF_VIEW_RAD,
    UP,
    FirstCamera,
    first_camera,
    fit_camera,
    named_view,
    scene_points,
    slanted,
)
from grasp_refine_apps.viewer.drawing.grasp_nodes import GraspNodes
from grasp_refine_apps.viewer.drawing.ground import light
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.comparison import compared_pose
from grasp_refine_apps.viewer.model.contacts import Contacts
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.state import DisplayOptions, State

NEAR_PLANE_M, FAR_PLANE_M = 0.005, 50.0
"""Clipping planes of the cameras, metres."""

ASPECT_RATIO = 1.1
"""Width of the scene over its height, beside the panel on a common screen."""


Drawn = tuple[Hand, Object, DisplayOptions, Environment | None, Plane | None]
"""Hand, object, display options, surroundings and table for which nodes are made."""


class View:
    """The 3D scene; `draw` is called by one thread."""

    def __init__(self, server: viser.ViserServer | viser.ClientHandle, controller: Controller) -> None:
        """Start with an empty scene, of one page or of all."""
        self.server, self._controller = server, controller
        self.nodes: GraspNodes | None = None
        self.simple = False
        """Whether the page draws slowly, without a graphics card."""
        self._made: Drawn | None = None
        self._camera: FirstCamera | None = None
        self._beside = False
        self._grasp: tuple[np.ndarray, int] | None = None
        """Rows of the open grasps, and number of the grasp that the cameras were placed for."""
        self._aspects: dict[int, float] = {}
        self._cuts: dict[int, float] = {}
        self._moved: set[int] = set()
        """Numbers of the pages whose users moved the camera."""
        self._placed: dict[int, FirstCamera] = {}
        """Cameras as they were placed, by numbers of pages."""
        self._motion: Recording | None = None
        self._later = Timer(0.0, lambda: None)
        self.redraw: Callable[[], None] = lambda: None
        """Draws the present state again, from any thread; set by whoever draws."""
        light(server.scene)

    @property
    def contacts(self) -> Contacts | None:
        """Drawn contacts, for panels that report on them."""
        return None if self.nodes is None else self.nodes.contacts

    def draw(self, state: State, *, bodies: bool = False) -> None:
        """Update the scene to a state; cameras follow hand and object until a user moves them.

        Args:
            state: The state.
            bodies: Draw hand and object alone, which a new page shows first.
        """
        scene, nodes = state.scene, self.nodes
        made = scene.hand, scene.object, state.display, scene.environment, scene.table
        grasp = state.collection.row, state.number
        with self.server.atomic():
            if nodes is None or self._made != made:
                same = nodes is not None and self._made is not None and _looks_same(self._made, made)
                if nodes is not None:
                    nodes.remove()
                    self.nodes = self._made = None
                nodes = self.nodes = GraspNodes(self.server.scene, self._controller, state, nodes if same else None)
                self._made = made
                if not same:
                    self._grasp = None
            if self._grasp is None or self._grasp[0] is not grasp[0] or self._grasp[1] != grasp[1]:
                lit = self._grasp is not None
                self._grasp = grasp
                self._choose_camera(state, nodes)
                if not lit:
                    light(self.server.scene, self._camera)
            if state.side_by_side != self._beside:
                self._beside = state.side_by_side
                self._place_cameras(state, nodes, moved=True)
            if state.motion is not self._motion:
                self._motion = state.motion
                if state.motion is not None and state.motion.travels:
                    self._place_cameras(state, nodes, moved=True)
            if self.simple and not nodes.simple:
                nodes.simplify()
            (nodes.draw_bodies if bodies else nodes.draw)(state)
        if not nodes.rests:
            self._later.cancel()
            self._later = Timer(1.1 * nodes.rest_s, self.redraw)
            self._later.daemon = True
            self._later.start()

    def close(self) -> None:
        """Draw no more."""
        self._later.cancel()

    def _choose_camera(self, state: State, nodes: GraspNodes) -> None:
        """Place the cameras so that hand and object are fully in view, palm and contacts seen."""
        before = None if self._camera is None else self._camera.towards
        seen = scene_points(self._controller.contacts(state), state.T_world_object)
        self._camera = first_camera(*seen, aspect=ASPECT_RATIO, before=before)
        across = np.cross(self._camera.look_at - self._camera.position, UP)
        nodes.right = across / np.linalg.norm(across)
        self._place_cameras(state, nodes)

    def moved(self, client: viser.ClientHandle) -> None:
        """Note that a user moved the camera of a page: from then on it stays; drags of fingers and objects do not."""
        placed, now = self._placed.get(client.client_id), client.camera
        if placed is None or not _same_view(placed, now.position, now.look_at):
            self._moved.add(client.client_id)

    def look(self, client: viser.ClientHandle, view: str, aspect: float | None = None) -> None:
        """Fit the camera of one page to hand and object; from then on it follows them.

        Args:
            client: The page.
            view: One of `VIEWS`; any other: from where palm and contacts are seen.
            aspect: Aspect ratio of its scene; None: as before.
        """
        nodes, state = self.nodes, self._controller.state
        self._moved.discard(client.client_id)
        if aspect is not None:
            self._aspects[client.client_id] = aspect
        if nodes is not None:
            seen = scene_points(self._controller.contacts(state), state.T_world_object)
            towards, points = named_view(view, *seen)
            with client.atomic():
                self._place(client, self._points(state, nodes) if points is None else points, towards)

    def ready(self, client: viser.ClientHandle, aspect: float) -> None:
        """Fit the camera of a page to an aspect ratio of its scene, unless its user moved it."""
        self._aspects[client.client_id] = aspect
        nodes, state = self.nodes, self._controller.state
        if nodes is not None and self._camera is not None and client.client_id not in self._moved:
            with client.atomic():
                self._place(client, self._points(state, nodes), self._camera.towards)

    def cut(self, client: viser.ClientHandle, share: float) -> None:
        """Cut away what is nearest to the camera of a page, as a share of the depth of hand and object."""
        self._cuts[client.client_id] = share
        nodes, state, camera = self.nodes, self._controller.state, client.camera
        if nodes is not None:
            back = slanted(np.array(camera.position) - np.array(camera.look_at))
            camera.near = self._near(client.client_id, self._points(state, nodes), np.array(camera.position), back)

    def _near(self, number: int, points: np.ndarray, position: np.ndarray, towards: np.ndarray) -> float:
        """Distance of the near plane of the camera of a page."""
        share, depth = self._cuts.get(number, 0.0), (position - points) @ towards
        return max(NEAR_PLANE_M, float(depth.min() + share * np.ptp(depth))) if share else NEAR_PLANE_M

    def _place(self, client: viser.ClientHandle, points: np.ndarray, towards: np.ndarray) -> None:
        """Fit the camera of a page to points (N, 3), from a direction (3,)."""
        camera, number = client.camera, client.client_id
        found = fit_camera(points, points.mean(axis=0), towards, self._aspects.get(number, ASPECT_RATIO))
        camera.up_direction = UP
        self._placed[number] = found
        _set(camera, found, self._near(number, points, found.position, towards))

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

    def _place_cameras(self, state: State, nodes: GraspNodes, *, moved: bool = False) -> None:
        """Place cameras for one grasp, for two side by side or overlaid, or for a whole trajectory or lift.

        Cameras that users `moved` stay unless they are to see something else.
        """
        camera, site = self._camera, self.server
        clients = site.get_clients() if isinstance(site, viser.ViserServer) else {site.client_id: site}
        if camera is None:
            return
        points, towards = self._points(state, nodes), camera.towards
        if isinstance(site, viser.ViserServer):
            first = site.initial_camera
            first.up = UP
            _set(first, fit_camera(points, points.mean(axis=0), towards, ASPECT_RATIO), NEAR_PLANE_M)
        self._moved = set() if moved else self._moved & clients.keys()
        for number, client in clients.items():
            if number not in self._moved:
                self._place(client, points, towards)


def _set(place: Any, camera: FirstCamera, near: float) -> None:
    """Set the camera of a page, or of all new ones."""
    place.fov, place.near, place.far = FIELD_OF_VIEW_RAD, near, FAR_PLANE_M
    place.position, place.look_at = camera.position, camera.look_at


def _same_view(camera: FirstCamera, position: np.ndarray, look_at: np.ndarray) -> bool:
    """Return whether a camera is where it was placed, up to what browsers round."""
    tolerance = 1e-3 * float(np.linalg.norm(camera.position - camera.look_at))
    return all(
        np.allclose(one, other, rtol=0.0, atol=tolerance)
        for one, other in ((camera.position, position), (camera.look_at, look_at))
    )


def _looks_same(one: Drawn, other: Drawn) -> bool:
    """Return whether hand and object are the same, apart from convex pieces that were cut meanwhile."""
    return one[0] is other[0] and one[1].mesh is other[1].mesh
