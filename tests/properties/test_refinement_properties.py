"""Whole refinements of round fingertips, whose losses are known in closed form: true losses, limits, grasps alone."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from claw import around, claw
from grasp_refine.core.se3 import log_so3
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.iteration_state import IterationState
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

FEWER, FEWEST = (
    settings(max_examples=max(least, settings().max_examples // part)) for least, part in ((4, 7), (2, 15))
)

RADIUS = 0.03
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    return claw(tmp_path_factory.mktemp("claw"))


@pytest.fixture(scope="module")
def ball() -> Object:
    return load_object(f"sphere:{RADIUS}", candidates=64)


@pytest.fixture(scope="module")
def prepared(hand: Hand, ball: Object) -> HandObject:
    return HandObject(hand, ball)


# losses in closed form


def segment(piece: Piece, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both ends (M, 3) of the core of a ball or a capsule at poses (M, 4, 4)."""
    ends = np.einsum("mij,vj->vmi", T[:, :3, :3], piece.vertices) + T[None, :, :3, 3]
    return ends[0], ends[-1]


def apart(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Distance (M,) of two segments of which one is a point."""
    (a, b), (point, other) = (first, second) if (second[0] == second[1]).all() else (second, first)
    assert (point == other).all()
    along = b - a
    share = ((point - a) * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-30)
    return np.linalg.norm(point - a - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)


def true_loss(prepared: HandObject, config: Config, touching: np.ndarray, T: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Gaps of the links (M, L) that should touch, depths in the object, and depths in each other: (M,), m^2."""
    links = prepared.chain.links
    poses = Kinematics(prepared.hand, links)(torch.from_numpy(T), torch.from_numpy(q)).numpy()
    pieces = [body.pieces[0] for body in prepared.bodies]
    cores = [segment(piece, poses[:, k]) for k, piece in enumerate(pieces)]
    center = (np.zeros((len(T), 3)),) * 2
    d = np.stack(
        [apart(core, center) - piece.radius - RADIUS for core, piece in zip(cores, pieces, strict=True)], axis=1
    )
    own = [
        apart(cores[i], cores[j]) - pieces[i].radius - pieces[j].radius
        for i, j in zip(*prepared.self_collision_links, strict=True)
    ]  # fmt: skip
    weights = config.weights
    return (
        weights.contact * (touching * (d - config.margin) ** 2).sum(axis=1)
        + weights.penetration * (np.minimum(d, 0.0) ** 2).sum(axis=1)
        + weights.self_penetration * sum(np.minimum(one, 0.0) ** 2 for one in own)
    )


class Seen:
    """What was seen of a refinement: losses of every grasp in their order, the true ones, and limits."""

    def __init__(self, prepared: HandObject, config: Config) -> None:
        self.prepared, self.config = prepared, config
        self.losses: dict[int, list[float]] = defaultdict(list)
        self.wrong = 0.0
        self.beyond = -np.inf

    def __call__(self, glimpse: IterationState) -> None:
        T, q, hand = glimpse.point.T, glimpse.point.q, self.prepared.hand
        self.beyond = max(self.beyond, (q - hand.upper).max(), (hand.lower - q).max())
        true = true_loss(self.prepared, self.config, glimpse.touching, T, q)
        self.wrong = max(self.wrong, (np.abs(glimpse.loss - true) / (true + 1e-12)).max())
        for row, value in zip(glimpse.row.tolist(), true, strict=True):
            self.losses[row].append(float(value))


def config_of(solver: Any, **changes: Any) -> Config:
    weights = Weights(wrench=0.0, penetration=50.0, self_penetration=30.0)
    touching = ContactSelection(links=("index", "ring", "thumb"))
    return Config(solver=solver, weights=weights, contact_selection=touching, **changes)


@FEWER
@given(seed=seeds, margin=st.sampled_from([0.0, 2e-3]), far=st.sampled_from([0.0, 0.05]), limited=st.booleans())
def test_levenberg_marquardt_only_lowers_the_true_loss(
    prepared: HandObject, seed: int, margin: float, far: float, limited: bool
) -> None:
    """Every loss that it tells is the closed form's, none is above the one before, and joints keep to their limits."""
    scene = around(prepared.hand, prepared.object, 3, seed)
    scene.T_world_root[:, 2, 3] += far
    reach = MaxMove(0.004, 0.05, 0.1) if limited else MaxMove()
    config = config_of(LevenbergMarquardt(iterations=60), margin=margin, max_move=reach)
    seen = Seen(prepared, config)
    found = refine(scene, config, on_iteration=seen, prepared=prepared)
    assert seen.wrong < 1e-6 and seen.beyond <= 0.0
    for row, losses in seen.losses.items():
        assert (np.diff(losses) <= 1e-9 * np.array(losses[:-1]) + 1e-18).all()
        assert found.loss[row, 1] == pytest.approx(min(losses), rel=1e-6, abs=1e-16)
    last = true_loss(prepared, config, found.touching, found.T_world_root, found.q)
    np.testing.assert_allclose(found.loss[:, 1], last, rtol=1e-6, atol=1e-16)
    moved = np.linalg.norm(found.T_world_root[:, :3, 3] - scene.T_world_root[:, :3, 3], axis=1)
    turned = np.linalg.norm(log_so3(found.T_world_root[:, :3, :3] @ scene.T_world_root[:, :3, :3].mT), axis=1)
    assert (moved <= reach.translation + 1e-12).all() and (turned <= reach.rotation + 1e-12).all()
    assert (np.abs(found.q - scene.q) <= reach.joints + 1e-12).all()


@FEWER
@given(
    seed=seeds,
    dtype=st.sampled_from(["float64", "float32"]),
    kind=st.sampled_from([Descent, Adam]),
    at_limit=st.booleans(),
)
def test_descent_reports_true_losses_and_keeps_to_the_limits(
    prepared: HandObject, seed: int, dtype: str, kind: Any, at_limit: bool
) -> None:
    scene = around(prepared.hand, prepared.object, 3, seed)
    if at_limit:
        rng = np.random.default_rng(seed)
        scene = replace(scene, q=np.where(rng.random(scene.q.shape) < 0.5, prepared.hand.lower, prepared.hand.upper))
    config = config_of(kind(iterations=12, step_joints=0.2), dtype=dtype)
    seen = Seen(prepared, config)
    found = refine(scene, config, on_iteration=seen, prepared=prepared)
    assert seen.beyond <= 0.0 and seen.wrong < (1e-6 if dtype == "float64" else 2e-2)
    for row, losses in seen.losses.items():
        assert found.loss[row, 1] == pytest.approx(min(losses), rel=1e-6 if dtype == "float64" else 2e-2, abs=1e-12)


# grasps on their own


def aimed(scene: Scene, seed: int) -> Scene:
    """Three fingertips should touch at given points."""
    rng, shape = np.random.default_rng(seed), (len(scene.q), len(scene.links), 3)
    n = rng.normal(size=(2, shape[0], 3, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    on_link, on_object = np.full((2, *shape), np.nan)
    centers = np.stack(
        [scene.hand.links_by_name[name].body.pieces[0].vertices.mean(axis=0) for name in scene.links[:3]]
    )
    on_link[:, :3], on_object[:, :3] = centers + 0.01 * n[0], RADIUS * n[1]
    return replace(scene, target_link=on_link, target_object=on_object)


def assert_near(found: Refinement, other: Refinement, rows: Iterable[int], atol: float) -> None:
    index = np.array(list(rows))
    np.testing.assert_allclose(found.T_world_root, other.T_world_root[index], rtol=0, atol=atol)
    np.testing.assert_allclose(found.q, other.q[index], rtol=0, atol=atol)


PLANS = {
    "gaps": lambda n: config_of(LevenbergMarquardt(iterations=n)),
    "descent": lambda n: config_of(Descent(iterations=n)),
    "adam": lambda n: config_of(Adam(iterations=n)),
    "targets": lambda n: Config(LevenbergMarquardt(iterations=n, restarts=2)),
    "forces": lambda n: Config(LevenbergMarquardt(iterations=n), starts=2),
}


@FEWER
@given(seed=seeds, plan=st.sampled_from(sorted(PLANS)), order=st.permutations(range(4)), alone=st.integers(0, 3))
def test_one_step_of_a_grasp_is_the_one_that_it_takes_alone(
    prepared: HandObject, seed: int, plan: str, order: list[int], alone: int
) -> None:
    """To 1e-9, alone and in any order; a whole run alone ends with the same status, and a loss that is as good."""
    scene = around(prepared.hand, prepared.object, 4, seed)
    scene = aimed(scene, seed) if plan == "targets" else scene
    for iterations, whole_run in ((2, False), (15, True)):
        config = PLANS[plan](iterations)
        whole = refine(scene, config, prepared=prepared)
        for rows in ([alone],) if whole_run else (order, [alone]):
            part = refine(scene.select(np.array(rows)), config, prepared=prepared)
            np.testing.assert_array_equal(part.status, whole.status[rows])
            if whole_run:
                np.testing.assert_allclose(part.loss[:, 1], whole.loss[rows, 1], rtol=1e-3, atol=1e-9)
            else:
                assert_near(part, whole, rows, 1e-9)
        if whole_run:
            narrow = refine(scene, replace(config, width=1), prepared=prepared)
            np.testing.assert_array_equal(narrow.status, whole.status)


@FEWEST
@given(seed=seeds, plan=st.sampled_from(sorted(PLANS)), other=st.sampled_from(sorted(PLANS)))
def test_nothing_is_remembered_between_refinements(hand: Hand, ball: Object, seed: int, plan: str, other: str) -> None:
    """After another plan and number of grasps: to the last bit the result of a new hand and object."""
    scene, between = around(hand, ball, 3, seed), around(hand, ball, 5, seed + 1)
    scene = aimed(scene, seed) if plan == "targets" else scene
    shared, config = HandObject(hand, ball), PLANS[plan](10)
    expected = refine(scene, config, prepared=HandObject(hand, ball))
    refine(aimed(between, seed) if other == "targets" else between, PLANS[other](3), prepared=shared)
    found = refine(scene, config, prepared=shared)
    for name in ("T_world_root", "q", "status", "loss", "iterations", "queries"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=f"{plan}, {other}")
