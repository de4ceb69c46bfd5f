"""The tab "Files" with a real server and a client that uploads, clicks and downloads as a browser does."""

import csv
import io
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import viser
from PIL import Image

from grasp_refine.core.se3 import exp_se3, pose_from_transform
from grasp_refine.core.short_repr import labels
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.files.gif import END_MS, FRAME_MS, MAX_FRAMES, recorded_gif
from grasp_refine_apps.viewer.files.uploads import MAX_UPLOAD_BYTES
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.recording import subsample
from grasp_refine_apps.viewer.panels import export_panel
from grasp_refine_apps.viewer.panels.banner import banner_text
from grasp_refine_apps.viewer.panels.export_panel import ExportPanel, open_html, png, shelf_titles
from grasp_refine_apps.viewer.server.viser_private import MAX_CONCURRENT_UPLOADS, uploads_under_way
from open_viewer import ignored
from refusals import assert_names
from viser_client import Client
from websocket_page import until

BOX = trimesh.creation.box((0.04, 0.05, 0.06)).export(file_type="stl")


@pytest.fixture(scope="module")
def collection() -> Collection:
    """One grasp of the Allegro hand on a ball."""
    hand, ball = load_hand("allegro", candidates=16), load_object("sphere:0.03", candidates=64)
    T, rows = exp_se3(np.array([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]])), np.arange(1)
    grasps = GraspSet.of(hand, T, hand.rest[None], object="sphere:0.03")
    group = Group("sphere:0.03", 1.0, Scene(hand, ball, T, hand.rest[None]), grasps, rows, rows, rows)
    return Collection.of(Problem(hand, (hand.urdf,), (group,), ("a <b>note</b>",), "sample:1"))


pytestmark = pytest.mark.usefixtures("untried")


@dataclass
class Shown:
    """A panel, and two browsers that look at it."""

    server: viser.ViserServer
    controller: Controller
    panel: ExportPanel
    one: Client
    other: Client

    def told(self, *named: str, bad: bool = False) -> bool:
        """Whether the user is told, sooner or later, something that names each of these."""

        before = self.controller.state.notice

        def is_told() -> bool:
            notice = self.controller.state.notice
            found = notice is not None and notice.bad == bad and all(one in notice.text for one in named)
            # Whatever else goes wrong is known at once.
            assert found or notice is None or notice is before or not notice.bad, notice.text
            return found

        return bool(until(is_told))


@pytest.fixture
def shown(collection: Collection) -> Iterator[Shown]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    controller = Controller(collection, Settings(geometry_only=True))
    panel = ExportPanel(server, controller)
    controller.listen(panel.draw)
    panel.draw(controller.state)
    with Client(server) as one, Client(server) as other:
        yield Shown(server, controller, panel, one, other)
    controller.close()
    panel.close()
    assert not panel.uploads.path.exists()
    server.stop()


def grasps_of(shown: Shown, count: int, name: str) -> bytes:
    """A grasp file of the same grasp several times."""
    hand, content = shown.controller.state.collection.hand, io.BytesIO()
    T = np.repeat(shown.controller.state.pose.T_object_root[None], count, axis=0)
    np.savez(content, **GraspSet.of(hand, T, np.repeat(hand.rest[None], count, axis=0), object=name).arrays())
    return content.getvalue()


def settle(shown: Shown) -> None:
    until(lambda: shown.controller.state.job is None)


