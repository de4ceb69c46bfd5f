"""Named experiments, as lists of variants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

from grasp_refine_apps.bench.grasp.tasks import Kind
from grasp_refine_apps.bench.grasp.variants import SolverName, Variant

FIRST_ORDER: tuple[SolverName, ...] = ("descent", "adam")


@dataclass(frozen=True)
class Preset:
    """An experiment."""

    variants: tuple[Variant, ...]
    """Variants to compare."""
    kinds: tuple[Kind, ...] = ("targets", "nothing")
    """Tasks with or without targets."""
    count: int | None = None
    """Tasks of each object and scale; None: all real grasps, and 64 with targets."""
    scenes: int | None = None
    """Number of objects and scales of each set, evenly chosen; None: all."""
    singles: int = 32
    """Tasks of a set that are run one at a time."""
    every_hand: bool = False
    """Whether, by default, all included hands are run, and sampled grasps of others, instead of one hand."""


def _over_time() -> tuple[Variant, ...]:
    quick = [Variant(budget=budget, batch=64) for budget in (5, 10, 20, 50, 100, 200)]
    slow = [
        Variant(solver, budget=budget, batch=64)
        for solver, budget in product(FIRST_ORDER, (50, 100, 200, 500, 1000, 2000))
    ]
    return (*quick, *slow)


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "targets": Preset(
            tuple(Variant(batch=batch) for batch in (1, 16, 64, 256)),
            kinds=("targets",),
            count=256,
        ),
        "nothing": Preset(
            tuple(Variant(batch=batch) for batch in (1, 16, 64, 256)),
            kinds=("nothing",),
        ),
        "time-to-error": Preset(
            _over_time(),
            kinds=("targets",),
            count=32,
            scenes=3,
        ),
        "contacts": Preset(
            tuple(Variant(contacts=count) for count in (1, 2, 3, 4, 5)),
            kinds=("targets",),
            count=64,
            scenes=2,
            every_hand=True,
        ),
        "pieces": Preset(
            tuple(Variant(pieces=count) for count in (1, 2, 4, 8, 16, 32, 64)),
            kinds=("targets",),
            count=64,
        ),
        "workers": Preset(
            tuple(Variant(processes=count) for count in (1, 2)),
            kinds=("targets",),
            count=256,
        ),
        "smoke": Preset(
            (
                Variant(batch=1),
                Variant(batch=16),
                *(Variant(solver, budget=40, batch=16) for solver in FIRST_ORDER),
            ),
            count=4,
            singles=4,
        ),
    }
)
"""Name -> experiment."""
