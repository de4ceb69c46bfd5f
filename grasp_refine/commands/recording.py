"""The options that record simulations, to be looked at: replays, models that open in any MuJoCo, films."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.commands.inputs import Group
from grasp_refine.errors import GraspRefineError
from grasp_refine.report.writing import check_writable
from grasp_refine.validation.export import export_xml
from grasp_refine.validation.motion import Motion
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.record import record
from grasp_refine.validation.replay import save_replay
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
    time, .xml that opens in any MuJoCo. At most 20 grasps: choose them with --index."""
    direction: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the worst)")] = None
    """Record this direction: +x, -x, +y, -y, +z, -z."""
    film: bool = False
    """Beside each replay, a short film (.gif); needs an offscreen OpenGL, MUJOCO_GL=egl or osmesa."""

    def check(self, protocol: Protocol | None, count: int) -> None:
        """Nothing, when it can be recorded what is asked for.

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
        if count > MOST:
            raise GraspRefineError(f"--replays records at most {MOST} grasps, here are {count}: choose with --index")
        check_writable(self.replays / "replay.npz")
        if self.film:
            from grasp_refine.validation.render import check_renderer

            check_renderer()

    def record(self, group: Group, world: World, motion: Motion, trials: Trials, hand: str) -> Iterator[str]:
        """Record the grasps of a group; yields what to tell about each."""
        if self.replays is None:
            return
        for i, number in enumerate(group.index):
            direction = self.direction or trials.directions[trials.worst[i]]
            name = f"{group.object} {number}"
            replay = record(world, motion.select(np.array([i])), direction, name=name, hand=hand)
            if replay is None:
                yield f"{name}: nothing to record, the trial could not start"
                continue
            # Objects of several scales share a name.
            stem = re.sub(r"[^\w.,=+-]+", "_", f"{hand}_{group.object}_{number}_{direction}")
            path = self.replays / f"{stem}.npz"
            save_replay(path, replay)
            export_xml(world.spec, world.model, replay, path.with_suffix(".xml"))
            if self.film:
                from grasp_refine.validation.render import film

                film(world.model, replay, path.with_suffix(".gif"))
            yield f"{name}: {direction} {replay.reason}, recorded in {path.with_suffix('')}.*"
