"""The scene of a state on a real server without a browser: what pages are sent, against the library's own numbers."""

from collections.abc import Coroutine
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, inverse, transform, transform_from_pose, transform_points
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.drawing.glyphs import force_arrows
from grasp_refine_apps.viewer.drawing.shapes import LinkPoses
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.state import DisplayOptions
from open_viewer import controller, example, settled, short_trials
from websocket_page import Node, Page, until

TIP = "link_3.0_tip"
ASIDE = transform(exp_so3(np.array([0.3, 0.0, 0.5])), np.array([0.02, -0.03, 0.01]))
"""A pose of the object, world frame."""


def pose(node: Any) -> np.ndarray:
    return transform_from_pose(np.concatenate([node.position, node.wxyz])[None])[0]


def link_poses(viewer: Controller) -> dict[str, np.ndarray]:
    """Poses of the links by forward kinematics, object frame."""
    shown = viewer.state.shown
    return LinkPoses.of(viewer.state.scene.hand)(shown.T_object_root, shown.q)


def drawn(view: View, viewer: Controller) -> dict[str, Node]:
    """The scene of the present state as a new page gets it."""
    view.draw(viewer.state)
    page = Page(view.server)
    nodes = until(lambda: "/ground/shadow" in (found := page.nodes()) and found)
    page.close()
    return nodes


