"""Animation of a refinement or a simulation: one HTML file that plays in any browser, without server and network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape

import numpy as np
import viser

from grasp_refine.core.array_types import Float, UInt8
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.drawing.camera import FIELD_OF_VIEW_RAD, UP, FirstCamera, first_camera_of
from grasp_refine_apps.viewer.drawing.colors import distance_colors
from grasp_refine_apps.viewer.drawing.environment_nodes import EnvironmentNodes
from grasp_refine_apps.viewer.drawing.glyphs import arrow_lines, push_arrow, segments
from grasp_refine_apps.viewer.drawing.ground import light
from grasp_refine_apps.viewer.drawing.scene_nodes import HandMeshes, Lines, Meshes, place
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses, object_shapes, visual_shapes
from grasp_refine_apps.viewer.model.contacts import contacts_of
from grasp_refine_apps.viewer.model.pose import Pose, Target
from grasp_refine_apps.viewer.model.recording import Recording, subsample
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.server.page import without_greeting
from grasp_refine_apps.viewer.server.viser_private import NODE_TEXT

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

PUSH_COLOR, PUSH_SHARE = (220, 20, 40), 0.3
"""Colour of the arrow of a push, and its length outside of the object as a share of the object's size."""

MAX_FRAMES = 200
"""Maximum number of frames of a film."""

NOTHING_TO_SHOW = "there is nothing to animate yet: refine the grasp, or watch a simulation, first"
"""Message where there is no recording."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a film."""

    pose: Pose
    """Pose of the hand."""
    caption: str
    """Caption of the frame."""
    lines: Float[np.ndarray, "N 2 3"] = field(default_factory=lambda: np.zeros((0, 2, 3)))
    """Line segments (N, 2, 3), metres."""
    colors: UInt8[np.ndarray, "N 3"] = field(default_factory=lambda: np.zeros((0, 3), dtype=np.uint8))
    """Colours of the segments (N, 3), 0 to 255."""
    T_object: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose of the object (4, 4)."""
    push: Float[np.ndarray, "_ 2 3"] = field(default_factory=lambda: np.zeros((0, 2, 3)))
    """Line segments of the arrow of a push (P, 2, 3), metres."""
    T_bodies: Mapping[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)
    """Poses (4, 4) of bodies around the object that have moved, by name."""


@dataclass(frozen=True, eq=False)
class Film:
    """At least one frame of a hand and an object; all in the initial frame of the object, metres."""

    title: str
    """Title."""
    hand: Hand
    """The hand."""
    object: Object
    """The object."""
    frames: Sequence[Frame]
    """Frames, evenly spaced in time."""
    camera: FirstCamera
    """Initial camera."""
    environment: Environment | None = None
    """Bodies around the object."""


def film_of(state: State) -> Film:
    """Return the film of a state, of at most `MAX_FRAMES` frames of the shown simulation, else of the last refinement.

    Raises:
        GraspRefineError: there is neither.
    """
    if state.recording is None:
        raise GraspRefineError(NOTHING_TO_SHOW)
    return film(state.scene, state.recording, state.targets)


def film(scene: Scene, recording: Recording, targets: Sequence[Target] = ()) -> Film:
    """Return the film of a recording: of a refinement, with lines where links and object touch; else with pushes."""
    prepared = HandObject.of(scene)
    size = float(np.linalg.norm(scene.object.mesh.extents))
    frames, contacts = [], []
    for k in subsample(len(recording), MAX_FRAMES).tolist():
        pose = recording.pose(k)
        frame = Frame(
            pose,
            recording.text(k),
            T_object=recording.object_pose(k),
            T_bodies={name: T[k] for name, T in recording.T_bodies.items()},
        )
        if isinstance(recording, Trace):
            found = contacts_of(prepared, pose.T_object_root, pose.q, gap=recording.gap[k], targets=targets)
            contacts.append(found)
            lines = segments(found.point_link, found.point_object).astype(float)
            frame = replace(frame, caption=recording.caption(k), lines=lines, colors=distance_colors(found.distance))
        elif recording.is_pushed(k):
            arrow = push_arrow(prepared, recording.object_pose(k), recording.force, PUSH_SHARE * size)
            frame = replace(frame, push=arrow_lines(arrow, 0.3 * PUSH_SHARE * size))
        frames.append(frame)
    first = frames[0].pose
    seen = contacts[-1] if contacts else contacts_of(prepared, first.T_object_root, first.q)
    title = f"{scene.hand.name} and {scene.object.name}: {recording.title}"
    return Film(title, scene.hand, scene.object, frames, first_camera_of(seen), scene.environment)


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
    light(scene, view)
    scene.world_axes.visible = False
    camera.fov, camera.up, camera.near = FIELD_OF_VIEW_RAD, UP, 0.005
    camera.position, camera.look_at = view.position, view.look_at


class _FilmNodes:
    """Scene nodes of a film."""

    def __init__(self, scene: viser.SceneApi, film: Film) -> None:
        """Make all nodes, at their poses in the first frame."""
        first = film.frames[0]
        self._object = scene.add_frame("/object", show_axes=False)
        Meshes(scene, "/object/mesh", object_shapes(film.object, "mesh"), opacity=OPACITY, shadow=False)
        shapes, poses = visual_shapes(film.hand), LinkPoses.of(film.hand)
        self._hand = HandMeshes(scene, "/hand", shapes, poses, shadow=False)
        ghost = {"opacity": GHOST_OPACITY, "color": GHOST_COLOR, "shadow": False}
        HandMeshes(scene, "/ghost", shapes, poses, **ghost).move(first.pose)
        around = film.environment
        self._environment = (
            None if around is None else EnvironmentNodes(scene, "/environment", around, film.object.body)
        )
        self._lines = Lines(scene, "/contacts", 3.0)
        self._push = Lines(scene, "/push", 5.0)
        self._caption = scene.add_label(CAPTION_NODE, first.caption, visible=False)

    def show(self, frame: Frame) -> None:
        """Move all nodes to their poses in a frame."""
        self._hand.move(frame.pose)
        place(self._object, frame.T_object)
        if self._environment is not None:
            self._environment.move(frame.T_bodies)
        self._lines.draw(frame.lines, frame.colors)
        self._push.draw(frame.push, np.tile(PUSH_COLOR, (len(frame.push), 1)))
        self._caption.text = frame.caption


def _with_title(html: str, title: str) -> str:
    """Return the page with its title in the window's title bar and above the scene."""
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + HEADING.replace("TITLE", escape(title)) + html[end:]
