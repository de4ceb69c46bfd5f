"""`refine-grasp bench queries`: cost of a witness query, forward and backward, and savings by skipping."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.collision.engine import chosen, engines
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.bench.queries.cases import Kind, State, cases_of
from grasp_refine_apps.bench.queries.measure import Measurement, MethodName
from grasp_refine_apps.bench.queries.peers import PeerName
from grasp_refine_apps.bench.queries.presets import BATCHES, DEFAULT, MIXED, PRESETS
from grasp_refine_apps.bench.queries.study import QueryStudy
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["full", "skips", "smoke"]
EngineName = Literal["native", "python"]


@dataclass(frozen=True)
class BenchQueries(BenchCommand):
    """Measure the cost of a witness query, forward and backward, against coal and MuJoCo, and the work that skips save.

    A query finds the closest or deepest points of two bodies over all their convex pieces; its derivative gives the
    motion of these points with both bodies. Bodies and poses are generated. The peers, timed in the same run, query
    every pair of pieces. Without options: batches, vertices, pieces and states, one varied at a time, in a few minutes.
    """

    command = "bench queries"
    compared = ("kinds", "pieces", "vertices", "states", "batches")

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment: full (every combination, half an hour), skips (only skipped work), smoke (in seconds)."""
    kinds: Annotated[DisallowNone[tuple[Kind, ...] | None], default("all")] = None
    """convex: one piece against one; mixed: one against several, such as a link and an object; concave: several against
    several. With any of these five options, all combinations of their values are measured; skips need --skips."""
    pieces: Annotated[DisallowNone[tuple[int, ...] | None], default("16")] = None
    """Number of convex pieces of each body that is not convex."""
    vertices: Annotated[DisallowNone[tuple[int, ...] | None], default("32")] = None
    """Number of vertices of each piece."""
    states: Annotated[DisallowNone[tuple[State, ...] | None], default("near")] = None
    """far (200 mm apart), near (4 mm), touching, shallow (1 mm deep), deep (5 mm)."""
    batches: Annotated[DisallowNone[tuple[int, ...] | None], default("1 16 256 1024")] = None
    """Number of poses in one call."""
    engines: Annotated[DisallowNone[tuple[EngineName, ...] | None], default("all there")] = None
    """Collision engines; the others are compared with the first."""
    methods: tuple[MethodName, ...] = Measurement.methods
    """Derivatives of the witness points."""
    peers: tuple[PeerName, ...] = Measurement.peers
    """coal-fresh: coal.distance with new objects each time; coal-reused: coal.ComputeDistance with reused objects;
    mujoco: mj_geomDistance."""
    rounds: Annotated[DisallowNone[int | None], default("7, or the preset's")] = None
    """Number of timings of each query; their median counts."""
    skips: Annotated[DisallowNone[bool | None], default("yes, see --kinds")] = None
    """Refine example grasps, and count the work that the program skips."""
    hands: Annotated[DisallowNone[tuple[str, ...] | None], default("allegro shadow")] = None
    """Hands whose example grasps show the savings by skipping."""
    objects: Annotated[DisallowNone[tuple[str, ...] | None], default("mug rounded_box")] = None
    """Objects of these examples."""
    count: Annotated[DisallowNone[int | None], default("16, or the preset's")] = None
    """Number of grasps of each example: the example grasps, then disturbed copies."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> QueryStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: a number out of its range, options that do not go together, or an engine that is not
                available.
        """
        for name, values, least in (("pieces", self.pieces, 2), ("vertices", self.vertices, 4)):
            if values and min(values) < least:
                raise GraspRefineError(f"--{name} must be at least {least}, got {min(values)}")
        study = PRESETS[self.preset] if self.preset is not None else DEFAULT
        names = tuple(chosen(name) for name in dict.fromkeys(self.engines or engines()))
        measurement = replace(study.measurement, **{**self.given(Measurement), "engines": names})
        study = replace(study, measurement=measurement, **self.given(QueryStudy))
        custom = any(getattr(self, name) is not None for name in self.compared)
        if custom:
            cases = cases_of(
                self.kinds or ("convex", "mixed", "concave"),
                self.pieces or (MIXED.pieces,),
                self.vertices or (MIXED.vertices,),
                self.states or (MIXED.state,),
                self.batches or BATCHES,
            )
            study = replace(study, cases=cases)
        if custom if self.skips is None else not self.skips:
            if any(getattr(self, name) is not None for name in ("hands", "objects", "count")):
                raise GraspRefineError("--hands, --objects and --count are for skips: add --skips, or leave them out")
            if not study.cases:
                raise GraspRefineError("--preset skips --no-skips: nothing is left to measure")
            return replace(study, examples=())
        hands, objects = (
            tuple(dict.fromkeys(names or (both[side] for both in study.examples)))
            for side, names in enumerate((self.hands, self.objects))
        )
        return replace(study, examples=tuple(product(hands, objects)))
