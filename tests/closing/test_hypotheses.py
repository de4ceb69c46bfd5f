"""Hands close on each solid that a scanned object may be: where they stop, what they reach, and which grasp is kept."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.closing.hypotheses import Ends, best_attempt
from grasp_refine.closing.stopped import close_until_stopped, table_obstruction
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scene.hand_object import CLEARANCE, HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from made_hands import BALL, joint, link, links, made_hand, slide

RADIUS = 0.01
"""Radius of the balls, metres."""

NEAR = 1e-4
"""Distance in metres within which fingers stop."""


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Two balls on slides along x, from 0.1 m on either side to each other, and a palm far below."""
    return made_hand(
        tmp_path_factory.mktemp("clamp"),
        link("base") + links("palm", "left", "right", inside=BALL),
        joint("p", "base", "palm", "fixed", at="0 0 -0.2"),
        slide("l", "base", "left", at="0.1 0 0", axis="-1 0 0", limits=(0, 0.1)),
        slide("r", "base", "right", at="-0.1 0 0", axis="1 0 0", limits=(0, 0.1)),
        name="clamp",
    )


def box(left: float, right: float) -> tuple[Piece, ...]:
    """A box between two planes of x, metres."""
    return (hull(np.array([[x, y, z] for x in (left, right) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])),)


RANGES = ((-0.03, 0.03), (-0.05, 0.03), (-0.01, 0.03))
"""Left and right face of each solid: the right one was seen."""


@pytest.fixture(scope="module")
def scanned() -> Object:
    """A box of which the right face was seen."""
    found = tuple(Hypothesis("extruded", box(*ends), p) for ends, p in zip(RANGES, (0.5, 0.3, 0.2), strict=True))
    return replace(load_object("box:0.06,0.06,0.06"), supplied=found[0].pieces, hypotheses=found)


def test_each_solid_has_its_own_surface_and_centre(scanned: Object):
    for solid, (left, right) in zip(scanned.solids, RANGES, strict=True):
        assert solid.center_of_mass == pytest.approx([(left + right) / 2, 0, 0], abs=1e-9)
        assert solid.mesh.bounds[:, 0] == pytest.approx([left, right])
    assert scanned.envelope.mesh.bounds[:, 0] == pytest.approx([-0.05, 0.03])


def closed(faces: tuple[float, float]) -> np.ndarray:
    """Joint values at which the balls touch faces at some x."""
    return np.array([0.1 - RADIUS - faces[1], 0.1 - RADIUS + faces[0]])


def test_fingers_stop_at_the_object_or_at_the_end_of_their_paths(hand: Hand, scanned: Object):
    prepared = HandObject(hand, scanned)
    q_open, q_end = np.array([[0.0, 0.0], [0.02, 0.0]]), np.array([[0.09, 0.09], [0.03, 0.09]])
    share = close_until_stopped(prepared, np.tile(np.eye(4), (2, 1, 1)), q_open, q_end)
    found = q_open + share * (q_end - q_open)
    touching = closed(RANGES[0])
    assert found == pytest.approx(np.array([touching, [0.03, touching[1]]]), abs=NEAR)
    witness = prepared.query(np.zeros(2, int), prepared.chain(np.tile(np.eye(4), (2, 1, 1)), found).T_world_link)
    assert (witness.distance >= -1e-9).all()


def test_a_table_stops_fingers_and_lets_them_rise(hand: Hand, scanned: Object):
    """One ball comes down on a table at x = 35 mm, or 50 mm; the other one rises from below it to the object."""
    prepared, q_open = HandObject(hand, scanned), np.zeros((2, 2))
    q_end, table = q_open + 0.09, Plane((1.0, 0.0, 0.0), 0.035)
    T, raised = np.tile(np.eye(4), (2, 1, 1)), np.array([0.0, 0.015])
    obstruction = table_obstruction(prepared, table, T, q_open, raised)
    found = q_end * close_until_stopped(prepared, T, q_open, q_end, obstruction=obstruction)
    left = 0.1 - RADIUS - 0.035 - raised
    assert found == pytest.approx(np.stack([left, np.full(2, closed(RANGES[0])[1])], axis=1), abs=NEAR)
    assert (found[:, 0] <= left).all()


def test_joints_that_do_not_move_or_touch_already_stay(hand: Hand, scanned: Object):
    inside = closed((-0.02, 0.02))[None]
    share = close_until_stopped(HandObject(hand, scanned), np.eye(4)[None], inside, inside + [[0.01, 0.0]])
    assert share.tolist() == [[0.0, 0.0]]


@pytest.fixture(scope="module")
def scene(hand: Hand, scanned: Object) -> Scene:
    """A grasp that touches the most probable solid, one that is open by a centimetre, and one that is none."""
    q = closed(RANGES[0])
    return Scene(hand, scanned, np.stack([np.eye(4), np.eye(4), np.full((4, 4), np.nan)]), np.stack([q, q - 0.01, q]))


