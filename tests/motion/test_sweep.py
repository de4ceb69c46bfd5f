"""Paths of hands and what they run into, against brute force and closed forms."""

from pathlib import Path

import numpy as np
import pytest

from ball_hand import AHEAD, BALL, PALM, TIP, WIDEST, ball_hand, body, grasp, thing
from grasp_refine.core.se3 import exp_se3, inverse, log_so3
from grasp_refine.hands.hand import Hand
from grasp_refine.motion.paths import HandPath
from grasp_refine.motion.sweep import SELF_TOUCHING_M, SPACING_M, TOUCHING_M, Sweep
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from made_hands import joint, link, solid

NAME = thing().name
LINKS, RADII = ("palm", "left", "right"), np.array([PALM, TIP, TIP])


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return ball_hand(tmp_path_factory.mktemp("balls"))


def centres(T: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the centres (K, 3, 3) of palm, left and right at poses (K, 4, 4) and joint values (K, 2)."""
    local = np.zeros((len(T), 3, 3))
    local[:, 1:, 2], local[:, 1, 1], local[:, 2, 1] = AHEAD, q[:, 0], -q[:, 1]
    return local @ T[:, :3, :3].mT + T[:, None, :3, 3]


def between(path: HandPath, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses and joint values at shares (K,) of a path of two poses: straight, at an even turn."""
    (before, after), (start, end) = path.T_world_root, path.q
    T = exp_se3(np.pad(share[:, None] * log_so3(before[:3, :3].T @ after[:3, :3]), ((0, 0), (3, 0))))
    T[:, :3, :3] = before[:3, :3] @ T[:, :3, :3]
    T[:, :3, 3] = before[:3, 3] + share[:, None] * (after[:3, 3] - before[:3, 3])
    return T, start + share[:, None] * (end - start)


Pairs = dict[tuple[str, str], tuple[np.ndarray, float, np.ndarray]]
"""Depth (K,), allowed depth and deepest point (K, 3) of each pair."""


def overlaps(
    T: np.ndarray, q: np.ndarray, around: dict[str, np.ndarray], plane: Plane | None, *, carries: bool
) -> Pairs:
    """Return the overlaps of all balls at K poses, the first of which is the start."""
    at = dict(zip(LINKS, np.moveaxis(centres(T, q), 1, 0), strict=True)) | {"object": (T @ inverse(T[0]))[:, :3, 3]}
    size = dict(zip(LINKS, RADII, strict=True)) | {"object": BALL}
    found: Pairs = {}

    def pair(a: str, b: str, place: np.ndarray, radius: float, allowed: float) -> None:
        apart = np.linalg.norm(place - at[a], axis=-1)
        depth = size[a] + radius - apart
        # What overlaps with the object at the start, such as a shelf, is left.
        left = max(float(depth[0]), 0.0) if a == "object" else 0.0
        found[a, b] = depth, allowed + left, at[a] + size[a] * (place - at[a]) / apart[:, None]

    pair("left", "right", at["right"], TIP, SELF_TOUCHING_M)
    for name, (*place, radius) in around.items():
        for a in (*LINKS, "object") if carries else LINKS:
            pair(a, name, np.array(place), radius, TOUCHING_M)
    for a in LINKS:
        if not carries:
            pair(a, NAME, np.zeros(3), BALL, TOUCHING_M)
        if plane is not None:
            normal = np.array(plane.normal)
            found[a, "table"] = size[a] + plane.offset - at[a] @ normal, TOUCHING_M, at[a] - size[a] * normal
    return found


@pytest.mark.parametrize("seed", range(20))
def test_sweeps_stop_where_brute_force_does(hand: Hand, seed: int) -> None:
    """At the first sample of any pair deeper than it may be: links, object, bodies, table, and the carried object."""
    rng = np.random.default_rng(seed)
    carries, on_table = bool(seed % 2), seed % 3 == 0
    T = exp_se3(rng.normal(size=(2, 6)) * [0.08, 0.08, 0.08, 1, 1, 1])
    q = rng.uniform(0.01 if seed % 4 else -0.002, WIDEST, (2, 2))
    path = HandPath(T, q[[0, 0]] if carries else q)
    around = {} if on_table else {f"post {k}": np.append(rng.normal(size=3) * 0.1, 0.02) for k in range(3)}
    plane = Plane((0.6, 0.0, 0.8), -0.12) if on_table else None
    bodies = [body(name, tuple(values)) for name, values in around.items()]
    scene, _ = grasp(hand, *bodies, table=plane, turn=exp_se3(rng.normal(size=6)))
    sweep = Sweep(scene, HandObject.of(scene))
    samples = sweep.sampled(path)
    along = T[1, :3, 3] - T[0, :3, 3]
    T_on, q_on = between(path, (samples.T_world_root[:, :3, 3] - T[0, :3, 3]) @ along / (along @ along))
    np.testing.assert_allclose(samples.T_world_root, T_on, atol=1e-9)
    np.testing.assert_allclose(samples.q, q_on, atol=1e-9)
    every = overlaps(T_on, q_on, around, plane, carries=carries)
    deep = np.array([depth > allowed for depth, allowed, _ in every.values()])
    met = sweep.obstruction(path, allowed=None if carries else TOUCHING_M, carries=carries)
    assert (met is None) == (not deep.any())
    if met is None:
        dense = overlaps(*between(path, np.linspace(0.0, 1.0, 2001)), around, plane, carries=carries)
        assert all(depth.max() < allowed + SPACING_M for depth, allowed, _ in dense.values())
        return
    first = int(deep.any(axis=0).argmax())
    assert met.share == pytest.approx(first / (len(samples) - 1))
    depth, _, place = every[met.first, met.second]
    assert met.depth == pytest.approx(depth[first], abs=1e-6)
    assert met.depth == pytest.approx(max(d[first] for d, most, _ in every.values() if d[first] > most), abs=1e-6)
    np.testing.assert_allclose(met.place, place[first], atol=1e-6)


def test_samples_are_close_together_and_begin_and_end_at_the_ends(hand: Hand) -> None:
    """No point of a link moves by more than the spacing; knots stay; a path that stands still has its ends."""
    rng = np.random.default_rng(0)
    T = exp_se3(rng.normal(size=(4, 6)) * [0.1, 0.1, 0.1, 1, 1, 1])
    T[2] = T[1]
    q = rng.uniform(0.0, WIDEST, (4, 2))
    q[2] = q[1]
    scene, _ = grasp(hand)
    path = Sweep(scene, HandObject.of(scene)).sampled(HandPath(T, q))
    np.testing.assert_allclose(path.T_world_root[[0, -1]], T[[0, -1]], atol=1e-12)
    knots = [np.flatnonzero(np.abs(path.q - value).max(axis=1) < 1e-12) for value in q]
    assert [len(found) for found in knots] == [1, 2, 2, 1] and knots[1][0] < knots[3][0]
    points = rng.normal(size=(200, 3))
    points = PALM * points / np.linalg.norm(points, axis=1, keepdims=True)
    middle = centres(path.T_world_root, path.q)
    for k, radius in enumerate(RADII):
        surface = middle[:, k, None] + radius / PALM * points @ path.T_world_root[:, :3, :3].mT
        step = np.linalg.norm(np.diff(surface, axis=0), axis=-1).max(axis=1)
        assert step.max() <= SPACING_M * 1.01
    assert len(path) < 1.5 * sum(np.linalg.norm(np.diff(middle, axis=0), axis=-1).max(axis=1)) / SPACING_M + 4


def test_a_whole_turn_of_a_joint_is_swept(tmp_path: Path) -> None:
    """At its ends all links are where they were, and half way a thumb is in a post."""
    turning = joint("t", "palm", "thumb", axis=(0, 0, 1), limits=(-7, 7))
    scene, motion = grasp(
        ball_hand(tmp_path, link("thumb", solid("sphere 0.01", "0.1 0 0")), turning),
        body("post", (-0.1, 0.0, AHEAD, 0.005)),
    )
    q = motion.q[0, [0, 0]]
    q[1, -1] = 2 * np.pi
    sweep = Sweep(scene, HandObject.of(scene))
    met = sweep.obstruction(HandPath(motion.T_world_root[0, :2], q))
    assert met is not None and (met.first, met.second) == ("thumb", "post")
    # It touches from where their centres are 15 mm apart.
    assert 0.0 < met.share - (0.5 - 0.015 / 0.1 / (2 * np.pi)) < 1.2 * SPACING_M / (0.11 * 2 * np.pi)
    assert met.depth < SPACING_M


def test_depth_in_object_is_the_largest_at_the_end(hand: Hand) -> None:
    scene, motion = grasp(hand, stages=(0.02, 0.036, 0.036), thing=thing((0.0, 0.0, 0.045, 0.005)))
    path = HandPath(motion.T_world_root[0, :2], motion.q[0, :2])
    # The tips are 4 mm deep, the palm 10 mm.
    assert Sweep(scene, HandObject.of(scene)).depth_in_object(path) == pytest.approx(0.01, abs=1e-9)
    apart = HandPath(path.T_world_root, path.q + 0.05)
    scene, _ = grasp(hand)
    assert Sweep(scene, HandObject.of(scene)).depth_in_object(apart) == 0.0


def test_of_several_overlaps_at_once_the_deepest_is_named(hand: Hand) -> None:
    """A tip 2 mm in the object and 5 mm in a post, where the hand stands still."""
    scene, motion = grasp(hand, body("post", (0.0, -0.053, 0.0, 0.01)), stages=(0.038, 0.05, 0.05))
    still = HandPath(motion.T_world_root[0, [0, 0]], motion.q[0, [0, 0]])
    met = Sweep(scene, HandObject.of(scene)).obstruction(still)
    assert met is not None and (met.first, met.second, met.share) == ("left", "post", 0.0)
    assert met.depth == pytest.approx(0.005, abs=1e-6)
