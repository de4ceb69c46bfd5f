"""Export of a film as one HTML file that plays in any browser, without server and network."""

from __future__ import annotations

from html import escape

import viser

from grasp_refine_apps.viewer.camera import FIELD_OF_VIEW_RAD, UP
from grasp_refine_apps.viewer.film import Film, Frame
from grasp_refine_apps.viewer.page import without_greeting
from grasp_refine_apps.viewer.scene_nodes import HandMeshes, Lines, Meshes, place
from grasp_refine_apps.viewer.viser_private import NODE_TEXT

FILM_DURATION_S = 6.0
"""Duration of a film in seconds, without the pauses at both ends."""

MAX_FRAME_S = 0.25
"""Longest time between two frames in seconds: a film of few frames is shorter."""

FIRST_FRAME_S, LAST_FRAME_S = 0.8, 1.6
"""Durations of the first and the last frame in seconds; then the film repeats."""

OPACITY, GHOST_OPACITY, GHOST_COLOR = 0.55, 0.22, (110, 130, 170)
"""Opacity of the object; opacity and colour of the copy of the hand in the first frame."""

CAPTION_NODE = "/caption"
"""Hidden node that carries the caption; a visible label could hide parts of the scene, or be hidden by them."""

HEADING = f"""<div style="position:fixed; left:1.2em; top:1em; z-index:2; pointer-events:none; white-space:pre-line; \
font:15px/1.5 system-ui, sans-serif; color:#333"><b>TITLE</b>
<span id="caption"></span>
<span style="color:#999">drag to turn, wheel to zoom, space bar to pause</span></div>
<script>setInterval(() => {{
    {NODE_TEXT.replace("NAME", CAPTION_NODE)}
    if (text) document.getElementById("caption").textContent = text;
}}, 100);</script>"""
"""HTML above the scene: title, caption of the frame, and hints on mouse and keys."""


def animation_html(film: Film, seconds: float = FILM_DURATION_S) -> str:
    """Return the HTML of a film: viser's page with the scene inside, played in a loop.

    A temporary server on a free port of this machine collects the scene; no other server is touched.

    Args:
        film: The film.
        seconds: Duration of all frames, without the pauses at both ends.
    """
    with without_greeting():
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            return _with_title(_recorded_html(server, film, seconds), film.title)
        finally:
            server.stop()


def _recorded_html(server: viser.ViserServer, film: Film, seconds: float) -> str:
    _light(server, film)
    nodes = _FilmNodes(server.scene, film)
    first, *others = film.frames
    nodes.show(first)
    recording = server.get_scene_serializer()
    recording.insert_sleep(FIRST_FRAME_S)
    for frame in others:
        nodes.show(frame)
        recording.insert_sleep(min(seconds / len(others), MAX_FRAME_S))
    recording.insert_sleep(LAST_FRAME_S)
    return recording.as_html()


def _light(server: viser.ViserServer, film: Film) -> None:
    """Set light and camera."""
    scene, camera, view = server.scene, server.initial_camera, film.camera
    scene.configure_environment_map(None)
    scene.configure_default_lights(True, cast_shadow=False)
    scene.add_light_ambient("/light", intensity=1.0)
    scene.world_axes.visible = False
    camera.fov, camera.up, camera.near = FIELD_OF_VIEW_RAD, UP, 0.005
    camera.position, camera.look_at = view.position, view.look_at


class _FilmNodes:
    """Scene nodes of a film."""

    def __init__(self, scene: viser.SceneApi, film: Film) -> None:
        """Make all nodes, at their poses in the first frame."""
        first = film.frames[0]
        self._object = scene.add_frame("/object", show_axes=False)
        Meshes(scene, "/object/mesh", film.object, opacity=OPACITY, shadow=False)
        self._hand = HandMeshes(scene, "/hand", film.hand, film.poses, shadow=False)
        ghost = {"opacity": GHOST_OPACITY, "color": GHOST_COLOR, "shadow": False}
        HandMeshes(scene, "/ghost", film.hand, film.poses, **ghost).move(first.pose)
        self._lines = Lines(scene, "/contacts", 3.0)
        self._caption = scene.add_label(CAPTION_NODE, first.caption, visible=False)

    def show(self, frame: Frame) -> None:
        """Move all nodes to their poses in a frame."""
        self._hand.move(frame.pose)
        place(self._object, frame.T_object)
        self._lines.draw(frame.lines, frame.colors)
        self._caption.text = frame.caption


def _with_title(html: str, title: str) -> str:
    """Return the page with its title in the window's title bar and above the scene."""
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + HEADING.replace("TITLE", escape(title)) + html[end:]
