"""What is wanted of a grasp: given targets, nearest points, or only that links touch."""

from dataclasses import replace

import numpy as np
import pytest

from boxed_example import boxed_example
from grasp_refine.measures.geometry import measure
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.goal import goal_of
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The four example grasps of the embedded hand on the embedded box."""
    return boxed_example(candidates=64)


AIMED = [0, 5, 9]
"""Links with targets, of different shapes."""


def given(scene: Scene, seed: int = 0) -> Scene:
    """Targets of three links: points on the surfaces, but for the last grasp, which has none."""
    rng = np.random.default_rng(seed)
    shape = (len(scene.q), len(scene.links), 3)
    on_link, on_object = np.full((2, *shape), np.nan)
    for column in AIMED:
        surface = scene.hand.links_by_name[scene.links[column]].body.candidates.points
        on_link[:-1, column] = surface[rng.integers(len(surface), size=len(scene.q) - 1)]
    surface = scene.object.body.candidates.points
    on_object[:-1, AIMED] = surface[rng.integers(len(surface), size=(len(scene.q) - 1, 3))]
    return replace(scene, target_link=on_link, target_object=on_object)


def test_links_that_are_near_should_touch_anywhere(scene: Scene) -> None:
    goal = goal_of(scene, ContactSelection())
    none = np.full((*goal.touching.shape, 3), np.nan)
    found = measure(HandObject.of(scene), scene.T_world_root, scene.q, none, none)
    np.testing.assert_array_equal(goal.touching, ContactSelection().choose(scene.hand, scene.links, found.witness))
    assert (goal.touching.sum(axis=1) >= 2).all() and not goal.aimed.any()
    assert np.isnan(goal.target_link).all() and np.isnan(goal.target_object).all()
    assert (goal.queries > 0).all() and not goal.off_surface.any() and goal.direction is None


def test_nearest_points_are_targets_of_the_same_links_on_both_surfaces(scene: Scene) -> None:
    goal, free = goal_of(scene, ContactSelection(), nearest=True), goal_of(scene, ContactSelection())
    np.testing.assert_array_equal(goal.touching, free.touching)
    np.testing.assert_array_equal(goal.aimed, goal.touching)
    found = measure(HandObject.of(scene), scene.T_world_root, scene.q, goal.target_link, goal.target_object)
    # They are the witness points, as far apart as the bodies.
    gap = np.abs(found.distance)[goal.touching]
    np.testing.assert_allclose(found.contact_error[goal.touching], gap, atol=1e-9)
    assert np.isnan(found.contact_error[~goal.touching]).all()
    np.testing.assert_allclose(goal.target_object[goal.touching], found.witness.point_b[goal.touching], atol=1e-9)


@pytest.mark.parametrize("nearest", [False, True])
def test_grasps_far_away_or_not_finite_have_no_goal(scene: Scene, nearest: bool) -> None:
    T, q = scene.T_world_root.copy(), scene.q.copy()
    T[0, 0, 3] += 1.0
    T[1, 1, 1] = np.nan
    q[2, 3] = np.inf
    goal = goal_of(replace(scene, T_world_root=T, q=q), ContactSelection(), nearest=nearest)
    assert not goal.touching[:3].any() and goal.touching[3].any()
    assert not goal.aimed[:3].any()
    np.testing.assert_array_equal(goal.touching[3], goal_of(scene, ContactSelection()).touching[3])


def test_links_given_by_name_are_the_goal_even_of_a_grasp_far_away(scene: Scene) -> None:
    T = scene.T_world_root.copy()
    T[0, 0, 3] += 1.0
    goal = goal_of(replace(scene, T_world_root=T), ContactSelection(links=("base_link", scene.links[0])), nearest=True)
    np.testing.assert_array_equal(goal.touching, np.tile(np.isin(scene.links, ["base_link", scene.links[0]]), (4, 1)))
    assert np.isfinite(goal.target_link[goal.touching]).all()


def test_given_targets_are_the_goal_and_nothing_is_asked_for_it(scene: Scene) -> None:
    aimed = given(scene)
    for touching, nearest in ((ContactSelection(), True), (ContactSelection(links=(scene.links[7],)), False)):
        goal = goal_of(aimed, touching, nearest=nearest)
        np.testing.assert_array_equal(goal.target_link, aimed.target_link)
        np.testing.assert_array_equal(goal.target_object, aimed.target_object)
        np.testing.assert_array_equal(goal.touching, np.isfinite(aimed.target_link[..., 0]))
        assert not goal.touching[3].any() and not goal.queries.any()


@pytest.mark.parametrize("side", ["target_link", "target_object"])
def test_a_point_on_one_side_only_is_no_target(scene: Scene, side: str) -> None:
    aimed = given(scene)
    points = getattr(aimed, side).copy()
    points[0], points[1, AIMED[1], 2] = np.nan, np.nan
    goal = goal_of(replace(aimed, **{side: points}), ContactSelection())
    np.testing.assert_array_equal(goal.touching.sum(axis=1), [0, 2, 3, 0])
    for target in (goal.target_link, goal.target_object):
        np.testing.assert_array_equal(np.isnan(target).any(axis=-1), ~goal.touching)


def test_targets_on_the_surfaces_are_on_them_and_others_as_far_off_as_they_are(scene: Scene) -> None:
    aimed = given(scene)
    np.testing.assert_allclose(goal_of(aimed, ContactSelection()).off_surface, 0.0, atol=1e-12)
    body = scene.object.body.candidates
    where = aimed.target_object.copy()
    # Above the top of the box, and as far below it; the sum of the squares of all that are off.
    top = body.points[body.normals[:, 2] > 0.999]
    middle = top[np.linalg.norm(top[:, :2], axis=1).argmin()]
    where[0, 0], where[1, 0] = middle + [0, 0, 0.005], middle - [0, 0, 0.004]
    where[2, AIMED[:2]] = middle + [0, 0, 0.003]
    goal = goal_of(replace(aimed, target_object=where), ContactSelection())
    np.testing.assert_allclose(np.sqrt(goal.off_surface), [0.005, 0.004, 0.003 * np.sqrt(2), 0.0], atol=1e-6)
    # On the links' side, too, each in the frame of its own link.
    on_link = aimed.target_link.copy()
    tip = scene.hand.links_by_name[scene.links[AIMED[2]]].body.candidates
    on_link[0, AIMED[2]] = tip.points[0] + 0.002 * tip.normals[0]
    off = goal_of(replace(aimed, target_link=on_link), ContactSelection()).off_surface
    assert 0.0005 < np.sqrt(off[0]) < 0.002 * 1.001 and off[1] < 1e-12


def test_wanted_directions_are_handed_on(scene: Scene) -> None:
    wanted = np.full((4, len(scene.links), 3), np.nan)
    wanted[:, 0] = [0.0, 0.0, 1.0]
    for one in (scene, given(scene)):
        np.testing.assert_array_equal(goal_of(replace(one, direction=wanted), ContactSelection()).direction, wanted)


@pytest.mark.parametrize("kind", ["near", "nearest", "targets"])
def test_a_link_with_a_direction_should_touch_though_it_is_not_near(scene: Scene, kind: str) -> None:
    """With nearest points as targets, it once had one that no query had found: the origin of its own frame."""
    one, nearest = given(scene) if kind == "targets" else scene, kind == "nearest"
    plain = goal_of(one, ContactSelection(), nearest=nearest)
    column = int(np.flatnonzero(~plain.touching.any(axis=0))[-1])
    wanted = np.full((4, len(scene.links), 3), np.nan)
    wanted[:3, column] = [0.0, 0.6, 0.8]
    goal = goal_of(replace(one, direction=wanted), ContactSelection(), nearest=nearest)
    assert goal.touching[:3, column].all() and not goal.touching[3, column]
    others = np.arange(len(scene.links)) != column
    np.testing.assert_array_equal(goal.touching[:, others], plain.touching[:, others])
    for name in ("target_link", "target_object"):
        np.testing.assert_array_equal(getattr(goal, name), getattr(plain, name))
