"""A finger that is dragged: it follows within its limits, and stops at the object; nothing else moves."""

import numpy as np
import pytest

from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.following import draggable_links, follow
from grasp_refine_apps.viewer.model.pose import Pose, Target

THUMB = "link_15.0_tip"
POINT = np.array([0.0, 0.0, 0.005])
THUMB_JOINTS = slice(12, 16)


@pytest.fixture
def prepared(viewer: Controller) -> HandObject:
    return HandObject(viewer.state.scene.hand, viewer.state.scene.object)


@pytest.fixture
def scene(viewer: Controller) -> Scene:
    return viewer.state.scene


@pytest.fixture
def opened(viewer: Controller, scene: Scene) -> Pose:
    """The first grasp with its thumb bent back from the mug."""
    q = viewer.state.pose.q.copy()
    q[14:16] = np.maximum(q[14:16] - 0.2, scene.hand.lower[14:16])
    return Pose(viewer.state.pose.T_object_root, q)


def tip(prepared: HandObject, pose: Pose, point: np.ndarray = POINT, link: str = THUMB) -> np.ndarray:
    T = prepared.chain(pose.T_object_root[None], pose.q[None]).T_world_link[0]
    return transform_points(T[prepared.chain.links.index(link)], point)


def distances(prepared: HandObject, pose: Pose) -> np.ndarray:
    """Distances of the links that the thumb's joints move."""
    T = prepared.chain(pose.T_object_root[None], pose.q[None]).T_world_link
    found = prepared.query(np.zeros(1, dtype=int), T).distance[0]
    return found[prepared.chain.moves[:, THUMB_JOINTS].any(axis=1)]


def test_a_fingertip_goes_where_it_is_dragged_and_nothing_else_moves(
    prepared: HandObject, scene: Scene, opened: Pose
) -> None:
    q = opened.q.copy()
    q[THUMB_JOINTS] += (-0.06, -0.08, 0.07, 0.05)
    wanted = tip(prepared, Pose(opened.T_object_root, q))
    assert distances(prepared, opened).min() > 0.005 and np.linalg.norm(wanted - tip(prepared, opened)) > 0.004
    moved = follow(prepared, scene, opened, Target(THUMB, POINT, wanted))
    np.testing.assert_allclose(tip(prepared, moved), wanted, atol=2e-5)
    assert moved.T_object_root is opened.T_object_root
    others = np.delete(np.arange(16), THUMB_JOINTS)
    assert np.array_equal(moved.q[others], opened.q[others])


def test_a_target_out_of_reach_ends_at_limits_and_nearer(prepared: HandObject, scene: Scene, opened: Pose) -> None:
    away = tip(prepared, opened) - prepared.object.body.diagonal * np.array([0.0, 0.0, 5.0])
    moved = follow(prepared, scene, opened, Target(THUMB, POINT, away))
    hand = scene.hand
    assert (moved.q >= hand.lower).all() and (moved.q <= hand.upper).all()
    assert np.linalg.norm(tip(prepared, moved) - away) < np.linalg.norm(tip(prepared, opened) - away)


def test_a_finger_stops_at_the_object_and_slides_along_it(prepared: HandObject, scene: Scene, opened: Pose) -> None:
    first = tip(prepared, opened)
    inside = np.array([0.0, 0.0, first[2]])
    pose, heights = opened, []
    # To the middle of the mug, and up.
    for share, up in [*((0.2 * k, 0.0) for k in range(6)), *((1.0, 0.003 * k) for k in range(1, 4))]:
        wanted = first + share * (inside - first) + np.array([0.0, 0.0, up])
        pose = follow(prepared, scene, pose, Target(THUMB, POINT, wanted))
        gap = distances(prepared, pose).min()
        assert gap > -1e-9 and (share < 1.0 or gap < 3e-4)
        heights.append(tip(prepared, pose)[2])
    assert heights[-1] - heights[5] > 0.006


def test_a_finger_in_the_object_goes_out_and_no_deeper(prepared: HandObject, scene: Scene, opened: Pose) -> None:
    inward = np.array([0.0, 0.0, tip(prepared, opened)[2]])
    stopped = follow(prepared, scene, opened, Target(THUMB, POINT, inward))
    q = stopped.q.copy()
    q[14:16] += 0.05
    deep = Pose(stopped.T_object_root, q)
    depth = distances(prepared, deep).min()
    assert depth < -0.002
    for toward, out in ((inward, False), (tip(prepared, deep) * (1.2, 1.2, 1.0), True)):
        moved = distances(prepared, follow(prepared, scene, deep, Target(THUMB, POINT, toward))).min()
        assert moved >= depth
        assert not out or moved > depth + 1e-3


def test_only_links_of_fingers_can_be_dragged(prepared: HandObject) -> None:
    links = draggable_links(prepared)
    assert THUMB in links and "base_link" not in links


def test_one_drag_is_one_step_that_can_be_undone(prepared: HandObject, viewer: Controller, opened: Pose) -> None:
    viewer.editor.edit("", pose=opened)
    steps = len(viewer.state.undo_steps)
    for drag, shift in ((1, 0.002), (1, 0.004), (2, 0.006)):
        target = Target(THUMB, POINT, tip(prepared, opened) - (0.0, 0.0, shift))
        viewer.editor.move_finger(target, drag)
    assert len(viewer.state.undo_steps) == steps + 2
    np.testing.assert_allclose(tip(prepared, viewer.state.pose), target.point_object, atol=1e-4)
    viewer.editor.undo()
    viewer.editor.undo()
    assert viewer.state.pose.same(opened)


def test_a_finger_stops_at_its_neighbour(prepared: HandObject, scene: Scene, opened: Pose) -> None:
    # The bent index finger is dragged across the bent middle finger, far from the mug.
    q, T = np.clip(np.zeros(16), scene.hand.lower, scene.hand.upper), opened.T_object_root.copy()
    q[[1, 5]], T[2, 3] = 1.2, 1.0
    before = pose = Pose(T, q)
    index, middle = (tip(prepared, before, np.zeros(3), link) for link in ("link_3.0_tip", "link_7.0_tip"))
    for share in np.linspace(0.0, 2.0, 9)[1:]:
        pose = follow(prepared, scene, pose, Target("link_3.0_tip", np.zeros(3), index + share * (middle - index)))
        assert self_penetration(scene.hand, touching_pairs(scene.hand), pose.q[None])[0] < 1e-4
    moved = np.linalg.norm(tip(prepared, pose, np.zeros(3), "link_3.0_tip") - index)
    assert 0.005 < moved < 0.9 * np.linalg.norm(middle - index)
    # Drawn back, it comes.
    back = follow(prepared, scene, pose, Target("link_3.0_tip", np.zeros(3), index))
    assert np.linalg.norm(tip(prepared, back, np.zeros(3), "link_3.0_tip") - index) < 1e-3
