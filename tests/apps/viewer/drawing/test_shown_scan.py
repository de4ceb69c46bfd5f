"""Of a scanned object, the seen points and the edges of the other solids are drawn, in its frame."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.objects.object import scanned_object
from grasp_refine.problem.problem import Problem
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from open_viewer import controller

WEIGHTS = (0.6, 0.3, 0.1)


def box(depth: float) -> tuple[Piece, ...]:
    return (hull(np.array([[x, y, z] for x in (0.03 - depth, 0.03) for y in (-0.03, 0.03) for z in (0.0, 0.1)])),)


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    """Grasps on boxes of which the face at x = 3 cm was seen."""
    y, z = np.meshgrid(np.linspace(-0.03, 0.03, 11), np.linspace(0.0, 0.1, 21))
    points = np.column_stack([np.full(y.size, 0.03), y.ravel(), z.ravel()])
    normals = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    scan = Scan(points, normals, np.array([[0.5, 0.0, 0.0]]), np.zeros(len(points), dtype=int), 1e-3)
    solids = [Hypothesis("extruded", box(0.06 + 0.02 * k), weight) for k, weight in enumerate(WEIGHTS)]
    obj = scanned_object("box", scan, tuple(solids))
    groups = tuple(replace(group, scene=replace(group.scene, object=obj)) for group in problem.groups)
    made = controller(replace(problem, groups=groups))
    yield made
    made.close()


def test_seen_points_and_other_solids_are_drawn_until_they_are_hidden(view: View, viewer: Controller) -> None:
    view.draw(viewer.state)
    drawn, obj = view.nodes.scan, viewer.state.scene.object
    assert drawn.points.points == pytest.approx(obj.scan.points, abs=1e-3)
    assert len(drawn.others) == 2
    for meshes, other in zip(drawn.others, obj.hypotheses[1:], strict=True):
        (node,) = meshes.nodes
        assert np.ptp(node.vertices, axis=0) == pytest.approx(np.ptp(other.pieces[0].vertices, axis=0), abs=1e-6)
        assert node.wireframe
    first, second = (meshes.nodes[0].opacity for meshes in drawn.others)
    assert first > second
    viewer.set(display=replace(viewer.state.display, scan=False))
    view.draw(viewer.state)
    assert view.nodes.scan is None


def test_known_objects_have_neither(view: View, problem: Problem) -> None:
    other = controller(problem)
    view.draw(other.state)
    assert view.nodes.scan.points is None
    assert view.nodes.scan.others == []
    other.close()
