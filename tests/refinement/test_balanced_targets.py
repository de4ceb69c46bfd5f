"""Targets are wishes among the contacts: other links touch as well, and forces balance."""

from dataclasses import replace

import numpy as np
import pytest

from claw import around, capsule, claw
from grasp_refine.core.se3 import exp_so3
from grasp_refine.measures.geometry import measure
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.judging import judge, target_miss
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

CONFIG = Config(starts=3, solver=LevenbergMarquardt(iterations=30))
GEOMETRY = replace(CONFIG, weights=Weights(wrench=0.0))
AXIS = np.array([0.008, -0.006, 0.02]) / np.linalg.norm([0.008, -0.006, 0.02])
"""Axis of the capsule, along which it looks the same from all sides."""


@pytest.fixture(scope="module")
def aimed(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Random claws, the index of which should touch a capsule 5 mm beside its nearest point, but for the last claw."""
    scene = around(claw(tmp_path_factory.mktemp("claw")), capsule(), 6, 1)
    near = refine(scene, replace(GEOMETRY, nearest=True))
    on_link, on_object = np.full((2, *near.target_link.shape), np.nan)
    on_link[:5, 0], on_object[:5, 0] = near.target_link[:5, 0], near.target_object[:5, 0] @ exp_so3(0.2 * AXIS).T
    assert np.isfinite(on_object[:5, 0]).all()
    return replace(scene, target_link=on_link, target_object=on_object)


@pytest.fixture(scope="module")
def prepared(aimed: Scene) -> HandObject:
    return HandObject.of(aimed)


def quality_of(prepared: HandObject, found: Refinement) -> np.ndarray:
    return judge(prepared, prepared.chain(found.T_world_root, found.q))[2]


def test_links_reach_their_targets_in_a_grasp_that_holds(aimed: Scene, prepared: HandObject) -> None:
    balanced, alone = (refine(aimed, config, prepared=prepared) for config in (CONFIG, GEOMETRY))
    miss = target_miss(aimed, prepared.chain(balanced.T_world_root, balanced.q).T_world_link)
    assert miss[5] == 0.0 and (miss < 5e-4).sum() >= 5, "targets are met, and a grasp without one has no miss"
    assert balanced.touching[:5, 0].all() and (balanced.touching.sum(axis=1) >= 2).all()
    np.testing.assert_array_equal(alone.touching[:5].sum(axis=1), 1)
    good = quality_of(prepared, balanced)
    assert (good > 0.9).sum() >= 5 and good.mean() > quality_of(prepared, alone).mean() + 0.1
    none = np.full_like(aimed.target_link, np.nan)
    after = measure(prepared, balanced.T_world_root, balanced.q, none, none)
    gaps = np.where(balanced.touching, np.abs(after.distance), 0.0).max(axis=1)
    assert (gaps < 5e-4).sum() >= 5 and (after.penetration < 5e-4).all()


def test_a_miss_is_the_distance_of_the_worst_target(aimed: Scene, prepared: HandObject) -> None:
    shift = np.array([0.0, 0.003, -0.004])
    T = prepared.chain(aimed.T_world_root, aimed.q).T_world_link
    here = np.einsum("nij,nj->ni", T[:, 0, :3, :3], aimed.target_link[:, 0]) + T[:, 0, :3, 3]
    scene = replace(aimed, target_object=np.where(np.isnan(aimed.target_object), np.nan, (here + shift)[:, None]))
    np.testing.assert_allclose(target_miss(scene, T), [0.005] * 5 + [0.0], atol=1e-12)
