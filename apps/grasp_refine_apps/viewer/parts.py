"""Scene nodes of one hand with one object and one set of display options, moved with the state."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from jaxtyping import Float

from grasp_refine.core.se3 import tangents, transform, transform_points
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.colors import distance_colors
from grasp_refine_apps.viewer.contacts import Contacts, contacts_of
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.glyphs import force_arrows, friction_cones, segments
from grasp_refine_apps.viewer.interaction import Interaction
from grasp_refine_apps.viewer.nodes import Arrows, HandMeshes, Lines, Meshes, PointMarkers, place
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.shapes import LinkPoses, collision_shapes, object_shapes, visual_shapes
from grasp_refine_apps.viewer.state import State

GRASP_NODE = "/grasp"
"""Parent node of everything in the object's frame."""

OPACITY, GHOST_OPACITY = 0.55, 0.16
"""Opacities of the object and of the input hand."""

GHOST_COLOR, TARGET_COLOR, FORCE_COLOR, DEEP_COLOR, PICKED_COLOR = (
    (110, 130, 170),
    (170, 60, 200),
    (30, 90, 200),
    (220, 20, 40),
    (250, 130, 20),
)

TABLE_THICKNESS_M = 0.004
"""Thickness of a drawn table in metres."""

BESIDE_WIDTHS = 1.3
"""Distance of the input grasp drawn beside, in widths of hand and object."""


