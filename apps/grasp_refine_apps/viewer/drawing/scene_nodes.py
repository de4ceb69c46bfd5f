"""Nodes of the 3D scene, which are made once and then only moved; viser sends only what changes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine_apps.viewer.drawing.colors import Color, tinted
from grasp_refine_apps.viewer.drawing.depth import DepthPatch
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses, Shape
from grasp_refine_apps.viewer.model.pose import Pose

SRGB_EXPONENT = 2.2
"""Exponent from the usual colours to linear ones."""

FADED_OPACITY = 0.3
"""Opacity of forearms."""

Clicked = Callable[[np.ndarray, np.ndarray], None]
"""Callback with origin (3,) and direction (3,) of the ray through a click, world frame."""


def place(node: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Move a node to a pose (4, 4) in the frame of its parent."""
    pose = pose_from_transform(T)
    node.position, node.wxyz = pose[:3], pose[3:]


def _report_click(clicked: Clicked, event: Any) -> None:
    """Call `clicked` with the ray of a click."""
    clicked(np.array(event.ray_origin), np.array(event.ray_direction))


class Meshes:
    """Nodes of triangle meshes under one name."""

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        shapes: Sequence[Shape],
        *,
        opacity: float | None = None,
        wireframe: bool = False,
        color: Color | None = None,
        shadow: bool = True,
        side: Literal["front", "double"] = "double",
    ) -> None:
        """Make a node for each shape, `name`/0, `name`/1 and so on; of open surfaces both sides should be drawn."""
        self.shapes = tuple(shapes)
        self.nodes = [
            scene.add_mesh_simple(
                f"{name}/{k}",
                shape.vertices,
                shape.faces,
                color=color or shape.color,
                opacity=FADED_OPACITY if shape.faded and opacity is None else opacity,
                wireframe=wireframe,
                side=side,
                cast_shadow=shadow,
                receive_shadow=False,
            )
            for k, shape in enumerate(shapes)
        ]

    def show(self, visible: bool) -> None:
        """Show or hide all nodes."""
        for node in self.nodes:
            node.visible = visible

    def on_click(self, clicked: Sequence[Clicked] | None) -> None:
        """Call the k-th of `clicked` when the k-th node is clicked; None: nothing, and no outline on hovering."""
        for k, node in enumerate(self.nodes):
            node.remove_click_callback("all")
            if clicked is not None:
                node.on_click(partial(_report_click, clicked[k]))

    def remove(self) -> None:
        """Remove all nodes."""
        for node in self.nodes:
            node.remove()


class HandMeshes(Meshes):
    """Meshes of a hand, whose links are placed by its kinematics."""

    def __init__(
        self, scene: viser.SceneApi, name: str, shapes: Sequence[Shape], poses: LinkPoses, **style: Any
    ) -> None:
        """Make a node for each link; `style` as for `Meshes`."""
        super().__init__(scene, name, shapes, **style)
        self.poses = poses
        self._at: Pose | None = None

    def tint(self, links: Collection[str], color: Color) -> None:
        """Tint some links with a colour, and show the others in their own."""
        for shape, node in zip(self.shapes, self.nodes, strict=True):
            node.color = tinted(shape.color, color) if shape.link in links else shape.color

    def move(self, pose: Pose) -> None:
        """Put the hand at a pose in the frame of its parent."""
        if pose is self._at or not pose.posed:
            return
        self._at = pose
        T = self.poses(pose.T_object_root, pose.q)
        for shape, node in zip(self.shapes, self.nodes, strict=True):
            place(node, T[shape.link])


class Lines:
    """Line segments, as many as there are at a time."""

    def __init__(self, scene: viser.SceneApi, name: str, thickness: float) -> None:
        """Start without segments; `thickness` in pixels."""
        self._scene, self._name, self._thickness = scene, name, thickness
        self.node: Any = None
        """The lines; None: there are none."""

    def draw(self, points: Float[np.ndarray, "N 2 3"], colors: np.ndarray) -> None:
        """Draw N segments from and to points, each in its colour (N, 3), 0 to 255."""
        if self.node is not None and not len(points):
            self.node.remove()
            self.node = None
        if len(points):
            colors = np.repeat(np.asarray(colors, dtype=np.uint8)[:, None], 2, axis=1)
            if self.node is None:
                self.node = self._scene.add_line_segments(
                    self._name, points, colors, thickness=self._thickness, thickness_units="screen"
                )
            else:
                self.node.points, self.node.colors = points.astype(np.float32), colors


