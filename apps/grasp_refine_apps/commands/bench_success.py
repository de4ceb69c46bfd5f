"""`refine-grasp bench success`: share of input and refined grasps that hold in simulation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.spec import AUTO, ProblemSpec
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.validation.engine_table import MUJOCO, EngineName, check_engine
from grasp_refine_apps.bench.success.cases import Axes
from grasp_refine_apps.bench.success.measure import MethodName
from grasp_refine_apps.bench.success.study import PRESETS, SuccessStudy, completed
from grasp_refine_apps.bench.success.trials import Trial
from grasp_refine_apps.commands.benchmark import BenchCommand, Outputs
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.options import default

PresetName = Literal["smoke", "grippers", "scenes", "assets"]

PRESET = "the preset's"
Names = DisallowNone[tuple[str, ...] | None]
Count = Annotated[DisallowNone[int | None], default(PRESET)]
Switch = Annotated[DisallowNone[bool | None], default(PRESET)]


@dataclass(frozen=True)
class BenchSuccess(BenchCommand):
    """Measure how many input and refined grasps hold in simulation, and the CPU time of refinement.

    Without axes, all methods run on the grasps of --grasps: by default the example grasps of the embedded hand on the
    embedded mug. With --hands, --on or --scenes, grasps are sampled for each combination. With --assets, grasps are
    sampled for each hand of the folder and of the program on each object; grasps of generators are taken with their own
    hand. All other options of inputs apply to every case.
    """

    command = "bench success"

    inputs: Annotated[Inputs, arg(name="")] = field(default_factory=Inputs)
    preset: Annotated[DisallowNone[PresetName | None], default("none")] = None
    """An experiment; other options replace its settings: smoke (every method on two grasps, in seconds), grippers
    (each grasp also moved by 5 mm and rotated by 10 degrees; frictions of 0.6 and 0.3, with several points for two
    convex pieces that touch and with one), scenes (hands on an arm in scenes: reachable, with a free trajectory, held
    and lifted; also refined without the scene), assets (all hands, objects and generators of --assets under all
    protocols)."""
    assets: Annotated[DisallowNone[Path | None], default("none", metavar="DIR")] = None
    """Folder with hands/NAME/*.urdf, hands/NAME_mjcf/*.xml, objects/NAME.obj, objects.csv (name, suggested_scale, diag,
    convexity) and grasps/normalised/*.npz."""
    hands: Annotated[Names, default("--hand, or all of --assets", metavar="HAND [...]")] = None
    """Hands, as for `run --hand`; with --assets also NAME_mjcf/MODEL and embedded/NAME."""
    on: Annotated[Names, default("--object, or all of --assets", metavar="OBJECT [...]")] = None
    """Objects, as for `run --object`; with --assets names in objects.csv."""
    scenes: Annotated[Names, default("none; with --preset scenes all of the program", metavar="SCENE [...]")] = None
    """Scenes, as for `run --scene`, whose objects are grasped."""
    stand: Annotated[DisallowNone[str | None], default(Axes.stand, metavar="POSE")] = None
    """Pose of the base of --arm from the origin of each scene's object, along the axes of the world, unless --base is
    given: x,y,z,roll,pitch,yaw (metres, degrees)."""
    generators: Annotated[Names, default("all of --assets", metavar="NAME [...]")] = None
    """Sources of grasps with --assets: sampled, and names of grasp files; NAME:N takes N grasps, evenly from its
    file."""
    count: Count = None
    """Number of sampled grasps of each hand on each object; with a grasp file, the first grasps of each object at
    each scale, at most this number."""
    generated: Count = None
    """Maximum number of grasps of each generator on each object, taken evenly from its file."""
    every: Count = None
    """Sample grasps of each hand on only every n-th object of --assets, different hands on different objects: 1/n of
    the time."""
    methods: Annotated[
        DisallowNone[tuple[MethodName, ...] | None],
        default("as-given own-stages geometry-only closest, or the preset's"),
    ] = None
    """Methods to compare: input as given, with our own pregrasps and squeezes, refined by geometry only, and refined
    for force balance by what is preferred (`run --prefer`); the first is the reference."""
    starts: Annotated[DisallowNone[tuple[int, ...] | None], default("1 6, or the preset's")] = None
    """Numbers of starts of the search for grasps that may not hold; each number is a separate run."""
    protocols: Annotated[Names, default("dexgraspbench strict, or the preset's", metavar="NAME|FILE.toml [...]")] = None
    """Protocols of the simulation: names that `refine-grasp validate --help` lists, or TOML files."""
    engines: Annotated[DisallowNone[tuple[EngineName, ...] | None], default(MUJOCO)] = None
    """Engines of the simulation. With several, every grasp is simulated in each, and a table shows how far each two
    agree. Each needs its extra, and all but mujoco take several times as long."""
    perturb: Switch = None
    """Simulate each grasp once more, moved by 5 mm and rotated by 10 degrees about the middle of the fingers, at
    random."""
    shrink: Switch = None
    """Scale objects on which no grasp is found by 0.8, repeatedly, down to 0.4."""
    unaware: Switch = None
    """Sample and refine once more without the scene, and simulate in it."""
    width: Count = None
    """Maximum number of grasps refined at once."""
    threads: Annotated[DisallowNone[int | None], default("all")] = None
    """CPU threads of the simulation; refinement uses one."""
    out: Annotated[DisallowNone[Path | None], default("none", metavar="DIR")] = None
    """Folder of results: the same command continues after an interruption, and other protocols, hands or objects add to
    it. The report then shows pictures of failures."""
    outputs: Annotated[Outputs, arg(name="")] = field(default_factory=Outputs)

    def study(self) -> SuccessStudy:
        """Return the study that the options define.

        Raises:
            GraspRefineError: targets, which the study does not use, or no such protocol or engine.
        """
        if self.inputs.targets != AUTO:
            raise GraspRefineError("--targets: the benchmark refines grasps without targets")
        preset = SuccessStudy() if self.preset is None else PRESETS[self.preset]
        inputs = {name: getattr(self.inputs, name) for name in ProblemSpec.__dataclass_fields__}
        own = {name: value for name, value in inputs.items() if value != getattr(ProblemSpec, name)}
        axes = replace(preset.axes, **{**self.given(Axes), "spec": replace(preset.axes.spec, **own)})
        settings = {name: value for name, value in self.given(SuccessStudy).items() if name != "axes"}
        if self.protocols is not None or self.engines is not None:
            settings["trials"] = self._trials(preset)
        return completed(replace(preset, axes=axes, **settings))

    def _trials(self, preset: SuccessStudy) -> tuple[Trial, ...]:
        """Return each protocol in each engine.

        Raises:
            GraspRefineError: there is no such protocol or engine, or two protocols have one name.
        """
        protocols = [trial.protocol for trial in preset.trials if isinstance(trial, Trial)]
        if self.protocols is not None:
            protocols = [load_protocol(name) for name in dict.fromkeys(self.protocols)]
        names = [protocol.name for protocol in protocols]
        if len(set(names)) < len(names) and self.protocols is not None:
            raise GraspRefineError(f"--protocols: two of them have one name: {', '.join(names)}")
        engines = tuple(dict.fromkeys(self.engines or (MUJOCO,)))
        for engine in engines:
            check_engine(engine)
        return tuple(Trial(protocol, engine) for protocol, engine in product(protocols, engines))
