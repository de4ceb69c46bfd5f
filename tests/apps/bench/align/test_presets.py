"""Presets: which methods, settings and sizes each experiment compares."""

from __future__ import annotations

from typing import get_args

import pytest

from grasp_refine.witness.derivative import Derivative
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.presets import EPSILON, PRESETS
from grasp_refine_apps.bench.align.tasks import CLASSES
from grasp_refine_apps.bench.align.variants import ADAPTIVE
from grasp_refine_apps.bench.derivatives import NEIGHBORHOODS
from grasp_refine_apps.commands.bench_align import PresetName


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
