"""An alignment task in 3D: two bodies, their targets and closest points, and where other methods put body B."""

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
SEE_THROUGH = 0.65
"""Opacity of bodies that do not hide what is behind them."""
GHOST = 0.25
"""Opacity of what other methods did."""
CREASE = 25.0
"""Edges sharper than this (degrees) are shown as edges."""
DOT, BALL = 0.011, 0.026
"""Radii of closest points and of the balls around targets, in mean diagonals of the bodies."""
REACH = 0.3
"""The camera is chosen as if the bodies together were this large (metres)."""
POINTS = 400
"""So many vertices of a body stand for it where the camera is chosen."""
NEAREST = 1e-2
"""How near to the camera things may be and still be seen, in mean diagonals."""
LATELY = 30
"""So many steps of the way of body B are shown."""


@dataclass(frozen=True)
class Layers:
    """What is shown beside the bodies of the present iterate."""

    see_through: bool = True
    """Whether bodies hide what is behind them."""
    path: bool = True
    """The way that the target on body B went lately."""
    others: bool = False
    """Where the other methods left body B."""


def method_color(number: int) -> Color:
    """The colour of a method, in the chart and in the scene."""
    red, green, blue = bytes.fromhex(COLORS[number % len(COLORS)][0][1:])
    return red, green, blue


class AlignmentScene:
    """The scene nodes of a task; `draw` moves them."""

    def __init__(self, server: viser.ViserServer, task: AlignmentTask) -> None:
        """Make the nodes, and set where the camera stands first.

        Args:
            server: All its pages see the same.
            task: What is shown.
        """
        self.task, self.scene = task, server.scene
        meshes = [_mesh(solid) for solid in task.bodies]
        self.size = float(np.mean([np.linalg.norm(np.ptp(mesh.vertices, axis=0)) for mesh in meshes]))
        self._before: tuple[int, Layers] | None = None
        R = self._upright(meshes)
        self.root = self.scene.add_frame("/task", show_axes=False, wxyz=quaternion_from_matrix(R))
        self.bodies = [
            self._add_mesh(f"/task/{name}", mesh, color, SEE_THROUGH)
            for name, mesh, color in zip("ab", meshes, BODY_COLORS, strict=True)
        ]
        for name, point, color, mesh in zip("ab", task.targets, POINT_COLORS, meshes, strict=True):
            radius = BALL * self.size
            self.scene.add_icosphere(f"/task/{name}/target", radius=radius, color=color, opacity=0.3, position=point)
            self.scene.add_label(f"/task/{name}/name", name.upper(), position=mesh.bounds.mean(axis=0))
        self.dots = [
            self.scene.add_icosphere(f"/task/closest_{name}", radius=DOT * self.size, color=color)
            for name, color in zip("ab", POINT_COLORS, strict=True)
        ]
        self.lines = self.scene.add_line_segments(
            "/task/lines", np.zeros((3, 2, 3)), np.zeros((3, 2, 3)), thickness=4.0, thickness_units="screen"
        )
        self.path = self.scene.add_line_segments(
            "/task/path", np.zeros((1, 2, 3)), (0, 0, 0), thickness=1.5, thickness_units="screen", visible=False
        )
        self.ghosts = [
            self._add_mesh(f"/task/others/{number}", meshes[1], method_color(number), GHOST)
            for number in range(len(task.trajectories))
        ]
        for ghost, run in zip(self.ghosts, task.trajectories, strict=True):
            _place(ghost, run.poses[run.result, 1])
            ghost.visible = False
        self._look(server, meshes, R)

    def draw(self, method: int, frame: int, layers: Layers) -> None:
        """Show an iterate of a method."""
        run = self.task.trajectories[method]
        for handle, T in zip(self.bodies, run.poses[frame], strict=True):
            _place(handle, T)
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
            lately = run.poses[max(frame - LATELY, 0) : frame + 1, 1]
            way = transform_points(lately, np.broadcast_to(self.task.targets[1], (len(lately), 3)))
            self.path.points = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
        if (method, layers) != self._before:
            self.path.colors = np.array(method_color(method), dtype=np.uint8)
            for body in self.bodies:
                body.opacity = SEE_THROUGH if layers.see_through else None
            for number, ghost in enumerate(self.ghosts):
                ghost.visible = layers.others and number != method
        self._before = method, layers

    def _add_mesh(self, name: str, mesh: trimesh.Trimesh, color: Color, opacity: float) -> viser.MeshHandle:
        return self.scene.add_mesh_simple(
            name, np.asarray(mesh.vertices), np.asarray(mesh.faces), color=color, opacity=opacity
        )

    def _best(self) -> Float[np.ndarray, "2 4 4"]:
        """Both poses of the smallest error of all methods."""
        errors = [run.error[run.result] for run in self.task.trajectories]
        run = self.task.trajectories[int(np.nan_to_num(errors, nan=np.inf).argmin())]
        return run.poses[run.result]

    def _upright(self, meshes: list[trimesh.Trimesh]) -> Float[np.ndarray, "3 3"]:
        """A rotation that turns the world so that body B comes to lie on body A."""
        a, b = (transform_points(T, m.bounds.mean(axis=0)) for T, m in zip(self._best(), meshes, strict=True))
        up = b - a if np.linalg.norm(b - a) > 1e-9 else np.array([0.0, 0.0, 1.0])
        z = up / np.linalg.norm(up)
        x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z])

    def _look(self, server: viser.ViserServer, meshes: list[trimesh.Trimesh], R: Float[np.ndarray, "3 3"]) -> None:
        """Put the camera where both bodies, before and after, are seen, and the targets are not behind body B."""
        best = self._best()
        few = [mesh.vertices[:: max(1, len(mesh.vertices) // POINTS)] for mesh in meshes]
        a = np.concatenate([transform_points(T, few[0]) for T in (self.task.start[0], best[0])]) @ R.T
        b = np.concatenate([transform_points(T, few[1]) for T in (self.task.start[1], best[1])]) @ R.T
        goals = np.stack(
            [
                transform_points(best[0], self.task.targets[0]),
                transform_points(self.task.start[1], self.task.targets[1]),
            ]
        )
        scale = REACH / np.ptp(np.concatenate([a, b]), axis=0).max()
        camera = first_camera(scale * b, scale * a, scale * goals @ R.T)
        view = server.initial_camera
        view.position, view.look_at = camera.position / scale, camera.look_at / scale
        view.up, view.fov, view.near = camera.up, camera.field_of_view, NEAREST * self.size


def _mesh(solid: Solid) -> trimesh.Trimesh:
    """A body with its sharp edges sharp."""
    return trimesh.graph.smooth_shade(solid.mesh(), angle=np.radians(CREASE))


def _place(handle: viser.SceneNodeHandle, T: Float[np.ndarray, "4 4"]) -> None:
    handle.position, handle.wxyz = T[:3, 3], quaternion_from_matrix(T[:3, :3])
