"""Scene nodes of one hand with one object and one set of display options, moved with the state."""

from __future__ import annotations

import time
from collections.abc import Collection
from typing import Any

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import tangents, transform, transform_points
from grasp_refine.forces.wrench import PLANNING_FRICTION
from grasp_refine.geometry.body import Body
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine_apps.viewer.drawing.camera import hand_points, surface_points
from grasp_refine_apps.viewer.drawing.colors import distance_colors, tinted
from grasp_refine_apps.viewer.drawing.depth import DepthField, overlap_patches
from grasp_refine_apps.viewer.drawing.environment_nodes import EnvironmentNodes
from grasp_refine_apps.viewer.drawing.gaps import GapField, gap_patch
from grasp_refine_apps.viewer.drawing.glyphs import (
    force_arrows,
    friction_cones,
    patch_area,
    patch_outline,
    push_arrow,
    segments,
)
from grasp_refine_apps.viewer.drawing.ground import Ground
from grasp_refine_apps.viewer.drawing.interaction import Interaction
from grasp_refine_apps.viewer.drawing.region_nodes import RegionNodes
from grasp_refine_apps.viewer.drawing.scan_nodes import ScanNodes
from grasp_refine_apps.viewer.drawing.scene_nodes import (
    Arrows,
    ColoredPatches,
    HandMeshes,
    Labels,
    Lines,
    Meshes,
    PointMarkers,
    place,
)
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses, collision_shapes, object_shapes, visual_shapes
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.comparison import compared_pose
from grasp_refine_apps.viewer.meters.obstacles import TABLE
from grasp_refine_apps.viewer.model.contacts import Contacts, Forces
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.state import State

GRASP_NODE = "/grasp"
"""Parent node of everything in the object's frame."""

OPACITY, GHOST_OPACITY, COMPARED_OPACITY = 0.55, 0.16, 0.3
"""Opacities of the object, of the input hand and of the compared one."""

GHOST_COLOR, TARGET_COLOR, FORCE_COLOR, DEEP_COLOR, PICKED_COLOR = (
    (110, 130, 170),
    (170, 60, 200),
    (30, 90, 200),
    (220, 20, 40),
    (250, 130, 20),
)

COMPARED_COLOR = (30, 150, 110)
"""Colour of the hand in the grasp that is compared."""

CONE_COLOR = (110, 150, 225)
"""Colour of the outlines of friction cones."""

FORCE_THICKNESS = 0.4
"""Thickness of the arrows of forces, as a share of that of a push."""

REST_S, SIMPLE_REST_S, SHADOW_PERIOD_S = 0.25, 1.0, 0.1
"""Seconds without a movement from which on colours of depths and gaps are drawn, on pages that draw slowly, where moves
come seldom, too; and between two shadows."""

LEAST_FORCE_N = 0.05
"""Least force in newtons that has a text."""

TABLE_COLOR = (200, 190, 175)
"""Colour of the table."""

TABLE_THICKNESS_M = 0.004
"""Thickness of a drawn table in metres."""

BESIDE_WIDTHS = 1.3
"""Distance of the input grasp drawn beside, in widths of hand and object."""

NO_POINTS = np.zeros((0, 3))
"""Empty array of points, or of colours."""


