"""The options that record simulations, to be looked at: replays, models that open in any MuJoCo, films."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.grasps.formats.folders import UNUSUAL, disambiguate
from grasp_refine.pipeline.problem import Draft, Group, UncutGroup
from grasp_refine.validation.motion import Motion
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.replay.export import export_xml
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.replay.replay import Replay, save_replay
from grasp_refine.validation.simulation import LIFT
from grasp_refine.validation.trials import Trials
from grasp_refine.validation.world import World

MOST = 20
"""Most grasps that are recorded at once: each takes some megabytes."""


@dataclass(frozen=True)
class Recording:
    """What is recorded of a simulation."""

    replays: Annotated[DisallowNone[Path | None], arg(metavar="DIR", help_behavior_hint="(default: none)")] = None
    """Record each grasp in the direction that is worst for it into this folder: .npz with all joint values over
    time, .xml that opens in any MuJoCo; of several files, each into a folder of its own therein. At most 20 grasps:
    choose them with --index."""
    direction: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the worst)")] = None
    """Record this direction: +x, -x, +y, -y, +z, -z; with --setting tabletop, lift."""
    film: bool = False
    """Beside each replay, a short film (.gif); needs an offscreen OpenGL, MUJOCO_GL=egl or osmesa."""

    def check(
        self, protocol: Protocol | None, files: Sequence[Path], drafts: Sequence[Draft], *, overwrite: bool
    ) -> None:
        """Nothing, when it can be recorded what is asked for.

        Args:
            protocol: How grasps are simulated; None: not at all.
            files: The grasp files.
            drafts: The grasps of each.
            overwrite: Whether files that exist may be replaced.

        Raises:
            GraspRefineError: it cannot.
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
        count = sum(len(draft.names) for draft in drafts)
        if count > MOST:
            raise GraspRefineError(f"--replays records at most {MOST} grasps, here are {count}: choose with --index")
        # Which direction is the worst is known in the end.
        directions = names if self.direction is None else (self.direction,)
        for folder, draft in zip(self.folders(files), drafts, strict=True):
            for group, direction in product(draft.groups, directions):
                for number in group.index:
                    path = _path(folder, draft.hand.name, group, number, direction)
                    suffixes = (".npz", ".xml", *([".gif"] if self.film else []))
                    written = (path.with_suffix(suffix) for suffix in suffixes)
                    check_writable(*written, overwrite=overwrite, inside=self.replays)
        if self.film:
            from grasp_refine.validation.replay.render import check_renderer

            check_renderer()

    def folders(self, files: Sequence[Path]) -> tuple[Path, ...]:
        """For each grasp file the folder that its replays go to, none being another's; empty: nothing is recorded."""
        if self.replays is None:
            return ()
        if len(files) == 1:
            return (self.replays,)
        names = disambiguate(UNUSUAL.sub("_", path.stem) for path in files)
        return tuple(self.replays / name for name in names)

    def record(
        self, group: Group, world: World, motion: Motion, trials: Trials, hand: str, folder: Path
    ) -> Iterator[str]:
        """Record the grasps of a group; yields what to tell about each, also where something could not be written.

        Args:
            group: The grasps.
            world: In which they were simulated.
            motion: How the hand closed to them.
            trials: What became of them.
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
        """Write all files of a replay, the most important one first; returns which there are, and why others not."""
        try:
            save_replay(path, replay)
        except GraspRefineError as error:
            return f"not recorded: {error}"
        said = f"recorded in {path}"
        try:
            export_xml(world.spec, world.model, replay, path.with_suffix(".xml"))
            said += ", .xml"
        except GraspRefineError as error:
            said += f"; no XML: {error}"
        if self.film:
            from grasp_refine.validation.replay.render import film

            try:
                film(world.model, replay, path.with_suffix(".gif"))
                said += ", .gif"
            except GraspRefineError as error:
                said += f"; no film: {error}"
        return said


def _path(folder: Path, hand: str, group: Group | UncutGroup, number: int, direction: str) -> Path:
    """The replay of a grasp; those of one call differ in grasp, object, size or folder."""
    # An object in another size is another object to who looks at it.
    thing = group.object if group.scale == 1 else f"{group.object}_x{group.scale:g}"
    return folder / f"{UNUSUAL.sub('_', f'{hand}_{thing}_{number}_{direction}')}.npz"
