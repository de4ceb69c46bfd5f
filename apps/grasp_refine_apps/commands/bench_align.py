"""`refine-grasp bench align`: accuracy and speed of witness derivatives that bring two bodies into contact."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.witness.slip import Coupling
from grasp_refine_apps.bench.align.bodies import Kind
from grasp_refine_apps.bench.align.presets import EPSILON, PRESETS
from grasp_refine_apps.bench.align.study import AlignStudy
from grasp_refine_apps.bench.align.variants import MethodName, SolverName, Variant, WitnessName
from grasp_refine_apps.bench.derivatives import NeighborhoodName
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.options import check_device, default
from grasp_refine_apps.report.command_line import flag

Class = Literal["vertex-vertex", "face-vertex", "vertex-face", "face-face"]
PresetName = Literal[
    "table1", "table2", "table3", "table4", "margin", "step-size", "coupling", "solvers", "patch", "smoke"
]

VARIED = ("methods", "neighborhoods", "couplings", "transport", "optimise", "step_sizes")
"""Options that vary descent."""
DESCENT_ONLY = (*VARIED, "dtype", "device")
"""Options that only descent reads."""


@dataclass(frozen=True)
class BenchAlign(BenchCommand):
    """Measure run time against error on the alignment task of arXiv 2511.06267.

    Two random bodies, a target contact point on each: body 2 moves by normalised gradient descent, or by
    Levenberg-Marquardt, until the witness points lie on the targets. The error of a task is
    |x_a - t_a|^2 + |x_b - t_b|^2 + (d - margin)^2 in m^2, so that 1e-6 is about a millimetre. Every combination of
    the options is run on the same tasks. Without options, the paper's derivative runs on the embedded objects.
    """

    command = "bench align"
    compared = ("solvers", *VARIED, "margins", "witnesses", "epsilon")

    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment of the paper, or our own: table1 (all methods), table2 (smoothing x sampling x gradients),
    table3 (time of a query by method), table4 (time of a backward pass), margin, step-size, coupling, solvers
    (descent, closed form, and levenberg-marquardt without and with it), patch (plain against patch witness points,
    targets on two faces), smoke (under a minute)."""
    meshes: Annotated[DisallowNone[Path | None], default("embedded", metavar="DIR")] = None
    """Folder of meshes from which pairs are drawn."""
    kinds: tuple[Kind, ...] = ("convex", "concave")
    """convex: hulls of the meshes; concave: their CoACD pieces (cached)."""
    pairs: Annotated[DisallowNone[int | None], default("8, or the preset's")] = None
    """Number of pairs of bodies of each kind."""
    targets: Annotated[DisallowNone[int | None], default("64, or the preset's")] = None
    """Number of accepted targets of each pair. zeroth-order and finite-difference run an eighth of them."""
    classes: Annotated[DisallowNone[tuple[Class, ...] | None], default("all but face-face")] = None
    """Features of body 1 and body 2 on which the targets lie. Face-face targets are counted separately."""
    solvers: Annotated[DisallowNone[tuple[SolverName, ...] | None], default("descent")] = None
    """Solver: normalised gradient descent, the paper's in short runs, or levenberg-marquardt, which ends each task
    when its error is below 1e-14 m^2. The latter differentiates by contact kinematics over neighbourhoods of its own,
    moves body 2 and runs in double precision on the CPU; a budget is the maximum number of iterations, each one query,
    of a task. closed-form places body 2 once, with opposite normals at the targets, without a derivative or an
    iteration. closed-form-first is levenberg-marquardt; a stalled task restarts from that pose first."""
    methods: Annotated[DisallowNone[tuple[MethodName, ...] | None], default("distance")] = None
    """Derivative of the witness points in descent."""
    neighborhoods: Annotated[DisallowNone[tuple[NeighborhoodName, ...] | None], default("adaptive")] = None
    """Samples used for smoothing."""
    couplings: Annotated[DisallowNone[tuple[Coupling, ...] | None], default("one-sided")] = None
    """Coupling of the slips of both bodies; one-sided: the paper's equations."""
    transport: Annotated[DisallowNone[bool | None], default("on")] = None
    """Equivalent gradient transport: the gradient of body 1 acts through body 2."""
    optimise: Annotated[DisallowNone[Literal["T2", "T1T2"] | None], default("T2")] = None
    """Bodies that move."""
    margins: Annotated[DisallowNone[tuple[float, ...] | None], default("0.001")] = None
    """Contact margins in metres."""
    step_sizes: Annotated[DisallowNone[tuple[float, ...] | None], default("10")] = None
    """Sizes s_r of the first steps; s_t = s_r / 1000."""
    witnesses: Annotated[DisallowNone[tuple[WitnessName, ...] | None], default("plain")] = None
    """Witness points of the solver: plain, or patch, for targets on two faces. Patch takes the points nearest to the
    targets among all points within epsilon of the closest. With it, all rows are evaluated by both."""
    epsilon: Annotated[DisallowNone[float | None], default(f"{EPSILON:g} with patch", metavar="METRES")] = None
    """Epsilon of the patch witness in metres."""
    budgets: Annotated[DisallowNone[tuple[int, ...] | None], default("2000, or the preset's")] = None
    """Budgets in iterations; several give a line in the plot of error against time."""
    seconds: Annotated[DisallowNone[tuple[float, ...] | None], default("none")] = None
    """Budgets in CPU seconds per pair, all its targets together, instead of iterations; for descent only."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of poses and losses of descent; queries and derivatives always run in double precision."""
    device: str = "cpu"
    """Torch device of poses and losses of descent."""
    threads: int = 1
    """Threads of torch in each process; more than one is slower for matrices this small."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> AlignStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: a number out of its range, or options that do not go together.
        """
        for name in ("seconds", "epsilon"):
            value = getattr(self, name)
            if 0.0 in (value if isinstance(value, tuple) else (value,)):
                raise GraspRefineError(f"{flag(name)} must be positive, got 0")
        if self.budgets is not None and self.seconds is not None:
            raise GraspRefineError(
                "--budgets and --seconds exclude each other: a budget is in iterations or in CPU seconds"
            )
        study = PRESETS[self.preset] if self.preset is not None else AlignStudy(self._variants())
        check_device(self.device, self.dtype)
        if self.seconds is not None and any(variant.solver != "descent" for variant in study.variants):
            raise GraspRefineError(
                "--seconds is for descent only: levenberg-marquardt ends each task on its own, so give --budgets"
            )
        return replace(study, **self.given(AlignStudy))

    def _variants(self) -> tuple[Variant, ...]:
        """Return every combination of the compared options; options that a method ignores are not varied."""
        solvers, witnesses = self.solvers or ("descent",), self.witnesses or ("plain",)
        if "descent" not in solvers:
            for name in DESCENT_ONLY:
                if getattr(self, name) != getattr(BenchAlign, name):
                    raise GraspRefineError(
                        f"{flag(name)} is for descent only: leave it out, or add descent to --solvers"
                    )
        if self.epsilon is not None and "patch" not in witnesses:
            raise GraspRefineError("--epsilon is for the patch witness only: leave it out, or give --witnesses patch")
        made = [
            Variant(
                method,
                near,
                coupling,
                transport=Variant.transport if self.transport is None else self.transport,
                optimise=self.optimise or Variant.optimise,
                margin=margin,
                step_size=size,
            )
            for method, near, coupling, margin, size in product(
                self.methods or ("distance",),
                self.neighborhoods or ("adaptive",),
                self.couplings or ("one-sided",),
                self.margins or (Variant.margin,),
                self.step_sizes or (Variant.step_size,),
            )
        ]
        margins = self.margins or (Variant.margin,)
        by_solver: dict[SolverName, list[Variant]] = {
            "descent": made,
            "closed-form": [Variant.closed_form(margin=m) for m in margins],
            "levenberg-marquardt": [Variant.least_squares(margin=m) for m in margins],
            "closed-form-first": [Variant.least_squares(margin=m, with_closed_form=True) for m in margins],
        }
        epsilon = (EPSILON if self.epsilon is None else self.epsilon) if "patch" in witnesses else None
        made = [
            # The closed form takes no witness points.
            replace(variant, witness="plain" if solver == "closed-form" else witness, epsilon=epsilon)
            for solver, witness in product(solvers, witnesses)
            for variant in by_solver[solver]
        ]
        distinct = {tuple(variant.columns().values()): variant for variant in reversed(made)}
        return tuple(reversed(distinct.values()))
