"""A film as one HTML file that plays in any browser, without a server and without the network."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
import rich
import viser
from jaxtyping import Float

from grasp_refine_apps.viewer.film import Film, Frame
from grasp_refine_apps.viewer.nodes import Lines, Meshes, place
from grasp_refine_apps.viewer.pose import Pose

SECONDS = 6.0
"""How long a film plays."""

SLOWEST = 0.25
"""Most seconds from one frame to the next: a film of few frames is shorter."""

FIRST, LAST = 0.8, 1.6
"""Seconds for which the first and the last frame stand; then it begins again."""

OPACITY, GHOST_OPACITY, GHOST_COLOR = 0.55, 0.22, (110, 130, 170)
"""Of the object, and of the hand as it was in the first frame."""

WORDS = "/caption"
"""The node that carries the caption; it is never seen itself, since in the scene it would hide or be hidden."""

HEADING = f"""<div style="position:fixed; left:1.2em; top:1em; z-index:2; pointer-events:none; white-space:pre-line; \
font:15px/1.5 system-ui, sans-serif; color:#333"><b>TITLE</b>
<span id="caption"></span>
<span style="color:#999">drag to turn, wheel to zoom, space bar to pause</span></div>
<script>setInterval(() => {{
    const node = window.__viserSceneTree && window.__viserSceneTree.getState()["{WORDS}"];
    if (node) document.getElementById("caption").textContent = node.message.props.text;
}}, 100);</script>"""
"""What stands above the scene: the title, the caption of the frame, and what a person can do."""


def animation_html(film: Film, seconds: float = SECONDS) -> str:
    """The HTML of a film: viser's page with the scene inside; it plays again and again.

    A server of its own, on a free port of this machine, collects the scene for a moment; nobody else's is touched.

    Args:
        film: What to show.
        seconds: How long all frames take, without the pauses at both ends.
    """
    # Servers greet on the terminal.
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            return _titled(_played(server, film, seconds), film.title)
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def _played(server: viser.ViserServer, film: Film, seconds: float) -> str:
    _light(server, film)
    cast = _Cast(server.scene, film)
    first, *others = film.frames
    cast.show(first)
    recording = server.get_scene_serializer()
    recording.insert_sleep(FIRST)
    for frame in others:
        cast.show(frame)
        recording.insert_sleep(min(seconds / len(others), SLOWEST))
    recording.insert_sleep(LAST)
    return recording.as_html()


def _light(server: viser.ViserServer, film: Film) -> None:
    """Light and camera."""
    scene, camera, view = server.scene, server.initial_camera, film.camera
    scene.configure_environment_map(None)
    scene.configure_default_lights(True, cast_shadow=False)
    scene.add_light_ambient("/light", intensity=1.0)
    scene.world_axes.visible = False
    camera.fov, camera.up, camera.near = view.field_of_view, view.up, 0.005
    camera.position, camera.look_at = view.position, view.look_at


class _Cast:
    """What appears in a film; only what changes from one frame to the next is told."""

    def __init__(self, scene: viser.SceneApi, film: Film) -> None:
        """Put everything on the stage."""
        first = film.frames[0]
        self._film = film
        self._object = scene.add_frame("/object", show_axes=False)
        Meshes(scene, "/object/mesh", film.object, opacity=OPACITY, shadow=False)
        self._links = Meshes(scene, "/hand", film.hand, shadow=False).nodes
        ghost = Meshes(scene, "/ghost", film.hand, opacity=GHOST_OPACITY, color=GHOST_COLOR, shadow=False).nodes
        for node, T in zip(ghost, self._places(first.pose), strict=True):
            place(node, T)
        self._lines = Lines(scene, "/contacts", 3.0)
        self._caption = scene.add_label(WORDS, first.caption, visible=False)
        self._at: dict[str, np.ndarray] = {}

    def show(self, frame: Frame) -> None:
        """Move everything to where it is in a frame."""
        for node, T in zip(self._links, self._places(frame.pose), strict=True):
            self._move(node, T)
        self._move(self._object, frame.T_object)
        self._lines.draw(frame.lines, frame.colors)
        self._caption.text = frame.caption

    def _places(self, pose: Pose) -> list[Float[np.ndarray, "4 4"]]:
        T = self._film.poses(pose.T_object_root, pose.q)
        return [T[shape.link] for shape in self._film.hand]

    def _move(self, node: Any, T: Float[np.ndarray, "4 4"]) -> None:
        if node.name not in self._at or not np.allclose(T, self._at[node.name], atol=1e-6):
            self._at[node.name] = T
            place(node, T)


def _titled(html: str, title: str) -> str:
    """The page with its title in the window's bar and above the scene."""
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + HEADING.replace("TITLE", escape(title)) + html[end:]
