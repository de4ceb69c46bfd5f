"""The first camera sees hand and object whole, and the contacts."""

from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.se3 import exp_se3, transform_from_pose, transform_points
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.drawing.camera import (
    ELEVATIONS_DEG,
    FIELD_OF_VIEW_RAD,
    FILLED_SHARE,
    UP,
    FirstCamera,
    first_camera,
    first_camera_of,
    slanted,
)
from grasp_refine_apps.viewer.drawing.shapes import forearm
from grasp_refine_apps.viewer.model.contacts import contacts_of


def in_picture(camera: FirstCamera, points: np.ndarray, aspect: float) -> np.ndarray:
    """Places (N, 2) in the picture, from -1 to 1 where they are in it."""
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    away = points - camera.position
    depth = away @ forward
    assert (depth > 0).all()
    seen = np.stack([away @ right, away @ np.cross(right, forward)], axis=1) / depth[:, None]
    return seen / np.tan(FIELD_OF_VIEW_RAD / 2) / [aspect, 1.0]


def elevation(camera: FirstCamera) -> float:
    towards = camera.position - camera.look_at
    return float(np.degrees(np.arcsin(towards[2] / np.linalg.norm(towards))))


BALL = np.random.default_rng(0).normal(size=(400, 3))
BALL *= 0.03 / np.linalg.norm(BALL, axis=1, keepdims=True)
GRID = np.stack(np.meshgrid([-0.06, -0.05], np.linspace(-0.1, 0.1, 40), np.linspace(-0.1, 0.1, 40)), axis=-1)
PALM = GRID.reshape(-1, 3)
"""A plate beside the ball, towards -x."""


@pytest.mark.parametrize("aspect", [0.6, 1.0, 1.4, 2.5])
def test_all_is_in_the_picture_and_fills_it(aspect: float):
    camera = first_camera(PALM, BALL, BALL[:3], aspect=aspect)
    reach = np.abs(in_picture(camera, np.concatenate([PALM, BALL]), aspect)).max(axis=0)
    assert reach.max() == pytest.approx(FILLED_SHARE) and (reach < FILLED_SHARE + 1e-9).all()
    assert elevation(camera) == pytest.approx(min(ELEVATIONS_DEG, key=lambda e: abs(e - elevation(camera))))


@pytest.mark.parametrize("degrees", [0.0, 90.0, 200.0])
def test_it_looks_past_the_hand(degrees: float):
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    contact = np.array([[-0.03, 0.0, 0.0]])
    camera = first_camera(PALM @ turn.T, BALL @ turn.T, contact @ turn.T)
    assert ((camera.position - camera.look_at) @ turn)[0] > 0


@pytest.mark.parametrize("side", [[1.0, 0.0, 0.0], [-0.6, 0.8, 0.0], [0.0, -1.0, 0.0]])
def test_it_stands_on_the_side_of_the_contacts(side: list[float]):
    every = np.random.default_rng(1).normal(size=(3000, 3))
    ball = 0.05 * every / np.linalg.norm(every, axis=1, keepdims=True)
    contacts = ball[ball @ side > 0.048]
    camera = first_camera(0.06 * np.eye(3), ball, contacts)
    assert (camera.position - camera.look_at) @ side > 0


def test_it_turns_little_where_another_place_is_hardly_better():
    """Contacts all around an upright bottle are seen as well from any side."""
    angle = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), np.zeros(60)], axis=1)
    for azimuth in (0.5, 2.5, 4.0):
        before = slanted(np.array([np.cos(azimuth), np.sin(azimuth), 0.4]))
        camera = first_camera(np.zeros((0, 3)), BALL, ring, before=before)
        assert camera.towards @ before > 0.75


def test_without_contacts_the_object_is_what_should_be_seen():
    camera = first_camera(PALM, BALL, np.zeros((0, 3)))
    assert camera.position[0] - camera.look_at[0] > 0  # not through the plate


def test_what_is_far_is_not_looked_at_from_behind_a_long_arm():
    along = np.linspace(-0.6, -0.05, 600)
    angle = np.linspace(0, 200, 600)
    arm = np.stack([along, 0.05 * np.cos(angle), 0.05 * np.sin(angle)], axis=1)
    camera = first_camera(arm, BALL, BALL[:4])
    towards = camera.position - camera.look_at
    assert towards[0] > -0.5 * np.linalg.norm(towards)


def hand_and_mug(name: str, urdf: Path | None = None) -> tuple[HandObject, np.ndarray, np.ndarray]:
    grasps = load_grasps(resource_dir("robots") / name / "example_mug.npz")
    hand = load_hand(name, urdf=urdf)
    q, _ = match_joints(grasps, hand)
    prepared = HandObject(hand, load_object("mug", scale=float(grasps.scale[0])))
    return prepared, transform_from_pose(grasps.hand_pose)[0], q[0]


def sees_all(prepared: HandObject, T: np.ndarray, q: np.ndarray, T_world_object: np.ndarray) -> None:
    found = contacts_of(prepared, T, q)
    camera = first_camera_of(found, T_world_object, aspect=1.4)
    poses = found.frames.T_world_link[0]
    behind = forearm(prepared.hand)
    parts = zip(prepared.chain.links, poses, prepared.bodies, strict=True)
    shown = [transform_points(pose, body.candidates.points) for link, pose, body in parts if link not in behind]
    points = np.concatenate([*shown, np.asarray(prepared.object.mesh.vertices)])
    places = in_picture(camera, transform_points(T_world_object, points), 1.4)
    assert np.abs(places).max() < 1.0
    assert np.ptp(places, axis=0).max() > 1.7


def test_a_real_grasp_is_seen_whole_wherever_it_stands():
    mug = hand_and_mug("allegro")
    sees_all(*mug, np.eye(4))
    sees_all(*mug, exp_se3(np.array([0.3, -2.0, 1.0, 0.4, -0.8, 2.0])))


@pytest.mark.slow
def test_a_hand_is_seen_whole_but_for_its_forearm(shared_assets: Path):
    urdf = shared_assets / "hands" / "shadow" / "shadow_right.urdf"
    prepared, T, q = hand_and_mug("shadow", urdf)
    assert forearm(prepared.hand) == {"forearm", "wrist"}
    sees_all(prepared, T, q, np.eye(4))
