"""Live simulation of one grasp whose object the user pulls."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from math import degrees

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.replay.live_pull import LivePull, Pull
from grasp_refine.validation.simulation import close
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.viewer.jobs.replaying import MAX_DISPLACEMENT_M, replay_recording
from grasp_refine_apps.viewer.jobs.validating import PREPARING, MakeWorld, PosedGrasp, trial_observer
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.recording import Recording

FRAME_S = 1.0 / 25.0
"""Seconds between two shown frames."""

MAX_SECONDS, LOST_SECONDS = 120.0, 1.5
"""Seconds of simulation after which a pull ends, and after the object is lost."""

SHOWN_PULL_N = 0.02
"""Least force in newtons that is drawn."""


def pull_live(
    make_world: MakeWorld,
    grasp: PosedGrasp,
    protocol: Protocol,
    control: Control,
    pulled: Callable[[], Pull],
    show: Callable[[Recording], bool],
) -> None:
    """Close the hand of one grasp as its trial does, and simulate it in real time until it is lost or time is up.

    Args:
        make_world: Function of `world_cache`.
        grasp: The grasp.
        protocol: Protocol of the simulation.
        control: Receives the progress, and can stop the simulation.
        pulled: Returns the present pull.
        show: Shows the newest frame; returns whether to go on.

    Raises:
        GraspRefineError: the hand cannot close on the object, or MuJoCo cannot make the world.
        Stopped: the job was stopped.
    """
    control.report(0.0, PREPARING)
    control.check()
    world = make_world(grasp.scene, protocol)
    motion, _ = grasp.motion(control.check)
    closed = close(world, motion, Conditions.nominal(world, 1), on_step=trial_observer(world.protocol, "", control))
    if closed.reason[0] != Reason.HELD:
        raise GraspRefineError(f"nothing to pull: {Reason(int(closed.reason[0])).label}")
    control.describe("simulating: drag the object, or set a force")
    live, lost_at = LivePull(world, closed), np.inf
    while live.time < min(MAX_SECONDS, lost_at + LOST_SECONDS) and not live.diverged:
        began = time.monotonic()
        control.check()
        pull = pulled()
        live.advance(FRAME_S, pull)
        if live.reason != Reason.HELD:
            lost_at = min(lost_at, live.time)
        if live.moved_m > MAX_DISPLACEMENT_M or not show(_frame(grasp.scene.hand, live, pull)):
            return
        time.sleep(max(FRAME_S - (time.monotonic() - began), 0.0))


def pull_text(live: LivePull) -> str:
    """Return force, movement and verdict in one line."""
    verdict = f"held so far, up to {live.strongest_n:.1f} N"
    if live.reason != Reason.HELD:
        verdict = f"lost ({live.reason.label}); it was held up to {live.strongest_n:.1f} N"
    return (
        f"pulled with {np.linalg.norm(live.force):.1f} N: the object has moved {1e3 * live.moved_m:.1f} mm and turned "
        f"{degrees(live.turned_rad):.1f}°; {verdict}"
    )


def _frame(hand: Hand, live: LivePull, pull: Pull) -> Recording:
    """Return the present frame."""
    both = replay_recording(hand, live.world.hand, live.replay("live pull", hand.name), live.world.model)
    assert both.T_object is not None
    lost = live.reason != Reason.HELD
    return replace(
        both,
        title="live pull",
        T_root=both.T_root[-1:],
        q=both.q[-1:],
        time=both.time[-1:],
        texts=(pull_text(live),),
        T_object=both.T_object[-1:],
        T_bodies={name: T[-1:] for name, T in both.T_bodies.items()},
        contacts=both.contacts[-1:],
        lost=np.array([lost]),
        pushed=np.array([np.linalg.norm(live.force) > SHOWN_PULL_N]),
        pulled=None if np.any(pull.force) else pull.point,
        succeeds=not lost,
        live=True,
    )
