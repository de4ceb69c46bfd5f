"""Open hands: clear of the object by as much as was asked for, near the grasp, within limits."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import closing_motion
from grasp_refine.closing.pregrasp import open_hand
from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3, transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.measures.geometry import measure, movement
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region import HalfSpace
from grasp_refine.scene.hand_object import CLEARANCE, CLEARANCE_OTHERS, HandObject, clearances
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import BALL, joint, link, links, made_hand, slide


@pytest.fixture(scope="module")
def clamp(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Two balls that hold a ball of 5 cm, and a palm under it, half a millimetre away."""
    return made_hand(
        tmp_path_factory.mktemp("clamp"),
        link("base") + links("palm", "left", "right", inside=BALL),
        joint("p", "base", "palm", "fixed", at="0 0 -0.0605"),
        slide("l", "base", "left", at="0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1)),
        slide("r", "base", "right", at="-0.06 0 0", axis="1 0 0", limits=(-0.1, 0.1)),
        name="clamp",
    )


@pytest.fixture(scope="module")
def mugs() -> Scene:
    """The example grasps of a mug."""
    grasps = load_grasps(resource_dir("robots") / "allegro" / "example_mug.npz").select(range(4))
    mug = load_object("mug", scale=float(grasps.scale[0]), candidates=16)
    return Scene(load_hand("allegro", candidates=16), mug, transform_from_pose(grasps.hand_pose), grasps.q)


def distances(scene: Scene, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    nowhere = np.full((len(q), len(scene.links), 3), np.nan)
    return measure(HandObject.of(scene), T, q, nowhere, nowhere).distance


def test_contact_links_open_wider_than_the_others(clamp: Hand) -> None:
    ball = load_object("sphere:0.05", candidates=16)
    scene = Scene(clamp, ball, np.eye(4)[None], np.zeros((1, 2)))
    assert scene.links[:2] == ("left", "right")
    np.testing.assert_allclose(clearances(clamp, scene.links), [CLEARANCE, CLEARANCE, CLEARANCE_OTHERS])
    T, q = open_hand(scene)
    found = distances(scene, T, q)[0]
    # The palm moves away by the root alone, and no link farther than it has to.
    np.testing.assert_allclose(found, [CLEARANCE, CLEARANCE, CLEARANCE_OTHERS], atol=2e-4)
    assert T[0, 2, 3] == pytest.approx(0.0005 - CLEARANCE_OTHERS, abs=5e-4)


def test_gloves_are_as_thick_as_the_clearances(mugs: Scene) -> None:
    """The distance of a gloved link is that of the bare one less its clearance, and links meet bare."""
    bare = HandObject.of(mugs)
    padded = bare.padded
    T = bare.chain(mugs.T_world_root, mugs.q).T_world_link
    T_object = np.broadcast_to(np.eye(4), T.shape)
    without, within = (query(pairs, T, T_object).distance for pairs in (bare.pairs, padded.pairs))
    apart = without > 0
    np.testing.assert_allclose((without - within)[apart], np.tile(clearances(mugs.hand, mugs.links), (4, 1))[apart])
    assert padded.self_collision_pairs is bare.self_collision_pairs


def test_hands_open_around_a_mug(mugs: Scene) -> None:
    T, q = open_hand(mugs)
    assert (distances(mugs, T, q) >= clearances(mugs.hand, mugs.links) - 1.1e-4).all()
    assert (q >= mugs.hand.lower).all() and (q <= mugs.hand.upper).all()
    assert self_penetration(mugs.hand, touching_pairs(mugs.hand), q).max() < 1e-4
    moved = movement(mugs.T_world_root, mugs.q, T, q, mugs.hand.slides)
    assert moved.palm_m.max() < 0.02 and moved.joints_rad.max() < 0.6


def test_opening_can_be_ended(mugs: Scene) -> None:
    heard: list[int] = []

    def progress(finished: int, iteration: int, loss: float) -> None:
        heard.append(iteration)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        closing_motion(mugs, None, progress)
    assert heard == [1]


def test_an_open_hand_stays(mugs: Scene) -> None:
    T, q = open_hand(mugs)
    again, q_again = open_hand(replace(mugs, T_world_root=T, q=q))
    np.testing.assert_array_equal(again, T)
    np.testing.assert_array_equal(q_again, q)


def test_what_the_scene_wants_of_contacts_means_nothing(mugs: Scene) -> None:
    target = np.zeros((4, len(mugs.links), 3))
    regions = {"touch": (HalfSpace("up", np.eye(3)[2], 0.02),), "avoid": (HalfSpace("right", np.eye(3)[0], 0.0),)}
    aimed = replace(mugs, target_link=target, target_object=target, direction=np.full_like(target, np.nan))
    aimed = replace(aimed, task=replace(mugs.task, **regions))
    assert aimed.regions is not None
    np.testing.assert_array_equal(open_hand(aimed)[1], open_hand(mugs)[1])


def test_hands_open_away_from_a_table(clamp: Hand) -> None:
    """From above, with the pads 5 mm over the table: they rise by what they lack, though they need not to open."""
    ball = load_object("sphere:0.05", candidates=16)
    over = exp_se3(np.array([0.0, 0.0, 0.0, np.pi, 0.0, 0.0]))[None]
    scene = Scene(clamp, ball, over, np.zeros((1, 2)))
    free, _ = open_hand(scene)
    T, q = open_hand(replace(scene, task=Task(table=-0.015)))
    assert free[0, 2, 3] - 0.01 == pytest.approx(-0.01 + CLEARANCE_OTHERS - 0.0005, abs=5e-4)
    assert T[0, 2, 3] - 0.01 == pytest.approx(-0.015 + CLEARANCE, abs=2e-4)
    assert (distances(scene, T, q) >= clearances(clamp, scene.links) - 1.1e-4).all()


def test_grasps_that_are_not_finite_become_nan_and_harm_no_other(mugs: Scene) -> None:
    T, q = mugs.T_world_root.copy(), mugs.q.copy()
    T[1, 0, 3], q[3, 2] = np.inf, np.nan
    T_open, q_open = open_hand(replace(mugs, T_world_root=T, q=q))
    bad = np.isin(np.arange(4), [1, 3])
    assert np.isnan(T_open[bad]).all() and np.isnan(q_open[bad]).all()
    T_all, q_all = open_hand(mugs)
    np.testing.assert_allclose(T_open[~bad], T_all[~bad], atol=1e-9)
    np.testing.assert_allclose(q_open[~bad], q_all[~bad], atol=1e-9)
