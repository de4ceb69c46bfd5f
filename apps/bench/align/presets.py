"""The experiments of arXiv 2511.06267, and some of our own, as lists of variants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType

from .tasks import CLASSES
from .variants import Variant

MARGINS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
STEP_SIZES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)

OURS = Variant()
"""The paper's method: distance smoothing, adaptive sampling, equivalent gradient transport."""
BASELINE = Variant("direction", "neighbor", transport=False)
"""The method that the paper improves on (Montaut et al. 2022)."""
EPSILON = 1e-5
"""Of the patch witness, in metres."""


@dataclass(frozen=True)
class Preset:
    """An experiment."""

    variants: tuple[Variant, ...]
    """What is compared, at the largest budget."""
    classes: tuple[str, ...] = CLASSES[:3]
    """Classes of targets."""
    pairs: int = 8
    """Pairs of bodies of each kind."""
    targets: int = 64
    """Accepted targets of each pair."""
    budgets: tuple[int, ...] = (2000,)
    """Budgets in iterations that every variant is run at; none: each has its own."""


def _table1() -> tuple[Variant, ...]:
    others = [Variant(name, transport=False) for name in ("analytical", "finite-difference", "zeroth-order")]
    return (*others, BASELINE, OURS, Variant("contact-kinematics"), Variant("rigid", transport=False))


def _table2() -> tuple[Variant, ...]:
    smoothing = ("direction", "distance")
    sampling = [Variant(name, near) for name, near in product(smoothing, ("neighbor", "fixed", "adaptive"))]
    without = [Variant(name, transport=False) for name in smoothing]
    both = [Variant(name, transport=False, optimise="T1T2") for name in smoothing]
    return tuple(replace(variant, margin=margin) for variant in (*both, *without, *sampling) for margin in (0.0, 1e-3))


def _table3() -> tuple[Variant, ...]:
    names = ("rigid", "analytical", "finite-difference", "zeroth-order", "direction", "distance", "contact-kinematics")
    return tuple(Variant(name) for name in names)


def _table4() -> tuple[Variant, ...]:
    backward = [
        Variant(name, near) for name, near in product(("direction", "distance"), ("neighbor", "fixed", "adaptive"))
    ]
    return (*backward, replace(OURS, transport=False))


def _margin() -> tuple[Variant, ...]:
    methods = (OURS, BASELINE, Variant("direction"))
    return tuple(replace(method, margin=margin) for method, margin in product(methods, MARGINS))


def _step_size() -> tuple[Variant, ...]:
    plain = (BASELINE, *(Variant(name, transport=False) for name in ("finite-difference", "zeroth-order")))
    best = (Variant("direction"), Variant("finite-difference"), Variant("zeroth-order"))
    return tuple(replace(method, step_size=size) for method, size in product((OURS, *plain, *best), STEP_SIZES))


def _coupling() -> tuple[Variant, ...]:
    return tuple(
        Variant(name, coupling=coupling, transport=transport)
        for name, coupling, transport in product(("distance", "direction"), ("one-sided", "coupled"), (True, False))
    )


def _solvers() -> tuple[Variant, ...]:
    least_squares = [Variant.least_squares(budget=budget) for budget in (200, 500)]
    methods = (OURS, Variant("contact-kinematics"), *least_squares)
    return tuple(replace(method, margin=margin) for margin in (0.0, 1e-3) for method in methods)


def _patch() -> tuple[Variant, ...]:
    methods = (OURS, Variant.least_squares(budget=500))
    return tuple(
        replace(method, witness=witness, epsilon=EPSILON) for method in methods for witness in ("plain", "patch")
    )


def _smoke() -> tuple[Variant, ...]:
    return (
        *_table1(),
        Variant.least_squares(epsilon=EPSILON),
        Variant.least_squares(witness="patch", epsilon=EPSILON),
    )


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "table1": Preset(_table1(), classes=CLASSES),
        "table2": Preset(_table2()),
        "table3": Preset(_table3(), budgets=(200,)),
        "table4": Preset(_table4(), budgets=(200,)),
        "margin": Preset(_margin()),
        "step-size": Preset(_step_size()),
        "coupling": Preset(_coupling()),
        "solvers": Preset(
            _solvers(),
            budgets=(),
        ),
        "patch": Preset(_patch(), classes=("face-face",), budgets=()),
        "smoke": Preset(
            _smoke(),
            classes=CLASSES,
            pairs=2,
            targets=8,
            budgets=(50, 200),
        ),
    }
)
"""Name -> experiment."""
