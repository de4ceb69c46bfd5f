"""Contact links of grasps: recorded ones, those with a target, or those near the object, in this order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import Witness, query
from grasp_refine.grasps.grasp_set import ContactLinks, GraspSet, load_grasps, save_npz
from grasp_refine.measures.metrics import metrics_of
from grasp_refine.scene.contact_links import contact_gaps
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from sliding_gripper import around_object, sliding_gripper


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    hand = sliding_gripper(tmp_path_factory.mktemp("hand"), "box", candidates=64)
    return around_object(hand, 4, 0)


def witness_of(scene: Scene) -> Witness:
    prepared = HandObject.of(scene)
    T = prepared.chain(scene.T_world_root, scene.q).T_world_link
    return query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))


def test_recorded_links_come_before_targets_and_these_before_what_is_near(scene: Scene) -> None:
    witness, shape = witness_of(scene), (len(scene.q), len(scene.links))
    near = ContactSelection().choose(scene.hand, scene.links, witness)
    np.testing.assert_array_equal(~np.isnan(contact_gaps(scene, witness)), near)
    points = np.full((*shape, 3), np.nan)
    points[:, 0] = 0.01
    aimed = replace(scene, target_link=points, target_object=points)
    np.testing.assert_array_equal(~np.isnan(contact_gaps(aimed, witness)), np.arange(shape[1]) == np.zeros((4, 1)))
    recorded = np.full(shape, np.nan)
    recorded[:2, 1] = 0.001
    found = contact_gaps(replace(scene, contact_gap=recorded), witness)
    np.testing.assert_array_equal(found[:2], recorded[:2])
    np.testing.assert_array_equal(~np.isnan(found[2:]), near[2:])
    found = contact_gaps(replace(aimed, contact_gap=recorded), witness)
    np.testing.assert_array_equal(found[0, :2], [0.0, 0.001])


def test_the_contact_error_is_the_worst_gap_of_the_contact_links(scene: Scene) -> None:
    distance, recorded = witness_of(scene).distance, np.full((len(scene.q), len(scene.links)), np.nan)
    recorded[:, :2] = 0.002, 0.0
    found = metrics_of(replace(scene, contact_gap=recorded)).contact_error_m
    np.testing.assert_allclose(found, np.abs(distance[:, :2] - [0.002, 0.0]).max(axis=1), atol=1e-12)


def test_links_are_recorded_once_and_found_again_in_a_file(scene: Scene, tmp_path: Path) -> None:
    links = ("tip", "tip", "palm", "other")
    gap = np.array([[np.nan, 0.001, np.nan, 0.0], [np.nan, np.nan, 0.0, np.nan]])
    found = ContactLinks.of(links, gap)
    assert found.name.tolist() == [["tip", "other"], ["palm", ""]]
    grasps = GraspSet.of(scene.hand, scene.T_world_root[:2], scene.q[:2])
    save_npz(tmp_path / "one.npz", replace(grasps, contact_links=found).arrays())
    again = load_grasps(tmp_path / "one.npz").select([1, 0]).contact_links
    assert again is not None
    expected = np.array([[np.nan, np.nan, 0.0, np.nan], [0.001, np.nan, np.nan, 0.0]])
    np.testing.assert_array_equal(again.on(links), expected)
    # Of another hand nothing is recorded where one of the links is missing.
    np.testing.assert_array_equal(again.on(("palm", "tip")), [[0.0, np.nan], [np.nan, np.nan]])
