"""`refine-grasp view`: what it opens, and what it refuses, without a browser."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from command_line import PROGRAM, interruptible, subprocess_environment
from grasp_refine.core.interruption import INTERRUPTED
from grasp_refine.geometry.pieces import Cut, cut_meshes
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects import object as object_module
from grasp_refine.validation.replay.replay import load_replay
from grasp_refine_apps.cli import main
from grasp_refine_apps.commands import view
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.commands.view_files import open_files
from grasp_refine_apps.viewer.jobs.controller import Controller
from open_viewer import settled
from running_processes import PATIENCE_S, soon


def opened(*files: Path, inputs: Inputs | None = None) -> Controller:
    """What the files mean; closed, only its state is looked at."""
    controller = open_files(files, inputs or Inputs(), Settings())
    controller.close()
    return controller


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Refined by geometry alone, and tested where it is slippery: some hold, some do not."""
    folder = tmp_path_factory.mktemp("results")
    assert main(["run", "--geometry-only", "--index", "1", "3", "--out", str(folder)]) == 0
    slippery = ["--friction", "0.15", "--json", str(folder / "report.json")]
    assert main(["validate", str(folder / "allegro_mug.npz"), *slippery, "--replays", str(folder / "replays")]) == 0
    return folder


def test_without_files_the_embedded_example_is_opened() -> None:
    state = opened().state
    assert len(state.collection) == 4 and state.collection.label(0) == "mug 0"


def test_results_are_opened_with_their_input_grasps_and_verdicts(results: Path) -> None:
    state = opened(results / "allegro_mug.npz", results / "report.json").state
    assert len(state.collection) == 2
    assert np.abs(state.initial.q - state.pose.q).max() > 1e-2
    assert set(state.collection.trials) == {0, 1} and state.trial is state.collection.trials[0]
    assert [trial.held for trial in state.collection.trials.values()] == [False, True]
    assert state.collection.columns["held"].values.tolist() == ["failed", "held"]


def test_a_replay_is_opened_with_its_motion(results: Path) -> None:
    path = next((results / "replays").rglob("*.npz"))
    state = opened(path).state
    assert state.motion is not None and len(state.motion) > 50 and len(state.collection) == 1
    # The number is that of the grasp where it was simulated; it was always 0.
    assert state.collection.label(0) == load_replay(path).name
    # The grasp is where the hand had closed to.
    shown = state.motion.pose(0).q
    assert np.isfinite(state.pose.q).all() and np.abs(state.pose.q - shown).max() > 1e-3


@pytest.mark.parametrize(("host", "ending"), [("127.0.0.1", signal.SIGTERM), ("0.0.0.0", signal.SIGINT)])
def test_it_ends_when_asked_and_its_address_has_a_token(tmp_path: Path, host: str, ending: signal.Signals) -> None:
    environment, told = {**subprocess_environment(), "TMPDIR": str(tmp_path)}, tmp_path.with_suffix(".json")
    options = ["--host", host, "--port", "0", "--no-open", "--json", str(told)]
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "view", *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment, preexec_fn=interruptible,
    )  # fmt: skip
    try:
        line = process.stdout.readline()
        assert soon(told.exists) and json.loads(told.read_text())["address"] == line.split()[0]
        process.send_signal(ending)
        _, error = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    # Ended once the viewer stands, or interrupted while it loads.
    assert process.returncode in (0, INTERRUPTED) and not list(tmp_path.iterdir())
    if host == "127.0.0.1":
        assert (
            line.startswith("http://127.0.0.1:")
            and "/?token=" in line
            and error == ("refine-grasp: interrupted\n" if process.returncode else "")
        )
    else:
        assert "/?token=" in line and "localhost" not in line and host not in line
        assert error.startswith("Warning: ") and "ssh -L" in error


@pytest.fixture
def several(tmp_path: Path) -> Path:
    """Grasps of the Allegro hand on three objects that have to be cut, with their meshes beside them."""
    hand = load_hand("allegro", candidates=16)
    names = ("one", "two", "three", "two")
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    for turns, name in enumerate(dict.fromkeys(names)):
        side = trimesh.creation.box((0.02, 0.02, 0.06 + 0.01 * turns))
        mesh = side.union(side.copy().apply_transform(trimesh.transformations.rotation_matrix(1.2, (0, 1, 0))))
        mesh.export(meshes / f"{name}.stl")
    T = np.tile(np.array([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]), (4, 1))
    grasps = GraspSet.of(hand, T, np.tile(hand.rest, (4, 1)))
    np.savez(tmp_path / "grasps.npz", **replace(grasps, object=np.array(names)).arrays())
    return tmp_path


def test_only_the_object_that_is_shown_is_cut(several: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All objects were cut before anything was shown: 15 minutes for 14."""
    done: list[str] = []

    def cut_and_note(meshes: Sequence[tuple[str, Any]], *given: Any, **options: Any) -> list[Cut]:
        done.extend(name for name, _ in meshes)
        return cut_meshes(meshes, *given, **options)

    monkeypatch.setattr(object_module, "cut_meshes", cut_and_note)
    viewer = open_files((several / "grasps.npz",), Inputs(objects=several / "meshes"), Settings())
    try:
        assert done == ["one"] and len(viewer.state.collection) == 4
        viewer.editor.set_joint(0, 0.1)
        viewer.background.measure()
        settled(viewer)
        quality = "penetration_m_after"
        assert np.isnan(viewer.state.collection.columns[quality].values).tolist() == [False, True, True, True]
        viewer.grasps.show(2)
        assert viewer.state.scene.object.rough and viewer.state.job.kind == "cut"
        viewer.refinement.start()
        assert viewer.state.job.kind == "cut"
        settled(viewer)
        assert done == ["one", "two"] and not viewer.state.scene.object.rough
        assert len(viewer.state.scene.object.body.pieces) > 1
        # What belongs to the others stays, and the new ones are measured, too.
        assert np.isnan(viewer.state.collection.columns[quality].values).tolist() == [False, False, False, True]
        assert viewer.state.unsaved == (0,) and not viewer.state.shelf
        # For a command on all, the rest is cut.
        viewer.set(settings=Settings(geometry_only=True, iterations=2))
        viewer.many.refine(range(4))
        settled(viewer, 60.0)
        assert done == ["one", "two", "three"] and len(viewer.state.works) == 4
        assert not any(group.scene.object.rough for group in viewer.state.collection.problem.groups)
    finally:
        viewer.close()


@pytest.mark.parametrize(
    ("unsaved", "signals", "told"),
    [(2, (signal.SIGINT, signal.SIGINT), "2 grasps"), (0, (signal.SIGINT,), ""), (2, (signal.SIGTERM,), "")],
)
def test_ctrl_c_asks_once_for_grasps_that_are_not_saved(
    unsaved: int,
    signals: tuple[signal.Signals, ...],
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    coming = iter(signals)

    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt(next(coming))

    monkeypatch.setattr(view.time, "sleep", interrupted)
    monkeypatch.setattr(view.threading, "Timer", lambda *given: SimpleNamespace(start=lambda: None))
    view._wait(SimpleNamespace(num_unsaved=unsaved))
    assert next(coming, None) is None
    assert (told in capsys.readouterr().err) if told else capsys.readouterr().err == ""
