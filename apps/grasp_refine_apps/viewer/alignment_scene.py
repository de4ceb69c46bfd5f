"""3D scene of an alignment task: two bodies, their targets and closest points, and results of other methods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
import viser
from jaxtyping import Float

from grasp_refine.core.se3 import quaternion_from_matrix, transform_points
from grasp_refine_apps.bench.align.saved import AlignmentTask, Solid
from grasp_refine_apps.report.panels import COLORS
from grasp_refine_apps.viewer.camera import first_camera
from grasp_refine_apps.viewer.colors import Color, distance_colors

BODY_COLORS: tuple[Color, Color] = ((143, 184, 237), (245, 173, 92))
"""Bodies A and B."""
POINT_COLORS: tuple[Color, Color] = ((11, 79, 156), (166, 60, 0))
"""Their targets and closest points."""
SEE_THROUGH_OPACITY = 0.65
"""Opacity of transparent bodies."""
GHOST_OPACITY = 0.25
"""Opacity of body B at the results of other methods."""
CREASE_ANGLE_DEG = 25.0
"""Angle in degrees above which an edge is drawn sharp."""
CLOSEST_RADIUS, TARGET_RADIUS = 0.011, 0.026
"""Radii of the spheres at closest points and around targets, in mean diagonals of the bodies."""
CAMERA_EXTENT_M = 0.3
"""Extent of both bodies together, in metres, to which they are scaled when the camera is chosen."""
POINTS_PER_BODY = 400
"""Approximate number of vertices per body with which the camera is chosen."""
NEAR_PLANE = 1e-2
"""Distance of the near clipping plane, in mean diagonals of the bodies."""
PATH_STEPS = 30
"""Number of last steps shown of the path of body B."""


@dataclass(frozen=True)
class Layers:
    """Layers shown beside the bodies of the present iterate."""

    see_through: bool = True
    """Whether the bodies are transparent."""
    path: bool = True
    """Whether the recent path of the target on body B is shown."""
    others: bool = False
    """Whether the results of other methods for body B are shown."""


def method_color(number: int) -> Color:
    """The colour of a method, in the chart and in the scene."""
    red, green, blue = bytes.fromhex(COLORS[number % len(COLORS)][0][1:])
    return red, green, blue


class AlignmentScene:
    """The scene nodes of a task; `draw` moves them."""

    def __init__(self, server: viser.ViserServer, task: AlignmentTask) -> None:
        """Make the nodes, and set the initial camera.

        Args:
            server: The server; all its pages show the same.
            task: The task to show.
        """
        self.task, self.scene = task, server.scene
        meshes = [_mesh(solid) for solid in task.bodies]
        self.size = float(np.mean([np.linalg.norm(np.ptp(mesh.vertices, axis=0)) for mesh in meshes]))
        self._before: tuple[int, Layers] | None = None
        R = self._upright(meshes)
        self.root = self.scene.add_frame("/task", show_axes=False, wxyz=quaternion_from_matrix(R))
        self.bodies = [
            self._add_mesh(f"/task/{name}", mesh, color, SEE_THROUGH_OPACITY)
            for name, mesh, color in zip("ab", meshes, BODY_COLORS, strict=True)
        ]
        for name, point, color, mesh in zip("ab", task.targets, POINT_COLORS, meshes, strict=True):
            radius = TARGET_RADIUS * self.size
            self.scene.add_icosphere(f"/task/{name}/target", radius=radius, color=color, opacity=0.3, position=point)
            self.scene.add_label(f"/task/{name}/name", name.upper(), position=mesh.bounds.mean(axis=0))
        self.dots = [
            self.scene.add_icosphere(f"/task/closest_{name}", radius=CLOSEST_RADIUS * self.size, color=color)
            for name, color in zip("ab", POINT_COLORS, strict=True)
        ]
        self.lines = self.scene.add_line_segments(
            "/task/lines", np.zeros((3, 2, 3)), np.zeros((3, 2, 3)), thickness=4.0, thickness_units="screen"
        )
        self.path = self.scene.add_line_segments(
            "/task/path", np.zeros((1, 2, 3)), (0, 0, 0), thickness=1.5, thickness_units="screen", visible=False
        )
        self.ghosts = [
            self._add_mesh(f"/task/others/{number}", meshes[1], method_color(number), GHOST_OPACITY)
            for number in range(len(task.trajectories))
        ]
        for ghost, run in zip(self.ghosts, task.trajectories, strict=True):
            _set_pose(ghost, run.poses[run.result, 1])
            ghost.visible = False
        self._set_camera(server, meshes, R)

    def draw(self, method: int, frame: int, layers: Layers) -> None:
        """Show an iterate of a method."""
        run = self.task.trajectories[method]
        for handle, T in zip(self.bodies, run.poses[frame], strict=True):
            _set_pose(handle, T)
        points = run.witness[frame]
        known = bool(np.isfinite(points).all())
        for dot, point in zip(self.dots, points, strict=True):
            dot.visible = known
            if known:
                dot.position = point
        self.lines.visible = known
        if known:
            targets = transform_points(run.poses[frame], self.task.targets)
            self.lines.points = np.stack([points, *np.stack([points, targets], axis=1)]).astype(np.float32)
            gap = tuple(distance_colors(run.distance[frame : frame + 1])[0].tolist())
            colors = np.array([gap, *POINT_COLORS], dtype=np.uint8)
            self.lines.colors = np.repeat(colors[:, None], 2, axis=1)
        self.path.visible = layers.path and frame > 0
        if self.path.visible:
            lately = run.poses[max(frame - PATH_STEPS, 0) : frame + 1, 1]
            way = transform_points(lately, np.broadcast_to(self.task.targets[1], (len(lately), 3)))
            self.path.points = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
        if (method, layers) != self._before:
            self.path.colors = np.array(method_color(method), dtype=np.uint8)
            for body in self.bodies:
                body.opacity = SEE_THROUGH_OPACITY if layers.see_through else None
            for number, ghost in enumerate(self.ghosts):
                ghost.visible = layers.others and number != method
        self._before = method, layers

    def _add_mesh(self, name: str, mesh: trimesh.Trimesh, color: Color, opacity: float) -> viser.MeshHandle:
        return self.scene.add_mesh_simple(
            name, np.asarray(mesh.vertices), np.asarray(mesh.faces), color=color, opacity=opacity
        )

    def _best(self) -> Float[np.ndarray, "2 4 4"]:
        """Poses of both bodies at the smallest error of all methods."""
        errors = [run.error[run.result] for run in self.task.trajectories]
        run = self.task.trajectories[int(np.nan_to_num(errors, nan=np.inf).argmin())]
        return run.poses[run.result]

    def _upright(self, meshes: list[trimesh.Trimesh]) -> Float[np.ndarray, "3 3"]:
        """Rotation of the world that puts body B on top of body A."""
        a, b = (transform_points(T, m.bounds.mean(axis=0)) for T, m in zip(self._best(), meshes, strict=True))
        up = b - a if np.linalg.norm(b - a) > 1e-9 else np.array([0.0, 0.0, 1.0])
        z = up / np.linalg.norm(up)
        x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z])

    def _set_camera(
        self, server: viser.ViserServer, meshes: list[trimesh.Trimesh], R: Float[np.ndarray, "3 3"]
    ) -> None:
        """Place the camera so that both bodies, before and after, are in view and body B hides no target."""
        best = self._best()
        few = [mesh.vertices[:: max(1, len(mesh.vertices) // POINTS_PER_BODY)] for mesh in meshes]
        a = np.concatenate([transform_points(T, few[0]) for T in (self.task.start[0], best[0])]) @ R.T
        b = np.concatenate([transform_points(T, few[1]) for T in (self.task.start[1], best[1])]) @ R.T
        goals = np.stack(
            [
                transform_points(best[0], self.task.targets[0]),
                transform_points(self.task.start[1], self.task.targets[1]),
            ]
        )
        scale = CAMERA_EXTENT_M / np.ptp(np.concatenate([a, b]), axis=0).max()
        camera = first_camera(scale * b, scale * a, scale * goals @ R.T)
        view = server.initial_camera
        view.position, view.look_at = camera.position / scale, camera.look_at / scale
        view.up, view.fov, view.near = camera.up, camera.field_of_view, NEAR_PLANE * self.size


def _mesh(solid: Solid) -> trimesh.Trimesh:
    """Mesh of a body, smooth-shaded except at sharp edges."""
    return trimesh.graph.smooth_shade(solid.mesh(), angle=np.radians(CREASE_ANGLE_DEG))


def _set_pose(handle: viser.SceneNodeHandle, T: Float[np.ndarray, "4 4"]) -> None:
    handle.position, handle.wxyz = T[:3, 3], quaternion_from_matrix(T[:3, :3])
