"""Commands that simulate the shown grasp, and plan its trajectory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.validation.replay.live_pull import Pull
from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.planning import plan_trajectory
from grasp_refine_apps.viewer.jobs.pulling import pull_live
from grasp_refine_apps.viewer.jobs.store import Change, Store
from grasp_refine_apps.viewer.jobs.targets import Prepare
from grasp_refine_apps.viewer.jobs.validating import (
    MakeWorld,
    PosedGrasp,
    protocol_of,
    record_direction,
    run_trial,
)
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.model.work import now

NO_PULL = Pull(np.zeros(3))


class Simulation:
    """Simulation and trajectory of the shown grasp."""

    def __init__(
        self, store: Store, editor: Editor, background: Background, prepare: Prepare, make_world: MakeWorld
    ) -> None:
        """Simulate what the state shows."""
        self._store, self._editor, self._background = store, editor, background
        self._prepare, self._make_world = prepare, make_world
        self._pull = NO_PULL

    def test(self, *protocol_and_friction: Any) -> None:
        """Simulate the shown grasp in MuJoCo, by the chosen protocol or another one (name, friction)."""
        with self._store.lock:
            state = self._store.state
            protocol = self._store.checked(lambda: protocol_of(*(protocol_and_friction or state.protocol)))
            if protocol is None or not self._background.ready():
                return
            grasp = PosedGrasp.of(state.collection, state.number, state.standing)

            def work(control: Control) -> Change:
                found = run_trial(self._make_world, grasp.with_bodies(self._prepare), protocol, control)
                return lambda state: state.evolve(trial=found, tested_at=now())

            if self._store.run_job("validate", "testing in MuJoCo", work):
                self._editor.keep_tested_pose(grasp.pose)
                self._store.set(trial=None, tested_at=None)

    def plan_trajectory(self) -> None:
        """Plan the trajectory of the shown grasp, if it is not known, and show it from its start."""
        with self._store.lock:
            state = self._store.state
            if state.work.plan is not None and state.standing is state.pose:
                self._store.set(motion=state.work.plan, motion_frame=0)
                return
            if not self._background.ready():
                return
            grasp = PosedGrasp.of(state.collection, state.number, state.standing)

            def work(control: Control) -> Change:
                found = plan_trajectory(grasp.with_bodies(self._prepare), control)
                return lambda state: state.evolve(plan=found, motion=found, motion_frame=0)

            if self._store.run_job("plan", "planning the trajectory", work):
                self._editor.keep_tested_pose(grasp.pose)

    def pull(self) -> None:
        """Simulate the shown grasp live, while the user pulls the object."""
        with self._store.lock:
            state = self._store.state
            protocol = self._store.checked(lambda: protocol_of(*state.protocol))
            if protocol is None or not self._background.ready():
                return
            grasp = PosedGrasp.of(state.collection, state.number, state.standing)
            self._pull = NO_PULL

            def work(control: Control) -> None:
                shown: Recording | None = None

                def show(frame: Recording) -> bool:
                    nonlocal shown
                    with self._store.lock:
                        # Who shows anything else ends it.
                        going = shown is None or self._store.state.motion is shown
                        if going:
                            self._store.update_from_job(control, motion=frame, motion_frame=0)
                        shown = frame
                        return going

                pull_live(self._make_world, grasp.with_bodies(self._prepare), protocol, control, self._pulled, show)

            if self._store.run_job("pull", "preparing the simulation", work):
                self._editor.keep_tested_pose(grasp.pose)

    def _pulled(self) -> Pull:
        return self._pull

    def pull_steadily(self, newtons: float, direction: str) -> None:
        """Pull at the object's centre of mass along one of `AXES`."""
        self._pull = replace(self._pull, force=newtons * np.array(AXES[direction]))

    def pull_point(self, point: np.ndarray | None, towards: np.ndarray | None) -> None:
        """Pull a point (3,) of the object, its frame, by a spring to a place (3,), frame of the grasp, or not."""
        self._pull = replace(self._pull, point=point, towards=towards)

    def record(self, direction: str) -> None:
        """Simulate one direction of the trial again, recorded for replay."""
        with self._store.lock:
            state = self._store.state
            trial, grasp = state.trial, PosedGrasp.of(state.collection, state.number, state.pose)
            if trial is None or direction not in trial.directions:
                return

            def work(control: Control) -> Change:
                bodies = grasp.with_bodies(self._prepare)
                found = record_direction(self._make_world, bodies, trial, direction, control)
                return lambda state: state.evolve(motion=found, motion_frame=0)

            self._store.run_job("replay", f"recording the push along {direction}", work)
