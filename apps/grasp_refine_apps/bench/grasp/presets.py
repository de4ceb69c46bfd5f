"""Named experiments, and sets of assets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

from grasp_refine_apps.bench.grasp.study import GraspStudy
from grasp_refine_apps.bench.grasp.variants import SolverName, Variant

BATCHES = (1, 16, 64, 256)
"""Default batch sizes."""

FIRST_ORDER: tuple[SolverName, ...] = ("descent", "adam")


def _over_time() -> tuple[Variant, ...]:
    quick = [Variant(budget=budget, batch=64) for budget in (5, 10, 20, 50, 100, 200)]
    slow = [
        Variant(solver, budget=budget, batch=64)
        for solver, budget in product(FIRST_ORDER, (50, 100, 200, 500, 1000, 2000))
    ]
    return (*quick, *slow)


PRESETS: Mapping[str, GraspStudy] = MappingProxyType(
    {
        "targets": GraspStudy(tuple(Variant(batch=batch) for batch in BATCHES), tasks=("targets",), count=256),
        "nothing": GraspStudy(tuple(Variant(batch=batch) for batch in BATCHES), tasks=("nothing",)),
        "time-to-error": GraspStudy(_over_time(), tasks=("targets",), count=32, scenes=3),
        "contacts": GraspStudy(
            tuple(Variant(contacts=count) for count in (1, 2, 3, 4, 5)), tasks=("targets",), count=64, scenes=2
        ),
        "pieces": GraspStudy(
            tuple(Variant(pieces=count) for count in (1, 2, 4, 8, 16, 32, 64)), tasks=("targets",), count=64
        ),
        "workers": GraspStudy(tuple(Variant(processes=count) for count in (1, 2)), tasks=("targets",), count=256),
        "smoke": GraspStudy(
            (Variant(batch=1), Variant(batch=16), *(Variant(solver, budget=40, batch=16) for solver in FIRST_ORDER)),
            count=4,
            singles=4,
        ),
    }
)
"""Name -> experiment."""

EVERY_HAND = ("contacts",)
"""Experiments that by default run all included hands, and sampled grasps of others, instead of one hand."""


@dataclass(frozen=True)
class Place:
    """Paths of the parts of a set in a folder of assets, beside grasps/normalised/NAME.npz and objects/."""

    hand: str
    """Path of the URDF."""
    object: str | None = None
    """Path of the object, if it is not in objects/."""
    sampled: int | None = None
    """Number of sampled grasps; None: the grasps of the file."""


PLACES: Mapping[str, Place] = MappingProxyType(
    {
        "bodex_shadow": Place("hands/shadow/shadow_right.urdf"),
        "dexgraspnet_shadow": Place("hands/shadow/shadow_right.urdf"),
        "frogger_allegro": Place("hands/allegro/allegro_right.urdf"),
        "leap_cube": Place("hands/leap/leap_right.urdf", "box:0.075,0.075,0.075"),
        "sampled_barrett": Place("hands/barrett/barrett.urdf", "rounded_box", 16),
        "sampled_robotiq": Place("hands/robotiq3f/robotiq3f.urdf", "rounded_box", 16),
    }
)
"""Name of a set -> its paths."""
