"""What is around an object is drawn where the scene has it, and what links are in is named, measured and red."""

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, inverse, transform, transform_from_pose, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.mount import mount
from grasp_refine.objects.object import load_object
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.drawing.environment_nodes import OPACITY
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.obstacles import TABLE, ObstacleMeter, overlaps_text
from grasp_refine_apps.viewer.model.pose import Pose
from open_viewer import controller, settled

LINK, DEPTH = "link_3.0_tip", 0.003
"""A fingertip of the first example grasp, and how deep a box is pushed over it, metres."""


def tip_points(problem: Problem) -> np.ndarray:
    """Points (N, 3) on the fingertip in the first grasp, object frame."""
    scene = problem.groups[0].scene
    prepared = HandObject.of(scene)
    column = prepared.chain.links.index(LINK)
    T = prepared.chain(scene.T_world_root[:1], scene.q[:1]).T_world_link[0, column]
    return transform_points(T, np.concatenate([piece.mesh().vertices for piece in prepared.bodies[column].pieces]))


@pytest.fixture(scope="module")
def crowded(problem: Problem) -> Problem:
    """The example in a turned world, with a box that ends `DEPTH` beyond the outermost point of a fingertip, and one
    far away.
    """
    points, size = tip_points(problem), 0.2
    reach = points[:, 0].max()
    T = np.eye(4)
    T[:3, 3] = reach - DEPTH + size / 2, *points[points[:, 0].argmax(), 1:]
    away = np.eye(4)
    away[:3, 3] = 0.0, 0.0, -3.0
    T_world_object = transform(exp_so3(np.array([0.0, 0.3, 0.0])), np.array([0.1, 0.2, 0.7]))
    bodies = tuple(
        EnvironmentBody(name, build_body(name, [box((size,) * 3)], candidates=16), T_world_object @ T_object)
        for name, T_object in (("crate", T), ("far", away))
    )
    return with_around(problem, Task(scene=Environment(bodies, T_world_object)))


def with_around(problem: Problem, task: Task) -> Problem:
    groups = tuple(replace(group, scene=replace(group.scene, task=task)) for group in problem.groups)
    return replace(problem, groups=groups)


@pytest.fixture
def viewer(crowded: Problem) -> Iterator[Controller]:
    made = controller(crowded)
    yield made
    made.close()


def test_the_link_in_a_body_is_named_with_its_depth(viewer: Controller) -> None:
    found = viewer.overlaps(viewer.state)
    by_link = {overlap.link: overlap for overlap in found}
    assert {overlap.body for overlap in found} == {"crate"}
    # The face of the box is a plane: the depth is that of the outermost point.
    assert by_link[LINK].depth == pytest.approx(DEPTH, abs=5e-5)
    assert overlaps_text(found).count("crate") >= 1 and "mm" in overlaps_text(found)
    assert [overlap.depth for overlap in found] == sorted((overlap.depth for overlap in found), reverse=True)


def test_refining_in_the_viewer_leaves_the_body(viewer: Controller) -> None:
    viewer.set(settings=Settings(geometry_only=True))
    viewer.refinement.start()
    settled(viewer)
    assert viewer.overlaps(viewer.state) == ()


def test_a_table_is_in_the_way_as_deep_as_the_lowest_point(problem: Problem) -> None:
    scene = problem.groups[0].scene
    prepared = HandObject.of(scene)
    T = prepared.chain(scene.T_world_root[:1], scene.q[:1]).T_world_link
    lowest = {
        link: min(transform_points(T[0, k], piece.mesh().vertices)[:, 2].min() for piece in body.pieces)
        for k, (link, body) in enumerate(zip(prepared.chain.links, prepared.bodies, strict=True))
    }
    height = min(lowest.values()) + 0.01
    made = controller(with_around(problem, Task(table=height)))
    found = {overlap.link: overlap.depth for overlap in made.overlaps(made.state)}
    assert all(overlap.body == TABLE for overlap in made.overlaps(made.state))
    made.close()
    assert max(found.values()) == pytest.approx(0.01, abs=1e-4)
    assert set(found) == {link for link, z in lowest.items() if height - z > 2e-4}


def test_the_standing_base_of_an_arm_is_in_nobodys_way(pytestconfig: pytest.Config) -> None:
    if pytestconfig.getoption("jaxtyping_packages"):
        pytest.skip("a scene and a pose stand in for a state")
    hand = mount(load_hand("ur5e", candidates=16), load_hand("franka_hand", candidates=16))
    ball, pose = load_object("sphere:0.03", candidates=16), Pose(np.eye(4), hand.rest)
    scene = Scene(hand, ball, pose.T_object_root[None], pose.q[None], task=Task(table=5.0))
    prepared = HandObject.of(scene)
    found = ObstacleMeter()(SimpleNamespace(scene=scene, shown=pose), prepared)
    links = set(prepared.chain.links)
    assert {overlap.link for overlap in found} == links - set(hand.arm.standing) != links


def test_bodies_are_drawn_where_the_scene_has_them_and_red_where_a_link_is_in_them(
    view: View, viewer: Controller
) -> None:
    environment, nodes = viewer.state.scene.environment, view.nodes.environment
    # What is up in the scene is up in the picture.
    np.testing.assert_allclose(viewer.state.T_world_object[:3, :3], environment.T_world_object[:3, :3])
    for frame, body in zip(nodes.frames, environment.bodies, strict=True):
        T = transform_from_pose(np.concatenate([frame.position, frame.wxyz])[None])[0]
        np.testing.assert_allclose(T, inverse(environment.T_world_object) @ body.T_world_body, atol=1e-7)
    (crate,), (far,) = (meshes.nodes for meshes in nodes.meshes)
    assert crate.color != far.color and tuple(far.color) == nodes.meshes[1].shapes[0].color
    # The one below the object is opaque, the one beside it is seen through.
    assert far.opacity is None and crate.opacity == OPACITY
    assert nodes.lowest == pytest.approx(min(body_heights(environment)), abs=1e-9)
    red = [k for k, shape in enumerate(view.nodes.hand.shapes) if shape.link == LINK]
    assert tuple(view.nodes.hand.nodes[red[0]].color) != view.nodes.hand.shapes[red[0]].color
    # Moved out of the way, it has its own colour.
    T = viewer.state.pose.T_object_root.copy()
    T[0, 3] -= 0.1
    viewer.editor.move_root(T)
    view.draw(viewer.state)
    assert tuple(crate.color) == nodes.meshes[0].shapes[0].color and crate.opacity == OPACITY
    viewer.set(display=replace(viewer.state.display, surroundings=False))
    view.draw(viewer.state)
    assert view.nodes.environment is None


def body_heights(environment: Environment) -> np.ndarray:
    """Heights of all corners over the object's origin."""
    pairs = zip(environment.bodies, environment.T_object_body, strict=True)
    corners = [transform_points(T, piece.mesh().vertices) for body, T in pairs for piece in body.body.pieces]
    return np.concatenate(corners) @ environment.up


def test_a_scene_is_tested_by_its_own_protocol(viewer: Controller) -> None:
    assert viewer.state.protocol == ("scene", None)
