"""What the view draws of a state, on a real server without a browser."""

from __future__ import annotations

from collections.abc import Coroutine, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, transform, transform_from_pose, transform_points
from grasp_refine.problem.problem import Problem
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.state import DisplayOptions
from grasp_refine_apps.viewer.server.page import close_server, open_server
from open_viewer import controller, example, settled


@pytest.fixture
def viewer(problem: Problem) -> Iterator[Controller]:
    made = controller(problem)
    yield made
    made.close()


@pytest.fixture
def view(viewer: Controller) -> Iterator[View]:
    server = open_server("127.0.0.1", 0).server
    made = View(server, viewer)
    made.draw(viewer.state)
    yield made
    close_server(server)


def pose(node: object) -> np.ndarray:
    return transform_from_pose(np.concatenate([node.position, node.wxyz])[None])[0]


def done(coroutine: Coroutine[None, None, None]) -> None:
    """Run what waits for nothing; playwright's tests leave a loop in which asyncio.run cannot."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


def test_links_stand_where_kinematics_says_and_follow_the_joints(view: View, viewer: Controller) -> None:
    hand = viewer.state.collection.hand
    for _ in range(2):
        shown = viewer.state.shown
        T = LinkPoses.of(hand)(shown.T_object_root, shown.q)
        for shape, node in zip(view.nodes.hand.shapes, view.nodes.hand.nodes, strict=True):
            np.testing.assert_allclose(pose(node), T[shape.link], atol=1e-7)
        for joint in range(len(hand.joint_names)):
            viewer.editor.set_joint(joint, shown.q[joint] + 0.1)
        view.draw(viewer.state)


def assert_sees(camera: Any, points: np.ndarray) -> None:
    """Assert that a camera has points (N, 3) in its picture, up to few corners that are cut."""
    forward = np.array(camera.look_at) - np.array(camera.position)
    distance = np.linalg.norm(forward)
    forward /= distance
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = (points - camera.position) @ np.stack([right, np.cross(right, forward), forward]).T
    opening = np.tan(camera.fov / 2)
    assert (seen[:, 2] > 0).all()
    assert (np.abs(seen[:, 1]) < opening * seen[:, 2]).mean() > 0.99
    assert (np.abs(seen[:, 0]) < 1.1 * opening * seen[:, 2]).mean() > 0.99


def test_the_first_camera_sees_hand_and_object(view: View, viewer: Controller) -> None:
    assert_sees(view.server.initial_camera, view.nodes.corners(viewer.state.shown))


def test_hands_that_lift_stay_in_the_picture(view: View, viewer: Controller) -> None:
    """From the first frame to the last one, 0.3 m higher, though the object fell off."""
    shown, count = viewer.state.shown, 4
    T_root = np.tile(shown.T_object_root, (count, 1, 1))
    T_root[:, 2, 3] += np.linspace(0.0, 0.3, count)
    T_object = np.tile(np.eye(4), (count, 1, 1))
    T_object[-1, 2, 3] = -50.0
    q = np.tile(shown.q, (count, 1))
    lift = {"title": "lift", "time": np.arange(count), "texts": ("lift",) * count, "travels": True}
    viewer.player.show(Recording(T_root=T_root, q=q, T_object=T_object, **lift))
    view.draw(viewer.state)
    for T in (T_root[0], T_root[-1]):
        assert_sees(view.server.initial_camera, view.nodes.corners(Pose(T, shown.q)))
    away = np.array(view.server.initial_camera.position) - np.array(view.server.initial_camera.look_at)
    assert np.linalg.norm(away) < 5.0


def test_witness_points_are_on_both_surfaces_and_links_inside_are_red(view: View, viewer: Controller) -> None:
    nodes = view.nodes
    found = view.contacts
    assert found is not None and len(found.link) == len(nodes.points_link.nodes) == len(nodes.points_object.nodes)
    for node, point in zip(nodes.points_link.nodes, found.point_link, strict=True):
        np.testing.assert_allclose(node.position, point, atol=1e-7)
    deep = {link for link, is_deep in zip(found.link, found.deep, strict=True) if is_deep}
    red = {
        shape.link
        for shape, node in zip(nodes.hand.shapes, nodes.hand.nodes, strict=True)
        if tuple(node.color) != shape.color
    }
    assert deep and red == deep
    viewer.set(display=DisplayOptions(contacts=False))
    view.draw(viewer.state)
    assert not view.nodes.points_link.nodes


def test_scrubbing_moves_the_hand_and_the_ghost_stays(view: View, viewer: Controller) -> None:
    assert not view.nodes.ghost.nodes[0].visible
    viewer.refinement.start()
    settled(viewer)
    view.draw(viewer.state)
    tip = [shape.link for shape in view.nodes.hand.shapes].index("link_3.0_tip")
    ghost = pose(view.nodes.ghost.nodes[tip])
    end = pose(view.nodes.hand.nodes[tip])
    viewer.player.scrub(0)
    view.draw(viewer.state)
    first = pose(view.nodes.hand.nodes[tip])
    assert np.linalg.norm(end[:3, 3] - first[:3, 3]) > 2e-3
    np.testing.assert_allclose(first, ghost, atol=1e-7)
    assert not view.nodes.ghost.nodes[0].visible
    viewer.player.scrub(5)
    view.draw(viewer.state)
    assert view.nodes.ghost.nodes[0].visible
    np.testing.assert_array_equal(pose(view.nodes.ghost.nodes[tip]), ghost)


def test_other_shapes_and_forces_are_drawn_when_asked_for(view: View, viewer: Controller) -> None:
    obj = viewer.state.scene.object
    assert len(view.nodes.object.nodes) == 1 and view.nodes.cones.node is None
    prepared = view.nodes.prepared
    viewer.set(display=DisplayOptions(object="pieces", hand="collision", forces=True, frames=True, transparent=False))
    view.draw(viewer.state)
    nodes = view.nodes
    assert len(nodes.object.nodes) == len(obj.body.pieces) > 1
    assert nodes.object.nodes[0].opacity is None and nodes.prepared is prepared
    assert nodes.cones.node is not None and nodes.forces.node is not None and all(node.visible for node in nodes.axes)
    viewer.set(display=DisplayOptions(object="wireframe", forces=False))
    view.draw(viewer.state)
    assert view.nodes.object.nodes[0].wireframe and view.nodes.cones.node is None


def test_gaps_are_drawn_on_links_that_are_near_when_asked_for(view: View, viewer: Controller) -> None:
    assert not view.nodes.gaps.nodes
    viewer.set(display=DisplayOptions(gaps=True))
    view.draw(viewer.state)
    found = view.contacts
    assert 0 < len(view.nodes.gaps.nodes) <= len(found.link)
    T = viewer.state.pose.T_object_root.copy()
    T[2, 3] += 0.5
    viewer.editor.move_root(T)
    view.draw(viewer.state)
    assert not view.nodes.gaps.nodes


def test_all_goes_with_the_object_and_side_by_side_shows_both(view: View, viewer: Controller) -> None:
    T = transform(exp_so3(np.array([0.0, 0.0, 0.5])), np.array([0.02, 0.0, 0.01]))
    viewer.editor.move_object(T)
    viewer.set(side_by_side=True)
    view.draw(viewer.state)
    nodes = view.nodes
    np.testing.assert_allclose(pose(nodes.root), T, atol=1e-7)
    assert nodes.input_frame.visible and not nodes.ghost.nodes[0].visible
    apart = pose(nodes.input_frame)[:3, 3] - T[:3, 3]
    assert np.linalg.norm(apart) > 0.1
    viewer.set(side_by_side=False)
    view.draw(viewer.state)
    assert not nodes.input_frame.visible and nodes.ghost.nodes[0].visible


def test_clicks_on_a_link_and_on_the_object_set_a_target_on_both_surfaces(view: View, viewer: Controller) -> None:
    viewer.editor.move_object(transform(exp_so3(np.array([0.3, 0.0, 0.5])), np.array([0.02, 0.0, 0.01])))
    viewer.targets.set_picking(True)
    view.draw(viewer.state)
    state, nodes = viewer.state, view.nodes
    tip = [shape.link for shape in view.nodes.hand.shapes].index("link_3.0_tip")
    T = state.T_world_object @ LinkPoses.of(state.scene.hand)(state.shown.T_object_root, state.shown.q)["link_3.0_tip"]
    middle = transform_points(T, nodes.shapes[tip].vertices.astype(float).mean(axis=0))
    eye = np.array([0.5, 0.4, 0.6])
    nodes.interaction._clicked_link(tip, eye, (middle - eye) / np.linalg.norm(middle - eye))
    view.draw(viewer.state)
    assert viewer.state.picked is not None and len(nodes.picked.nodes) == 1
    centre = transform_points(state.T_world_object, np.array([0.0, 0.0, 0.05]))
    nodes.interaction._clicked_object(eye, (centre - eye) / np.linalg.norm(centre - eye))
    view.draw(viewer.state)
    (target,) = viewer.state.targets
    assert target.link == "link_3.0_tip" and len(nodes.targets.nodes) == 1
    # On the mug's wall: 4 cm from its axis, to within the pieces.
    assert np.linalg.norm(target.point_object[:2]) == pytest.approx(0.04, abs=2.5e-3)
    before = target.point_object
    away = transform_points(state.T_world_object, before + np.array([0.0, 0.0, 0.01]))
    client = SimpleNamespace(camera=SimpleNamespace(position=eye))
    event = SimpleNamespace(client=client, end_position=away, phase="update")
    nodes.interaction._drag_target(0, event)
    moved = viewer.state.targets[0].point_object
    assert 5e-3 < np.linalg.norm(moved - before) < 3e-2
    assert np.linalg.norm(moved[:2]) == pytest.approx(0.04, abs=2.5e-3)
    # A ray that meets nothing does nothing.
    nodes.interaction._clicked_object(eye, np.array([0.0, 0.0, 1.0]))
    assert len(viewer.state.targets) == 1


def test_a_gizmo_follows_what_it_moves(view: View, viewer: Controller) -> None:
    viewer.set(gizmo="hand")
    view.draw(viewer.state)
    node = view.nodes.interaction.gizmos["hand"]
    np.testing.assert_allclose(pose(node), viewer.state.shown.T_object_root, atol=1e-7)
    node.position = np.array(node.position) + np.array([0.01, 0.0, 0.0])
    done(view.nodes.interaction._drag_hand(SimpleNamespace(client=object(), target=node, phase="update")))
    np.testing.assert_allclose(pose(node), viewer.state.shown.T_object_root, atol=1e-7)
    viewer.set(gizmo="object")
    view.draw(viewer.state)
    assert list(view.nodes.interaction.gizmos) == ["object"]
    # What Python sets is no drag.
    done(view.nodes.interaction._drag_object(SimpleNamespace(client=None, target=node, phase="update")))
    np.testing.assert_array_equal(viewer.state.T_world_object, np.eye(4))


def test_another_object_takes_the_place_of_the_first(view: View, viewer: Controller) -> None:
    before = view.nodes
    other = controller(example(object="bottle", hand="allegro"))
    viewer.grasps.open(other.state.collection)
    other.close()
    view.draw(viewer.state)
    assert view.nodes is not before and view.nodes.prepared.object is viewer.state.scene.object
    assert len(view.nodes.object.nodes) == 1


def test_a_pose_that_is_not_finite_is_not_drawn(view: View, viewer: Controller) -> None:
    shown = viewer.state.pose
    bad = viewer.state.evolve(pose=replace(shown, q=np.full_like(shown.q, np.nan)))
    view.draw(bad)
    assert np.isfinite(pose(view.nodes.hand.nodes[0])).all()


def test_a_simulation_moves_the_object_and_shows_the_push(view: View, viewer: Controller) -> None:
    # The first example grasp that holds with the usual friction: what is ejected while the hand closes is not pushed.
    viewer.grasps.show(1)
    viewer.simulation.test("dexgraspbench", 0.15)
    settled(viewer)
    viewer.simulation.record("+z")
    settled(viewer)
    viewer.player.show_frame(10_000)
    view.draw(viewer.state)
    nodes = view.nodes
    np.testing.assert_allclose(pose(nodes.object_frame), viewer.state.T_shown_object, atol=1e-6)
    assert not nodes.ghost.nodes[0].visible
    # From the middle of the object along the axis of its frame in which it was pushed at the start.
    ((start, end),) = nodes.push.node.points
    np.testing.assert_allclose((end - start) / np.linalg.norm(end - start), [0.0, 0.0, 1.0], atol=1e-5)
    viewer.player.show(None)
    view.draw(viewer.state)
    np.testing.assert_allclose(pose(nodes.object_frame), np.eye(4), atol=1e-12)
    assert nodes.push.node is None
