"""Regions of an object are drawn where they are, and links that touch elsewhere are named and red."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.drawing.region_nodes import AVOID_COLOR, TOUCH_COLOR, bisected
from grasp_refine_apps.viewer.drawing.scene_nodes import Meshes
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.region_meter import RegionMeter, elsewhere_text
from open_viewer import controller

HEIGHT_M = 0.06
"""Height on the mug above which hands may not touch it: below two of the fingertips of the first grasp."""


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    regions = contact_regions(problem.groups[0].scene.object, avoid=f"above:z={HEIGHT_M}")
    groups = tuple(
        replace(group, scene=replace(group.scene, task=Task(avoid=regions.avoid))) for group in problem.groups
    )
    made = controller(replace(problem, groups=groups))
    yield made
    made.close()


def centres_and_areas(meshes: Meshes) -> tuple[np.ndarray, np.ndarray]:
    """Centres (F, 3) and areas (F,) of the drawn faces."""
    corners = np.concatenate([np.zeros((0, 3, 3)), *(node.vertices[node.faces] for node in meshes.nodes)])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), np.linalg.norm(across, axis=1) / 2


def test_links_that_touch_elsewhere_are_named_with_their_distance(viewer: Controller) -> None:
    contacts, found = viewer.contacts(viewer.state), viewer.elsewhere(viewer.state)
    height = dict(zip(contacts.link, contacts.point_object[:, 2] - HEIGHT_M, strict=True))
    near = dict(zip(contacts.link, contacts.distance <= CONTACT_DISTANCE_M, strict=True))
    assert {one.link for one in found} == {link for link, z in height.items() if z > 5e-4 and near[link]} != set()
    # Patches reach beyond the witness points, by less than 2 mm here.
    assert all(height[one.link] <= one.miss < height[one.link] + 2e-3 for one in found)
    assert [one.miss for one in found] == sorted((one.miss for one in found), reverse=True)
    text = elsewhere_text(found)
    assert found[0].link in text and f"{1e3 * found[0].miss:.1f} mm" in text


@pytest.mark.parametrize(("above", "named"), [(1e-4, False), (1e-3, True)])
def test_a_contact_at_the_border_is_not_named(viewer: Controller, above: float, named: bool) -> None:
    contacts, obj = viewer.contacts(viewer.state), viewer.state.scene.object
    top = contacts.point_object[contacts.distance <= CONTACT_DISTANCE_M, 2].max()
    regions = contact_regions(obj, avoid=f"above:z={top - above}")
    assert bool(RegionMeter()(contacts, regions)) == named


def test_the_whole_surface_is_tinted_by_the_regions(view: View, viewer: Controller) -> None:
    (touch, touch_area), (avoid, avoid_area) = map(centres_and_areas, view.nodes.regions.meshes)
    assert touch[:, 2].max() <= HEIGHT_M + 2e-4 and avoid[:, 2].min() >= HEIGHT_M - 2e-4
    assert [meshes.shapes[0].color for meshes in view.nodes.regions.meshes] == [TOUCH_COLOR, AVOID_COLOR]
    mesh = viewer.state.scene.object.mesh
    assert touch_area.sum() + avoid_area.sum() == pytest.approx(mesh.area, rel=0.02)
    above = mesh.slice_plane([0, 0, HEIGHT_M], [0, 0, 1]).area
    assert avoid_area.sum() == pytest.approx(above, rel=0.05)
    link = viewer.elsewhere(viewer.state)[0].link
    (k,) = [k for k, shape in enumerate(view.nodes.hand.shapes) if shape.link == link]
    assert tuple(view.nodes.hand.nodes[k].color) != view.nodes.hand.shapes[k].color
    viewer.set(display=replace(viewer.state.display, regions=False))
    view.draw(viewer.state)
    assert not view.nodes.regions.meshes


def test_cut_faces_are_short_and_cover_what_they_covered() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.02, 0.0], [0.0, 0.02, 0.0]])
    fine, faces = bisected(vertices, np.array([[0, 1, 2], [0, 2, 3]]), 0.1)
    corners = fine[faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.1
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0).all() and normal[:, 2].sum() / 2 == pytest.approx(0.02)
    # Halves of all edges would be 512.
    assert len(faces) < 256
