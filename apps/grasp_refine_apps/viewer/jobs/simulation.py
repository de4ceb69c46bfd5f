"""Commands that simulate the shown grasp, and plan its trajectory."""

from __future__ import annotations

from typing import Any

from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.planning import plan_trajectory
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
from grasp_refine_apps.viewer.model.work import now


class Simulation:
    """Simulation and trajectory of the shown grasp."""

    def __init__(
        self, store: Store, editor: Editor, background: Background, prepare: Prepare, make_world: MakeWorld
    ) -> None:
        """Simulate what the state shows."""
        self._store, self._editor, self._background = store, editor, background
        self._prepare, self._make_world = prepare, make_world

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
