"""Presets: which methods, settings and sizes each experiment compares."""

from __future__ import annotations

from collections import Counter
from typing import get_args

import pytest

from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.distance import Distance
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.presets import BASELINE, EPSILON, MARGINS, OURS, PRESETS, STEP_SIZES
from grasp_refine_apps.bench.align.tasks import CLASSES
from grasp_refine_apps.bench.align.variants import ADAPTIVE, TARGET_STRIDE, MethodName, Variant
from grasp_refine_apps.bench.derivatives import NEIGHBORHOODS
from grasp_refine_apps.commands.bench_align import PresetName

METHODS = set(get_args(MethodName))


def variants(name: str) -> tuple[Variant, ...]:
    return PRESETS[name].variants


@pytest.mark.parametrize("name", PRESETS)
def test_the_variants_of_a_preset_differ_and_can_be_built(name: str):
    preset = PRESETS[name]
    # Not only as values: rows that look alike would be two names of one thing.
    shown = [tuple(variant.columns().values()) for variant in preset.variants]
    assert len(set(shown)) == len(shown) > 1
    assert preset.pairs >= 1 and preset.targets >= 1
    assert set(preset.classes) <= set(CLASSES)
    for variant in preset.variants:
        assert variant.solver_patch == (Patch(EPSILON) if variant.witness == "patch" else None)
        method = variant.derivative(3)
        assert isinstance(method, Derivative) and getattr(method, "seed", 3) == 3
        near = ADAPTIVE if variant.neighborhood == "adaptive" else NEIGHBORHOODS[variant.neighborhood]
        assert getattr(method, "neighborhood", None) in (None, near)
        assert getattr(method, "coupling", variant.coupling) == variant.coupling


def test_the_command_line_offers_all_presets():
    assert set(get_args(PresetName)) == set(PRESETS)


def test_table1_compares_all_methods():
    assert {variant.method for variant in variants("table1")} == METHODS and len(METHODS) == 7
    assert len(variants("table1")) == 7
    assert OURS in variants("table1") and BASELINE in variants("table1")
    # Only what the paper proposes, and what we do, transports; the baseline has the samples of its paper.
    assert {variant.method for variant in variants("table1") if variant.transport} == {"distance", "contact-kinematics"}
    assert (BASELINE.method, BASELINE.neighborhood, BASELINE.transport) == ("direction", "neighbor", False)
    assert "face-face" in PRESETS["table1"].classes


def test_smoke_runs_all_methods_on_little():
    smoke = PRESETS["smoke"]
    others = {(variant.solver, variant.witness) for variant in smoke.variants[7:]}
    assert smoke.variants[:7] == variants("table1")
    first = "closed-form-first"
    assert others == {("closed-form", "plain"), ("levenberg-marquardt", "plain"), (first, "plain"), (first, "patch")}
    assert smoke.pairs * smoke.targets <= 16 and max(smoke.budgets) <= 200


def test_table2_crosses_smoothing_with_sampling_and_gradients():
    found = variants("table2")
    assert Counter(variant.margin for variant in found) == {0.0: 10, 1e-3: 10}
    for margin in (0.0, 1e-3):
        rows = {(v.method, v.neighborhood, v.optimise, v.transport) for v in found if v.margin == margin}
        for smoothing in ("direction", "distance"):
            assert (smoothing, "adaptive", "T1T2", False) in rows
            assert (smoothing, "adaptive", "T2", False) in rows
            for near in ("neighbor", "fixed", "adaptive"):
                assert (smoothing, near, "T2", True) in rows


def test_tables_of_times_are_short():
    assert {variant.method for variant in variants("table3")} == METHODS
    assert {(v.method, v.neighborhood) for v in variants("table4")} == {
        (method, near) for method in ("direction", "distance") for near in ("neighbor", "fixed", "adaptive")
    }
    assert any(not variant.transport for variant in variants("table4"))
    assert PRESETS["table3"].budgets == PRESETS["table4"].budgets == (200,)


def test_margins_and_step_sizes_are_swept():
    assert MARGINS == (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
    assert STEP_SIZES == (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
    for name, field, values in (("margin", "margin", MARGINS), ("step-size", "step_size", STEP_SIZES)):
        swept = Counter(getattr(variant, field) for variant in variants(name))
        assert set(swept) == set(values) and len(set(swept.values())) == 1
        methods = {variant.method for variant in variants(name)}
        assert {"distance", "direction"} <= methods
    assert {"finite-difference", "zeroth-order"} <= {variant.method for variant in variants("step-size")}
    assert {v.coupling for v in variants("coupling")} == {"one-sided", "coupled"}


def test_solvers_are_compared_each_at_its_own_budgets():
    preset = PRESETS["solvers"]
    assert preset.budgets == () and "face-face" not in preset.classes
    for margin in (0.0, 1e-3):
        assert [(v.name, v.budget) for v in preset.variants if v.margin == margin] == [
            ("distance", 2000), ("contact-kinematics", 2000), ("closed-form", 1),
            *((solver, budget) for solver in ("levenberg-marquardt", "closed-form-first") for budget in (200, 500)),
        ]  # fmt: skip


def test_patch_is_compared_on_faces_by_both_metrics():
    preset = PRESETS["patch"]
    assert preset.classes == ("face-face",) and {variant.epsilon for variant in preset.variants} == {EPSILON}
    assert [(variant.name, variant.witness) for variant in preset.variants] == [
        (name, witness) for name in ("distance", "closed-form-first") for witness in ("plain", "patch")
    ]


def test_methods_of_many_queries_run_an_eighth_of_the_targets():
    assert TARGET_STRIDE == 8
    for method in METHODS:
        expensive = method in ("finite-difference", "zeroth-order")
        assert Variant(method).every == (8 if expensive else 1)


def test_the_default_is_the_method_of_the_paper():
    assert Variant() == OURS
    assert (OURS.method, OURS.neighborhood, OURS.transport, OURS.optimise) == ("distance", "adaptive", True, "T2")
    assert (OURS.margin, OURS.step_size, OURS.budget) == (1e-3, 10.0, 2000)
    unilateral, coupled = (Variant(coupling=coupling).derivative(0) for coupling in ("one-sided", "coupled"))
    assert isinstance(unilateral, Distance) and isinstance(coupled, Distance)
    assert (unilateral.smoothed_self, coupled.smoothed_self) == (True, False)
