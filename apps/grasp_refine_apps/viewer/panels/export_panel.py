"""Tab "Files": open grasps, uploads, and export of grasp, picture and animation."""

from __future__ import annotations

import html
import io
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import viser
from PIL import Image

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.export.targets import TARGETS, export
from grasp_refine.geometry.units import NAMES
from grasp_refine.grasps.formats.listing import FORMATS
from grasp_refine.objects.region import ContactRegions, Faces
from grasp_refine.problem.exports import exported_grasps
from grasp_refine_apps.viewer.drawing.camera import FirstCamera
from grasp_refine_apps.viewer.files.animation import animation_html, film_of
from grasp_refine_apps.viewer.files.gif import RENDER_TIMEOUT_S, SETTLE_S, recorded_gif
from grasp_refine_apps.viewer.files.opening import HOLE_LABELS, MeshOptions, Opened, open_upload
from grasp_refine_apps.viewer.files.saved_results import with_results
from grasp_refine_apps.viewer.files.saving import Saved, grasp_file, grasp_set, grasp_sets
from grasp_refine_apps.viewer.files.uploads import MAX_UPLOAD_BYTES, UPLOAD_SUFFIXES, Uploads, shown_name, too_large
from grasp_refine_apps.viewer.jobs.batches import batches
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.store import BUSY_MESSAGE
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.choice import CHOICES, chosen
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.names import file_stem, shortened
from grasp_refine_apps.viewer.model.painting import faces_file
from grasp_refine_apps.viewer.model.present import present
from grasp_refine_apps.viewer.model.state import JobKind, State
from grasp_refine_apps.viewer.model.work import Work
from grasp_refine_apps.viewer.panels.widgets import on_change, on_click
from grasp_refine_apps.viewer.server.viser_private import MAX_CONCURRENT_UPLOADS, Site, limit_uploads, pages_of

UNSPECIFIED_UNIT = "ask me"
"""Label of a unit that is not specified."""
COPY_LINK = (
    '<div style="padding:.2em 1em .6em;font-size:.85em"><button data-copy-link style="cursor:pointer">'
    "Copy link</button> to this grasp and tab; the address of the page follows, too</div>"
)
"""Button that copies the address; the page's own script does it."""
MAX_PICTURE_PIXELS = 4096
"""Maximum pixels of a picture's longer side; browsers may report any size."""


