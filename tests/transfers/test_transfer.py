"""Transfers: the same hand gets its own grasps back, fingers reach contacts, frames do not matter, losses are said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import grasp_refine as gr
from grasp_refine.core.se3 import distances, exp_so3, matvec, transform
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.fidelity import SAME_M, Likeness
from grasp_refine.objects.object import load_object
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.transfers.hand_frame import HandFrame
from grasp_refine.transfers.placement import Pads
from grasp_refine.transfers.source_grasps import source_grasps
from grasp_refine.transfers.transfer import Transferred, copied_grasps, transfer_grasps


@pytest.fixture(scope="module")
def shadow() -> Problem:
    """Grasps of the Shadow hand on the mug, from its palm on."""
    return load_problem(ProblemSpec(hand="shadow_palm"))


@pytest.fixture(scope="module")
def allegro() -> Hand:
    return load_hand("allegro")


def transferred(scene: Scene, hand: Hand) -> Transferred:
    number = np.zeros(len(scene.q), dtype=np.int64)
    return transfer_grasps(source_grasps(scene), HandObject(hand, scene.object), number, (scene.hand, scene.q))


def pad_misses(found: Transferred, hand: Hand) -> np.ndarray:
    """Distances (N, k) of the fingers' surfaces from the contacts that they take over."""
    points = Pads.of(hand).points(hand, found.T, found.q)
    order = [HandFrame.of(hand).fingers.index(finger) for finger in hand.fingers]
    return np.linalg.norm(points[:, order] - found.original.point[:, :, None], axis=-1).min(axis=2)


def test_copied_joints_of_the_same_hand_are_its_own(shadow: Problem):
    scene, hand = shadow.groups[0].scene, load_hand("shadow_palm")
    number = np.zeros(len(scene.q), dtype=np.int64)
    found = copied_grasps(source_grasps(scene), HandObject(hand, scene.object), number, (scene.hand, scene.q))
    np.testing.assert_allclose(found.q, scene.q, atol=1e-9)
    assert np.isnan(found.target_link).all()
    # Laid over another pose of the same hand, the palm is where it is.
    moved, turned = distances(scene.T_world_root, found.T)
    assert moved.max() < 1e-9 and turned.max() < 1e-6


def test_the_same_hand_gets_its_own_grasps_back(shadow: Problem):
    scene = shadow.groups[0].scene
    found = transferred(scene, load_hand("shadow_palm"))
    moved, turned = distances(scene.T_world_root, found.T)
    assert moved.max() < 1e-4
    assert turned.max() < 1e-3
    np.testing.assert_allclose(found.q, scene.q, atol=1e-3)
    assert set(found.original.dropped.tolist()) == {""}


def test_a_longer_arm_of_the_same_hand_reaches_the_same_contacts(shadow: Problem):
    scene, hand = shadow.groups[0].scene, load_hand("shadow")
    assert np.nanmedian(pad_misses(transferred(scene, hand), hand)) < 3e-3


def test_fingers_of_another_hand_reach_the_contacts_of_their_namesakes(shadow: Problem, allegro: Hand):
    scene = shadow.groups[0].scene
    found = transferred(scene, allegro)
    assert np.nanmedian(pad_misses(found, allegro)) < 3e-3
    takes = [dict(zip(allegro.fingers, names, strict=True)) for names in found.original.finger.tolist()]
    assert all(one["thumb"] in ("thumb", "") for one in takes)
    order = ["thumb", "index", "middle", "ring", "little"]
    for one in takes:
        ranks = [order.index(one[finger]) for finger in ("index", "middle", "ring") if one[finger]]
        assert ranks == sorted(ranks)


