"""The example grasps are what the script makes, almost right, and good after refinement."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, match_joints
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.geometry import measure
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.refine import Scene, refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.authoring.close_fingers import (
    CLEARANCE_M,
    CLOSING_JOINTS,
    EXAMPLES,
    HANDS,
    OPEN_RAD,
    HandObjectDistances,
    close,
    example_grasps,
    main,
    sample_touching,
)

HAND = load_hand("allegro")


def example(name: str) -> GraspSet:
    return load_grasps(resource_dir("robots") / "allegro" / f"example_{name}.npz")


@cache
def embedded(name: str) -> Object:
    return load_object(name)


def test_every_example_file_has_its_script():
    files = {(path.parent.name, path.name) for path in resource_dir("robots").glob("*/*.npz")}
    assert files == {(hand, f"example_{name}.npz") for hand in HANDS for name in EXAMPLES}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_files_belong_to_the_embedded_hand_and_objects(name: str):
    grasps = example(name)
    assert name in EMBEDDED
    assert (grasps.hand, grasps.base_link, grasps.joint_names) == (HAND.name, HAND.base_link, HAND.joint_names)
    assert set(grasps.object) == {name} and (grasps.scale == 1).all() and len(grasps) == 4
    q, notes = match_joints(grasps, HAND)
    assert not notes
    assert ((HAND.lower <= q) & (q <= HAND.upper)).all()


@pytest.mark.slow
def test_the_script_makes_the_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    main(["allegro", "--out", str(tmp_path)])
    assert capsys.readouterr().out.count("4 grasps") == len(EXAMPLES)
    for name in EXAMPLES:
        made, stored = load_grasps(tmp_path / "allegro" / f"example_{name}.npz"), example(name)
        message = f"{name}: run apps/grasp_refine_apps/authoring/close_fingers.py again, and look at the grasps"
        np.testing.assert_allclose(made.hand_pose, stored.hand_pose, rtol=0, atol=1e-9, err_msg=message)
        np.testing.assert_allclose(made.q, stored.q, rtol=0, atol=1e-9, err_msg=message)


@pytest.mark.slow
def test_examples_of_a_hand_without_given_poses_are_sampled():
    hand, obj = load_hand("leap"), embedded("rounded_box")
    stored = load_grasps(resource_dir("robots") / "leap" / "example_rounded_box.npz")
    made = example_grasps(hand, obj)
    assert (made.hand, made.base_link, made.joint_names) == ("leap", hand.base_link, hand.joint_names)
    message = "run apps/grasp_refine_apps/authoring/close_fingers.py again, and look at the grasps"
    np.testing.assert_allclose(made.hand_pose, stored.hand_pose, rtol=0, atol=1e-6, err_msg=message)
    np.testing.assert_allclose(made.q, stored.q, rtol=0, atol=1e-6, err_msg=message)
    around = HandObjectDistances(hand, obj)
    T, q = sample_touching(hand, obj, around, seed=0)
    assert len(q) >= len(made)
    tips = [around.links.index(contact.link) for contact in hand.contacts]
    assert (around.distances(T, q)[:, tips] < CLEARANCE_M).all()


@pytest.mark.parametrize("name", EXAMPLES)
def test_they_are_almost_right_and_refinement_makes_them_right(name: str):
    grasps, obj = example(name), embedded(name)
    scene = Scene(HAND, obj, transform_from_pose(grasps.hand_pose), grasps.q)
    result = refine(scene)
    before, after = (
        measure(HandObject.of(scene), T, q, result.target_link, result.target_object, touching=result.touching)
        for T, q in ((scene.T_world_root, scene.q), (result.T_world_root, result.q))
    )
    tips = before.distance[:, : len(HAND.contacts)]
    assert (tips.max(axis=1) > 0.005).all() and (tips.max(axis=1) < 0.015).all()
    assert (before.penetration > 0.001).all() and (before.penetration < 0.004).all()
    assert np.median(np.nanmax(after.contact_error, axis=1)) < 1e-3
    assert (after.penetration < 0.5e-3).all()


@pytest.fixture(scope="module")
def around() -> HandObjectDistances:
    return HandObjectDistances(HAND, embedded("rounded_box"))


def opened(hand: Hand) -> np.ndarray:
    return np.array([[OPEN_RAD[name] for name in hand.joint_names]])


def test_closing_on_nothing_ends_at_the_limits(around: HandObjectDistances):
    T = np.eye(4)[None]
    T[0, 0, 3] = 10.0
    closed = dict(zip(HAND.joint_names, close(HAND, around, T, opened(HAND))[0], strict=True))
    upper = dict(zip(HAND.joint_names, HAND.upper, strict=True))
    moving = [joint for joints in CLOSING_JOINTS.values() for joint in joints]
    assert all(closed[name] == upper[name] for name in moving)
    assert all(closed[name] == OPEN_RAD[name] for name in HAND.joint_names if name not in moving)
