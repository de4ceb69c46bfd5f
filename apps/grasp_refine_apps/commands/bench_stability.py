"""`refine-grasp bench stability`: error counts of witness queries and derivatives, by body, size and state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, get_args

from tyro.conf import DisallowNone, arg

from grasp_refine.collision.engine import chosen, engines
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.stability.cases import DType, Kind, Method, Neighborhood, State, Task
from grasp_refine_apps.bench.stability.cases import Engine as EngineName
from grasp_refine_apps.bench.stability.presets import PRESETS, Part
from grasp_refine_apps.bench.stability.rows import Measure
from grasp_refine_apps.bench.stability.study import StabilityStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["full", "quick", "smoke"]


@dataclass(frozen=True)
class BenchStability(BenchCommand):
    """Count wrong distances, witness points and derivatives of bodies of all kinds and sizes, in all states.

    Each distance is compared with an independent reference, and is wrong beyond 1e-8 of the diagonal + 1e-12 m +
    1e-15 of the distance from the origin. The preset selects the queries, and each other option
    replaces its part. Exit code 1: an answer is wrong.
    """

    command = "bench stability"

    preset: PresetName = "quick"
    """An experiment: full (more than a million queries, half an hour), quick (more than 20000, in half a minute),
    smoke (in seconds)."""
    kinds: Annotated[DisallowNone[tuple[Kind, ...] | None], default("the preset's")] = None
    """Bodies: ball, box, needle, plate (1e-4 thin), hull1000 (1000 vertices), concave40 (40 pieces), boxes with
    duplicate or near-duplicate vertices, slivers."""
    diagonals: Annotated[DisallowNone[tuple[float, ...] | None], default("the preset's", metavar="METRES")] = None
    """Diagonals of the larger body, metres."""
    states: Annotated[DisallowNone[tuple[State, ...] | None], default("the preset's")] = None
    """Relative placements of the bodies: far (1000 diagonals), near, gap-1e-3 to gap-1e-12 (in diagonals), gap-1um,
    gap-1nm, contact, two features against each other, shallow, deep, total (one in the other), concentric."""
    measures: Annotated[DisallowNone[tuple[Measure, ...] | None], default("both")] = None
    """forward: distances and witness points; derivative: motion of the points."""
    dtypes: Annotated[DisallowNone[tuple[DType, ...] | None], default("the preset's")] = None
    """Number types of poses. The first values of this and the next two options are combined; each other value is
    combined with the first of the others."""
    batches: Annotated[DisallowNone[tuple[int, ...] | None], default("the preset's")] = None
    """Number of poses in one call."""
    engines: Annotated[DisallowNone[tuple[EngineName, ...] | None], default("all there")] = None
    """Collision engines."""
    translations: Annotated[DisallowNone[tuple[float, ...] | None], default("the preset's", metavar="METRES")] = None
    """Distances of the bodies from the world origin in forward queries, metres."""
    methods: Annotated[DisallowNone[tuple[Method, ...] | None], default("the preset's")] = None
    """Derivatives of the witness points."""
    neighborhoods: Annotated[DisallowNone[tuple[Neighborhood, ...] | None], default("the preset's")] = None
    """Surface samples of the derivatives; only three of the methods use any."""
    queries: Annotated[DisallowNone[int | None], default("the preset's")] = None
    """Number of queries for each body, state, kind of call and translation."""
    differentiated: Annotated[DisallowNone[int | None], default("the preset's")] = None
    """Number of derivatives for each body, state and method."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> StabilityStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: as `tasks`.
        """
        return StabilityStudy(self.tasks(), self.outputs.seed, self.outputs.workers)

    def tasks(self) -> tuple[Task, ...]:
        """Return the tasks that the options define.

        Raises:
            GraspRefineError: a number out of its range, or an engine that is not available.
        """
        if self.diagonals is not None and min(self.diagonals) == 0:
            raise GraspRefineError("--diagonals must be above 0 metres, got 0")
        chosen_options = self.given(Part)
        names = tuple(chosen(name) for name in dict.fromkeys(self.engines or engines()))
        measures = chosen_options.pop("measures", get_args(Measure))
        parts = [
            replace(part, measures=both, **chosen_options)
            for part in PRESETS[self.preset]
            if (both := tuple(measure for measure in part.measures if measure in measures))
        ]
        return tuple(dict.fromkeys(task for part in parts for task in part.tasks(names, self.outputs.seed)))
