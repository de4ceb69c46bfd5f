"""Contacts are where the links touch, as far off as they are, and what they do balances."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import transform_from_pose, transform_points
from grasp_refine.forces.squeeze import contacts, grasp_forces
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.files.hand_toml import Contact
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.measures.geometry import measure
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.drawing.glyphs import patch_area, patch_outline
from grasp_refine_apps.viewer.model.contacts import Contacts, contacts_of
from grasp_refine_apps.viewer.model.pose import Target


def at(prepared: HandObject, left: float, right: float, **options) -> Contacts:
    return contacts_of(prepared, np.eye(4), np.array([left, right]), **options)


def column(prepared: HandObject, *links: str) -> np.ndarray:
    """Gaps of 0 of some links."""
    return np.where(np.isin(prepared.chain.links, links), 0.0, np.nan)


def test_gaps_and_penetrations_are_where_they_are(clamp: HandObject):
    found = at(clamp, 0.004, -0.002)
    assert found.link == ("left", "right") and found.should.all()
    np.testing.assert_allclose(found.distance, [0.004, -0.002], atol=1e-9)
    np.testing.assert_allclose(found.point_link, [[0.054, 0, 0], [-0.048, 0, 0]], atol=1e-7)
    np.testing.assert_allclose(found.point_object, [[0.05, 0, 0], [-0.05, 0, 0]], atol=1e-7)
    np.testing.assert_allclose(found.error, [0.004, 0.002], atol=1e-9)
    assert found.contact_error == pytest.approx(0.004) and found.penetration == pytest.approx(0.002)
    np.testing.assert_array_equal(found.deep, [False, True])


def test_all_is_in_the_frame_of_the_object(clamp: HandObject):
    T = transform_from_pose(np.array([[0.001, 0.0, 0.0, np.cos(0.3), 0.0, np.sin(0.3), 0.0]]))[0]
    found = contacts_of(clamp, T, np.array([0.004, 0.004]))
    for here, point, on_link in zip((0.064, -0.064), found.point_object, found.point_link, strict=True):
        center = transform_points(T, np.array([here, 0.0, 0.0]))
        outward = center / np.linalg.norm(center)
        np.testing.assert_allclose(point, 0.05 * outward, atol=1e-7)
        np.testing.assert_allclose(on_link, center - 0.01 * outward, atol=1e-7)


def test_links_that_should_touch_are_shown_however_far_they_are(clamp: HandObject):
    assert at(clamp, 0.09, 0.09).link == ()
    found = at(clamp, 0.09, 0.09, gap=column(clamp, "left", "far"))
    assert found.link == ("left", "far") and found.should.all()
    np.testing.assert_allclose(found.distance, [0.09, 0.24], atol=1e-8)
    assert found.contact_error == pytest.approx(0.24)
    # The gap that they should keep counts.
    assert at(clamp, 0.09, 0.09, gap=column(clamp, "left") + 0.01).contact_error == pytest.approx(0.08)


def test_links_that_touch_but_need_not_are_shown_without_an_error(clamp: HandObject):
    found = at(clamp, 0.004, -0.002, gap=column(clamp, "left"))
    np.testing.assert_array_equal(found.should, [True, False])
    assert np.isnan(found.error[1]) and found.contact_error == pytest.approx(0.004)


def test_nothing_near_is_no_contact(clamp: HandObject):
    found = at(clamp, 0.09, 0.09)
    assert found.distance.shape == (0,) and found.penetration == 0.0 and np.isnan(found.contact_error)
    assert len(found.forces.point) == 0


def test_the_largest_miss_of_all_targets_of_a_link_counts_at_both_ends(clamp: HandObject):
    """Witness points of the left ball are (0.051, 0, 0) and (0.05, 0, 0)."""
    near = Target("left", np.array([-0.01, 0.0, 0.0]), np.array([0.05, 0.0, 0.0]))
    on_object = Target("left", np.array([0.0, 0.01, 0.0]), np.array([0.0, 0.0, 0.05]))
    on_link = Target("left", np.array([0.0, 0.03, 0.0]), np.array([0.05, 0.01, 0.0]))
    found = at(clamp, 0.001, 0.001, targets=(on_object,))
    assert found.link == ("left",)
    np.testing.assert_allclose(found.target_link, [[0.061, 0.01, 0.0]], atol=1e-12)
    np.testing.assert_array_equal(found.target_object, [[0.0, 0.0, 0.05]])
    for targets, miss in (
        ((near,), 0.001),
        ((on_object,), 0.05 * np.sqrt(2)),
        ((on_link,), np.hypot(0.01, 0.03)),
        ((on_object, near), 0.05 * np.sqrt(2)),
        ((near, on_link), np.hypot(0.01, 0.03)),
    ):
        assert at(clamp, 0.001, 0.001, targets=targets).contact_error == pytest.approx(miss, abs=1e-7)


@pytest.mark.parametrize(("gap", "shown", "deep"), [(1.1e-4, 0, 0), (0.9e-4, 1, 0), (-0.9e-4, 1, 0), (-1.1e-4, 1, 1)])
def test_a_link_that_need_not_touch_is_shown_below_a_tenth_of_a_millimetre(
    clamp: HandObject, gap: float, shown: int, deep: int
):
    found = at(clamp, 0.004, gap, gap=column(clamp, "left"))
    assert found.link == ("left", "right")[: 1 + shown] and found.deep.sum() == deep


def test_a_target_of_a_link_that_cannot_touch_keeps_its_place(clamp: HandObject):
    nothing = Target("base", np.zeros(3), np.array([0.0, 0.05, 0.0]))
    found = at(clamp, 0.0, 0.0, targets=(nothing, Target("right", np.array([0.01, 0, 0]), np.array([-0.05, 0, 0]))))
    assert np.isnan(found.target_link[0]).all() and np.isfinite(found.target_link[1]).all()
    assert found.link == ("left", "right") and found.contact_error < 1e-6
    np.testing.assert_array_equal(found.should, [False, True])


def test_a_link_with_two_contact_points_is_shown_once(clamp: HandObject):
    contacts = (*clamp.hand.contacts, Contact("left", "left", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    twice = HandObject(replace(clamp.hand, contacts=contacts), clamp.object)
    assert twice.chain.links == ("left", "right", "left", "far")
    assert at(twice, 0.002, 0.002).link == ("left", "right")
    found = at(twice, 0.002, 0.002, gap=np.array([np.nan, 0.0, 0.0, np.nan]))
    assert found.link == ("left", "right") and found.should.all()
    np.testing.assert_allclose(found.forces.force, at(clamp, 0.002, 0.002).forces.force, atol=1e-9)


def test_forces_of_two_opposite_contacts_balance(clamp: HandObject):
    forces = at(clamp, 0.0, 0.0).forces
    np.testing.assert_allclose(forces.force, [[-0.5, 0, 0], [0.5, 0, 0]], atol=1e-4)
    np.testing.assert_allclose(forces.normal, [[-1, 0, 0], [1, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(forces.point, [[0.05, 0, 0], [-0.05, 0, 0]], atol=1e-7)


@pytest.mark.filterwarnings("error")
def test_a_pose_that_is_not_finite_has_no_contacts(clamp: HandObject):
    found = at(clamp, np.nan, 0.0, gap=column(clamp, "left"))
    assert "left" not in found.link and np.isnan(found.penetration)


def real(name: str, obj: str, urdf: Path | None = None) -> tuple[HandObject, np.ndarray, np.ndarray]:
    grasps = load_grasps(resource_dir("robots") / name / f"example_{obj}.npz")
    hand: Hand = load_hand(name, urdf=urdf, candidates=64)
    q, _ = match_joints(grasps, hand)
    prepared = HandObject(hand, load_object(obj, scale=float(grasps.scale[0]), candidates=64))
    return prepared, transform_from_pose(grasps.hand_pose), q


def agrees_with_validation(prepared: HandObject, T: np.ndarray, q: np.ndarray) -> None:
    scene = Scene(prepared.hand, prepared.object, T, q)
    nowhere = np.full((len(q), len(scene.links), 3), np.nan)
    for n in range(len(q)):
        found = contacts_of(prepared, T[n], q[n])
        should = np.isin(scene.links, [link for link, meant in zip(found.link, found.should, strict=True) if meant])
        rows = slice(n, n + 1)
        geometry = measure(
            prepared, T[rows], q[rows], nowhere[rows], nowhere[rows],
            touching=should[None],
        )  # fmt: skip
        assert found.penetration == pytest.approx(geometry.penetration[0], abs=1e-9)
        assert found.contact_error == pytest.approx(np.nanmax(geometry.contact_error[0]), abs=1e-9)
        place = [scene.links.index(link) for link in found.link]
        np.testing.assert_allclose(found.distance, geometry.distance[0, place], atol=1e-9)
        deep = {link for link, distance in zip(scene.links, geometry.distance[0], strict=True) if distance < -1e-4}
        assert deep == {link for link, is_deep in zip(found.link, found.deep, strict=True) if is_deep}
        given = prepared.hand, prepared.object, scene.links, geometry.witness, geometry.T_world_link
        forces = grasp_forces(contacts(*given), prepared.object, T[rows][:, :3, :3])
        pressing = np.isfinite(contacts(*given).point[0]).all(axis=1)
        np.testing.assert_allclose(found.forces.force, forces.force[0, pressing], atol=1e-6)


@pytest.mark.parametrize(("name", "obj"), [("allegro", "mug"), ("shadow_palm", "bottle")])
def test_embedded_grasps_agree_with_validation(name: str, obj: str):
    agrees_with_validation(*real(name, obj))


@pytest.mark.slow
def test_makers_meshes_agree_with_validation(shared_assets: Path):
    urdf = shared_assets / "hands" / "shadow" / "shadow_right.urdf"
    agrees_with_validation(*real("shadow", "bottle", urdf))


@pytest.mark.parametrize("gap", [0.0, 0.0005])
def test_flat_pads_on_a_box_touch_in_patches_of_their_gap(gap: float) -> None:
    half = 0.025
    prepared = HandObject(
        load_hand("franka_hand", candidates=16), load_object(f"box:0.05,{2 * half},0.12", candidates=16)
    )
    T = transform_from_rpy([0.0, 0.0, 0.06 - 0.02 + 0.1034, 180.0, 0.0, 0.0])
    found = contacts_of(prepared, T, np.array([half + gap])).patches
    assert sorted(patch.normal[1].round(6) for patch in found) == [-1.0, 1.0]
    for patch in found:
        # On the side that it presses on, below the upper edge of the box.
        np.testing.assert_allclose(patch.corners[:, 1], -half * patch.normal[1], atol=1e-9)
        np.testing.assert_allclose(patch.gap, gap, atol=1e-6)
        assert len(patch.corners) == 4 and patch.corners[:, 2].max() <= 0.06 + 1e-9
        assert np.ptp(patch.corners[:, 2]) == pytest.approx(0.02, abs=0.003)
        area, outline = patch_area(patch), patch_outline(patch.corners)
        mesh = trimesh.Trimesh(area.vertices, area.faces, process=False)
        assert mesh.area == pytest.approx(np.prod(np.ptp(patch.corners, axis=0)[[0, 2]]), rel=1e-4)
        # Seen from outside, in front of the face.
        assert (mesh.face_normals @ patch.normal < 0).all() and (area.vertices[:, 1] * -patch.normal[1] > half).all()
        assert np.linalg.norm(outline[:, 1] - outline[:, 0], axis=1).sum() == pytest.approx(
            2 * np.ptp(patch.corners, axis=0)[[0, 2]].sum()
        )