def test_a_rigid_motion_of_the_scene_moves_the_transfer_with_it(shadow: Problem, allegro: Hand):
    scene = shadow.groups[0].scene
    # Round, so that no contact may be anywhere on a flat face.
    egg = trimesh.creation.icosphere(subdivisions=4)
    egg.apply_transform(np.diag([0.045, 0.04, 0.055, 1.0]))
    M = transform(exp_so3(np.array([0.3, -0.8, 0.5])), np.array([0.2, -0.1, 0.4]))
    plain, turned = load_object(egg), load_object(egg.copy().apply_transform(M))
    first = transferred(replace(scene, object=plain), allegro)
    second = transferred(replace(scene, object=turned, T_world_root=M @ scene.T_world_root), allegro)
    np.testing.assert_allclose(second.T, M @ first.T, atol=1e-5)
    np.testing.assert_allclose(second.q, first.q, atol=1e-4)
    points = matvec(M[:3, :3], first.original.point) + M[:3, 3]
    np.testing.assert_allclose(second.original.point, points, atol=1e-8)


def test_refined_transfers_touch_where_the_original_did(shadow: Problem, allegro: Hand):
    found = gr.transfer(shadow, to=allegro).outcome
    assert np.nanmedian(found["original_pinch_shift_m"]) < 0.015
    assert (found.fidelity != Likeness.OTHER).mean() >= 0.5
    assert np.nanmax(found["original_turn_rad"]) < np.radians(60.0)


def test_jaws_are_a_thumb_and_one_finger(shadow: Problem):
    found = gr.transfer(shadow, to=load_hand("franka_hand")).outcome
    assert set(" ".join(found.fingers.tolist()).replace(":", "").split()) >= {"fingers", "thumb", "by", "left", "right"}
    assert np.isfinite(found["original_turn_rad"]).all()


def test_a_dropped_finger_is_named_and_is_never_the_thumb(shadow: Problem, allegro: Hand):
    scene = shadow.groups[0].scene
    plain = source_grasps(scene)
    middle = np.nanmean(plain.point, axis=1, keepdims=True)
    every = replace(
        plain,
        point=np.where(np.isnan(plain.point), middle, plain.point),
        normal=np.where(np.isnan(plain.normal), [0.0, 0.0, 1.0], plain.normal),
        weight=np.ones_like(plain.weight),
    )
    found = transfer_grasps(every, HandObject(allegro, scene.object), np.zeros(len(scene.q), dtype=np.int64))
    assert set(found.original.dropped.tolist()) <= {"index", "middle", "ring", "little"}
    assert (found.original.finger != "").all()


def test_refinements_of_a_hands_own_grasps_have_no_fidelity(shadow: Problem):
    found = gr.refine(shadow).outcome
    assert set(found.fidelity.tolist()) == {""}
    assert np.isnan(found["original_kept"]).all()


def test_a_hand_on_an_arm_is_refused(shadow: Problem):
    mounted = gr.mount(gr.load_arm("ur5e"), load_hand("allegro"))
    with pytest.raises(gr.GraspRefineError, match="allegro"):
        gr.transfer(shadow, to=mounted)


def test_there_and_back_the_fingers_are_the_same_and_touch_where_they_did(shadow: Problem, allegro: Hand):
    """Shadow to Allegro and back: the thumb stays the thumb, fingers keep their order, most contacts stay."""
    first, hand = shadow.groups[0].scene, load_hand("shadow_palm")
    there = transferred(first, allegro)
    back = transferred(Scene(allegro, first.object, there.T, there.q), hand)
    fingers, away = list(HandFrame.of(hand).fingers), []
    start, end = (source_grasps(scene).point for scene in (first, Scene(hand, first.object, back.T, back.q)))
    for row in range(len(start)):
        through = dict(zip(allegro.fingers, there.original.finger[row].tolist(), strict=True))
        mine = dict(zip(hand.fingers, back.original.finger[row].tolist(), strict=True))
        came = [through[mine[finger]] if mine[finger] else "" for finger in fingers]
        places = [fingers.index(finger) for finger in came if finger]
        assert places == sorted(places) and came[0] in ("", fingers[0])
        same = [k for k, finger in enumerate(came) if finger == fingers[k]]
        assert len(same) >= 3
        away.append(np.linalg.norm(end[row, same] - start[row, same], axis=-1))
    assert np.nanmedian(np.concatenate(away)) < SAME_M
