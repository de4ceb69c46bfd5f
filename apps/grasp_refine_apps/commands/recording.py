"""Options for recordings of simulations: replays, models that open in a plain MuJoCo, films."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.grasps.formats.folders import UNUSUAL, disambiguate
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.replay.export import export_xml
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.replay.replay import Replay, save_replay
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import Trials
from grasp_refine_apps.commands.option_rules import OptionGroup

MAX_RECORDED = 20
"""Maximum number of grasps recorded at once: each takes some megabytes."""


@dataclass(frozen=True)
class Recording:
    """Recordings of a simulation, to look at."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("recording"),)

    replays: Annotated[DisallowNone[Path | None], arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """Record each grasp in its worst direction into this folder: .npz with all joint values over time, .xml that opens
    in MuJoCo 3.3 and later; with several FILEs, each into its own subfolder. At most 20 grasps: choose them with
    --index."""
    direction: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the worst)")] = None
    """Record this direction: +x, -x, +y, -y, +z, -z; with a protocol that lifts, lift."""
    film: bool = False
    """Write a short film (.gif) beside each replay, which takes some ten seconds."""

    def check(
        self, protocol: Protocol | None, files: Sequence[Path], problems: Sequence[Problem], *, overwrite: bool
    ) -> None:
        """Refuse recordings that cannot be made.

        Args:
            protocol: Protocol of the simulation; None: grasps are not simulated.
            files: Grasp files.
            problems: Grasps of each file.
            overwrite: Whether existing files may be replaced.

        Raises:
            GraspRefineError: names the option or file.
        """
        if self.replays is None:
            if self.film or self.direction is not None:
                raise GraspRefineError("--film and --direction are for --replays DIR")
            return
        if protocol is None:
            raise GraspRefineError("--replays needs the simulation: leave out --no-simulate")
        names = protocol.directions or LIFT
        if self.direction is not None and self.direction not in names:
            raise GraspRefineError(f"--direction {self.direction}: there are {', '.join(names)}")
        count = sum(map(len, problems))
        if count > MAX_RECORDED:
            raise GraspRefineError(
                f"--replays records at most {MAX_RECORDED} grasps, here are {count}: choose with --index"
            )
        # The worst direction is known only after the simulation.
        directions = names if self.direction is None else (self.direction,)
        for folder, problem in zip(self.folders(files), problems, strict=True):
            for group, direction in product(problem.groups, directions):
                for number in group.index:
                    path = _path(folder, problem.hand.name, group, number, direction)
                    suffixes = (".npz", ".xml", *([".gif"] if self.film else []))
                    written = (path.with_suffix(suffix) for suffix in suffixes)
                    check_writable(*written, overwrite=overwrite, inside=self.replays)

    def folders(self, files: Sequence[Path]) -> tuple[Path, ...]:
        """Folder of the replays of each grasp file, all distinct; empty: nothing is recorded."""
        if self.replays is None:
            return ()
        if len(files) == 1:
            return (self.replays,)
        names = disambiguate(UNUSUAL.sub("_", path.stem) for path in files)
        return tuple(self.replays / name for name in names)

    def record(
        self, group: Group, world: World, motion: Motion, trials: Trials, hand: str, folder: Path
    ) -> Iterator[str]:
        """Record the grasps of a group; yield a message about each, also on failure.

        Args:
            group: Grasps.
            world: Simulated world.
            motion: Closing motion of the hand.
            trials: Results of the simulation.
            hand: Name of the hand.
            folder: One of `folders`.
        """
        for i, number in enumerate(group.index):
            direction = self.direction or trials.directions[trials.worst[i]]
            name = f"{group.object} {number}"
            replay = record(world, motion.select(np.array([i])), direction, name=name, hand=hand)
            if replay is None:
                yield f"{name}: nothing to record, the trial could not start"
                continue
            path = _path(folder, hand, group, number, direction)
            yield f"{name}: {direction} {replay.reason}, {self._save(replay, world, path)}"

    def _save(self, replay: Replay, world: World, path: Path) -> str:
        """Write all files of a replay, the most important one first; return a message on the files."""
        try:
            save_replay(path, replay)
        except GraspRefineError as error:
            return f"not recorded: {error}"
        message = f"recorded in {path}"
        try:
            export_xml(world.spec, world.model, replay, path.with_suffix(".xml"))
            message += ", .xml"
        except GraspRefineError as error:
            message += f"; no XML: {error}"
        if self.film:
            from grasp_refine_apps.report.film import film

            try:
                film(world.model, replay, path.with_suffix(".gif"))
                message += ", .gif"
            except GraspRefineError as error:
                message += f"; no film: {error}"
        return message


def _path(folder: Path, hand: str, group: Group, number: int, direction: str) -> Path:
    """Path of the replay of a grasp; paths of one call differ in grasp, object, size or folder."""
    # An object in another size counts as another object.
    name = group.object if group.scale == 1 else f"{group.object}_x{group.scale:g}"
    return folder / f"{UNUSUAL.sub('_', f'{hand}_{name}_{number}_{direction}')}.npz"
