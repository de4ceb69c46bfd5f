"""The tab "Files": what is open, opening more, and taking grasp, picture and animation away."""

from __future__ import annotations

import html
import io
from collections.abc import Callable

import numpy as np
import viser
from PIL import Image

from grasp_refine.geometry.units import NAMES
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine_apps.viewer.animation import animation_html
from grasp_refine_apps.viewer.collection import Collection
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.film import film_of
from grasp_refine_apps.viewer.opening import HOLES, MeshOptions, opened
from grasp_refine_apps.viewer.saving import Saved, grasp_file, grasp_set
from grasp_refine_apps.viewer.state import JobKind, State
from grasp_refine_apps.viewer.upload_limit import MOST_AT_ONCE, limit_uploads
from grasp_refine_apps.viewer.uploads import ENDINGS, LARGEST_UPLOAD, Uploads, shown_name, too_large
from grasp_refine_apps.viewer.worker import Control

ASK = "ask me"
"""The unit that nobody has said."""
PATIENCE = 15.0
"""Seconds in which a browser must have drawn a picture; one that is hidden or hangs never does."""
LARGEST_PICTURE = 4096
"""Pixels of a picture's longer side; browsers say what they like."""
BUSY = "something else is being done: wait until it ends, or stop it, then try again"


class ExportPanel:
    """What is open, uploads and downloads; downloads go only to the browser that asks."""

    def __init__(self, server: viser.ViserServer, controller: Controller, uploads: Uploads | None = None) -> None:
        """Make the widgets inside the tab or folder that is open.

        Args:
            server: The server.
            controller: What is shown, and what can be done with it.
            uploads: Where uploads go; None: a folder of our own, until `close`.
        """
        self._server, self._controller = server, controller
        self._uploads = uploads or Uploads()
        self._collection: Collection | None = None
        gui = server.gui
        self._open = gui.add_html("")
        with gui.add_folder("Open"):
            self._upload = gui.add_upload_button(
                "Upload mesh, hand or grasps",
                icon=viser.Icon.UPLOAD,
                mime_type=",".join(ENDINGS),
                hint=f"A mesh, a URDF or a zip of a hand with its meshes, or a grasp file; up to "
                f"{LARGEST_UPLOAD // 2**20} MiB",
            )
            self._unit = gui.add_dropdown(
                "Mesh unit", (ASK, *NAMES.values()), hint="Unit of the numbers in an uploaded mesh"
            )
            self._holes = gui.add_dropdown(
                "Mesh holes", tuple(HOLES.values()), hint="What to do with an uploaded mesh that is not closed"
            )
        with gui.add_folder("Take away"):
            self._format = gui.add_dropdown(
                "Format", tuple(known.name for known in FORMATS), hint="\n".join(known.what for known in FORMATS)
            )
            self._save = gui.add_button(
                "Save grasp", icon=viser.Icon.DOWNLOAD, hint="Download the hand as it is shown, in this format"
            )
            self._picture = gui.add_button(
                "Screenshot (PNG)", icon=viser.Icon.CAMERA, hint="Download what you see of the scene"
            )
            self._animation = gui.add_button(
                "Animation (HTML)",
                icon=viser.Icon.MOVIE,
                hint="Download the last refinement, or the simulation that is shown, as a page that plays anywhere",
            )
        self._upload.on_upload(self._uploaded)
        self._save.on_click(self._save_grasp)
        self._picture.on_click(self._take_picture)
        self._animation.on_click(self._animate)
        limit_uploads(server, LARGEST_UPLOAD, self._refused)

    def draw(self, state: State) -> None:
        """Show a state."""
        if state.collection is not self._collection:
            other = self._collection is None or self._collection.problem is not state.collection.problem
            self._collection = state.collection
            if other:
                self._open.content = open_html(state.collection)

    def close(self) -> None:
        """Delete what was uploaded."""
        self._uploads.close()

    # opening

    def _refused(self, name: str, size: int) -> None:
        text = f"{shown_name(name)}: {MOST_AT_ONCE} files are being uploaded already; wait for them"
        self._controller.say(too_large(name, size) if size > LARGEST_UPLOAD else text, bad=True)

    def _uploaded(self, event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
        """Check and open what a browser sent."""
        file = event.target.value
        units, holes = {words: key for key, words in NAMES.items()}, {words: key for key, words in HOLES.items()}
        options = MeshOptions(units.get(self._unit.value), holes.get(self._holes.value, "refuse"))
        now, shown = self._controller.state, shown_name(file.name)
        pose = now.standing

        def work(control: Control) -> None:
            control.tell(None, f"checking {shown}")
            upload = self._uploads.receive(file.name, file.content)
            control.check()

            def tell(line: str) -> None:
                control.tell(None, line)

            tell(f"opening {shown}")
            problem = opened(upload, now.scene, pose, options=options, tell=tell, check=control.check)
            found = Collection.of(problem)
            control.check()
            self._controller.change_collection(found)
            self._controller.say(f"{shown} is open: {_sentence(found)}")

        self._run("load", f"opening {shown}", work)

    # taking away

    def _save_grasp(self, event: viser.GuiEvent) -> None:
        """Send the grasp that is shown, as a file."""
        now, to, client = self._controller.state, self._format.value, event.client
        if client is None:
            return
        pose = now.standing
        group = now.collection.group(now.number)

        def work(control: Control) -> None:
            grasps = grasp_set(now.scene, pose, group.object, group.scale, now.targets)
            control.check()
            saved = grasp_file(now.collection.hand, grasps, to)
            control.check()
            self._send(client, saved)
            if saved.notes:
                self._controller.say(f"{saved.name}: {'; '.join(saved.notes)}")

        self._run("export", f"saving as {to}", work)

    def _take_picture(self, event: viser.GuiEvent) -> None:
        """Send what a browser sees, as it sees it."""
        client, now = event.client, self._controller.state
        if client is None:
            return
        try:
            image = client.get_render(*_size(client.camera), transport_format="png", timeout=PATIENCE)
        except (RuntimeError, TimeoutError) as error:
            if client.client_id in self._server.get_clients():
                self._controller.say(f"there is no picture: the browser drew none ({error}); try again", bad=True)
            return
        self._send(client, Saved(f"{_stem(now)}.png", png(image)))

    def _animate(self, event: viser.GuiEvent) -> None:
        """Send the last refinement, or the simulation that is looked at, as a page."""
        now, client = self._controller.state, event.client
        if client is None:
            return

        def work(control: Control) -> None:
            film = film_of(now)
            control.check()
            page = animation_html(film)
            control.check()
            self._send(client, Saved(f"{_stem(now)}.html", page.encode()))

        self._run("export", "making the animation", work)

    def _run(self, kind: JobKind, what: str, work: Callable[[Control], None]) -> None:
        if not self._controller.run_job(kind, what, work):
            self._controller.say(BUSY, bad=True)

    def _send(self, client: viser.ClientHandle, saved: Saved) -> None:
        """Hand a file to a browser, if it is still there."""
        if client.client_id in self._server.get_clients():
            client.send_file_download(saved.name, saved.content, save_immediately=True)


def open_html(collection: Collection) -> str:
    """What is open, in words, and what its readers said."""
    problem = collection.problem
    objects = ", ".join(dict.fromkeys(group.object for group in problem.groups))
    files = problem.sampled or ", ".join(path.name for path in problem.files)
    if len(files) > 200:
        files = f"{files[:200]} …"
    lines = [
        ("Hand", f"{problem.hand.name} ({problem.hand.urdf.name}), {len(problem.hand.joint_names)} joints"),
        ("Object", objects if len(objects) <= 200 else f"{objects[:200]} …"),
        ("Grasps", f"{len(problem)} from {files}"),
    ]
    text = "<br>".join(f"<b>{name}</b> {html.escape(what)}" for name, what in lines)
    if problem.notes:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in problem.notes)
        text += (
            f"<details><summary>{len(problem.notes)} note{'' if len(problem.notes) == 1 else 's'}</summary>"
            f'<ul style="margin:0.3em 0;padding-left:1.2em">{notes}</ul></details>'
        )
    style = "padding:0.5em 1em;line-height:1.5;font-size:0.85em;overflow-wrap:anywhere;max-height:18em;overflow:auto"
    return f'<div style="{style}">{text}</div>'