class ExportPanel:
    """Open grasps, uploads and downloads; downloads go only to the browser that requests them."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self.uploads = Uploads()
        self._collection: Collection | None = None
        self.settle: Callable[[float], None] = lambda seconds: None
        """Waits until what the controller shows is drawn, for some seconds at most; set by whoever draws."""
        gui = server.gui
        self.opened = gui.add_html("")
        with gui.add_folder("Open"):
            self.shelf: Any = gui.add_dropdown(
                "Show", ("-",), visible=False, hint="Files that were opened, as you left them"
            )
            self.upload = gui.add_upload_button(
                "Upload mesh, hand or grasps",
                icon=viser.Icon.UPLOAD,
                mime_type=",".join(UPLOAD_SUFFIXES),
                hint=f"A mesh, a URDF or a zip of a hand with its meshes, or a grasp file; up to "
                f"{MAX_UPLOAD_BYTES // 2**20} MiB",
            )
            self.unit = gui.add_dropdown(
                "Mesh unit", (UNSPECIFIED_UNIT, *NAMES.values()), hint="Unit of the numbers in an uploaded mesh"
            )
            self.scale = gui.add_number(
                "Mesh scale",
                1.0,
                min=1e-6,
                max=1e6,
                step=1e-6,
                hint="Factor on the size of an uploaded mesh, besides its unit",
            )
            self.holes = gui.add_dropdown(
                "Mesh holes", tuple(HOLE_LABELS.values()), hint="What to do with an uploaded mesh that is not closed"
            )
        with gui.add_folder("Export"):
            self.format = gui.add_dropdown(
                "Format", tuple(known.name for known in FORMATS), hint="\n".join(known.what for known in FORMATS)
            )
            self.save = gui.add_button(
                "Save grasp", icon=viser.Icon.DOWNLOAD, hint="Download the hand as it is shown, in this format"
            )
            self.which = gui.add_dropdown("Several", CHOICES, hint="Which grasps the next button saves")
            self.save_all = gui.add_button(
                "Save them all", icon=viser.Icon.DOWNLOAD, hint="Download these grasps as they stand, in this format"
            )
            self.program = gui.add_dropdown("Program", TARGETS, hint="What the next button writes a folder for")
            self.export = gui.add_button(
                "Export for this program",
                icon=viser.Icon.PACKAGE_EXPORT,
                hint="Download a zip of the folder that refine-grasp export writes for it, with the grasps of Several",
            )
            self.faces = gui.add_button(
                "Painted faces (TXT)",
                icon=viser.Icon.DOWNLOAD,
                visible=False,
                hint="Download the numbers of the faces to touch and to avoid, as --touch faces:FILE reads them",
            )
            self.picture = gui.add_button(
                "Screenshot (PNG)", icon=viser.Icon.CAMERA, hint="Download what you see of the scene"
            )
            self.animation = gui.add_button(
                "Animation (HTML)",
                icon=viser.Icon.MOVIE,
                hint="Download the last refinement, or the simulation that is shown, as a page that plays anywhere",
            )
            self.gif = gui.add_button(
                "Animation (GIF)",
                icon=viser.Icon.GIF,
                hint="Download the same as a GIF, from where your camera is; it is played once for that",
            )
            gui.add_html(COPY_LINK)
        self.doing = gui.add_markdown("", visible=False)
        self.stop = gui.add_button("Stop", visible=False, hint="Stop opening or saving")
        on_click(self.stop, controller.stop)
        self.upload.on_upload(self._uploaded)
        on_change(self.shelf, self._reopen)
        self.save.on_click(self._save_grasp)
        self.save_all.on_click(self._save_several)
        self.export.on_click(self._export)
        self.faces.on_click(self._send_faces)
        self.picture.on_click(self._send_picture)
        self.animation.on_click(self._animate)
        self.gif.on_click(self._record)
        limit_uploads(server, MAX_UPLOAD_BYTES, self._refused)

    def draw(self, state: State) -> None:
        """Show a state."""
        if state.collection is not self._collection:
            other = self._collection is None or not self._collection.same_grasps(state.collection)
            self._collection = state.collection
            if other:
                self.opened.content = open_html(state.collection)
        regions = state.scene.regions or ContactRegions()
        self.faces.visible = any(isinstance(region, Faces) for region in (*regions.touch, *regions.avoid))
        job = state.job
        ours = job is not None and job.kind in ("load", "cut", "export")
        self.doing.visible = self.stop.visible = ours
        if ours and job is not None:
            share = "" if job.share is None else f", {job.share:.0%}"
            self.doing.content = f"{job.what[:1].upper()}{job.what[1:]}{share} …"
        titles = shelf_titles(state)
        if self.shelf.options != titles:
            self.shelf.options = titles
        self.shelf.visible = len(titles) > 1
        self.shelf.value = titles[0]

    def close(self) -> None:
        """Delete the uploads."""
        self.uploads.close()

    # uploads

    def _refused(self, name: str, size: int) -> None:
        text = f"{shown_name(name)}: {MAX_CONCURRENT_UPLOADS} files are being uploaded already; wait for them"
        text = f"{shown_name(name)}: is empty" if not size else text
        self._controller.notify(too_large(name, size) if size > MAX_UPLOAD_BYTES else text, bad=True)

    def _uploaded(self, event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
        """Check and open what a browser sent."""
        file = event.target.value
        units, holes = {words: key for key, words in NAMES.items()}, {words: key for key, words in HOLE_LABELS.items()}
        options = MeshOptions(
            units.get(self.unit.value), holes.get(self.holes.value, "refuse"), float(self.scale.value)
        )
        now, shown = self._controller.state, shown_name(file.name)
        pose = now.standing

        def work(control: Control) -> None:
            control.describe(f"checking {shown}")
            upload = self.uploads.receive(file.name, file.content)
            control.check()
            control.describe(f"opening {shown}")
            open_now = Opened(now.collection.problem, now.collection.stand_ins)
            opened = open_upload(upload, now.scene, pose, control, options, open_now)
            found = Collection.of(opened.problem, opened.stand_ins)
            control.check()
            self._controller.grasps.open(found, now.number if opened.attached else found.first)
            self._controller.background.measure()
            self._controller.notify(opened_text(shown, found, opened, now.collection))

        self._run("load", f"opening {shown}", work)

    def _reopen(self, title: str) -> None:
        """Show grasps again that were open before."""
        titles = shelf_titles(self._controller.state)
        if title in titles[1:]:
            self._controller.grasps.reopen(titles.index(title) - 1)

    # export

    def _save_grasp(self, event: viser.GuiEvent) -> None:
        """Send the grasp that is shown, as a file."""
        now, to, client = self._controller.state, self.format.value, event.client
        if client is None or not self._controller.background.ready():
            return
        pose = now.standing
        group, counted = now.collection.group(now.number), self._controller.contacts.counted(now)

        def work(control: Control) -> None:
            grasps = grasp_set(now.scene, pose, group.object, group.scale, now.targets, counted=counted)
            control.check()
            number = str(group.index[now.collection.member[now.number]])
            saved = grasp_file(now.collection.hand, grasps, to, number)
            control.check()
            self._send(client, saved)
            self._controller.grasps.mark_saved({now.number: pose})
            if saved.notes:
                self._controller.notify(f"{saved.name}: {'; '.join(saved.notes)}")

        self._run("export", f"saving as {to}", work)

    def _save_several(self, event: viser.GuiEvent) -> None:
        """Send all chosen grasps as they stand, as one file."""
        now, to, client = self._controller.state, self.format.value, event.client
        if client is None:
            return
        works = self._works(now)
        if not works:
            self._controller.notify(f"no grasp is {self.which.value}: choose others", bad=True)
            return
        what = f"saving {count_text(len(works), 'grasp')} as {to}"

        def work(control: Control) -> None:
            control.describe(what)
            collection = self._controller.background.cut_all(works, control)
            grasps = grasp_sets(collection, works, lambda share: control.report(share, what), control.check)
            control.check()
            saved = grasp_file(now.collection.hand, grasps, to)
            saved = with_results(saved, to, present(replace(now, collection=collection)), works)
            control.check()
            self._send(client, saved)
            self._controller.grasps.mark_saved({number: one.standing for number, one in works.items()})
            notes = "".join(f"; {note}" for note in saved.notes)
            self._controller.notify(f"{count_text(len(works), 'grasp')} saved as {saved.name}{notes}")

        self._run("export", what, work)

    def _works(self, now: State) -> dict[int, Work]:
        """Return number and work of all chosen grasps."""
        return {n: now.works.get(n) or now.collection.work(n) for n in chosen(now, self.which.value)}

    def _export(self, event: viser.GuiEvent) -> None:
        """Send the folder of all chosen grasps as they stand for another program, as a zip."""
        now, to, client = self._controller.state, str(self.program.value), event.client
        if client is None:
            return
        # Forces and closing motions are made for the grasps as they stand.
        works = {n: replace(work, targets=()) for n, work in self._works(now).items() if work.standing.posed}
        if not works:
            self._controller.notify(f"no grasp that can be drawn is {self.which.value}: choose others", bad=True)
            return
        what = f"exporting {count_text(len(works), 'grasp')} for {to}"

        def work(control: Control) -> None:
            control.describe(what)
            collection = self._controller.background.cut_all(works, control)
            groups = tuple(batch.group for batch in batches(collection, works, len(works)))
            parts = exported_grasps(replace(collection.problem, groups=groups), closing="own")
            control.check()
            with TemporaryDirectory() as folder:
                name = f"{file_stem(collection.hand.name)}_{to}"
                export(parts, to, Path(folder) / name)
                packed = shutil.make_archive(str(Path(folder) / "packed"), "zip", folder, name)
                self._send(client, Saved(f"{name}.zip", Path(packed).read_bytes()))

        self._run("export", what, work)

    def _send_faces(self, event: viser.GuiEvent) -> None:
        """Send the painted faces, a file for each kind of region."""
        scene, client = self._controller.state.scene, event.client
        if client is None or scene.regions is None:
            return
        try:
            faces = self._controller.regions.painted_faces(scene.object)
        except GraspRefineError as error:
            self._controller.notify(str(error), bad=True)
            return
        options = []
        for verb, regions in (("touch", scene.regions.touch), ("avoid", scene.regions.avoid)):
            if text := faces.text(regions):
                name = faces_file(scene.object, verb)
                self._send(client, Saved(name, text.encode()))
                options.append(f"--{verb} faces:{name}")
        self._controller.notify(f"saved: run, view and validate take them with {' '.join(options)}")

    def _send_picture(self, event: viser.GuiEvent) -> None:
        """Send a picture of the scene as the browser shows it."""
        client, now = event.client, self._controller.state
        if client is None:
            return
        if now.gizmo != "none":
            self._controller.set(gizmo="none")
            self.settle(RENDER_TIMEOUT_S)
            time.sleep(SETTLE_S)
        try:
            image = client.get_render(*_size(client.camera), transport_format="png", timeout=RENDER_TIMEOUT_S)
        except (RuntimeError, TimeoutError) as error:
            if client.client_id in pages_of(self._server):
                self._controller.notify(f"there is no picture: the browser drew none ({error}); try again", bad=True)
            return
        finally:
            self._controller.set(gizmo=now.gizmo)
        self._send(client, Saved(f"{_stem(now)}.png", png(image)))

    def _animate(self, event: viser.GuiEvent) -> None:
        """Send the last refinement, or the simulation that is shown, as an HTML page."""
        now, client = self._controller.state, event.client
        if client is None:
            return

        camera = client.camera
        view = camera_in_object(now, np.array(camera.position), np.array(camera.look_at))

        def work(control: Control) -> None:
            film = replace(film_of(now), camera=view)
            control.check()
            page = animation_html(film)
            control.check()
            self._send(client, Saved(f"{_stem(now)}.html", page.encode()))

        self._run("export", "making the animation", work)

    def _record(self, event: viser.GuiEvent) -> None:
        """Send the last refinement, or the simulation that is shown, as a GIF from this browser's camera."""
        now, client = self._controller.state, event.client
        if client is None:
            return
        size = _size(client.camera)

        def work(control: Control) -> None:
            recorded = recorded_gif(self._controller, client, size, self.settle, control)
            self._send(client, Saved(f"{_stem(now)}.gif", recorded))

        self._run("export", "recording a GIF", work)

    def _run(self, kind: JobKind, what: str, work: Callable[[Control], None]) -> None:
        if not self._controller.run_job(kind, what, work):
            self._controller.notify(BUSY_MESSAGE, bad=True)

    def _send(self, client: viser.ClientHandle, saved: Saved) -> None:
        """Send a file to a browser, if it is still connected."""
        if client.client_id in pages_of(self._server):
            client.send_file_download(saved.name, saved.content, save_immediately=True)


