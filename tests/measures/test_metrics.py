"""Metrics of a clamp around a ball in closed form."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from claw import around, claw
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.forces.calibration import CALIBRATION
from grasp_refine.forces.quality import quality
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.metrics import Metrics, metrics
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.hand_object import HandObject
from made_hands import BALL, link, links, made_hand, slide

PARTS = (
    link("base"),
    links("left", "right", "palm", inside=BALL),
    slide("l", "base", "left", at="0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1)),
    slide("r", "base", "right", at="-0.06 0 0", axis="-1 0 0", limits=(-0.1, 0.1)),
    slide("p", "base", "palm", at="0 0 -0.06", axis="0 0 -1", limits=(-0.1, 0.1)),
)
"""Three balls of 1 cm that touch a ball of 5 cm and move straight away from it by as much as their joints say."""

TOML = """[rest_pose]
l = 0.05
r = 0.05
p = 0.05
[[contact]]
link = "left"
group = "one"
point = [-0.01, 0.0, 0.0]
[[contact]]
link = "left"
group = "one"
point = [0.0, 0.01, 0.0]
[[contact]]
link = "right"
group = "two"
"""
"""The palm is no contact link; the left pad has two contact points."""


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return made_hand(tmp_path_factory.mktemp("clamp"), *PARTS, name="clamp", toml=TOML)


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object("sphere:0.05", candidates=16)


def at(hand: Hand, ball: Object, q: list, T: np.ndarray | None = None) -> Metrics:
    q = np.array(q, dtype=float)
    return metrics(hand, ball, np.tile(np.eye(4), (len(q), 1, 1)) if T is None else T, q)


def test_fingers_count_once_with_their_nearest_link(hand: Hand, ball: Object) -> None:
    found = at(hand, ball, [[0.004, 0.001, 0.0], [-0.003, 0.008, 0.03], [0.05, 0.09, 0.0]])
    np.testing.assert_allclose(found.contact_distance_m, [0.0025, 0.004, 0.07], atol=1e-9)


def test_contact_errors_are_the_worst_and_the_mean_of_links_that_should_touch(hand: Hand, ball: Object) -> None:
    """The right pad is too far from the ball to be a contact link in the last grasp."""
    found = at(hand, ball, [[0.004, 0.001, 0.05], [0.002, 0.002, 0.05], [0.004, 0.05, 0.05]])
    np.testing.assert_allclose(found.contact_error_m, [0.004, 0.002, 0.004], atol=1e-6)
    np.testing.assert_allclose(found.contact_error_mean_m, [0.0025, 0.002, 0.004], atol=1e-6)


def test_links_near_the_object_count_once_each(hand: Hand, ball: Object) -> None:
    found = at(hand, ball, [[0, 0, 0], [0.0019, 0.0021, 0.0], [-0.005, 0.01, 0.01], [0.01, 0.01, 0.01]])
    np.testing.assert_array_equal(found.contact_number, [3, 2, 1, 0])


def test_depths_and_limits(hand: Hand, ball: Object) -> None:
    found = at(hand, ball, [[-0.004, 0.0, -0.006], [0.01, 0.01, 0.01], [-0.06, -0.06, 0.2]])
    np.testing.assert_allclose(found.penetration_m, [0.006, 0.0, 0.06], atol=1e-6)
    np.testing.assert_array_equal(found.limits_violated, [0, 0, 1])
    # The two pads coincide: as deep in each other as they are wide.
    np.testing.assert_allclose(found.self_penetration_m, [0.0, 0.0, 0.02], atol=1e-6)


def test_a_clamp_balances_and_its_palm_alone_does_not(hand: Hand, ball: Object) -> None:
    # Both pads; both and the palm, which need not push; pads out of reach; all out of reach.
    found = at(hand, ball, [[0.009, 0.0, 0.05], [0, 0, 0.0029], [0.011, 0.011, 0.0], [0.011, 0.011, 0.0031]])
    np.testing.assert_allclose(found.wrench_residual, [0.0, 0.0, 1.0, np.nan], atol=1e-6)


def test_torques_are_about_the_centre_of_mass(hand: Hand, tmp_path: Path) -> None:
    """A plate, pushed up 2 cm beside its centre and 1 cm below it by the palm alone; friction t helps a little.

    |[F, tau / 5 cm]|^2 = 1 + t^2 + (0.4 - 0.2 t)^2 is least at t = 0.08 / 1.04.
    """
    plate = trimesh.creation.box((0.2, 0.2, 0.02))
    plate.apply_translation([0.02, 0.0, -0.04])
    plate.export(tmp_path / "plate.obj")
    found = at(hand, load_object(tmp_path / "plate.obj", candidates=16), [[0.09, 0.09, 0.001]])
    np.testing.assert_allclose(found.wrench_residual, np.sqrt(1.0 + 0.4**2 / 1.04), atol=1e-5)


def test_the_hand_may_come_from_anywhere(hand: Hand, ball: Object) -> None:
    turn = exp_se3(np.array([0.0, 0.0, 0.0, 1.0, 0.3, -2.0]))[None]
    q = [[0.001, -0.002, 0.003]]
    turned, straight = at(hand, ball, q, turn), at(hand, ball, q)
    for name in ("contact_distance_m", "contact_number", "penetration_m", "self_penetration_m", "wrench_residual"):
        np.testing.assert_allclose(getattr(turned, name), getattr(straight, name), atol=1e-6)


def test_there_is_no_quality_without_contacts_and_it_falls_with_depth(hand: Hand, ball: Object) -> None:
    found = at(hand, ball, [[0.011, 0.011, 0.0031], [0.0, 0.0, 0.05], [-0.002, -0.002, 0.05]])
    # That deep, 2 mm over `quality.DEEP` = 1 cm are added to the shortcomings; the forces are the same.
    odds = np.log(found.quality / (1.0 - found.quality))
    assert np.isnan(found.quality[0]) and 0.0 < found.quality[2] < found.quality[1] < 1.0
    (cost,) = CALIBRATION.costs(np.array([[0.0, 0.0, 0.2, 0.0, 0.0, 0.0]])).sum(axis=1)
    np.testing.assert_allclose(odds[1] - odds[2], cost, atol=1e-3)


def test_the_quality_of_coupled_joints_is_that_where_they_are(tmp_path: Path) -> None:
    """What one actuator of several joints can balance depends on their axes, not on the contacts alone."""
    obj = load_object("sphere:0.03", candidates=16)
    scene = around(claw(tmp_path, coupled=True), obj, 16, 0)
    prepared = HandObject.of(scene)
    frames = prepared.chain(scene.T_world_root, scene.q)
    T = frames.T_world_link
    witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
    expected = quality(scene.hand, obj, prepared.chain, frames, witness).value
    assert np.isfinite(expected).sum() > 4
    np.testing.assert_allclose(metrics(scene.hand, obj, scene.T_world_root, scene.q).quality, expected, rtol=1e-9)


def test_grasps_that_are_not_finite_have_no_metrics_and_spoil_no_other(hand: Hand, ball: Object) -> None:
    T, q = np.tile(np.eye(4), (3, 1, 1)), np.zeros((3, 3))
    T[0, 2, 2], q[2, 1] = np.nan, np.inf
    found, alone = metrics(hand, ball, T, q), metrics(hand, ball, T[1:2], q[1:2])
    for name in found.values:
        # There is no scene, no region, no arm and no scan.
        middle = name in ("scene_penetration_m", "region_miss_m", "arm_dexterity_m", "likely_quality", "contacts_seen")
        np.testing.assert_array_equal(np.isnan(getattr(found, name)), [True, middle, True], err_msg=name)
        np.testing.assert_array_equal(getattr(found, name)[1:2], getattr(alone, name))