class PointMarkers:
    """Point markers: small spheres of one radius, as many as there are at a time."""

    def __init__(self, scene: viser.SceneApi, name: str, radius: float, color: Color, opacity: float | None = None):
        """Start without markers; `radius` in metres."""
        self._scene, self._name, self._radius, self._color, self._opacity = scene, name, radius, color, opacity
        self.nodes: list[Any] = []

    def draw(self, points: Float[np.ndarray, "N 3"], colors: np.ndarray | None = None) -> range:
        """Draw markers at points, in colours (N, 3) or the default colour; returns the indices of new markers."""
        before = len(self.nodes)
        while len(self.nodes) > len(points):
            self.nodes.pop().remove()
        for k, point in enumerate(points):
            color: Any = self._color if colors is None else tuple(int(c) for c in colors[k])
            if k == len(self.nodes):
                self.nodes.append(
                    self._scene.add_icosphere(
                        f"{self._name}/{k}",
                        radius=self._radius,
                        color=color,
                        opacity=self._opacity,
                        position=point,
                        cast_shadow=False,
                        receive_shadow=False,
                    )
                )
            else:
                self.nodes[k].position, self.nodes[k].color = point, color
        return range(before, len(points))


class Labels:
    """Texts at points, as many as there are at a time."""

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        """Start without texts."""
        self._scene, self._name = scene, name
        self.nodes: list[Any] = []

    def draw(self, texts: Sequence[str], points: Float[np.ndarray, "N 3"]) -> None:
        """Draw N texts, each at its point, frame of the parent."""
        while len(self.nodes) > len(texts):
            self.nodes.pop().remove()
        for k, (text, point) in enumerate(zip(texts, points, strict=True)):
            if k == len(self.nodes):
                self.nodes.append(self._scene.add_label(f"{self._name}/{k}", text, position=point))
            self.nodes[k].text, self.nodes[k].position = text, point


class ColoredPatches:
    """Triangle meshes with a colour per vertex, as many as there are at a time."""

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        """Start without patches."""
        self._scene, self._name = scene, name
        self.nodes: list[Any] = []

    def draw(self, patches: Sequence[tuple[DepthPatch, Float[np.ndarray, "4 4"]]]) -> None:
        """Draw patches at poses (4, 4) in the frame of their parent, instead of the previous ones."""
        import trimesh

        while self.nodes:
            self.nodes.pop().remove()
        for k, (patch, T) in enumerate(patches):
            # Files for browsers have linear colours.
            colors = np.round(255 * (patch.colors / 255) ** SRGB_EXPONENT).astype(np.uint8)
            mesh = trimesh.Trimesh(patch.vertices, patch.faces, vertex_colors=colors, process=False)
            data = mesh.export(file_type="glb", tree_postprocessor=_without_light)
            assert isinstance(data, bytes)
            node = self._scene.add_glb(f"{self._name}/{k}", data, cast_shadow=False, receive_shadow=False)
            place(node, T)
            self.nodes.append(node)


def _without_light(tree: dict[str, Any]) -> None:
    """Give the meshes of a glTF tree a material that no light changes, so that their colours match the scale."""
    tree["extensionsUsed"] = ["KHR_materials_unlit"]
    tree["materials"] = [{"extensions": {"KHR_materials_unlit": {}}, "doubleSided": True}]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0


class Arrows:
    """Arrows of one colour, as many as there are at a time."""

    def __init__(self, scene: viser.SceneApi, name: str, size: float, color: Color) -> None:
        """Start without arrows; `size` is their approximate length in metres and sets their thickness."""
        self._add = partial(
            scene.add_arrows,
            name,
            colors=color,
            shaft_radius=0.03 * size,
            head_radius=0.075 * size,
            head_length=0.2 * size,
        )
        self.node: Any = None
        """The arrows; None: there are none."""

    def draw(self, points: Float[np.ndarray, "N 2 3"]) -> None:
        """Draw N arrows from and to points."""
        if self.node is not None:
            self.node.remove()
        self.node = self._add(points) if len(points) else None