@pytest.fixture(scope="module")
def ends(scene: Scene, scanned: Object) -> Ends:
    solids = tuple(HandObject(scene.hand, solid) for solid in scanned.solids)
    return Ends.of(scene, Config(), solids, HandObject(scene.hand, scanned.envelope))


def test_frozen_joints_stay(scene: Scene, scanned: Object):
    solids = tuple(HandObject(scene.hand, solid) for solid in scanned.solids)
    found = Ends.of(scene, Config(freeze=("l",)), solids, HandObject(scene.hand, scanned.envelope))
    assert (found.q[:2, :, 0] == scene.q[:2, None, 0]).all()
    assert np.ptp(found.q[0, :, 1]) > 0.01


def test_hands_open_beside_the_thickest_solid(scene: Scene, ends: Ends):
    left, right = min(low for low, _ in RANGES), max(high for _, high in RANGES)
    x = ends.T_open[0, 0, 3] + np.array([0.1 - ends.q_open[0, 0], ends.q_open[0, 1] - 0.1])
    assert x[0] >= right + RADIUS + CLEARANCE - NEAR
    assert x[1] <= left - RADIUS - CLEARANCE + NEAR
    assert np.isnan(ends.T_open[2]).all()


def test_each_solid_stops_the_fingers_where_it_is(scene: Scene, ends: Ends):
    for k, faces in enumerate(RANGES):
        assert ends.q[0, k] == pytest.approx(closed(faces), abs=NEAR), f"solid {k}"
        assert ends.touching[0, k][[scene.links.index("left"), scene.links.index("right")]].all()
    assert not ends.touching[0, :, scene.links.index("palm")].any()
    seen = ends.point[0, :, scene.links.index("left"), 0]
    assert seen == pytest.approx(np.full(3, 0.03), abs=1e-9)


def test_links_touch_as_probably_as_the_solids_that_stop_them(scene: Scene, ends: Ends):
    left, right, palm = (scene.links.index(name) for name in ("left", "right", "palm"))
    touching = ends.touching.copy()
    touching[0, 1, left] = touching[0, 2, right] = False
    found = replace(ends, touching=touching).contact_probability(np.array([0.5, 0.3, 0.2]))[0]
    assert found[[left, right, palm]] == pytest.approx([0.7, 0.8, 0.0])


def test_squeezes_press_on_the_thinnest_solid(scene: Scene, scanned: Object, ends: Ends):
    solids = tuple(HandObject(scene.hand, solid) for solid in scanned.solids)
    motion = ends.motion(replace(scene, q=ends.q[:, 0]), solids)
    assert (motion.q[0, 2] >= ends.q[0].max(axis=0) - 1e-12).all()
    assert (motion.q[0, 1] == ends.q[0, 0]).all()


def test_a_grasp_of_no_pose_has_no_quality(ends: Ends):
    assert (ends.value[2] == 0.0).all()


def test_quality_falls_where_a_solid_that_is_displaced_slips_out(hand: Hand, scanned: Object):
    """Balls lose a small box that is displaced by 7 mm, and hold a large one at another place."""
    found = []
    for size in (0.03, 0.005):
        pieces = (hull(box(-0.03, 0.03)[0].vertices * [1.0, size / 0.03, size / 0.03]),)
        obj = replace(scanned, supplied=pieces, hypotheses=())
        one = HandObject(hand, obj)
        found.append(Ends.of(Scene(hand, obj, np.eye(4)[None], closed((-0.03, 0.03))[None]), Config(), (one,) * 3, one))
    large, small = (ends.value.mean() for ends in found)
    assert small < 0.8 * large


def attempt(scene: Scene, ends: Ends, values: list[list[float]], shift: float) -> tuple[Scene, Ends]:
    """All grasps moved by some metres, with given qualities on each solid."""
    T = scene.T_world_root.copy()
    T[:, 1, 3] += shift
    return replace(scene, T_world_root=T), replace(ends, value=np.array(values))


@pytest.mark.parametrize(("prefer", "kept"), [("closest", [1, 2, 2]), ("strongest", [2, 2, 2])])
def test_the_nearest_good_attempt_is_kept_or_the_most_probable(scene: Scene, ends: Ends, prefer: str, kept: list[int]):
    weights = np.array([0.5, 0.3, 0.2])
    found = [
        attempt(scene, ends, [[1.0, 0.0, 0.0], [0.9, 0.9, 0.9], [0.0, 0.0, 0.0]], 0.0),
        attempt(scene, ends, [[0.98, 0.98, 0.98], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]], 0.001),
        attempt(scene, ends, [[1.0, 1.0, 1.0], [0.94, 0.94, 0.94], [0.1, 0.0, 0.0]], 0.01),
    ]
    best = best_attempt(scene, *map(list, zip(*found, strict=True)), weights, Config(prefer=prefer))
    assert best.tolist() == kept