def done(coroutine: Coroutine[None, None, None]) -> None:
    """Run what waits for nothing; playwright's tests leave a loop in which asyncio.run cannot."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


def test_links_stand_where_kinematics_says_and_follow_the_joints(view: View, viewer: Controller) -> None:
    hand = viewer.state.collection.hand
    for _ in range(2):
        T = link_poses(viewer)
        for shape, node in zip(view.nodes.hand.shapes, view.nodes.hand.nodes, strict=True):
            np.testing.assert_allclose(pose(node), T[shape.link], atol=1e-7)
        for joint in range(len(hand.joint_names)):
            viewer.editor.set_joint(joint, viewer.state.shown.q[joint] + 0.1)
        view.draw(viewer.state)


def test_all_of_a_grasp_is_drawn_where_the_library_has_it(view: View, viewer: Controller) -> None:
    viewer.targets.set_nearest()
    settled(viewer)
    viewer.editor.move_object(ASIDE)
    viewer.set(display=DisplayOptions(forces=True, frames=True, gaps=True, transparent=False))
    nodes, found, T = drawn(view, viewer), view.contacts, link_poses(viewer)
    np.testing.assert_allclose(nodes["/grasp"].T, ASIDE, atol=1e-7)
    for name, expected in (("hand", viewer.state.shown.T_object_root), ("object", np.eye(4))):
        assert nodes[f"/grasp/frame_of_{name}"].visible
        np.testing.assert_allclose(nodes[f"/grasp/frame_of_{name}"].T, expected, atol=1e-7)
    targets = viewer.state.targets
    for k, target in enumerate(targets):
        on_link = transform_points(T[target.link], target.point_link)
        np.testing.assert_allclose(nodes[f"/grasp/targets/object/{k}"].T[:3, 3], target.point_object, atol=1e-7)
        np.testing.assert_allclose(nodes[f"/grasp/targets/link/{k}"].T[:3, 3], on_link, atol=1e-7)
    assert len(targets) > 2 and f"/grasp/targets/object/{len(targets)}" not in nodes
    for end, points in (("link", found.point_link), ("object", found.point_object)):
        drawn_points = [nodes[f"/grasp/contacts/{end}/{k}"].T[:3, 3] for k in range(len(found.link))]
        np.testing.assert_allclose(drawn_points, points, atol=1e-7)
    deep = np.array(found.link)[found.deep]
    assert len(deep) and len([name for name in nodes if name.startswith("/grasp/depth/")]) > len(deep)
    for name, links in (("depth", deep), ("gaps", found.link)):
        places = [np.eye(4)] * (name == "depth") + [T[link] for link in links]
        for each in [node for key, node in nodes.items() if key.startswith(f"/grasp/{name}/")]:
            assert min(np.abs(each.T - place).max() for place in places) < 1e-6, name
    depths = [node.T for key, node in nodes.items() if key.startswith("/grasp/depth/")]
    assert min(np.abs(T_depth - np.eye(4)).max() for T_depth in depths) < 1e-9, "the part of the object in a link"
    forces = found.forces
    expected = force_arrows(forces.point, forces.force, viewer.state.scene.object.body)
    np.testing.assert_allclose(view.nodes.forces.node.points, expected, atol=1e-6)
    assert len(view.nodes.cones.node.points) == 28 * len(forces.point)
    red = {
        shape.link
        for shape, node in zip(view.nodes.hand.shapes, view.nodes.hand.nodes, strict=True)
        if tuple(node.color) != shape.color
    }
    assert red == set(deep)
    # Without these options nothing of it is left; nor far away.
    viewer.set(display=DisplayOptions(contacts=False, overlap=False, object="wireframe"))
    nodes = drawn(view, viewer)
    assert not any(
        name.startswith(("/grasp/contacts/", "/grasp/depth", "/grasp/gaps", "/grasp/forces")) for name in nodes
    )
    assert not nodes["/grasp/frame_of_hand"].visible and nodes["/grasp/object/mesh/0"].props["wireframe"]
    viewer.set(display=DisplayOptions(gaps=True, object="pieces", hand="collision"))
    viewer.editor.move_root(transform(np.eye(3), np.array([0.0, 0.0, 1.0])))
    nodes = drawn(view, viewer)
    assert not any(name.startswith(("/grasp/depth", "/grasp/gaps")) for name in nodes)
    pieces = [name for name in nodes if name.startswith("/grasp/object/mesh/")]
    assert len(pieces) == len(viewer.state.scene.object.body.pieces) > 1


def test_the_ground_lies_below_all_and_the_light_comes_from_the_upper_left(view: View, viewer: Controller) -> None:
    nodes, shown = drawn(view, viewer), view.nodes.corners(viewer.state.shown)
    assert nodes["/ground/grid"].T[2, 3] == pytest.approx(shown[:, 2].min(), abs=0.003)
    shadow = nodes["/ground/shadow"]
    np.testing.assert_allclose(shadow.T[:2, 3], (shown.min(axis=0) + shown.max(axis=0))[:2] / 2, atol=0.01)
    # The picture of the shadow lies on its back: rows go along y.
    np.testing.assert_allclose(shadow.T[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-9)
    camera = view.server.initial_camera
    back = np.array(camera.position) - np.array(camera.look_at)
    towards, right = nodes["/light/key"].T[:3, 3], np.cross([0.0, 0.0, 1.0], back)
    assert towards @ back > 0 and towards @ right < 0 and towards[2] > 0


def test_a_table_is_drawn_with_its_top_at_the_plane(problem: Problem, server: Any) -> None:
    plane = Plane((0.6, 0.0, 0.8), -0.05)
    (group,) = problem.groups
    scene = replace(group.scene, task=Task(table=plane))
    viewer = controller(replace(problem, groups=(replace(group, scene=scene),)))
    table = drawn(View(server, viewer), viewer)["/grasp/table"]
    viewer.close()
    top = table.T @ np.array([0.0, 0.0, table.props["dimensions"][2] / 2, 1.0])
    assert top[:3] @ plane.normal == pytest.approx(plane.offset, abs=1e-9)
    np.testing.assert_allclose(table.T[:3, 2], plane.normal, atol=1e-9)
    middle = scene.object.mesh.bounds.mean(axis=0)
    np.testing.assert_allclose(np.cross(top[:3] - middle, plane.normal), 0.0, atol=2e-3)


def assert_sees(camera: Any, points: np.ndarray, aspect: float = 1.1) -> None:
    """Assert that a camera has points (N, 3) in its picture, up to few corners that are cut."""
    forward = np.array(camera.look_at) - np.array(camera.position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = (points - camera.position) @ np.stack([right, np.cross(right, forward), forward]).T
    opening = np.tan(camera.fov / 2)
    assert (seen[:, 2] > 0).all()
    assert (np.abs(seen[:, 1]) < opening * seen[:, 2]).mean() > 0.99
    assert (np.abs(seen[:, 0]) < aspect * opening * seen[:, 2]).mean() > 0.99


def test_the_first_camera_sees_hand_and_object(view: View, viewer: Controller) -> None:
    assert_sees(view.server.initial_camera, view.nodes.corners(viewer.state.shown))


def page_camera(number: int = 7) -> Any:
    """A page whose camera looks from afar."""
    camera = SimpleNamespace(position=np.array([3.0, 1.0, 2.0]), look_at=np.array([0.0, 0.0, 1.0]))
    return SimpleNamespace(client_id=number, camera=camera, atomic=nullcontext)


def back(camera: Any) -> np.ndarray:
    """Unit vector towards a camera."""
    away = np.array(camera.position) - np.array(camera.look_at)
    return away / np.linalg.norm(away)


@pytest.mark.parametrize("aspect", [0.5, 2.0])
@pytest.mark.parametrize("beside", [False, True])
def test_each_view_has_all_in_a_picture_of_any_shape(
    view: View, viewer: Controller, aspect: float, *, beside: bool
) -> None:
    viewer.editor.move_object(ASIDE)
    viewer.set(side_by_side=beside)
    view.draw(viewer.state)
    client = page_camera()
    points = transform_points(ASIDE, view.nodes.corners(viewer.state.shown))
    if beside:
        input_grasp = transform_points(pose(view.nodes.input_frame), view.nodes.corners(viewer.state.initial))
        points = np.concatenate([points, input_grasp])
    for name in ("best", "front", "side", "palm"):
        view.look(client, name, aspect)
        assert_sees(client.camera, points, aspect)
    view.look(client, "contacts", aspect)
    assert_sees(client.camera, transform_points(ASIDE, view.contacts.point_object), aspect)
    view.ready(client, aspect)
    np.testing.assert_allclose(back(client.camera), back(view.server.initial_camera), atol=1e-9)
    assert_sees(client.camera, points, aspect)


def test_the_palm_is_seen_from_what_it_holds(view: View, viewer: Controller) -> None:
    client = page_camera()
    view.look(client, "palm")
    hand = np.mean([T[:3, 3] for T in link_poses(viewer).values()], axis=0)
    assert back(client.camera) @ (view.contacts.point_object.mean(axis=0) - hand) > 0


def test_cameras_follow_the_grasp_until_a_user_moves_them_and_again_after_fit(
    view: View, viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    still, following = page_camera(1), page_camera(2)
    monkeypatch.setattr(view.server, "get_clients", lambda: {1: still, 2: following})
    for client in (still, following):
        view.look(client, "best")
    still.camera.position = np.array(still.camera.position) + (0.0, 0.0, 0.05)
    # Who drags a finger does not move the camera, though the page cannot tell.
    for client in (still, following):
        view.moved(client)
    before = np.array(still.camera.position)
    # Of another grasp, the hand is elsewhere.
    for number in (1, 2):
        viewer.grasps.show(number)
        viewer.editor.move_object(transform(np.eye(3), np.array([0.0, 0.3 * number, 0.0])))
        viewer.grasps.show(0)
        viewer.grasps.show(number)
        view.draw(viewer.state)
        points = transform_points(viewer.state.T_world_object, view.nodes.corners(viewer.state.shown))
        assert_sees(following.camera, points)
        np.testing.assert_array_equal(still.camera.position, before)
    # Iterations of a refinement and edits leave all cameras.
    before = np.array(following.camera.position)
    viewer.editor.set_joint(3, 0.4)
    view.draw(viewer.state)
    np.testing.assert_array_equal(following.camera.position, before)
    view.look(still, "best")
    viewer.grasps.show(0)
    view.draw(viewer.state)
    assert_sees(still.camera, view.nodes.corners(viewer.state.shown))


def test_what_is_nearest_to_a_camera_is_cut_away(view: View, viewer: Controller) -> None:
    client = page_camera()
    view.look(client, "side")
    depth = (np.array(client.camera.position) - view.nodes.corners(viewer.state.shown)) @ back(client.camera)
    for share in (0.25, 0.75, 0.0):
        view.cut(client, share)
        hidden = (depth < client.camera.near).any()
        assert hidden == (share > 0) and (not share or client.camera.near == pytest.approx(
            depth.min() + share * np.ptp(depth)
        ))  # fmt: skip


def test_hands_that_lift_stay_in_the_picture(view: View, viewer: Controller) -> None:
    """From the first frame to the last one, 0.3 m higher, though the object fell off."""
    shown, count = viewer.state.shown, 4
    T_root = np.tile(shown.T_object_root, (count, 1, 1))
    T_root[:, 2, 3] += np.linspace(0.0, 0.3, count)
    T_object = np.tile(np.eye(4), (count, 1, 1))
    T_object[-1, 2, 3] = -50.0
    q = np.tile(shown.q, (count, 1))
    lift = {"title": "lift", "time": np.arange(float(count)), "texts": ("lift",) * count, "travels": True}
    viewer.player.show(Recording(T_root=T_root, q=q, T_object=T_object, **lift))
    view.draw(viewer.state)
    for T in (T_root[0], T_root[-1]):
        assert_sees(view.server.initial_camera, view.nodes.corners(Pose(T, shown.q)))
    away = np.array(view.server.initial_camera.position) - np.array(view.server.initial_camera.look_at)
    assert np.linalg.norm(away) < 5.0


def has_ghost(view: View) -> bool:
    """Whether the input hand is drawn."""
    return view.nodes.ghost is not None and view.nodes.ghost.nodes[0].visible


def test_scrubbing_moves_the_hand_and_the_ghost_stays(view: View, viewer: Controller) -> None:
    initial = link_poses(viewer)
    assert not has_ghost(view)
    viewer.refinement.start()
    settled(viewer)
    for frame, moved in ((None, True), (5, True), (0, False)):
        viewer.player.scrub(frame)
        view.draw(viewer.state)
        T = link_poses(viewer)
        assert (np.linalg.norm((T[TIP] - initial[TIP])[:3, 3]) > 1e-3) == moved
        ghost = view.nodes.ghost
        for shape, node, copy in zip(ghost.shapes, view.nodes.hand.nodes, ghost.nodes, strict=True):
            np.testing.assert_allclose(pose(node), T[shape.link], atol=1e-7)
            np.testing.assert_allclose(pose(copy), initial[shape.link], atol=1e-7)
            assert copy.visible == moved


def test_pages_without_a_graphics_card_have_no_ground_and_no_input_hand_even_if_it_is_known_late(
    view: View, viewer: Controller
) -> None:
    page, extra = Page(view.server), {"/ground/grid", "/ground/shadow"}
    until(lambda: extra <= page.nodes().keys())
    viewer.editor.set_joint(3, 0.4)
    view.draw(viewer.state)
    assert has_ghost(view)
    view.simple = True
    for joint in (4, 5):
        viewer.editor.set_joint(joint, 0.3)
        view.draw(viewer.state)
        assert not has_ghost(view)
    until(lambda: not extra & page.nodes().keys())
    # A compared grasp is drawn there, too.
    other = controller(example(index=(1,))).state.collection
    viewer.grasps.open(other)
    viewer.grasps.compare(0)
    view.draw(viewer.state)
    assert has_ghost(view)
    page.close()


def test_side_by_side_the_input_grasp_has_an_object_of_its_own(view: View, viewer: Controller) -> None:
    viewer.editor.move_object(ASIDE)
    viewer.set(side_by_side=True)
    view.draw(viewer.state)
    nodes = view.nodes
    assert nodes.input_frame.visible and not has_ghost(view)
    apart = pose(nodes.input_frame)[:3, 3] - ASIDE[:3, 3]
    across = np.array(view.server.initial_camera.look_at) - np.array(view.server.initial_camera.position)
    assert np.linalg.norm(apart) > 0.1 and apart @ np.cross(across, [0.0, 0.0, 1.0]) < 0, "to the left"
    viewer.set(side_by_side=False)
    view.draw(viewer.state)
    assert not nodes.input_frame.visible and has_ghost(view)


def test_clicks_on_a_link_and_on_the_object_set_a_target_on_both_surfaces(view: View, viewer: Controller) -> None:
    viewer.editor.move_object(ASIDE)
    viewer.targets.set_picking(True)
    view.draw(viewer.state)
    state, nodes = viewer.state, view.nodes
    tip = [shape.link for shape in view.nodes.hand.shapes].index(TIP)
    T = ASIDE @ link_poses(viewer)[TIP]
    middle = transform_points(T, nodes.shapes[tip].vertices.astype(float).mean(axis=0))
    eye = np.array([0.5, 0.4, 0.6])
    nodes.interaction._clicked_link(tip, eye, (middle - eye) / np.linalg.norm(middle - eye))
    view.draw(viewer.state)
    link, point = viewer.state.picked
    (picked,) = nodes.picked.nodes
    np.testing.assert_allclose(picked.position, transform_points(inverse(ASIDE) @ T, point), atol=1e-7)
    centre = transform_points(state.T_world_object, np.array([0.0, 0.0, 0.05]))
    nodes.interaction._clicked_object(eye, (centre - eye) / np.linalg.norm(centre - eye))
    view.draw(viewer.state)
    (target,) = viewer.state.targets
    assert link == target.link == TIP and len(nodes.targets.nodes) == 1
    # On the mug's wall: 4 cm from its axis, to within the pieces.
    assert np.linalg.norm(target.point_object[:2]) == pytest.approx(0.04, abs=2.5e-3)
    before = target.point_object
    away = transform_points(state.T_world_object, before + np.array([0.0, 0.0, 0.01]))
    client = SimpleNamespace(camera=SimpleNamespace(position=eye))
    nodes.interaction._drag_target(0, SimpleNamespace(client=client, end_position=away, phase="update"))
    moved = viewer.state.targets[0].point_object
    assert 5e-3 < np.linalg.norm(moved - before) < 3e-2
    assert np.linalg.norm(moved[:2]) == pytest.approx(0.04, abs=2.5e-3)
    # A ray that meets nothing does nothing.
    nodes.interaction._clicked_object(eye, np.array([0.0, 0.0, 1.0]))
    assert len(viewer.state.targets) == 1


def test_a_gizmo_moves_what_it_stands_at_in_one_step_for_each_drag(view: View, viewer: Controller) -> None:
    viewer.editor.move_object(ASIDE)
    for kind in ("hand", "object"):
        viewer.set(gizmo=kind)
        view.draw(viewer.state)
        gizmos, state = view.nodes.interaction.gizmos, viewer.state
        assert list(gizmos) == [kind]
        hand = ASIDE @ state.shown.T_object_root
        np.testing.assert_allclose(pose(gizmos[kind]), hand if kind == "hand" else ASIDE, atol=1e-7)
        steps, drag = len(state.undo_steps), getattr(view.nodes.interaction, f"_drag_{kind}")
        for phase, x in (("start", 0.0), ("update", 0.01), ("update", 0.01), ("start", 0.0), ("update", 0.01)):
            gizmos[kind].position = np.array(gizmos[kind].position) + np.array([x, 0.0, 0.0])
            done(drag(SimpleNamespace(client=object(), target=gizmos[kind], phase=phase)))
        # What Python sets is no drag.
        done(drag(SimpleNamespace(client=None, target=gizmos[kind], phase="update")))
        now = viewer.state
        assert len(now.undo_steps) == steps + 2
        aside = transform(np.eye(3), np.array([0.03, 0.0, 0.0]))
        hand = now.T_world_object @ now.shown.T_object_root
        before = state.T_world_object @ state.shown.T_object_root
        np.testing.assert_allclose(hand, aside @ before if kind == "hand" else before, atol=1e-7)
        np.testing.assert_allclose(now.T_world_object, ASIDE if kind == "hand" else aside @ ASIDE, atol=1e-7)


def test_a_finger_follows_a_drag_of_its_link_in_one_step(view: View, viewer: Controller) -> None:
    viewer.editor.edit("", T_world_object=ASIDE)
    viewer.set(gizmo="fingers")
    view.draw(viewer.state)
    interaction, start = view.nodes.interaction, viewer.state
    assert not interaction.gizmos
    k = [shape.link for shape in view.nodes.hand.shapes].index(TIP)
    point = np.array([0.003, 0.0, 0.01])

    def grabbed() -> np.ndarray:
        return transform_points(ASIDE @ link_poses(viewer)[TIP], point)

    first, q = grabbed(), start.shown.q.copy()
    q[2:4] -= 0.1
    T = ASIDE @ view.nodes.hand.poses(start.shown.T_object_root, q)[TIP]
    bent = transform_points(T, point)
    for phase, share in (("start", 0.0), ("update", 0.5), ("end", 1.0)):
        event = SimpleNamespace(phase=phase, start_position=grabbed(), end_position=first + share * (bent - first))
        interaction._drag_link(k, event)
    np.testing.assert_allclose(grabbed(), bent, atol=1e-4)
    assert len(viewer.state.undo_steps) == len(start.undo_steps) + 1
    viewer.set(gizmo="none")
    view.draw(viewer.state)
    assert not interaction._fingers


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
    view.draw(viewer.state.evolve(pose=replace(shown, q=np.full_like(shown.q, np.nan))))
    assert np.isfinite(pose(view.nodes.hand.nodes[0])).all()


def test_a_simulation_moves_the_object_and_shows_the_push(
    view: View, viewer: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The first example grasp that holds with the usual friction: what is ejected while the hand closes is not pushed.
    viewer.grasps.show(1)
    viewer.simulation.test(short_trials(monkeypatch), 0.15)
    settled(viewer)
    viewer.simulation.record("+z")
    settled(viewer)
    nodes, motion = view.nodes, viewer.state.motion
    for frame in (max(range(len(motion)), key=lambda k: len(motion.contacts[k])), len(motion) - 1):
        viewer.player.show_frame(frame)
        view.draw(viewer.state)
        points = np.reshape([node.position for node in nodes.points_object.nodes], (-1, 3))
        np.testing.assert_allclose(points, motion.contacts[frame], atol=1e-6)
        np.testing.assert_allclose(pose(nodes.object_frame), viewer.state.T_shown_object, atol=1e-6)
    assert len(motion.contacts[0]) == 0 < max(map(len, motion.contacts))
    assert not has_ghost(view) and not nodes.points_link.nodes
    # From the middle of the object along the axis of its frame in which it was pushed at the start.
    ((start, end),) = nodes.push.node.points
    np.testing.assert_allclose((end - start) / np.linalg.norm(end - start), [0.0, 0.0, 1.0], atol=1e-5)
    viewer.player.show(None)
    view.draw(viewer.state)
    np.testing.assert_allclose(pose(nodes.object_frame), np.eye(4), atol=1e-12)
    assert nodes.push.node is None


def test_a_click_on_a_link_reads_its_distance_and_force_and_another_one_ends_that(
    view: View, viewer: Controller
) -> None:
    viewer.refinement.start()
    settled(viewer)
    view.draw(viewer.state)
    found, interaction = view.contacts, view.nodes.interaction
    middle = np.mean(view.nodes.prepared.box, axis=0)
    # From inside the object outwards through each contact lies the link that touches there.
    for link, point in zip(found.link, found.point_link, strict=True):
        if not link.endswith("_tip"):
            # It touches at its rim, beside a tip.
            continue
        outwards = (point - middle) / np.linalg.norm(point - middle)
        interaction._clicked_anywhere(SimpleNamespace(ray_origin=point - 0.01 * outwards, ray_direction=outwards))
        assert interaction.label.text.startswith(f"{link}: touches")
        np.testing.assert_allclose(interaction.label.position, point, atol=3e-3)
    newtons = sum(float(found.reading(link, 30.0).rpartition(", ")[2].split()[0]) for link in found.link)
    # Links with small gaps press, too; forces in the corners of a patch add up to at most their sum.
    every = 30.0 * np.linalg.norm(found.forces.force, axis=1).sum()
    assert 0.5 * every < newtons < every + 0.3
    viewer.editor.move_root(transform(np.eye(3), np.array([0.0, 0.0, 1.0])) @ viewer.state.pose.T_object_root)
    view.draw(viewer.state)
    assert " mm" in interaction.label.text or "not near" in interaction.label.text
    interaction._clicked_anywhere(SimpleNamespace(ray_origin=np.ones(3), ray_direction=np.ones(3)))
    assert interaction.label is None