def test_an_uploaded_mesh_takes_the_place_of_the_object_which_comes_back_as_it_was_left(shown: Shown):
    made, panel = shown.controller, shown.panel
    made.editor.set_joint(0, 0.1)
    before = made.state
    shown.one.upload(panel.upload, "bad.stl", b"solid nothing", key="1")
    assert shown.told("bad.stl", bad=True)
    assert made.state.scene.object is before.scene.object
    assert [*panel.uploads.path.iterdir()] == [panel.uploads.path / "1"]
    large = trimesh.creation.box((40, 50, 60)).export(file_type="stl")
    shown.one.upload(panel.upload, "My Box.stl", large, key="2", part=300)
    assert shown.told("My Box.stl", "Mesh unit", "millimetres", "40 x 50 x 60 mm", bad=True)
    shown.one.change(panel.unit, "millimetres")
    until(lambda: panel.unit.value == "millimetres")
    shown.one.upload(panel.upload, "My Box.stl", large, key="3", part=300)
    assert shown.told("My Box.stl", "1 grasp", "allegro", "My_Box", "Show")
    settle(shown)
    np.testing.assert_allclose(made.state.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    np.testing.assert_allclose(made.state.pose.T_object_root, before.pose.T_object_root, atol=1e-12)
    assert not unmeasured(made.state.collection).any() and "My_Box" in panel.opened.content
    until(lambda: panel.shelf.visible)
    assert made.state.num_unsaved == 1 and not made.state.unsaved
    titles = panel.shelf.options
    assert len(titles) == 2 and "My_Box" in titles[0] and "sphere" in titles[1]
    shown.one.change(panel.shelf, titles[1])
    until(lambda: made.state.collection.problem is before.collection.problem)
    assert made.state.work is before.work and made.state.unsaved == (0,)
    shown.one.change(panel.shelf, shelf_titles(made.state)[1])
    until(lambda: "My_Box" in made.state.collection.title)
    assert len(made.state.shelf) == 1


def test_a_stand_in_is_reported_over_the_scene_until_its_mesh_comes(shown: Shown):
    assert banner_text(shown.controller.state) == ""
    shown.one.upload(shown.panel.upload, "grasps.npz", grasps_of(shown, 5, "core/my box"), key="1")
    assert shown.told("grasps.npz", "5 grasps")
    assert_names(banner_text(shown.controller.state), "Stand-in", "'core/my box'", "'sphere:0.03'")
    settle(shown)
    shown.controller.grasps.show(3)
    shown.one.upload(shown.panel.upload, "My Box.stl", BOX, key="2")
    assert shown.told("My Box.stl", "'core/my box'", "5 grasps")
    state = shown.controller.state
    assert len(state.collection) == 5 and state.number == 3 and banner_text(state) == ""
    np.testing.assert_allclose(state.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    # Nothing was made of them on the stand-in, which is not worth keeping.
    assert len(state.shelf) == 1 and "sphere" in state.shelf[0].collection.title


def test_many_are_saved_together_as_they_stand(shown: Shown):
    made, hand = shown.controller, shown.controller.state.collection.hand
    shown.one.upload(shown.panel.upload, "grasps.npz", grasps_of(shown, 3, "sphere:0.03"))
    assert shown.told("grasps.npz", "3 grasps")
    settle(shown)
    made.grasps.show(1)
    made.editor.set_joint(2, 0.3)
    made.many.refine((2,))
    until(lambda: made.state.job is None and made.state.unsaved == (1, 2))
    works = made.state.works
    shown.one.change(shown.panel.save_all, True)
    name, saved = shown.one.download()
    path = shown.panel.uploads.path / "again.npz"
    path.write_bytes(saved)
    again, outcome = load_grasps(path), works[2].outcome
    assert len(again) == 3 and name.endswith(".npz")
    np.testing.assert_allclose(again.q, [hand.rest, works[1].pose.q, works[2].pose.q])
    np.testing.assert_allclose(again.squeeze.q[2], outcome.stage_q[0, -1])
    reopened = Collection.of(load_problem(ProblemSpec(grasps=path, object="sphere:0.03", hand=str(hand.toml))))
    for key, value in outcome.entries().items():
        if key in reopened.columns:
            np.testing.assert_allclose(reopened.columns[key].values[2], value[0])
    assert {"quality_before", "quality_after", "contact_error_m_after"} <= reopened.columns.keys()
    assert reopened.columns["status"].values.tolist() == ["", "", labels(Status, outcome.status)[0]]
    assert reopened.columns["change"].values.tolist() == ["", "", outcome.change[0]] != ["", "", ""]
    np.testing.assert_array_equal(reopened.recorded(2).gap, outcome.contact_gap[0])
    np.testing.assert_allclose(reopened.initial(2)[1], hand.rest)
    with np.load(path) as entries:
        assert set(entries["forces_grasp"].tolist()) <= {2}
    until(lambda: made.state.unsaved == ())


def test_downloads_go_to_the_browser_that_asks(shown: Shown, tmp_path: Path):
    made, panel, T = shown.controller, shown.panel, exp_se3(np.array([0.01, 0.02, 0.12, 0.1, 0.2, 0.3]))
    shown.one.change(panel.animation, True)
    assert shown.told(bad=True)
    made.editor.move_root(T)
    (tmp_path / "some.txt").write_text("0 7 12")
    assert not panel.faces.visible
    made.regions.set("", f"above:z=0.02; faces:{tmp_path / 'some.txt'}")
    assert panel.faces.visible
    made.refinement.start()
    until(lambda: made.state.outcome is not None and made.state.job is None)
    for button, expected in (
        (panel.faces, "sphere_0.03_avoid.txt"),
        (panel.animation, "allegro_sphere_0.03_0.html"),
    ):
        shown.one.change(button, True)
        until(lambda expected=expected: expected in shown.one.downloads())
        settle(shown)
    made.editor.undo()
    shown.one.change(panel.save, True)
    until(lambda: len(shown.one.downloads()) == 3)
    files = shown.one.downloads()
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    again = contact_regions(made.state.scene.object, avoid=f"faces:{tmp_path / 'sphere_0.03_avoid.txt'}")
    assert again is not None and np.flatnonzero(again.avoid[0].chosen).tolist() == [0, 7, 12]
    assert b"<html" in files["allegro_sphere_0.03_0.html"][:1000].lower()
    grasps = load_grasps(tmp_path / "allegro_sphere_0.03_0_ours.npz")
    np.testing.assert_allclose(grasps.hand_pose, pose_from_transform(T[None]), atol=1e-12)
    assert grasps.pregrasp is not None and grasps.squeeze is not None and not shown.other.downloads()


def test_a_format_that_cannot_hold_it_and_a_busy_worker_are_reported(shown: Shown):
    shown.one.change(shown.panel.format, "leap_cache")
    until(lambda: shown.panel.format.value == "leap_cache")
    shown.one.change(shown.panel.save, True)
    assert shown.told("leap_cache", "'allegro'", bad=True)
    settle(shown)
    ended = threading.Event()
    assert shown.controller.run_job("load", "something long", lambda control: ended.wait() and None)
    shown.one.change(shown.panel.save, True)
    assert shown.told(bad=True) and not shown.one.downloads()
    ended.set()


def test_a_browser_that_left_gets_nothing(shown: Shown):
    """The job ends all the same, and the others see nothing of it."""
    shown.one.change(shown.panel.save, True)
    until(lambda: shown.controller.state.job is not None)
    shown.one.close()
    settle(shown)
    assert shown.controller.state.notice is None and not shown.other.downloads()


def test_a_picture_comes_as_the_browser_drew_it_on_white(shown: Shown, monkeypatch: pytest.MonkeyPatch):
    shown.one.change(shown.panel.picture, True)
    until(lambda: shown.one.of("GetRenderRequestMessage"))
    (asked,) = shown.one.of("GetRenderRequestMessage")
    assert (asked["height"], asked["width"], asked["format"]) == (600, 800, "image/png")
    drawn = io.BytesIO()
    Image.new("RGBA", (64, 48), (255, 0, 0, 0)).save(drawn, "PNG")
    shown.one.draw(asked, drawn.getvalue())
    name, content = shown.one.download()
    assert name == "allegro_sphere_0.03_0.png"
    picture = Image.open(io.BytesIO(content))
    assert picture.size == (64, 48) and picture.getpixel((3, 3)) == (255, 255, 255)
    half = np.zeros((2, 3, 4), dtype=np.uint8)
    half[..., 3] = 128
    assert Image.open(io.BytesIO(png(half))).getpixel((0, 0)) == (127, 127, 127)
    # One that draws nothing holds nothing up.
    monkeypatch.setattr(export_panel, "RENDER_TIMEOUT_S", 0.3)
    shown.one.change(shown.panel.picture, True)
    assert shown.told(bad=True)


@pytest.mark.slow
def test_a_gif_has_the_frames_of_the_recording_and_the_view_stays(shown: Shown):
    """A browser that is only written down: it draws the number of the frame that it is shown."""
    made = shown.controller
    made.refinement.start()
    until(lambda: made.state.outcome is not None and made.state.job is None)
    frames, asked = subsample(len(made.state.trace), MAX_FRAMES).tolist(), []
    assert len(frames) == MAX_FRAMES < len(made.state.trace)

    def render(height: int, width: int, **_: object) -> np.ndarray:
        asked.append((height, width, made.state.frame))
        return np.full((height, width, 3), 5 * len(asked), dtype=np.uint8)

    made.player.scrub(1)
    content = recorded_gif(made, SimpleNamespace(get_render=render), (500, 1440), lambda seconds: None, ignored())
    assert asked == [(250, 720, frame) for frame in frames] and made.state.frame == 1
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.size == (720, 250) and picture.n_frames == len(frames) and picture.info["loop"] == 0
        durations = []
        for number in range(len(frames)):
            picture.seek(number)
            durations.append(picture.info["duration"])
    assert durations == [FRAME_MS] * (len(frames) - 1) + [END_MS]


def test_too_large_uploads_are_refused_before_they_come(shown: Shown):
    states = uploads_under_way(shown.server)
    shown.one.upload(shown.panel.upload, "big.stl", bytes(2**20), said=MAX_UPLOAD_BYTES + 1)
    assert shown.told("big.stl", "64 MiB", bad=True)
    # The browser is told that it is over, or it would wait for ever.
    until(lambda: shown.one.of("FileTransferPartAck"))
    ack = shown.one.of("FileTransferPartAck")[-1]
    assert ack["transferred_bytes"] == ack["total_bytes"] == MAX_UPLOAD_BYTES + 1
    assert not states


def test_more_bytes_than_were_announced_are_dropped(shown: Shown):
    states, button = uploads_under_way(shown.server), shown.panel.upload
    shown.one.announce(button, "a.stl", 1000, 100)
    until(lambda: "1" in states)
    shown.one.send_part(button, 0, bytes(900))
    shown.one.send_part(button, 1, bytes(900))
    until(lambda: not states)


def test_many_uploads_at_once_are_refused(shown: Shown):
    states = uploads_under_way(shown.server)
    for number in range(MAX_CONCURRENT_UPLOADS + 3):
        shown.one.announce(shown.panel.upload, "a.stl", 1000, 2, str(number))
    assert shown.told("a.stl", "4 files", bad=True)
    assert len(states) == MAX_CONCURRENT_UPLOADS
    # They go with the browser.
    shown.one.close()
    until(lambda: not states)


def test_what_is_open_is_shown_as_text(collection: Collection):
    text = open_html(collection)
    assert all(one in text for one in ("allegro (allegro.urdf)", "16 joints", "sample:1"))
    assert "a &lt;b&gt;note&lt;/b&gt;" in text


def test_an_empty_upload_is_refused(shown: Shown):
    """viser waits for its parts, and said nothing."""
    shown.one.announce(shown.panel.upload, "nothing.stl", 0, 0)
    assert shown.told("nothing.stl", "empty", bad=True)


def test_a_mesh_has_a_scale(shown: Shown):
    shown.panel.scale.value = 1.5
    shown.one.upload(shown.panel.upload, "box.stl", BOX)
    until(lambda: shown.controller.state.scene.object.name == "box")
    size = np.ptp(shown.controller.state.scene.object.mesh.vertices, axis=0)
    np.testing.assert_allclose(size, 1.5 * np.array([0.04, 0.05, 0.06]), rtol=1e-6)


def test_grasps_as_they_stand_are_exported_for_a_program(shown: Shown):
    controller, panel = shown.controller, shown.panel
    controller.editor.set_joint(2, 0.2)
    shown.one.change(panel.program, "csv")
    shown.one.change(panel.export, True)
    name, content = shown.one.download()
    assert name == "allegro_csv.zip"
    files = zipfile.ZipFile(io.BytesIO(content))
    (readme,) = (one for one in files.namelist() if one.endswith("README.md"))
    table = next(one for one in files.namelist() if one.endswith("grasps.csv"))
    (row,) = csv.DictReader(io.StringIO(files.read(table).decode()))
    assert readme and float(row[controller.state.collection.hand.joint_names[2]]) == pytest.approx(0.2)