def png(image: np.ndarray) -> bytes:
    """A picture (H, W, 4), or (H, W, 3), on white, as a file."""
    drawn = Image.fromarray(np.asarray(image, dtype=np.uint8)).convert("RGBA")
    white = Image.new("RGBA", drawn.size, (255, 255, 255, 255))
    stream = io.BytesIO()
    Image.alpha_composite(white, drawn).convert("RGB").save(stream, "PNG")
    return stream.getvalue()


def _size(camera: viser.CameraHandle) -> tuple[int, int]:
    """Height and width in pixels of what a browser shows, no longer than a picture may be."""
    height, width = max(int(camera.image_height), 1), max(int(camera.image_width), 1)
    factor = min(1.0, LARGEST_PICTURE / max(height, width))
    return max(int(height * factor), 1), max(int(width * factor), 1)


def _stem(state: State) -> str:
    """A file's name without its ending, of hand, object and number."""
    label = f"{state.collection.hand.name}_{state.collection.label(state.number)}"
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in label)[:100].lstrip(".")


def _sentence(collection: Collection) -> str:
    count = len(collection)
    objects = ", ".join(dict.fromkeys(group.object for group in collection.problem.groups))
    what = f"{count} grasp{'' if count == 1 else 's'} of {collection.hand.name} on {objects}"
    drawn = ", drawn at random" if collection.problem.sampled and count > 1 else ""
    return f"{what}{drawn}"[:300]