def camera_in_object(state: State, position: np.ndarray, look_at: np.ndarray) -> FirstCamera:
    """Return a camera of the scene (3,), (3,) in the frame of the object, in which films are made."""
    T = inverse(state.T_world_object)
    return FirstCamera(transform_points(T, position), transform_points(T, look_at))


def shelf_titles(state: State) -> tuple[str, ...]:
    """Titles of the open grasps and of the shelf, all different."""
    titles: list[str] = []
    for collection in (state.collection, *(each.collection for each in state.shelf)):
        title, count = collection.title, 2
        while title in titles:
            title, count = f"{collection.title} ({count})", count + 1
        titles.append(title)
    return tuple(titles)


def opened_text(name: str, found: Collection, opened: Opened, before: Collection) -> str:
    """Sentence on what an upload became."""
    if opened.attached:
        count = int((found.objects == opened.attached).sum())
        return f"{name} is the object '{opened.attached}' of {count_text(count, 'grasp')}"
    text = f"{name} is open: {_sentence(found)}"
    if before.stand_ins and found.problem.sampled.startswith("upload:"):
        missing = ", ".join(sorted(before.stand_ins))[:200]
        text += f". It is not named like an object that is missing ({missing}): to attach a mesh, name its file so"
    return f"{text}. What was open before is under Show" if len(before) else text


