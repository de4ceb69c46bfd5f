"""Films of refinements and simulations: which frames, what they show, what they say."""

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.drawing.colors import distance_colors
from grasp_refine_apps.viewer.files.animation import MAX_FRAMES, Film, film_of
from grasp_refine_apps.viewer.files.animation import film as film_of_recording
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.contacts import contacts_of
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.recording import Recording, subsample
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.trace import Trace
from grasp_refine_apps.viewer.model.work import Work
from refusals import assert_names, refused

AWAY = 0.04
"""Metres by which the hand comes nearer in the film."""


@pytest.fixture(scope="module")
def collection(problem: Problem) -> Collection:
    return Collection.of(problem)


@pytest.fixture(scope="module")
def scene(collection: Collection) -> Scene:
    return collection.scene(0)


def coming(scene: Scene, count: int) -> Trace:
    """The hand moves straight along x to where it is in the scene."""
    T = np.repeat(scene.T_world_root[:1], count, axis=0)
    T[:, 0, 3] += np.linspace(AWAY, 0.0, count)
    gap = np.full((count, len(scene.links)), np.nan)
    gap[:, -1] = 0.0
    ramp = np.linspace(0.002, 0.0, count)
    measures = {"gap": gap, "loss": ramp, "remaining": ramp, "penetration": 0.5 * ramp}
    return Trace.of(T, np.repeat(scene.q[:1], count, axis=0), **measures, label=("gaps close",) * count)


@pytest.fixture(scope="module")
def film(scene: Scene) -> Film:
    return film_of_recording(scene, coming(scene, 5))


def test_many_iterations_are_thinned_evenly_and_keep_both_ends():
    assert subsample(5, MAX_FRAMES).tolist() == [0, 1, 2, 3, 4]
    assert subsample(1, MAX_FRAMES).tolist() == [0]
    kept = subsample(1003, MAX_FRAMES)
    assert len(kept) == MAX_FRAMES and kept[0] == 0 and kept[-1] == 1002
    assert set(np.diff(kept)) == {5, 6}


def test_a_refinement_is_shown_frame_by_frame_with_its_numbers(scene: Scene, film: Film):
    assert_names(film.title, "allegro", "mug")
    assert [frame.pose.T_object_root[0, 3] for frame in film.frames] == pytest.approx(
        scene.T_world_root[0, 0, 3] + np.array([0.04, 0.03, 0.02, 0.01, 0.0])
    )
    first, last = film.frames[0], film.frames[-1]
    for frame, named in ((first, ("1 of 5", "2.00 mm", "1.00 mm")), (last, ("5 of 5", "0.00 mm"))):
        assert all(one in frame.caption for one in ("gaps close", *named)), frame.caption
    assert last.caption.count("0.00 mm") == 2
    np.testing.assert_array_equal(last.T_object, np.eye(4))


def test_lines_go_from_the_links_that_touch_to_the_object(scene: Scene, film: Film):
    prepared = HandObject.of(scene)
    gap = np.where(np.arange(len(scene.links)) == len(scene.links) - 1, 0.0, np.nan)
    for frame in film.frames:
        found = contacts_of(prepared, frame.pose.T_object_root, frame.pose.q, gap=gap)
        np.testing.assert_allclose(frame.lines, np.stack([found.point_link, found.point_object], axis=1), atol=1e-7)
        np.testing.assert_array_equal(frame.colors, distance_colors(found.distance))
        assert scene.links[-1] in found.link


def test_a_simulation_moves_the_object_and_reports_how_far(scene: Scene):
    count = 3
    T_object = np.tile(np.eye(4), (count, 1, 1))
    T_object[:, 0, 3] = [0.0, 0.005, 0.02]
    motion = Recording(
        title="simulation, +x, moved",
        T_root=np.repeat(scene.T_world_root[:1], count, axis=0),
        q=np.repeat(scene.q[:1], count, axis=0),
        time=np.arange(count) * 0.1,
        texts=tuple(f"moved {1e3 * T[0, 3]:.1f} mm" for T in T_object),
        T_object=T_object,
        pushed=np.ones(count, dtype=bool),
        force=np.array([1.0, 0.0, 0.0]),
    )
    film = film_of_recording(scene, motion)
    assert_names(film.title, "allegro", "mug", "+x", "moved")
    np.testing.assert_array_equal([frame.T_object for frame in film.frames], T_object)
    assert [frame.caption for frame in film.frames] == [motion.text(k) for k in range(count)]
    assert "20.0 mm" in film.frames[-1].caption
    # The push is seen, from the object outwards along its axis; it was missing in the file.
    for frame in film.frames:
        shaft = frame.push[0]
        assert len(frame.push) == 5 and shaft[1, 0] - frame.T_object[0, 3] > scene.object.mesh.bounds[1, 0]
        np.testing.assert_allclose(shaft[0, 1:], shaft[1, 1:], atol=1e-12)


def test_a_state_is_filmed_by_what_it_shows(collection: Collection, scene: Scene):
    pose = Pose(scene.T_world_root[0], scene.q[0])
    state = State(collection, 0, scene, pose, {0: Work(pose)}, settings=None)
    with refused(GraspRefineError):
        film_of(state)
    assert len(film_of(state.evolve(trace=coming(scene, 2))).frames) == 2
