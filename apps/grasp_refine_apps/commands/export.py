"""`refine-grasp export`: write grasps for the programs that use them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from grasp_refine.core.plurals import count_text
from grasp_refine.export.targets import export, target
from grasp_refine.problem.exports import of_file
from grasp_refine.problem.load import Loader
from grasp_refine.problem.problem import StageSource
from grasp_refine_apps.commands.inputs import Sources
from grasp_refine_apps.report.progress import Reporter
from grasp_refine_apps.report.screen import screen

TargetName = Literal["mjcf", "sapien", "drake", "usd", "isaac_grasp", "ros2", "lerobot", "csv", "parquet"]
"""Names of the targets, as in `export.targets`."""


@dataclass(frozen=True)
class Export:
    """Write grasps for the programs that use them: a new folder that they take unedited, with a README.

    mjcf: a MuJoCo scene with key frames, and a script that simulates the grasps. sapien, drake: URDFs of hand and
    object in convex pieces, with such a script. usd: a stage with hand, drives, object and grasps, for Isaac Sim, Isaac
    Lab and Newton. isaac_grasp: the file of Isaac Sim's grasp editor. ros2: messages of MoveIt and of joint trajectory
    controllers. lerobot: a LeRobot data set, an episode a grasp. csv, parquet: tables of grasps, joints by name, and of
    contacts with their forces. Takes any grasp file; pregrasps and squeezes that it lacks are made.
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """Grasp file or folder, such as the result of `run`."""
    to: TargetName
    """Program or format."""
    out: Annotated[Path, arg(metavar="FOLDER")]
    """New folder; grasps on several objects get one inside for each."""
    closing: StageSource = "auto"
    """Pregrasps and squeezes: from the file, generated, or auto: from the file if it has them, else generated."""
    sources: Annotated[Sources, arg(name="")] = field(default_factory=Sources)

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        began = time.perf_counter()
        made = target(self.to)
        named = self.sources.with_named_task()
        named.check_task()
        with Reporter(screen(stderr=True)) as reporter:
            loader = Loader(named.of(self.file), 0, reporter.say)
            problem = loader.prepare(loader.problem())
            for note in problem.notes:
                reporter.note(note)
            parts = of_file(problem, self.closing)
            folders = export(parts, self.to, self.out, progress=lambda name: reporter.say(f"writing {name}"))
        console, count = screen(), sum(map(len, parts))
        for folder in folders:
            console.print(f"{folder}: see README.md there", soft_wrap=True, markup=False)
        console.print(
            f"{count_text(count, 'grasp')} for {self.to}: {made.what}; {time.perf_counter() - began:.1f} s",
            soft_wrap=True,
            markup=False,
        )
        return 0
