"""User interaction with the scene: clicks on links and on the object, dragged targets and gizmos."""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial
from threading import Lock
from typing import Any, Literal

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import inverse, transform_from_pose, transform_points
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.drawing.picking import hit_mesh, nearest_on_surface
from grasp_refine_apps.viewer.drawing.scene_nodes import HandMeshes, Meshes, PointMarkers, place
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.following import draggable_links
from grasp_refine_apps.viewer.model.painting import Camera
from grasp_refine_apps.viewer.model.pose import Target
from grasp_refine_apps.viewer.model.state import State

BRUSH_KEY: Literal["shift"] = "shift"
"""Key that users hold to paint on the object."""

GIZMO_HOLD_S = 0.5
"""Seconds for which a gizmo stays where the user dragged it: drawn states may be older."""


class Interaction:
    """Translation of clicks and drags into commands."""

    def __init__(
        self,
        scene: viser.SceneApi,
        controller: Controller,
        prepared: HandObject,
        hand: HandMeshes,
        obj: Meshes,
        targets: PointMarkers,
        length: float,
    ) -> None:
        """Start without listening.

        Args:
            scene: Scene of the gizmos.
            controller: Receiver of the commands.
            prepared: Hand and object.
            hand: Meshes of the shown hand.
            obj: Meshes of the shown object.
            targets: Markers of the target points on the object.
            length: Approximate size of the gizmos in metres.
        """
        self._scene, self._controller, self._length = scene, controller, length
        self._prepared, self._hand, self._object, self._targets = prepared, hand, obj, targets
        self.gizmos: dict[str, Any] = {}
        """The gizmo that is shown, by the body that it moves."""
        self._picking = self._painting = self._fingers = self._pulling = False
        self._grabbed = np.zeros(3)
        """Point of the dragged link (3,), link frame, or of the pulled object, object frame."""
        self._following, self._newest = Lock(), 0
        self._dragged = -np.inf
        self._read: tuple[str, np.ndarray] | None = None
        """Link that is read, and the clicked point on it (3,), link frame."""
        self.label: Any = None
        """Text on that link; None: there is none."""
        self._click = scene.on_click()(self._clicked_anywhere)
        self._drag = 0
        """Number of the present drag."""

    def draw(self, state: State) -> None:
        """Update listeners and gizmos to a state."""
        if state.picking != self._picking:
            self._picking = state.picking
            self._listen(state.picking)
        self._draw_reading(state)
        self._listen_to_brush(state.brush != "off" and state.motion is None)
        self._listen_to_pulls(state.motion is not None and state.motion.live)
        self._listen_to_fingers(state.gizmo == "fingers" and state.motion is None)
        for kind in [kind for kind in self.gizmos if kind != state.gizmo]:
            self.gizmos.pop(kind).remove()
        if state.gizmo in ("none", "fingers") or state.motion is not None:
            return
        T = state.T_world_object if state.gizmo == "object" else state.T_world_object @ state.shown.T_object_root
        node = self.gizmos.get(state.gizmo)
        if node is None:
            node = self._scene.add_transform_controls(
                f"/gizmo_{state.gizmo}", scale=1.2 * self._length, depth_test=False
            )
            place(node, T)
            node.on_update(self._drag_hand if state.gizmo == "hand" else self._drag_object)
            self.gizmos[state.gizmo] = node
        elif time.monotonic() - self._dragged > GIZMO_HOLD_S:
            place(node, T)

    # Asynchronous, so that they are called at once and in order, before the gizmo is moved again.
    async def _drag_hand(self, event: Any) -> None:
        if event.client is not None and self._moves(event.phase):
            self._dragged = time.monotonic()
            T = inverse(self._controller.state.T_world_object) @ _pose_of(event.target)
            self._controller.editor.move_root(T, self._drag)

    async def _drag_object(self, event: Any) -> None:
        if event.client is not None and self._moves(event.phase):
            self._dragged = time.monotonic()
            self._controller.editor.move_object(_pose_of(event.target), self._drag)

    def _moves(self, phase: str) -> bool:
        """Return whether a phase of a drag moves anything; a start begins another drag."""
        self._drag += phase == "start"
        return phase != "start"

    def _listen_to_fingers(self, dragging: bool) -> None:
        """Make the links that fingers move draggable, or not."""
        if dragging == self._fingers:
            return
        self._fingers = dragging
        links = draggable_links(self._prepared)
        for k, (shape, node) in enumerate(zip(self._hand.shapes, self._hand.nodes, strict=True)):
            if dragging and shape.link in links:
                node.on_drag(partial(self._drag_link, k))
            else:
                node.remove_drag_callback("all")

    def _drag_link(self, k: int, event: Any) -> None:
        """Let a finger follow; of movements that come while it is moved, the newest counts."""
        state, link = self._controller.state, self._hand.shapes[k].link
        if not self._moves(event.phase):
            T = state.T_world_object @ self._hand.poses(state.shown.T_object_root, state.shown.q)[link]
            self._grabbed = transform_points(inverse(T), np.array(event.start_position))
            return
        self._newest = number = self._newest + 1
        with self._following:
            if number == self._newest and state.motion is None:
                wanted = transform_points(inverse(state.T_world_object), np.array(event.end_position))
                self._controller.editor.move_finger(Target(link, self._grabbed, wanted), self._drag)

    def _listen_to_pulls(self, pulling: bool) -> None:
        """Make the object draggable in a live simulation, or not."""
        if pulling == self._pulling:
            return
        self._pulling = pulling
        for node in self._object.nodes:
            if pulling:
                node.on_drag(self._drag_pulled)
            else:
                node.remove_drag_callback("all")

    # Asynchronous, so that it is called at once and in order.
    async def _drag_pulled(self, event: Any) -> None:
        """Pull the grabbed point of the object with the mouse."""
        state = self._controller.state
        if event.phase == "start":
            T = state.T_world_object @ state.T_shown_object
            self._grabbed = transform_points(inverse(T), np.array(event.start_position))
        towards = transform_points(inverse(state.T_world_object), np.array(event.end_position))
        ends = event.phase == "end"
        self._controller.simulation.pull_point(*(None, None) if ends else (self._grabbed, towards))

    def _listen(self, picking: bool) -> None:
        """Make links and object clickable, or not."""
        links = [partial(self._clicked_link, k) for k in range(len(self._hand.shapes))]
        self._hand.on_click(links if picking else None)
        self._object.on_click([self._clicked_object] * len(self._object.shapes) if picking else None)

    def listen_to_targets(self, new: Iterable[int]) -> None:
        """Make new targets draggable along the object."""
        for k in new:
            self._targets.nodes[k].on_drag(partial(self._drag_target, k))

    def _clicked_link(self, k: int, origin: np.ndarray, direction: np.ndarray) -> None:
        state, shape = self._controller.state, self._hand.shapes[k]
        if state.motion is not None:
            return
        T = state.T_world_object @ self._hand.poses(state.shown.T_object_root, state.shown.q)[shape.link]
        hit = hit_mesh(*_ray_in_frame(T, origin, direction), shape.vertices, shape.faces)
        body = state.scene.hand.links_by_name[shape.link].body
        if hit is not None:
            # The visual mesh may differ from the collision geometry.
            self._controller.targets.pick_link(shape.link, hit if body is None else nearest_on_surface(body, hit))

    def _clicked_anywhere(self, event: Any) -> None:
        """Read the first link on the ray of a click; a click elsewhere, or once more, removes the text."""
        state = self._controller.state
        if state.picking or state.motion is not None or not state.shown.posed:
            return
        T = self._hand.poses(state.shown.T_object_root, state.shown.q)
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        hits = []
        for shape in self._hand.shapes:
            T_link = state.T_world_object @ T[shape.link]
            ray = _ray_in_frame(T_link, origin, direction)
            hit = hit_mesh(*ray, shape.vertices, shape.faces)
            if hit is not None:
                hits.append((float(np.linalg.norm(hit - ray[0])), shape.link, hit))
        _, link, point = min(hits, key=lambda one: one[0], default=(0.0, "", np.zeros(3)))
        self._read = (link, point) if link and (self._read is None or self._read[0] != link) else None
        self._draw_reading(state)

    def _draw_reading(self, state: State) -> None:
        """Draw the text on the link that is read."""
        read = self._read if state.motion is None and state.shown.posed else None
        if read is None:
            if self.label is not None:
                self.label.remove()
                self.label = None
            return
        link, point = read
        text = self._controller.contacts(state).reading(link, state.pressure_n)
        if state.outcome is not None and state.frame is None:
            text += state.outcome.likely_contact(state.scene.links, link)
        T = state.T_world_object @ self._hand.poses(state.shown.T_object_root, state.shown.q)[link]
        if self.label is None:
            self.label = self._scene.add_label("/reading", text)
        self.label.text, self.label.position = text, transform_points(T, point)

    def _clicked_object(self, origin: np.ndarray, direction: np.ndarray) -> None:
        state = self._controller.state
        point = None if state.motion is not None else self._on_surface(state, origin, direction)
        if point is not None:
            self._controller.targets.pick_object(point)

    def _drag_target(self, k: int, event: Any) -> None:
        self._drag += event.phase == "start"
        eye = np.array(event.client.camera.position)
        point = self._on_surface(self._controller.state, eye, np.array(event.end_position) - eye)
        if point is not None:
            self._controller.targets.move(k, point, self._drag)

    def _on_surface(self, state: State, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """First point (3,) of the object on a ray in the world frame; object frame."""
        ray = _ray_in_frame(state.T_world_object, origin, direction)
        hits = [hit_mesh(*ray, shape.vertices, shape.faces) for shape in self._object.shapes]
        first = min(
            (hit for hit in hits if hit is not None), key=lambda hit: float(np.linalg.norm(hit - ray[0])), default=None
        )
        return None if first is None else nearest_on_surface(state.scene.object.body, first)

    def _listen_to_brush(self, painting: bool) -> None:
        """Listen to rectangles that users draw, or not; without the key of the brush the mouse turns the camera."""
        if painting != self._painting:
            self._painting = painting
            if painting:
                self._scene.on_rect_select(modifier=BRUSH_KEY)(self._drew_rectangle)
            else:
                self._scene.remove_rect_select_callback(self._drew_rectangle)

    def _drew_rectangle(self, event: Any) -> None:
        camera = event.client.camera
        T = transform_from_pose(np.concatenate([camera.position, camera.wxyz])[None])[0]
        self._controller.regions.paint(Camera(T, camera.fov, camera.aspect, event.screen_min, event.screen_max))

    def remove(self) -> None:
        """Remove the gizmos and the text, and listen no longer."""
        self._scene.remove_click_callback(self._click)
        if self.label is not None:
            self.label.remove()
        self._listen_to_brush(False)
        for node in self.gizmos.values():
            node.remove()


def _pose_of(node: Any) -> Float[np.ndarray, "4 4"]:
    return transform_from_pose(np.concatenate([node.position, node.wxyz])[None])[0]


def _ray_in_frame(T: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a ray in the frame whose pose (4, 4) is T."""
    return transform_points(inverse(T), origin), T[:3, :3].T @ direction