def open_html(collection: Collection) -> str:
    """Description of the open grasps as HTML, with the notes of their readers."""
    problem = collection.problem
    objects = ", ".join(dict.fromkeys(group.object for group in problem.groups))
    files = problem.sampled or ", ".join(path.name for path in problem.files)
    if len(files) > 200:
        files = f"{files[:200]} …"
    lines = [
        ("Hand", f"{problem.hand.name} ({problem.hand.urdf.name}), {len(problem.hand.joint_names)} joints"),
        ("Object", shortened(objects if len(objects) <= 200 else f"{objects[:200]} …")),
        ("Grasps", f"{len(problem)} from {files}"),
    ]
    text = "<br>".join(f"<b>{name}</b> {html.escape(what)}" for name, what in lines)
    if problem.notes:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in problem.notes)
        text += (
            f"<details><summary>{count_text(len(problem.notes), 'note')}</summary>"
            f'<ul style="margin:0.3em 0;padding-left:1.2em">{notes}</ul></details>'
        )
    style = "padding:0.5em 1em;line-height:1.5;font-size:0.85em;overflow-wrap:anywhere;max-height:18em;overflow:auto"
    return f'<div style="{style}">{text}</div>'


def png(image: np.ndarray) -> bytes:
    """Encode a picture (H, W, 4), or (H, W, 3), on white, as a PNG file."""
    drawn = Image.fromarray(np.asarray(image, dtype=np.uint8)).convert("RGBA")
    white = Image.new("RGBA", drawn.size, (255, 255, 255, 255))
    stream = io.BytesIO()
    Image.alpha_composite(white, drawn).convert("RGB").save(stream, "PNG")
    return stream.getvalue()


def _size(camera: viser.CameraHandle) -> tuple[int, int]:
    """Height and width in pixels of a browser's scene, limited to the size of a picture."""
    height, width = max(int(camera.image_height), 1), max(int(camera.image_width), 1)
    factor = min(1.0, MAX_PICTURE_PIXELS / max(height, width))
    return max(int(height * factor), 1), max(int(width * factor), 1)


def _stem(state: State) -> str:
    """Name of a file without suffix, of hand, object and number."""
    return file_stem(f"{state.collection.hand.name}_{state.collection.name(state.number)}")


def _sentence(collection: Collection) -> str:
    count = len(collection)
    objects = ", ".join(dict.fromkeys(group.object for group in collection.problem.groups))
    what = f"{count_text(count, 'grasp')} of {collection.hand.name} on {objects}"
    drawn = ", drawn at random" if collection.problem.sampled and count > 1 else ""
    return f"{what}{drawn}"[:300]
