"""Regions are painted on what is seen of an object, written in words, undone, respected, and saved to be read again."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, inverse, transform, transform_points
from grasp_refine.objects.object import Object, load_object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.drawing.picking import hit_mesh
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.files.saved_results import entries_of
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.painting import Camera, PaintedFaces, seen_faces
from open_viewer import settled
from websocket_page import Page, until

DOWN = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.5]))
"""A camera over the mug that looks down on it."""
WHOLE = (0.0, 0.0), (1.0, 1.0)
"""The whole picture."""


@pytest.fixture(scope="module")
def mug() -> Object:
    return load_object("mug")


def specs(viewer: Controller) -> tuple[list[str], list[str]]:
    """Specifications of the regions to touch and to avoid."""
    regions = viewer.state.scene.regions or ContactRegions()
    return [one.spec for one in regions.touch], [one.spec for one in regions.avoid]


def paint(viewer: Controller, brush: str, *, camera: np.ndarray = DOWN, rectangle: tuple = WHOLE) -> None:
    viewer.set(brush=brush)
    viewer.regions.paint(Camera(camera, 0.6, 1.2, *rectangle))


@pytest.mark.parametrize("seed", [0, 1])
def test_faces_are_seen_where_the_ray_to_their_centre_meets_nothing_before(mug: Object, seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_object = transform(exp_so3(rng.normal(size=3)), rng.normal(size=3) * 0.1)
    middle = transform_points(T_object, mug.mesh.bounds.mean(axis=0))
    R = exp_so3(rng.normal(size=3))
    T = transform(R, middle - 0.3 * R[:, 2])
    camera = Camera(T, 0.5, 1.4, (0.2, 0.3), (0.6, 0.9))
    triangles = np.asarray(mug.mesh.triangles)
    found = seen_faces(triangles, T_object, camera)
    corners = transform_points(inverse(T) @ T_object, triangles)
    soup, numbers = corners.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    expected = np.zeros(len(triangles), dtype=bool)
    for k, centre in enumerate(corners.mean(axis=1)):
        u = 0.5 + 0.5 * centre[:2] / centre[2] / (np.tan(0.25) * np.array([1.4, 1.0]))
        first = hit_mesh(np.zeros(3), centre, soup, numbers)
        expected[k] = (u >= camera.low).all() and (u <= camera.high).all() and first[2] > centre[2] * (1 - 1e-5)
    np.testing.assert_array_equal(found, expected)
    assert 10 < found.sum() < len(found) / 2


def test_nothing_behind_the_camera_is_seen(mug: Object) -> None:
    up = transform(np.eye(3), np.array([0.0, 0.0, 0.5]))
    assert not seen_faces(np.asarray(mug.mesh.triangles), np.eye(4), Camera(up, 0.6, 1.2, *WHOLE)).any()


def test_painted_faces_are_of_one_kind_and_their_file_is_read_as_the_same(mug: Object, tmp_path: Path) -> None:
    faces = PaintedFaces.of(mug)
    height = faces.triangles.mean(axis=1)[:, 2]
    upper, lower = height > 0.05, height < 0.03
    regions = contact_regions(mug, touch="above:z=0.01") or ContactRegions()
    regions = faces.stroke(faces.stroke(regions, "touch", upper), "avoid", lower)
    regions = faces.stroke(regions, "avoid", upper & (faces.triangles.mean(axis=1)[:, 0] > 0))
    box, touch = regions.touch
    (avoid,) = regions.avoid
    assert box.spec == "above:z=0.01"
    assert not (touch.chosen & avoid.chosen).any()
    np.testing.assert_array_equal(touch.chosen | avoid.chosen, upper | lower)
    file = tmp_path / "faces.txt"
    file.write_text(faces.text(regions.avoid))
    again = contact_regions(mug, avoid=f"faces:{file}")
    np.testing.assert_array_equal(again.avoid[0].chosen, avoid.chosen)
    # What was read is painted on, and erased.
    erased = faces.stroke(again, "erase", lower)
    np.testing.assert_array_equal(erased.avoid[0].chosen, avoid.chosen & ~lower)
    everything = np.ones(len(faces.face), dtype=bool)
    assert faces.stroke(regions, "erase", everything).touch == (box,) and not faces.text((box,))


def test_a_face_of_several_triangles_is_painted_as_one(tmp_path: Path) -> None:
    square = tmp_path / "block.obj"
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 0.05) for y in (0, 0.05) for z in (0, 0.05))
    square.write_text(corners + "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n")
    faces = PaintedFaces.of(load_object(square))
    painted = faces.stroke(ContactRegions(), "touch", np.arange(12) == 11).touch
    assert np.flatnonzero(painted[0].chosen).tolist() == [10, 11] and faces.text(painted) == "5\n"


def test_a_rectangle_that_is_drawn_in_the_page_paints(server: Any, view: View, viewer: Controller) -> None:
    page = Page(server)

    def use(brush: str) -> None:
        viewer.set(brush=brush)
        view.draw(viewer.state)

    # The object is turned and moved; the camera looks down on it.
    viewer.editor.move_object(transform(exp_so3(np.array([0.0, 0.4, 0.0])), np.array([0.05, 0.0, 0.0])))
    use("avoid")
    page.look((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.5))
    page.draw_rectangle((0.0, 0.0), (1.0, 1.0))
    until(lambda: viewer.state.scene.regions is not None)
    (painted,) = viewer.state.scene.regions.avoid
    eye = transform_points(inverse(viewer.state.T_world_object), np.array([0.0, 0.0, 0.5]))
    camera = Camera(transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.5])), 1.0, 800 / 600, *WHOLE)
    seen = seen_faces(painted.triangles, viewer.state.T_world_object, camera)
    np.testing.assert_array_equal(painted.chosen, seen)
    normal = np.cross(*np.moveaxis(np.diff(painted.triangles, axis=1), 1, 0))
    facing = np.einsum("fi,fi->f", normal, eye - painted.triangles.mean(axis=1)) > 0
    assert painted.chosen.any() and not (painted.chosen & ~facing).any()
    # Other display options make new nodes.
    viewer.set(display=viewer.state.display.__class__(ground=False))
    use("erase")
    page.draw_rectangle((0.0, 0.0), (1.0, 1.0))
    until(lambda: viewer.state.scene.regions is None)
    # Without a brush, Shift and the mouse do what they did before.
    use("off")
    until(lambda: [m["modifiers"] for m in page.messages if m["type"] == "ScenePointerEnableMessage"][-1] == [])
    page.close()


def test_regions_are_undone_where_they_were_set_and_hold_for_all_grasps(viewer: Controller) -> None:
    paint(viewer, "avoid")
    painted = specs(viewer)
    assert painted == ([], ["faces:mug_avoid.txt"])
    viewer.editor.set_joint(0, 0.2)
    viewer.editor.undo()
    assert specs(viewer) == painted
    viewer.grasps.show(1)
    assert specs(viewer) == painted
    viewer.editor.set_joint(0, 0.2)
    viewer.regions.set("", f"{painted[1][0]}; below:z=0.02")
    both = specs(viewer)
    assert both == ([], [*painted[1], "below:z=0.02"])
    viewer.editor.undo()
    assert specs(viewer) == painted
    viewer.editor.redo()
    assert specs(viewer) == both
    viewer.grasps.show(0)
    viewer.editor.undo()
    assert specs(viewer) == ([], []) and viewer.state.scene.regions is None
    viewer.editor.redo()
    assert specs(viewer) == both
    viewer.regions.clear()
    assert viewer.state.scene.regions is None


@pytest.mark.parametrize(
    ("touch", "named"), [("abov:z=0.1", "above"), ("above:z=3", "0.09"), ("faces:no_such.txt", "no_such.txt")]
)
def test_wrong_regions_are_refused_by_name(viewer: Controller, touch: str, named: str) -> None:
    viewer.regions.set("", "above:z=0.08")
    before = viewer.state.scene.regions
    viewer.regions.set(touch, "above:z=0.08")
    assert viewer.state.notice.bad and named in viewer.state.notice.text
    assert viewer.state.scene.regions is before


def test_a_rectangle_beside_the_object_and_a_brush_that_is_off_paint_nothing(viewer: Controller) -> None:
    paint(viewer, "touch", rectangle=((0.0, 0.0), (0.1, 0.1)))
    assert viewer.state.notice.bad and not viewer.state.undo_steps
    paint(viewer, "off")
    assert viewer.state.scene.regions is None


def test_refinements_respect_the_regions_and_saved_results_record_them(viewer: Controller) -> None:
    viewer.set(settings=Settings(geometry_only=True))
    viewer.regions.set("", "above:z=0.06")
    assert viewer.elsewhere(viewer.state)
    viewer.refinement.start()
    settled(viewer)
    assert viewer.state.outcome["region_miss_m"][0, 1] < 5e-4 and not viewer.elsewhere(viewer.state)
    works = {0: viewer.state.work}
    recorded = json.loads(str(entries_of(viewer.state.collection, works)["provenance"]))
    assert recorded["task"] == {"touch": [], "avoid": ["above:z=0.06"]}
    # With other regions it is to be refined again.
    first = viewer.state.outcome
    viewer.many.refine([0])
    settled(viewer)
    assert viewer.state.outcome is first
    viewer.regions.clear()
    viewer.many.refine([0])
    settled(viewer)
    assert viewer.state.outcome is not first and np.isnan(viewer.state.outcome["region_miss_m"]).all()