class GraspNodes:
    """Scene nodes of one hand with one object and one set of display options."""

    def __init__(self, scene: viser.SceneApi, controller: Controller, state: State, before: GraspNodes | None) -> None:
        """Make all nodes; geometry that was prepared `before` for the same hand and object is used again."""
        self.simple = False
        """Whether ground, shadow and input hand are left out, for pages that draw slowly."""
        hand, obj, display = state.scene.hand, state.scene.object, state.display
        self._contacts_of, self._overlaps_of = controller.contacts, controller.overlaps
        self._elsewhere_of = controller.elsewhere
        self.prepared: HandObject = controller.contacts.prepared(state.scene)
        self.contacts: Contacts | None = None
        self.right: np.ndarray = np.array([0.0, 1.0, 0.0]) if before is None else before.right
        """Right direction of the initial view (3,), world frame."""
        self._scene, self._display, self._poses = scene, display, LinkPoses.of(hand)
        unread: list[str] = []
        self.shapes = visual_shapes(hand, unread.append) if display.hand == "visual" else collision_shapes(hand)
        if unread and before is None:
            controller.notify("; ".join(unread))
        self.root = scene.add_frame(GRASP_NODE, show_axes=False)
        self.hand = HandMeshes(scene, f"{GRASP_NODE}/hand", self.shapes, self._poses)
        self.ghost: HandMeshes | None = None
        """The input hand or the compared one; None until it is shown first: pages wait for every mesh."""
        self.object_frame = scene.add_frame(f"{GRASP_NODE}/object", show_axes=False)
        self.object_shapes = object_shapes(obj, "pieces" if display.object == "pieces" else "mesh")
        self._surface = self.object_shapes[0] if display.object != "pieces" else object_shapes(obj, "mesh")[0]
        wireframe = display.object == "wireframe"
        opacity = OPACITY if display.transparent and not wireframe else None
        self._object_style: dict[str, Any] = {"opacity": opacity, "wireframe": wireframe}
        self.object = Meshes(scene, f"{GRASP_NODE}/object/mesh", self.object_shapes, **self._object_style)
        self.regions = RegionNodes(scene, f"{GRASP_NODE}/object/regions", self._surface)
        self.scan = ScanNodes(scene, f"{GRASP_NODE}/object/scan", obj) if display.scan else None
        self.input_frame = scene.add_frame("/beside", show_axes=False, visible=False)
        self._input: tuple[HandMeshes, Meshes] | None = None
        self._label: Any = None
        self._input_width: tuple[Pose, float] | None = None
        low, high = self.prepared.box
        size = float(np.linalg.norm(high - low))
        radius = float(np.clip(0.012 * size, 8e-4, 3e-3))
        length = self._length = float(np.clip(0.5 * size, 0.02, 0.1))
        self._lines = Lines(scene, f"{GRASP_NODE}/contacts/lines", 3.0)
        self.points_link = PointMarkers(scene, f"{GRASP_NODE}/contacts/link", radius, (0, 0, 0))
        self.points_object = PointMarkers(scene, f"{GRASP_NODE}/contacts/object", radius, (0, 0, 0))
        self.targets = PointMarkers(scene, f"{GRASP_NODE}/targets/object", 1.8 * radius, TARGET_COLOR, 0.75)
        self._targets_link = PointMarkers(scene, f"{GRASP_NODE}/targets/link", 1.3 * radius, TARGET_COLOR)
        self._target_lines = Lines(scene, f"{GRASP_NODE}/targets/lines", 2.0)
        self.picked = PointMarkers(scene, f"{GRASP_NODE}/picked", 1.8 * radius, PICKED_COLOR)
        self.met = PointMarkers(scene, f"{GRASP_NODE}/met", 3.0 * radius, DEEP_COLOR)
        self.depths = ColoredPatches(scene, f"{GRASP_NODE}/depth")
        self.gaps = ColoredPatches(scene, f"{GRASP_NODE}/gaps")
        self._depths_of: Contacts | None = None
        self._seen: tuple[Contacts | None, float] = None, -np.inf
        """Contacts that were drawn last, and when they came."""
        self.rests = True
        """Whether all is drawn; False: `draw` should be called again after `rest_s`."""
        self._moves, self._shadow_at = False, -np.inf
        self._gaps_of: Contacts | None = None
        self._gap_field: GapField | None = None
        self._depth_fields: dict[Body, DepthField] = {}
        self.forces = Arrows(scene, f"{GRASP_NODE}/forces", FORCE_THICKNESS * length, FORCE_COLOR)
        self.newtons = Labels(scene, f"{GRASP_NODE}/forces_text")
        self.cones = Lines(scene, f"{GRASP_NODE}/cones", 1.5)
        self.patches = ColoredPatches(scene, f"{GRASP_NODE}/contacts/patches")
        self.outlines = Lines(scene, f"{GRASP_NODE}/contacts/outlines", 2.5)
        self._patches_of: Contacts | None = None
        self.push = Arrows(scene, f"{GRASP_NODE}/push", length, DEEP_COLOR)
        self.axes = [
            scene.add_frame(f"{GRASP_NODE}/{name}", axes_length=0.6 * length, axes_radius=0.02 * length, visible=False)
            for name in ("frame_of_hand", "frame_of_object")
        ]
        self._table: Any = None
        self.environment: EnvironmentNodes | None = None
        if display.surroundings and state.scene.table is not None:
            self._add_table(state.scene.table, 6 * size)
        if display.surroundings and state.scene.environment is not None:
            self.environment = EnvironmentNodes(scene, f"{GRASP_NODE}/environment", state.scene.environment, obj.body)
        self._ground: Ground | None = None
        self._shadow_of: tuple[bytes, ...] | None = None
        self.interaction = Interaction(scene, controller, self.prepared, self.hand, self.object, self.targets, length)

    def simplify(self) -> None:
        """Leave out ground, shadow and input hand from now on."""
        self.simple = True
        if self._ground is not None:
            self._ground.remove()
            self._ground = None
        if self.ghost is not None:
            self.ghost.show(False)

    @property
    def rest_s(self) -> float:
        """Seconds without a movement from which on the hand rests."""
        return SIMPLE_REST_S if self.simple else REST_S

    def draw_bodies(self, state: State) -> None:
        """Update hand and object alone to a state, which pages show first."""
        place(self.root, state.T_world_object)
        self.hand.move(state.shown)
        self.hand.show(state.shown.posed)
        place(self.object_frame, state.T_shown_object)

    def draw(self, state: State) -> None:
        """Update all nodes to a state."""
        self.rests, shown = True, state.shown
        self.draw_bodies(state)
        self._draw_ghost(state)
        overlaps = self._overlaps_of(state) if self._display.surroundings else ()
        blocked, blocking = {overlap.link for overlap in overlaps}, {overlap.body for overlap in overlaps}
        met = None if state.motion is None else state.motion.obstruction_at(state.motion_frame)
        if met is not None:
            blocked |= {met.first, met.second}
            blocking |= blocked
        self.met.draw(NO_POINTS if met is None else np.array([met.place]))
        if state.motion is not None:
            touched = state.motion.contacts and self._display.contacts
            self._draw_touched(state.motion.contacts[state.motion_frame] if touched else NO_POINTS)
            self.hand.tint(blocked, DEEP_COLOR)
        elif shown.posed:
            elsewhere = self._elsewhere_of(state) if self._display.regions else ()
            self._draw_contacts(state, blocked | {one.link for one in elsewhere})
        else:
            self._draw_touched(NO_POINTS)
        self.regions.draw(state.scene.regions if self._display.regions else None)
        self._draw_surroundings(state, blocking)
        self._draw_push(state)
        self._draw_ground(state)
        if self._ground is not None:
            self._ground.show_shadow(self.environment is None or not blocking)
        for node, T in zip(self.axes, (shown.T_object_root, state.T_shown_object), strict=True):
            node.visible = self._display.frames
            place(node, T)
        self._draw_input(state)
        self.interaction.draw(state)

    def corners(
        self, pose: Pose, T_object: Float[np.ndarray, "4 4"] | None = None, *, arm: bool = False
    ) -> Float[np.ndarray, "N 3"]:
        """Points (N, 3) on the object and on a hand that can be drawn, enough to give their extent, frame of the pose.

        Args:
            pose: Pose of the hand.
            T_object: Pose of the object (4, 4) in the same frame; None: it is at the origin.
            arm: Whether the arm of a hand that is on one counts.
        """
        whole = arm and self.prepared.hand.arm is not None
        points = [transform_points(np.eye(4) if T_object is None else T_object, s.vertices) for s in self.object_shapes]
        shown = [shape for shape in self.shapes if whole or not shape.faded]
        if pose.posed:
            T = self._poses(pose.T_object_root, pose.q)
            points += [transform_points(T[shape.link], shape.vertices.astype(float)) for shape in shown]
        every = max(sum(map(len, points)) // 4000, 1)
        return np.concatenate(points)[::every].astype(float)

    def _draw_surroundings(self, state: State, blocking: Collection[str]) -> None:
        """Draw the table and the bodies around the object, tinted where links are inside."""
        if self._table is not None:
            self._table.color = tinted(TABLE_COLOR, DEEP_COLOR) if TABLE in blocking else TABLE_COLOR
        if self.environment is not None:
            self.environment.tint(blocking, DEEP_COLOR)
            moved = {} if state.motion is None else state.motion.T_bodies
            self.environment.move({name: T[state.motion_frame] for name, T in moved.items()})

    def _draw_ghost(self, state: State) -> None:
        """Draw the compared grasp as a ghost, or else the input grasp, unless it is drawn beside."""
        pose = compared_pose(state)
        wanted = self._display.input_hand and not state.side_by_side if pose is None else True
        color, opacity = (GHOST_COLOR, GHOST_OPACITY) if pose is None else (COMPARED_COLOR, COMPARED_OPACITY)
        pose = state.initial if pose is None else pose
        seen = wanted and pose.posed and state.motion is None and not pose.same(state.shown)
        seen &= not self.simple or pose is not state.initial
        if self.ghost is None:
            if not seen:
                return
            self.ghost = HandMeshes(
                self._scene, f"{GRASP_NODE}/ghost", self.shapes, self._poses, opacity=opacity, color=color,
                shadow=False, side="front",
            )  # fmt: skip
        self.ghost.show(seen)
        self.ghost.move(pose)
        for node in self.ghost.nodes:
            node.color, node.opacity = color, opacity

    def _draw_contacts(self, state: State, blocked: Collection[str]) -> None:
        """Draw witness points, lines between them, targets, and forces; links that are `blocked` are tinted."""
        shown, on = state.shown, self._display.contacts
        found = self.contacts = self._contacts_of(state)
        inside = [link for link, deep in zip(found.link, found.deep, strict=True) if on and deep]
        self.hand.tint([*inside, *blocked], DEEP_COLOR)
        colors = distance_colors(found.distance) if on else NO_POINTS
        on_link, on_object = (found.point_link, found.point_object) if on else (NO_POINTS, NO_POINTS)
        self._lines.draw(segments(on_link, on_object), colors)
        self.points_link.draw(on_link, colors)
        self.points_object.draw(on_object, colors)
        self.interaction.listen_to_targets(self.targets.draw(found.target_object))
        self._targets_link.draw(found.target_link[np.isfinite(found.target_link).all(axis=1)])
        lines = segments(found.target_link, found.target_object)
        self._target_lines.draw(lines, np.full((len(lines), 3), TARGET_COLOR))
        picked = NO_POINTS
        if state.picked is not None:
            link, point = state.picked
            picked = transform_points(self._poses(shown.T_object_root, shown.q)[link], point)[None]
        self.picked.draw(picked)
        refining = state.job is not None and state.job.kind == "refine"
        self._draw_patches(found if on and not refining else None)
        self._draw_forces(found.forces if self._display.forces and not refining else None, state.pressure_n)
        still = not refining and self._rests(found)
        self._draw_depths(found if self._display.overlap and still else None)
        self._draw_gaps(found if self._display.gaps and still else None)

    def _rests(self, found: Contacts) -> bool:
        """Return whether the hand rests: it did not move twice within `rest_s`, or once on slow pages."""
        now = time.monotonic()
        if found is not self._seen[0]:
            self._moves = self.simple or now - self._seen[1] <= self.rest_s
            self._seen = found, now
        elif now - self._seen[1] > self.rest_s:
            self._moves = False
        self.rests &= not self._moves
        return not self._moves

    def _draw_patches(self, found: Contacts | None) -> None:
        """Draw the areas where flat faces of links and object meet, coloured by the gap; None: nothing."""
        if found is self._patches_of:
            return
        self._patches_of, patches = found, () if found is None else found.patches
        self.patches.draw([(patch_area(patch), np.eye(4)) for patch in patches if len(patch.corners) > 2])
        edges = [patch_outline(patch.corners) for patch in patches]
        colors = [distance_colors(patch.gap) for patch in patches]
        self.outlines.draw(np.concatenate([np.zeros((0, 2, 3)), *edges]), np.concatenate([NO_POINTS, *colors]))

    def _draw_depths(self, found: Contacts | None) -> None:
        """Draw where links and object overlap, coloured by depth; None, and while the hand moves: nothing."""
        if found is self._depths_of:
            return
        self._depths_of, patches = found, []
        for link in () if found is None else np.array(found.link)[found.deep]:
            shape = next((shape for shape in self.shapes if shape.link == link), None)
            body = self.prepared.hand.links_by_name[link].body
            if found is None or shape is None or body is None:
                continue
            T = found.frames.T_world_link[0, self.prepared.chain.links.index(link)]
            both = overlap_patches(shape, self._field(body), self._surface, self._field(self.prepared.object.body), T)
            patches += [(patch, pose) for patch, pose in zip(both, (T, np.eye(4)), strict=True) if patch is not None]
        self.depths.draw(patches)

    def _draw_gaps(self, found: Contacts | None) -> None:
        """Draw links that touch, or should, coloured by their distance from the object; None: nothing."""
        if found is self._gaps_of:
            return
        self._gaps_of, patches = found, []
        if found is not None and self._gap_field is None:
            self._gap_field = GapField(self._field(self.prepared.object.body))
        for link in () if found is None else found.link:
            shape = next((shape for shape in self.shapes if shape.link == link), None)
            if found is not None and shape is not None and self._gap_field is not None:
                T = found.frames.T_world_link[0, self.prepared.chain.links.index(link)]
                patch = gap_patch(shape, T, self._gap_field)
                patches += [] if patch is None else [(patch, T)]
        self.gaps.draw(patches)

    def _field(self, body: Body) -> DepthField:
        """Depth in a body, built when it is needed first."""
        if body not in self._depth_fields:
            self._depth_fields[body] = DepthField.of(body)
        return self._depth_fields[body]

    def _draw_touched(self, points: Float[np.ndarray, "N 3"]) -> None:
        """Draw the points (N, 3) where the object touches in a simulation, and no targets or forces."""
        for markers in (self.points_link, self.targets, self._targets_link, self.picked):
            markers.draw(NO_POINTS)
        for lines in (self._lines, self._target_lines):
            lines.draw(np.zeros((0, 2, 3)), NO_POINTS)
        self._draw_patches(None)
        self.points_object.draw(points, distance_colors(np.zeros(len(points))))
        self._draw_forces(None)
        self._draw_depths(None)
        self._draw_gaps(None)

    def _draw_push(self, state: State) -> None:
        """Draw the push of a simulation outwards, from the middle of the object or the point that is dragged."""
        motion, arrows = state.motion, np.zeros((0, 2, 3))
        if motion is not None and motion.is_pushed(state.motion_frame):
            length = 0.4 * self._length
            arrows = push_arrow(self.prepared, state.T_shown_object, motion.force, length, motion.pulled)[None]
        self.push.draw(arrows)

    def _draw_ground(self, state: State) -> None:
        """Draw the ground, which stays where it was first, and the shadow of hand and object."""
        shown, T = state.shown, state.T_world_object
        seen = shown.T_object_root.tobytes(), shown.q.tobytes(), T.tobytes(), state.T_shown_object.tobytes()
        if self.simple or not (shown.posed and self._display.ground) or seen == self._shadow_of:
            return
        now = time.monotonic()
        if now - self._shadow_at < SHADOW_PERIOD_S and self._ground is not None:
            self.rests = False
            return
        self._shadow_of, self._shadow_at = seen, now
        obj = transform_points(state.T_shown_object, surface_points(self.prepared.object.body))
        hand = hand_points(self.prepared, self.prepared.chain(shown.T_object_root[None], shown.q[None]).T_world_link[0])
        points = transform_points(T, np.concatenate([hand, obj]))
        if self._ground is None:
            height, size = float(points[:, 2].min()), float(np.ptp(points, axis=0).max())
            floor = height
            if self.environment is not None:
                # The object stands on a body, which carries the shadow.
                height = float(transform_points(T, obj)[:, 2].min())
                floor = min(height, float(T[2, 3]) + self.environment.lowest)
            self._ground = Ground(self._scene, floor, size, height)
        self._ground.draw(points)

    def _draw_forces(self, forces: Forces | None, total_n: float = 0.0) -> None:
        """Draw contact forces as arrows into the object with their newtons, and outlines of cones; None: nothing."""
        if forces is None:
            self.forces.draw(np.zeros((0, 2, 3)))
            self.newtons.draw((), NO_POINTS)
            self.cones.draw(np.zeros((0, 2, 3)), NO_POINTS)
            return
        body = self.prepared.object.body
        arrows = force_arrows(forces.point, forces.force, body)
        self.forces.draw(arrows)
        # An arrow that points at the camera is a dot.
        newtons = total_n * np.linalg.norm(forces.force, axis=1)
        pushing = newtons > LEAST_FORCE_N
        self.newtons.draw([f"{one:.1f} N" for one in newtons[pushing]], forces.point[pushing])
        cones = friction_cones(forces.point, forces.normal, PLANNING_FRICTION, body)
        self.cones.draw(cones, np.full((len(cones), 3), CONE_COLOR))

    def _draw_input(self, state: State) -> None:
        """Draw the input grasp beside, with its own object."""
        if state.side_by_side and self._input is None:
            hand = HandMeshes(self._scene, "/beside/hand", self.shapes, self._poses)
            self._input = hand, Meshes(self._scene, "/beside/object", self.object_shapes, **self._object_style)
            above = self.corners(state.initial).max(axis=0) * np.array([0.0, 0.0, 1.0]) + 0.1 * self._length
            self._scene.add_label("/beside/label", "input", position=above)
            self._label = self._scene.add_label(f"{GRASP_NODE}/label", "now", position=above)
        if self._input is None:
            return
        self.input_frame.visible = self._label.visible = state.side_by_side
        if state.side_by_side:
            self._input[0].move(state.initial)
            place(self.input_frame, transform(np.eye(3), self.input_offset(state)) @ state.T_world_object)

    def input_offset(self, state: State) -> Float[np.ndarray, " 3"]:
        """Offset of the input grasp that is drawn beside (3,), world frame."""
        if self._input_width is None or self._input_width[0] is not state.initial:
            self._input_width = state.initial, float(np.ptp(self.corners(state.initial), axis=0).max())
        return -BESIDE_WIDTHS * self._input_width[1] * self.right

    def _add_table(self, table: Plane, width: float) -> None:
        """Add the table below the object, `width` in metres."""
        normal = np.asarray(table.normal, dtype=float)
        middle = np.mean(self.prepared.box, axis=0)
        below = middle + (table.offset - 0.5 * TABLE_THICKNESS_M - normal @ middle) * normal
        dimensions = (width, width, TABLE_THICKNESS_M)
        self._table = self._scene.add_box(
            f"{GRASP_NODE}/table", dimensions=dimensions, color=TABLE_COLOR, opacity=0.8, cast_shadow=False
        )
        place(self._table, transform(np.column_stack([tangents(normal), normal]), below))

    def remove(self) -> None:
        """Remove all nodes."""
        self.root.remove()
        self.input_frame.remove()
        if self._ground is not None:
            self._ground.remove()
        self.interaction.remove()
