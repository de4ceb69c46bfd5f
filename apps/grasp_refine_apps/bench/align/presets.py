"""The experiments of arXiv 2511.06267, and some of our own, as lists of variants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from types import MappingProxyType

from grasp_refine.witness.slip import Coupling
from grasp_refine_apps.bench.align.study import AlignStudy
from grasp_refine_apps.bench.align.tasks import CLASSES
from grasp_refine_apps.bench.align.variants import MethodName, Variant
from grasp_refine_apps.bench.derivatives import NeighborhoodName

MARGINS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
STEP_SIZES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)

OURS = Variant()
"""The paper's method: distance smoothing, adaptive sampling, equivalent gradient transport."""
BASELINE = Variant("direction", "neighbor", transport=False)
"""The method that the paper improves on (Montaut et al. 2022)."""
SMOOTHING: tuple[MethodName, ...] = ("direction", "distance")
"""Methods that use samples of the surface."""
NEIGHBORHOODS: tuple[NeighborhoodName, ...] = ("neighbor", "fixed", "adaptive")
"""Neighbourhoods of these samples."""
EPSILON = 1e-5
"""Epsilon of the patch witness, in metres."""


def _table1() -> tuple[Variant, ...]:
    names: tuple[MethodName, ...] = ("analytical", "finite-difference", "zeroth-order")
    others = [Variant(name, transport=False) for name in names]
    return (*others, BASELINE, OURS, Variant("contact-kinematics"), Variant("rigid", transport=False))


def _table2() -> tuple[Variant, ...]:
    sampling = [Variant(name, near) for name, near in product(SMOOTHING, NEIGHBORHOODS)]
    without = [Variant(name, transport=False) for name in SMOOTHING]
    both = [Variant(name, transport=False, optimise="T1T2") for name in SMOOTHING]
    return tuple(replace(variant, margin=margin) for variant in (*both, *without, *sampling) for margin in (0.0, 1e-3))


def _table3() -> tuple[Variant, ...]:
    others: tuple[MethodName, ...] = ("rigid", "analytical", "finite-difference", "zeroth-order")
    return tuple(Variant(name) for name in (*others, *SMOOTHING, "contact-kinematics"))


def _table4() -> tuple[Variant, ...]:
    backward = [Variant(name, near) for name, near in product(SMOOTHING, NEIGHBORHOODS)]
    return (*backward, replace(OURS, transport=False))


def _margin() -> tuple[Variant, ...]:
    methods = (OURS, BASELINE, Variant("direction"))
    return tuple(replace(method, margin=margin) for method, margin in product(methods, MARGINS))


def _step_size() -> tuple[Variant, ...]:
    names: tuple[MethodName, ...] = ("finite-difference", "zeroth-order")
    plain = (BASELINE, *(Variant(name, transport=False) for name in names))
    best = (Variant("direction"), Variant("finite-difference"), Variant("zeroth-order"))
    return tuple(replace(method, step_size=size) for method, size in product((OURS, *plain, *best), STEP_SIZES))


def _coupling() -> tuple[Variant, ...]:
    couplings: tuple[Coupling, ...] = ("one-sided", "coupled")
    return tuple(
        Variant(name, coupling=coupling, transport=transport)
        for name, coupling, transport in product(reversed(SMOOTHING), couplings, (True, False))
    )


def _solvers() -> tuple[Variant, ...]:
    least_squares = [
        Variant.least_squares(budget=budget, with_closed_form=closed)
        for closed in (False, True)
        for budget in (200, 500)
    ]
    methods = (OURS, Variant("contact-kinematics"), Variant.closed_form(), *least_squares)
    return tuple(replace(method, margin=margin) for margin in (0.0, 1e-3) for method in methods)


def _patch() -> tuple[Variant, ...]:
    methods = (OURS, Variant.least_squares(budget=500, with_closed_form=True))
    return tuple(
        replace(method, witness=witness, epsilon=EPSILON) for method in methods for witness in ("plain", "patch")
    )


def _smoke() -> tuple[Variant, ...]:
    return (
        *_table1(),
        Variant.closed_form(epsilon=EPSILON),
        Variant.least_squares(epsilon=EPSILON),
        Variant.least_squares(epsilon=EPSILON, with_closed_form=True),
        Variant.least_squares(witness="patch", epsilon=EPSILON, with_closed_form=True),
    )


PRESETS: Mapping[str, AlignStudy] = MappingProxyType(
    {
        "table1": AlignStudy(_table1(), classes=CLASSES),
        "table2": AlignStudy(_table2()),
        "table3": AlignStudy(_table3(), budgets=(200,)),
        "table4": AlignStudy(_table4(), budgets=(200,)),
        "margin": AlignStudy(_margin()),
        "step-size": AlignStudy(_step_size()),
        "coupling": AlignStudy(_coupling()),
        "solvers": AlignStudy(_solvers(), budgets=()),
        "patch": AlignStudy(_patch(), classes=("face-face",), budgets=()),
        "smoke": AlignStudy(_smoke(), classes=CLASSES, pairs=2, targets=8, budgets=(50, 200)),
    }
)
"""Name -> experiment."""
