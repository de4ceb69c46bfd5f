"""`refine-grasp bench grasp`: accuracy and speed of the refinement of grasps, by solver and batch size."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import list_hands, needs_urdf
from grasp_refine.problem.example import EXAMPLE_HAND
from grasp_refine.problem.spec import AUTO, SAMPLE
from grasp_refine.refinement.config import Config
from grasp_refine_apps.bench.grasp.presets import BATCHES, EVERY_HAND, PLACES, PRESETS
from grasp_refine_apps.bench.grasp.study import COUNT, GraspStudy
from grasp_refine_apps.bench.grasp.tasks import Disturbance
from grasp_refine_apps.bench.grasp.variants import DerivativeName, Kind, SolverName, Variant
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["targets", "nothing", "time-to-error", "contacts", "pieces", "workers", "smoke"]
SetName = Literal[
    "bodex_shadow", "dexgraspnet_shadow", "frogger_allegro", "leap_cube", "sampled_barrett", "sampled_robotiq"
]


@dataclass(frozen=True)
class BenchGrasp(BenchCommand):
    """Measure accuracy and speed of the refinement of grasps, by solver, batch size and budget.

    Accuracies and penetrations come from a plain query of the final grasps, not from the solver. Without options,
    Levenberg-Marquardt runs on the embedded Allegro examples.
    """

    command = "bench grasp"
    compared = ("tasks", "solvers", "derivatives", "budgets")

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment: targets (disturbed true grasps, batch 1 to 256), nothing (real grasps as input, batch 1 to
    256), time-to-error (all solvers at several budgets, for a plot of error over time), contacts (time by number of
    contacts, and of joints: all hands), pieces (by number of convex pieces: a box in 1 to 64), workers (grasps
    per second with 1 and 2 processes), smoke (under a minute)."""
    assets: Annotated[DisallowNone[Path | None], default("none", metavar="DIR")] = None
    """Folder with hands/, objects/ and grasps/normalised/, from which --sets chooses, instead of --hand, --object and
    --grasps. By default, the embedded Allegro examples."""
    sets: Annotated[DisallowNone[tuple[SetName, ...] | None], default("all; sampled: of contacts only")] = None
    """Sets of grasps in the folder of assets; grasps of sampled sets are drawn."""
    tasks: Annotated[DisallowNone[tuple[Kind, ...] | None], default("both")] = None
    """targets: true grasps, whose fingertips all touch, are disturbed and must return to their contact points; nothing:
    real grasps, as input, should touch and not penetrate."""
    solvers: Annotated[DisallowNone[tuple[SolverName, ...] | None], default("levenberg-marquardt")] = None
    """Solvers."""
    derivatives: Annotated[DisallowNone[tuple[DerivativeName, ...] | None], default("contact-kinematics")] = None
    """Derivatives of the witness points in descent and adam."""
    budgets: Annotated[DisallowNone[tuple[int, ...] | None], default("the solver's")] = None
    """Maximum iterations of a grasp; each budget is a separate run, a point in the plot of error over time."""
    batches: Annotated[DisallowNone[tuple[int, ...] | None], default("1 16 64 256, or the preset's")] = None
    """Batch sizes; with 1, each grasp is a separate call. Times are means."""
    count: Annotated[DisallowNone[int | None], default(f"{COUNT} with targets, else all; or the preset's")] = None
    """Number of tasks on each object at each scale."""
    scenes: Annotated[DisallowNone[int | None], default("all, or the preset's")] = None
    """Number of objects at one scale of each set, evenly chosen."""
    singles: Annotated[DisallowNone[int | None], default("32, or the preset's")] = None
    """Number of tasks of a set that are run at batch 1, about evenly from all objects."""
    shift: float = Disturbance.translation
    """Disturbance: translation of the root in a random direction, metres."""
    turn: Annotated[float, default("0.2618 (15 degrees)")] = Disturbance.rotation
    """Disturbance: rotation of the root about a random axis, radians."""
    noise: float = Disturbance.joints
    """Disturbance: standard deviation of the joint values, radians, clipped to the limits."""
    tolerance: float = Config.tolerance
    """Loss below which a grasp is converged, m^2."""
    threads: int = 1
    """Threads of torch in each process."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> GraspStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: a number out of its range, or options that do not go together.
        """
        if self.inputs.targets != AUTO:
            raise GraspRefineError("--targets: the benchmark makes its own targets, from grasps that touch exactly")
        study = PRESETS[self.preset] if self.preset is not None else GraspStudy(self._variants())
        variants = study.variants
        if self.outputs.workers > 1 and any(variant.processes is not None for variant in variants):
            raise GraspRefineError(f"--preset {self.preset} has processes of its own: leave out --workers")
        if self.batches is not None:
            variants = tuple(replace(variant, batch=batch) for variant in variants for batch in self.batches)
        return replace(
            study,
            variants=tuple(dict.fromkeys(variants)),
            sources=self._sources(),
            disturbance=Disturbance(self.shift, self.turn, self.noise),
            **self.given(GraspStudy),
        )

    def _variants(self) -> tuple[Variant, ...]:
        """Return every combination of the compared options; Levenberg-Marquardt has no choice of derivatives."""
        solvers = self.solvers or (Variant.solver,)
        if self.derivatives is not None and set(solvers) == {"levenberg-marquardt"}:
            raise GraspRefineError("--derivatives is for descent and adam only: leave it out, or add one to --solvers")
        usual = (Variant.derivative,)
        return tuple(
            Variant(solver, derivative, budget, batch)
            for solver in solvers
            for derivative, budget, batch in product(
                usual if solver == "levenberg-marquardt" else self.derivatives or usual,
                self.budgets or (None,),
                self.batches or BATCHES,
            )
        )

    def _sources(self) -> tuple[tuple[str, tuple[Inputs, ...]], ...]:
        """Return the names of the sets, each with its inputs."""
        inputs = self.inputs
        hand = inputs.hand or EXAMPLE_HAND
        plain = replace(inputs, threshold=Inputs.threshold) == Inputs()
        if self.assets is None:
            if self.sets is not None:
                raise GraspRefineError("--sets name sets in a folder of assets: give it with --assets")
            if not plain:
                return ((inputs.grasps.stem if inputs.grasps is not None else f"{hand} example", (inputs,)),)
            hands = [hand]
            if self.preset in EVERY_HAND:
                hands = [name for name in list_hands() if not needs_urdf(name)]
            return tuple(
                (f"{name} examples", tuple(replace(inputs, hand=name, grasps=path) for path in _examples(name)))
                for name in hands
            )
        if not plain:
            raise GraspRefineError(
                "--assets has hands, objects and grasps of its own: leave it out, or else --hand, --object, --objects, "
                "--object-name, --scale, --grasps and --index"
            )
        folder, found = self.assets, []
        sampled = self.preset in EVERY_HAND
        usual = tuple(name for name, place in PLACES.items() if sampled or place.sampled is None)
        for name in dict.fromkeys(self.sets or usual):
            path, place = folder / "grasps" / "normalised" / f"{name}.npz", PLACES[name]
            if place.sampled is not None:
                path = Path(f"{SAMPLE}{place.sampled}")
            elif not path.is_file():
                raise GraspRefineError(f"--assets {folder}: has no set {name}, that is grasps/normalised/{name}.npz")
            objects = folder / "objects" if place.object is None else None
            one = replace(inputs, hand=str(folder / place.hand), object=place.object, objects=objects, grasps=path)
            found.append((name, (one,)))
        return tuple(found)


def _examples(hand: str) -> list[Path]:
    """Example grasps of a hand that ships with the program."""
    return sorted((resource_dir("robots") / hand).glob("*.npz"))
