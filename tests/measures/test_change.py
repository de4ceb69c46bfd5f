"""Change of grasps: boundaries of each word, and movements of contacts in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from claw import TIPS, around, capsule, claw
from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.measures.change import MOVED_M, changes, links_kept
from grasp_refine.refinement.refine import Refinement
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.scene.scene import Scene


@pytest.mark.parametrize(
    ("before", "after", "moved_m", "kept", "word"),
    [
        ("ab", "ab", MOVED_M, 1.0, "kept"),
        ("ab", "ab", MOVED_M + 1e-9, 1.0, "contacts moved"),
        ("abc", "ab", 0.0, 2 / 3, "other links"),
        ("ab", "abc", 0.0, 1.0, "other links"),
        ("ab", "abcd", 0.0, 1.0, "other links"),  # half of those that touch before or after
        ("ab", "bc", 0.0, 0.5, "other grasp"),  # a third of them
        ("a", "abc", 0.0, 1.0, "other grasp"),
        ("ab", "cd", np.nan, 0.0, "other grasp"),
        ("", "ab", np.nan, np.nan, "other grasp"),
    ],
)
def test_a_word_says_which_links_touch_and_whether_they_moved(
    before: str, after: str, moved_m: float, kept: float, word: str
) -> None:
    first, last = (np.array([[name in links for name in "abcd"]]) for links in (before, after))
    assert changes(first, last, np.array([moved_m])).tolist() == [word]
    np.testing.assert_allclose(links_kept(first, last), [kept])


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Three claws around a capsule, all tips of which touch."""
    found = around(claw(tmp_path_factory.mktemp("claw")), capsule(), 3, 2)
    return replace(found, contact_gap=np.where(np.isin(found.links, TIPS), 0.0, np.full((3, 1), np.nan)))


def refined_to(
    scene: Scene, T: np.ndarray, q: np.ndarray, tips: tuple[str, ...] = TIPS, status: Status = Status.CONVERGED
) -> Outcome:
    """The outcome of a refinement that ended with these poses, and these tips touching."""
    N, L = len(q), len(scene.links)
    touching, count, time = np.tile(np.isin(scene.links, tips), (N, 1)), np.zeros(N, dtype=int), np.zeros(N)
    nowhere, ended = np.full((N, L, 3), np.nan), np.full(N, status)
    refinement = Refinement(T, q, touching, nowhere, nowhere, ended, np.zeros((N, 2)), count, count, time, time, count)
    motion = Motion(np.repeat(T[:, None], 3, axis=1), np.repeat(q[:, None], 3, axis=1))
    rows = np.arange(N)
    return compare(scene, refinement, motion, margin=0.0, name="capsule", scale=1.0, row=rows, index=rows)


@pytest.mark.parametrize(("length", "word"), [(0.0, "kept"), (4.99e-3, "kept"), (5.01e-3, "contacts moved")])
def test_a_translation_moves_hand_and_contacts_by_its_length(scene: Scene, length: float, word: str) -> None:
    T = scene.T_world_root.copy()
    T[:, :3, 3] += length * np.array([0.6, 0.0, -0.8])
    outcome = refined_to(scene, T, scene.q)
    for name in ("displacement_m", "contacts_moved_m"):
        np.testing.assert_allclose(outcome[name], length, atol=1e-12)
    assert outcome.change.tolist() == [word] * 3 and outcome["links_kept"].tolist() == [1.0] * 3


def test_a_joint_moves_the_contact_of_its_finger_alone(scene: Scene) -> None:
    """By the chord of its turn about the joint, a quarter of which is the mean over four contacts."""
    hand, q, angle = scene.hand, scene.q.copy(), 0.3
    q[:, hand.joint_names.index("I1")] += angle
    outcome, still = refined_to(scene, scene.T_world_root, q), refined_to(scene, scene.T_world_root, scene.q)
    index, T = scene.links.index("index"), Chain(hand, ("index",))(scene.T_world_root, scene.q).T_world_link[:, 0]
    point = still.contact_point_object[:, index] - still.contact_normal[:, index] * still.contact_distance[:, [index]]
    at = transform_points(np.linalg.inv(T), point)
    axis = np.array([0.3, 1.0, 0.0]) / np.hypot(0.3, 1.0)
    chord = 2 * np.sin(angle / 2) * np.linalg.norm(np.cross(axis, at), axis=-1)
    np.testing.assert_allclose(outcome["contacts_moved_m"], chord / 4, rtol=1e-6)
    assert (outcome["displacement_m"] < chord).all() and (outcome["displacement_m"] > 1e-3).all()


def test_links_that_no_longer_touch_do_not_count_as_moved(scene: Scene) -> None:
    q = scene.q.copy()
    q[:, scene.hand.joint_names.index("I1")] += 0.3
    outcome = refined_to(scene, scene.T_world_root, q, TIPS[1:])
    assert outcome.change.tolist() == ["other links"] * 3 and outcome["links_kept"].tolist() == [0.75] * 3
    np.testing.assert_allclose(outcome["contacts_moved_m"], 0.0, atol=1e-12)
    other = refined_to(scene, scene.T_world_root, q, ("palm",))
    assert other.change.tolist() == ["other grasp"] * 3 and np.isnan(other["contacts_moved_m"]).all()


def test_grasps_that_were_not_refined_have_no_change(scene: Scene) -> None:
    q = scene.q.copy()
    q[0] = np.nan
    outcome = refined_to(replace(scene, q=q), scene.T_world_root, q, status=Status.NOT_FINITE)
    assert outcome.change.tolist() == [""] * 3
    assert np.isnan(outcome["displacement_m"]).tolist() == [True, False, False]
