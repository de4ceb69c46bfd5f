"""The tab "Files" with a real server and a client that uploads, clicks and downloads as a browser does."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
from grasp_refine_apps.viewer.files.uploads import MAX_UPLOAD_BYTES
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.panels import export_panel
from grasp_refine_apps.viewer.panels.banner import banner_text
from grasp_refine_apps.viewer.panels.export_panel import ExportPanel, open_html, png, shelf_titles
from grasp_refine_apps.viewer.server.viser_private import MAX_CONCURRENT_UPLOADS, uploads_under_way
from refusals import assert_names
from uploaded import gripper_zip
from viser_client import Client
from websocket_page import until

BOX = trimesh.creation.box((0.04, 0.05, 0.06)).export(file_type="stl")


@pytest.fixture(scope="module")
def collection() -> Collection:
    """One grasp of the Allegro hand on a ball."""
    hand, ball = load_hand("allegro", candidates=16), load_object("sphere:0.03", candidates=64)
    T = exp_se3(np.array([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]]))
    grasps = GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.array(["sphere:0.03"]),
        scale=np.ones(1),
        hand_pose=pose_from_transform(T),
        q=hand.rest[None],
    )
    rows = np.arange(1)
    group = Group("sphere:0.03", 1.0, Scene(hand, ball, T, hand.rest[None]), grasps, rows, rows, rows)
    return Collection.of(Problem(hand, (hand.urdf,), (group,), ("a <b>note</b>",), "sample:1"))


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


def test_an_uploaded_mesh_takes_the_place_of_the_object(shown: Shown):
    before = shown.controller.state
    shown.one.upload(shown.panel.upload, "My Box.stl", BOX, part=300)
    assert shown.told("My Box.stl", "1 grasp", "allegro", "My_Box")
    now = shown.controller.state
    np.testing.assert_allclose(now.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    np.testing.assert_allclose(now.pose.T_object_root, before.pose.T_object_root, atol=1e-12)
    until(lambda: shown.controller.state.job is None and not unmeasured(shown.controller.state.collection).any())
    assert "My_Box" in shown.panel.opened.content


def test_what_was_open_before_comes_back_as_it_was_left(shown: Shown):
    before = shown.controller.state.collection
    shown.controller.editor.set_joint(0, 0.1)
    left = shown.controller.state.work
    shown.one.upload(shown.panel.upload, "My Box.stl", BOX)
    assert shown.told("My Box.stl", "Show")
    until(lambda: shown.panel.shelf.visible)
    assert shown.controller.state.num_unsaved == 1 and not shown.controller.state.unsaved
    titles = shown.panel.shelf.options
    assert len(titles) == 2 and "My_Box" in titles[0] and "sphere" in titles[1]
    until(lambda: shown.controller.state.job is None)
    shown.one.change(shown.panel.shelf, titles[1])
    until(lambda: shown.controller.state.collection.problem is before.problem)
    assert shown.controller.state.work is left and shown.controller.state.unsaved == (0,)
    shown.one.change(shown.panel.shelf, shelf_titles(shown.controller.state)[1])
    until(lambda: "My_Box" in shown.controller.state.collection.title)
    assert len(shown.controller.state.shelf) == 1


def test_a_stand_in_is_reported_over_the_scene_until_its_mesh_comes(shown: Shown):
    hand = shown.controller.state.collection.hand
    T = shown.controller.state.pose.T_object_root[None]
    grasps = GraspSet.of(hand, np.repeat(T, 5, axis=0), np.repeat(hand.rest[None], 5, axis=0), object="core/my box")
    content = io.BytesIO()
    np.savez(content, **grasps.arrays())
    assert banner_text(shown.controller.state) == ""
    shown.one.upload(shown.panel.upload, "grasps.npz", content.getvalue(), key="1")
    assert shown.told("grasps.npz", "5 grasps")
    assert_names(banner_text(shown.controller.state), "Stand-in", "'core/my box'", "'sphere:0.03'")
    until(lambda: shown.controller.state.job is None)
    shown.controller.grasps.show(3)
    shown.one.upload(shown.panel.upload, "My Box.stl", BOX, key="2")
    assert shown.told("My Box.stl", "'core/my box'", "5 grasps")
    state = shown.controller.state
    assert len(state.collection) == 5 and state.number == 3 and banner_text(state) == ""
    np.testing.assert_allclose(state.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    # Nothing was made of them on the stand-in, which is not worth keeping.
    assert len(state.shelf) == 1 and "sphere" in state.shelf[0].collection.title


def test_many_are_saved_together_as_they_stand(shown: Shown):
    hand = shown.controller.state.collection.hand
    T = shown.controller.state.pose.T_object_root[None]
    grasps = GraspSet.of(hand, np.repeat(T, 3, axis=0), np.repeat(hand.rest[None], 3, axis=0), object="sphere:0.03")
    content = io.BytesIO()
    np.savez(content, **grasps.arrays())
    shown.one.upload(shown.panel.upload, "grasps.npz", content.getvalue())
    assert shown.told("grasps.npz", "3 grasps")
    until(lambda: shown.controller.state.job is None)
    shown.controller.grasps.show(1)
    shown.controller.editor.set_joint(2, 0.3)
    shown.controller.many.refine((2,))
    until(lambda: shown.controller.state.job is None and shown.controller.state.unsaved == (1, 2))
    works = shown.controller.state.works
    shown.one.change(shown.panel.save_all, True)
    name, saved = shown.one.download()
    path = shown.panel.uploads.path / "again.npz"
    path.write_bytes(saved)
    again = load_grasps(path)
    assert len(again) == 3 and name.endswith(".npz")
    np.testing.assert_allclose(again.q[0], hand.rest)
    np.testing.assert_allclose(again.q[1], works[1].pose.q)
    np.testing.assert_allclose(again.q[2], works[2].pose.q)
    np.testing.assert_allclose(again.squeeze.q[2], works[2].outcome.stage_q[0, -1])
    outcome = works[2].outcome
    reopened = Collection.of(load_problem(ProblemSpec(grasps=path, object="sphere:0.03", hand=str(hand.toml))))
    for key, value in outcome.entries().items():
        if key in reopened.columns:
            np.testing.assert_allclose(reopened.columns[key].values[2], value[0])
    assert {"quality_before", "quality_after", "contact_error_m_after"} <= reopened.columns.keys()
    assert reopened.columns["status"].values.tolist() == ["", "", labels(Status, outcome.status)[0]]
    np.testing.assert_array_equal(reopened.recorded(2).gap, outcome.contact_gap[0])
    np.testing.assert_allclose(reopened.initial(2)[1], hand.rest)
    until(lambda: shown.controller.state.unsaved == ())


def test_a_bad_mesh_is_reported_and_the_next_one_opened(shown: Shown):
    shown.one.upload(shown.panel.upload, "bad.stl", b"solid nothing", key="1")
    assert shown.told("bad.stl", bad=True)
    assert shown.controller.state.scene.object.name == "sphere:0.03"
    assert [*shown.panel.uploads.path.iterdir()] == [shown.panel.uploads.path / "1"]
    shown.one.upload(shown.panel.upload, "box.stl", BOX, key="2")
    assert shown.told("box.stl")


def test_the_unit_is_chosen_in_the_panel(shown: Shown):
    large = trimesh.creation.box((40, 50, 60)).export(file_type="stl")
    shown.one.upload(shown.panel.upload, "box.stl", large, key="1")
    assert shown.told("box.stl", "Mesh unit", "millimetres", "40 x 50 x 60 mm", bad=True)
    shown.one.change(shown.panel.unit, "millimetres")
    until(lambda: shown.panel.unit.value == "millimetres")
    shown.one.upload(shown.panel.upload, "box.stl", large, key="2")
    assert shown.told("box.stl")
    np.testing.assert_allclose(shown.controller.state.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)


def test_an_uploaded_hand_comes_with_grasps(shown: Shown):
    shown.one.upload(shown.panel.upload, "gripper.zip", gripper_zip())
    assert shown.told("gripper.zip", "gripper on", "sphere:0.03")
    assert shown.controller.state.collection.hand.joint_names == ("left_hinge", "right_hinge")


def test_the_shown_grasp_goes_to_the_browser_that_asks(shown: Shown, tmp_path: Path):
    T = exp_se3(np.array([0.01, 0.02, 0.12, 0.1, 0.2, 0.3]))
    shown.controller.editor.move_root(T)
    shown.one.change(shown.panel.save, True)
    name, content = shown.one.download()
    assert name == "allegro_sphere_0.03_0_ours.npz"
    (tmp_path / name).write_bytes(content)
    grasps = load_grasps(tmp_path / name)
    np.testing.assert_allclose(grasps.hand_pose, pose_from_transform(T[None]), atol=1e-12)
    assert grasps.pregrasp is not None and grasps.squeeze is not None
    assert not shown.other.downloads()


def test_painted_faces_go_to_the_browser_that_asks(shown: Shown, tmp_path: Path):
    obj = shown.controller.state.scene.object
    assert not shown.panel.faces.visible
    (tmp_path / "some.txt").write_text("0 7 12")
    shown.controller.regions.set("", f"above:z=0.02; faces:{tmp_path / 'some.txt'}")
    assert shown.panel.faces.visible
    shown.one.change(shown.panel.faces, True)
    name, content = shown.one.download()
    (tmp_path / name).write_bytes(content)
    again = contact_regions(obj, avoid=f"faces:{tmp_path / name}")
    assert again is not None and np.flatnonzero(again.avoid[0].chosen).tolist() == [0, 7, 12]
    assert shown.told(f"--avoid faces:{name}")
    assert not shown.other.downloads()


def test_a_format_that_cannot_hold_it_says_so(shown: Shown):
    shown.one.change(shown.panel.format, "leap_cache")
    until(lambda: shown.panel.format.value == "leap_cache")
    shown.one.change(shown.panel.save, True)
    assert shown.told("leap_cache", "'allegro'", bad=True) and not shown.one.downloads()


def test_the_animation_needs_something_to_show(shown: Shown):
    shown.one.change(shown.panel.animation, True)
    assert shown.told(bad=True) and not shown.one.downloads()


def test_an_animation_goes_to_the_browser_that_asks(shown: Shown):
    shown.controller.refinement.start()
    until(lambda: shown.controller.state.outcome is not None and shown.controller.state.job is None)
    shown.one.change(shown.panel.animation, True)
    name, content = shown.one.download()
    assert name == "allegro_sphere_0.03_0.html" and b"<html" in content[:1000].lower()
    assert not shown.other.downloads()


def test_one_thing_at_a_time(shown: Shown):
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
    until(lambda: shown.controller.state.job is None)
    assert shown.controller.state.notice is None and not shown.other.downloads()


def test_a_picture_comes_as_the_browser_drew_it(shown: Shown):
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
    # What is transparent is white.
    assert picture.size == (64, 48) and picture.getpixel((3, 3)) == (255, 255, 255)


def test_a_browser_that_draws_nothing_holds_nothing_up(shown: Shown, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(export_panel, "RENDER_TIMEOUT_S", 0.3)
    shown.one.change(shown.panel.picture, True)
    assert shown.told(bad=True) and not shown.one.downloads()
    # One that leaves meanwhile is not missed.
    monkeypatch.setattr(export_panel, "RENDER_TIMEOUT_S", 60.0)
    told = shown.controller.state.notice
    shown.one.change(shown.panel.picture, True)
    until(lambda: len(shown.one.of("GetRenderRequestMessage")) == 2)
    shown.one.close()
    until(lambda: len(shown.server.get_clients()) == 1)
    time.sleep(0.5)
    assert shown.controller.state.notice is told


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


def test_half_transparent_is_half_white():
    image = np.zeros((2, 3, 4), dtype=np.uint8)
    image[..., 3] = 128
    assert Image.open(io.BytesIO(png(image))).getpixel((0, 0)) == (127, 127, 127)
