"""`refine-grasp transfer`: grasps of one hand become grasps of another, refined, with their fidelity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import DisallowNone, Positional, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.commands.inputs import HAND, OBJECT, OF_FILES, TASK, Inputs
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.run import Output, OutputWithTrajectory, Run
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.simulation_options import ValidationOptions


@dataclass(frozen=True)
class Given(Inputs):
    """Grasps of one hand, another hand, and the object."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup("grasps", "The grasps, and the hand that they are of.", ("grasps", "transfer_from", *OF_FILES)),
        OptionGroup(HAND.title, HAND.about, tuple(name for name in HAND.names if name != "transfer_from")),
        OBJECT,
        TASK,
    )
    metavars: ClassVar[Mapping[str, str]] = {**Inputs.metavars, "grasps": "FILE"}

    grasps: Positional[Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="")]] = None
    """Grasp file, or a folder of them: ours (.npz), or of another program (see --format)."""
    transfer_from: Annotated[DisallowNone[str | None], arg(name="from", metavar="HAND", help_behavior_hint="")] = None
    """Hand of the grasp file, named like --hand."""


@dataclass(frozen=True)
class Transfer:
    """Transfer grasps of one hand to another, and refine them.

    `refine-grasp transfer grasps.npz --from shadow --hand allegro`. The thumb takes the place of the thumb, and the
    other fingers their order from its side on, found by the geometry of both hands; they touch the object where
    those fingers do, and the palm comes from the same side. Then the grasps are refined, so that they touch and hold.
    The table has the distances of contacts from the originals', and what is no longer the same grasp.
    """

    inputs: Annotated[Given, arg(name="")] = field(default_factory=Given)
    settings: Annotated[Settings, arg(name="")] = field(default_factory=Settings)
    validation: Annotated[ValidationOptions, arg(name="")] = field(default_factory=ValidationOptions)
    output: Annotated[Output, arg(name="")] = field(default_factory=Output)

    def execute(self) -> int:
        """Run the command and return its exit code.

        Raises:
            GraspRefineError: an input that cannot be used; then nothing is written.
        """
        inputs = self.inputs
        needed = {"the grasp file": inputs.grasps, "--from HAND": inputs.transfer_from, "--hand HAND": inputs.hand}
        if missing := [name for name, value in needed.items() if value is None]:
            raise GraspRefineError(
                f"a transfer needs {' and '.join(missing)}, as in refine-grasp transfer grasps.npz --from shadow "
                "--hand allegro"
            )
        plain = Inputs(**{one.name: getattr(inputs, one.name) for one in fields(Inputs)})
        output = OutputWithTrajectory(**{one.name: getattr(self.output, one.name) for one in fields(Output)})
        return Run(plain, self.settings, self.validation, output).execute()
