"""Draws of the factors: their distributions, and that they are the same for all."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.stats import kstest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.validation.margins.draws import MAX_DRAWS, Draws, draw, nominal
from grasp_refine.validation.margins.factors import FIELDS, JOINT, MEANING, PUSH, Factors

FACTORS = Factors()


@pytest.fixture(scope="module")
def many() -> Draws:
    return draw(FACTORS, 1024, 3)


def test_fewer_draws_are_the_first_of_more_and_another_seed_has_others(many: Draws) -> None:
    few, other = draw(FACTORS, 10, 3), draw(FACTORS, 10, 4)
    for field in fields(Draws):
        np.testing.assert_array_equal(getattr(few, field.name), getattr(many, field.name)[:10])
    assert not np.allclose(few.direction, other.direction)


def test_vectors_are_uniform_in_the_sphere_and_on_it(many: Draws) -> None:
    assert np.linalg.norm(many.direction, axis=1) == pytest.approx(1.0)
    for vectors, largest in ((many.shift, FACTORS.offset), (many.turn, FACTORS.turn)):
        radius = np.linalg.norm(vectors, axis=1) / largest
        assert kstest(radius**3, "uniform").pvalue > 0.01
    for unit in (many.direction, many.shift / np.linalg.norm(many.shift, axis=1)[:, None]):
        for axis in range(3):
            assert kstest((1 + unit[:, axis]) / 2, "uniform").pvalue > 0.01


def test_numbers_are_uniform_in_their_ranges_or_in_the_logarithm(many: Draws) -> None:
    for name in ("friction", "gain", "force_limit", "thickness"):
        low, high = getattr(FACTORS, name)
        assert kstest((getattr(many, name) - low) / (high - low), "uniform").pvalue > 0.01
    for name, field in (("mass", "mass"), ("softness", "contact_time")):
        low, high = getattr(FACTORS, name)
        assert kstest(np.log(getattr(many, field) / low) / np.log(high / low), "uniform").pvalue > 0.01
    assert many.default_contact.mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("factor", FIELDS)
def test_one_factor_alone_leaves_all_others_as_in_the_protocol(many: Draws, factor: str) -> None:
    alone = many.only(factor, STRICT, 0.3)
    for name, value in nominal(len(many), STRICT, 0.3).items():
        drawn = getattr(many, name) if name in FIELDS[factor] else value
        np.testing.assert_array_equal(getattr(alone, name), drawn)
    np.testing.assert_array_equal(alone.direction, many.direction)
    np.testing.assert_array_equal(many.only(PUSH, STRICT, 0.3).mass, 0.3)
    assert many.only(JOINT, STRICT, 0.3) is many


def test_every_drawn_field_belongs_to_one_factor() -> None:
    of_factors = [name for names in FIELDS.values() for name in names]
    assert sorted(of_factors) == sorted(field.name for field in fields(Draws) if field.name != "direction")
    assert set(MEANING) == {JOINT, PUSH, *FIELDS}


def test_the_weight_pushes_and_the_object_turns_about_its_middle(many: Draws) -> None:
    middle = np.array([0.1, -0.2, 0.3])
    conditions = many.conditions(DEXGRASPBENCH, middle)
    weight = many.mass * DEXGRASPBENCH.acceleration
    assert conditions.wrench is not None
    np.testing.assert_allclose(conditions.wrench[:, 0, :3], weight[:, None] * many.direction)
    assert not conditions.wrench[..., 3:].any()
    moved = np.einsum("kij,j->ki", conditions.T_world_object[:, :3, :3], middle) + conditions.T_world_object[:, :3, 3]
    np.testing.assert_allclose(moved, middle + many.shift, atol=1e-12)
    np.testing.assert_allclose(conditions.T_world_object[:, :3, :3], exp_so3(many.turn))


@pytest.mark.parametrize("count", [0, -1, MAX_DRAWS + 1])
def test_a_number_of_draws_that_cannot_be_is_refused(count: int) -> None:
    with pytest.raises(GraspRefineError, match=f"{MAX_DRAWS}.*{count}"):
        draw(FACTORS, count)


@pytest.mark.parametrize(
    "wrong",
    [
        {"friction": (1.0, 0.2)},
        {"mass": (0.0, 1.0)},
        {"offset": -1.0},
        {"default_contact": 1.5},
        {"turn": float("inf")},
    ],
)
def test_a_range_that_cannot_be_drawn_from_is_refused(wrong: dict) -> None:
    with pytest.raises(GraspRefineError, match=next(iter(wrong))):
        replace(FACTORS, **wrong)