class Parts:
    """Scene nodes of one hand with one object and one set of display options."""

    def __init__(self, scene: viser.SceneApi, controller: Controller, state: State, before: Parts | None) -> None:
        """Make all nodes; geometry that was prepared `before` for the same hand and object is used again."""
        hand, obj, showing = state.scene.hand, state.scene.object, state.showing
        # Not shared with the controller: queries of two threads would mix their warm starts.
        self.prepared: HandObject = HandObject(hand, obj) if before is None else before.prepared
        self.contacts: Contacts | None = None
        self.right: np.ndarray = np.array([0.0, 1.0, 0.0]) if before is None else before.right
        """Right direction of the initial view (3,), world frame."""
        self._scene, self._showing = scene, showing
        self._root = scene.add_frame(GRASP_NODE, show_axes=False)
        poses = LinkPoses.of(hand)
        unread: list[str] = []
        self.shapes = visual_shapes(hand, unread.append) if showing.hand == "visual" else collision_shapes(hand)
        if unread and before is None:
            controller.say("; ".join(unread))
        self.hand = HandMeshes(scene, f"{GRASP_NODE}/hand", self.shapes, poses)
        ghost_style = {"opacity": GHOST_OPACITY, "color": GHOST_COLOR, "shadow": False, "side": "front"}
        self.ghost = HandMeshes(scene, f"{GRASP_NODE}/ghost", self.shapes, poses, **ghost_style)
        self.object_shapes = object_shapes(obj, "pieces" if showing.object == "pieces" else "mesh")
        solid: dict[str, Any] = {
            "opacity": OPACITY if showing.transparent and showing.object != "wireframe" else None,
            "wireframe": showing.object == "wireframe",
        }
        self._object_frame = scene.add_frame(f"{GRASP_NODE}/object", show_axes=False)
        self.object = Meshes(scene, f"{GRASP_NODE}/object/mesh", self.object_shapes, **solid)
        self._beside_frame = scene.add_frame("/beside", show_axes=False, visible=False)
        self._beside: tuple[HandMeshes, Meshes] | None = None
        self._labelled: Any = None
        self._wide: tuple[Pose, float] | None = None
        self._beside_style, self._poses = solid, poses
        low, high = self.prepared.box
        self.size = float(np.linalg.norm(high - low))
        radius = float(np.clip(0.012 * self.size, 8e-4, 3e-3))
        self._lines = Lines(scene, f"{GRASP_NODE}/contacts/lines", 3.0)
        self._on_link = PointMarkers(scene, f"{GRASP_NODE}/contacts/link", radius, (0, 0, 0))
        self._on_object = PointMarkers(scene, f"{GRASP_NODE}/contacts/object", radius, (0, 0, 0))
        self._targets = PointMarkers(scene, f"{GRASP_NODE}/targets/object", 1.8 * radius, TARGET_COLOR, 0.75)
        self._wanted = PointMarkers(scene, f"{GRASP_NODE}/targets/link", 1.3 * radius, TARGET_COLOR)
        self._target_lines = Lines(scene, f"{GRASP_NODE}/targets/lines", 2.0)
        self._picked = PointMarkers(scene, f"{GRASP_NODE}/picked", 1.8 * radius, PICKED_COLOR)
        length = float(np.clip(0.5 * self.size, 0.02, 0.1))
        self._forces = Arrows(scene, f"{GRASP_NODE}/forces", length)
        self._length = length
        self._push = Arrows(scene, f"{GRASP_NODE}/push", length)
        self._cones: Any = None
        self._axes = [
            scene.add_frame(f"{GRASP_NODE}/{name}", axes_length=0.6 * length, axes_radius=0.02 * length, visible=False)
            for name in ("frame_of_hand", "frame_of_object")
        ]
        self._table = self._table_node(state) if showing.table else None
        self.interaction = Interaction(scene, controller, self.hand, self.object, self._targets, self._length)
        self._drawn: State | None = None

    # drawing

    def draw(self, state: State) -> None:
        """Update all nodes to a state."""
        shown, showing = state.shown, self._showing
        place(self._root, state.T_world_object)
        moving = state.motion is not None
        self.hand.move(shown)
        place(self._object_frame, state.T_shown_object)
        differs = not state.initial.same(shown)
        self.ghost.show(showing.ghost and differs and not moving and not state.side_by_side)
        self.ghost.move(state.initial)
        self._draw_contacts(state, shown)
        self._draw_push(state)
        for node in self._axes:
            node.visible = showing.frames
        if showing.frames:
            place(self._axes[0], shown.T_object_root)
            place(self._axes[1], state.T_shown_object)
        self._draw_beside(state)
        self.interaction.draw(state)
        self._drawn = state

    def corners(self, pose: Pose) -> Float[np.ndarray, "N 3"]:
        """Points (N, 3) on hand and object, object frame, enough to give their extent."""
        T = self._poses(pose.T_object_root, pose.q)
        points = [shape.vertices for shape in self.object_shapes]
        points += [transform_points(T[shape.link], shape.vertices.astype(float)) for shape in self.shapes]
        every = max(sum(map(len, points)) // 4000, 1)
        return np.concatenate(points)[::every].astype(float)

    def _draw_contacts(self, state: State, shown: Pose) -> None:
        """Draw witness points, lines between them, targets, and forces."""
        if state.motion is not None:
            self._draw_motion_contacts(state)
            return
        finite = np.isfinite(shown.T_object_root).all() and np.isfinite(shown.q).all()
        if not finite:
            return
        found = contacts_of(
            self.prepared, shown.T_object_root, shown.q, touching=_touching(state), targets=state.targets
        )
        self.contacts = found
        on = self._showing.contacts
        deep = [link for link, is_deep in zip(found.link, found.deep, strict=True) if on and is_deep]
        self.hand.tint(deep, DEEP_COLOR)
        none = np.zeros((0, 3))
        colors = distance_colors(found.distance) if on else none
        on_link, on_object = (found.point_link, found.point_object) if on else (none, none)
        self._lines.draw(segments(on_link, on_object), colors)
        self._on_link.draw(on_link, colors)
        self._on_object.draw(on_object, colors)
        wanted = np.isfinite(found.target_link).all(axis=1)
        self.interaction.listen_to_targets(self._targets.draw(found.target_object))
        self._wanted.draw(found.target_link[wanted])
        ends = segments(found.target_link, found.target_object)
        self._target_lines.draw(ends, np.full((len(ends), 3), TARGET_COLOR))
        picked = none
        if state.picked is not None:
            T = self._poses(shown.T_object_root, shown.q)[state.picked[0]]
            picked = transform_points(T, state.picked[1])[None]
        self._picked.draw(picked)
        if self._showing.forces and not _refining(state):
            self._draw_forces(found)
        elif self._drawn is not None and not _refining(self._drawn):
            self._clear_forces()

    def _draw_motion_contacts(self, state: State) -> None:
        """Draw the contact points of a simulation."""
        motion, none = state.motion, np.zeros((0, 3))
        assert motion is not None
        points = motion.contacts[state.motion_frame] if motion.contacts and self._showing.contacts else none
        self.hand.tint((), DEEP_COLOR)
        self._lines.draw(np.zeros((0, 2, 3)), none)
        self._on_link.draw(none, none)
        self._on_object.draw(points, np.full((len(points), 3), distance_colors(np.zeros(1))[0]))
        self._targets.draw(none)
        self._wanted.draw(none)
        self._target_lines.draw(np.zeros((0, 2, 3)), none)
        self._picked.draw(none)
        self._clear_forces()

    def _draw_push(self, state: State) -> None:
        """Draw the push of a simulation, from the middle of the object outwards."""
        motion = state.motion
        if motion is None or not motion.pushed[state.motion_frame]:
            if self._drawn is not None and self._drawn.motion is not None:
                self._push.draw(np.zeros((0, 2, 3)), FORCE_COLOR)
            return
        direction = motion.force / np.linalg.norm(motion.force)
        points = transform_points(state.T_shown_object, self.prepared.object.body.candidates.points)
        middle = transform_points(state.T_shown_object, np.mean(self.prepared.box, axis=0))
        reach = ((points - middle) @ direction).max()
        self._push.draw(np.stack([middle, middle + (reach + 0.4 * self._length) * direction])[None], DEEP_COLOR)

    def _draw_forces(self, found: Contacts) -> None:
        """Draw contact forces as arrows into the object, and friction cones."""
        forces, body = found.forces, self.prepared.object.body
        self._forces.draw(force_arrows(forces.point, forces.force, body), FORCE_COLOR)
        vertices, faces = friction_cones(forces.point, forces.normal, forces.friction, body)
        self._clear_cones()
        if len(faces):
            self._cones = self._scene.add_mesh_simple(
                f"{GRASP_NODE}/cones", vertices, faces, color=FORCE_COLOR, opacity=0.2, side="double",
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip

    def _clear_forces(self) -> None:
        self._forces.draw(np.zeros((0, 2, 3)), FORCE_COLOR)
        self._clear_cones()

    def _clear_cones(self) -> None:
        if self._cones is not None:
            self._cones.remove()
            self._cones = None

    def _draw_beside(self, state: State) -> None:
        """Draw the input grasp beside, with its own object."""
        if state.side_by_side and self._beside is None:
            hand = HandMeshes(self._scene, "/beside/hand", self.shapes, self._poses)
            self._beside = hand, Meshes(self._scene, "/beside/object", self.object_shapes, **self._beside_style)
            above = self.corners(state.initial).max(axis=0) * np.array([0.0, 0.0, 1.0]) + 0.1 * self._length
            self._scene.add_label("/beside/label", "input", position=above)
            self._labelled = self._scene.add_label(f"{GRASP_NODE}/label", "now", position=above)
        if self._beside is None:
            return
        self._beside_frame.visible = self._labelled.visible = state.side_by_side
        if state.side_by_side:
            self._beside[0].move(state.initial)
            place(self._beside_frame, transform(np.eye(3), self.beside(state)) @ state.T_world_object)

    def beside(self, state: State) -> Float[np.ndarray, " 3"]:
        """Offset of the input grasp drawn beside (3,), world frame."""
        if self._wide is None or self._wide[0] is not state.initial:
            self._wide = state.initial, float(np.ptp(self.corners(state.initial), axis=0).max())
        return -BESIDE_WIDTHS * self._wide[1] * self.right

    def _table_node(self, state: State) -> Any:
        """Make the table below the object."""
        table = state.scene.table
        if table is None:
            return None
        normal = np.asarray(table.normal, dtype=float)
        R = np.column_stack([tangents(normal), normal])
        middle = np.mean(self.prepared.box, axis=0)
        below = middle + (table.offset - 0.5 * TABLE_THICKNESS_M - normal @ middle) * normal
        T = transform(R, below)
        node = self._scene.add_box(
            f"{GRASP_NODE}/table",
            dimensions=(6 * self.size, 6 * self.size, TABLE_THICKNESS_M),
            color=(200, 190, 175),
            opacity=0.8,
            cast_shadow=False,
        )
        place(node, T)
        return node

    def remove(self) -> None:
        """Remove all nodes."""
        self._root.remove()
        self._beside_frame.remove()
        self.interaction.remove()


def _touching(state: State) -> np.ndarray | None:
    """True for links (L,) that should touch in the shown pose, by the refinement that led to it; None: none did."""
    trace = state.trace
    if trace is None:
        return None
    if state.frame is not None:
        return trace.touching[state.frame]
    known = state.outcome is not None or state.job is not None
    return trace.touching[-1] if known and state.pose.same(trace.pose(len(trace) - 1)) else None


def _refining(state: State) -> bool:
    return state.job is not None and state.job.kind == "refine"
