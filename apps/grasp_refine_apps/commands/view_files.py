"""Opening of what `refine-grasp view` shows: grasp files, results of documents about them, and replays.

A module of its own, as it loads packages for a second: the page is served before.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.formats.listing import OURS
from grasp_refine.grasps.formats.reading import Reading
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.problem.load import Loader
from grasp_refine.validation.replay.replay import Replay, Stage, load_replay
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.report.progress import Reporter
from grasp_refine_apps.report.screen import screen
from grasp_refine_apps.viewer.files.validation_file import ValidationFile, read_validation
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.replaying import is_replay, replay_recording
from grasp_refine_apps.viewer.model.collection import Collection, posed_in
from grasp_refine_apps.viewer.model.recording import Recording


def open_files(
    files: tuple[Path, ...],
    inputs: Inputs,
    settings: Settings,
    compare: Path | None = None,
    report: Callable[[str], None] = lambda step: None,
) -> Controller:
    """Load the grasps of files, with the results of documents about them; arguments as the options of `view`.

    Args:
        files: Files and documents.
        inputs: Hand, objects and grasps.
        settings: Settings of refinements.
        compare: File of the grasps that are drawn as a ghost.
        report: Called with each step.

    Raises:
        GraspRefineError: a file cannot be used.
    """
    report("reading the grasps")
    documents = [read_validation(path) for path in files if path.suffix.lower() == ".json"]
    grasps = [path for path in files if path.suffix.lower() != ".json"]
    if len(grasps) > 1 or (grasps and inputs.grasps is not None):
        raise GraspRefineError(
            "one grasp file at a time, or a folder of them, such as the one that run wrote; "
            f"got {', '.join(map(str, [*grasps, *filter(None, [inputs.grasps])]))}"
        )
    if grasps:
        inputs = replace(inputs, grasps=grasps[0])
    with Reporter(screen(stderr=True)) as reporter:

        def say(line: str) -> None:
            reporter.say(line)
            report(line)

        def wait(what: str) -> None:
            reporter.wait(what)
            report(what)

        if grasps and is_replay(grasps[0]):
            if compare is not None:
                raise GraspRefineError(f"--compare is for grasp files; {grasps[0]} is a replay")
            return _replay_controller(grasps[0], inputs, settings, reporter)
        if documents and inputs.grasps is None:
            inputs = replace(inputs, grasps=_grasp_file(documents[0]))
        collection = _load(inputs, settings.seed, say, wait)
        compared = None
        if compare is not None:
            compared = _load(replace(inputs, grasps=compare), settings.seed, say, wait, shown=False)
        opened = [each for each in (collection, compared) if each is not None]
        for note in dict.fromkeys(note for each in opened for note in each.problem.notes):
            reporter.note(note)
    for document in documents:
        collection = collection.with_trials(document.of(collection))
    return Controller(collection, settings, compared)


def _load(
    inputs: Inputs, seed: int, say: Callable[[str], None], wait: Callable[[str], None], *, shown: bool = True
) -> Collection:
    """Load grasps; all objects are read and checked, only the shown one is decomposed."""
    # A suspected convention is seen best.
    inputs = replace(inputs, as_is=True)
    loader = Loader(inputs, seed, say, wait)
    problem = loader.problem()
    number = int(posed_in(problem).argmax())
    first = next((at for at, group in enumerate(problem.groups) if number in group.place), 0) if shown else None
    rough = [at for at, group in enumerate(problem.groups) if at != first and group.scene.object.takes_long]
    return Collection.of(loader.prepare(problem, rough=rough))


def _replay_controller(path: Path, inputs: Inputs, settings: Settings, reporter: Reporter) -> Controller:
    """Load the grasp of a replay, with its motion."""
    replay = load_replay(path)
    loader = Loader(inputs, settings.seed, reporter.say)
    hand = loader.hands.load(inputs.hand or replay.hand, None)
    recording = replay_recording(hand, model_of(hand), replay)
    problem = loader.prepare(loader.of_grasps(_grasp_of(replay, recording, hand), path))
    # The grasp keeps the number that it had where it was simulated.
    number = re.search(r" (\d+)$", replay.name)
    if number is not None:
        groups = tuple(replace(group, index=np.array([int(number[1])])) for group in problem.groups)
        problem = replace(problem, groups=groups)
    controller = Controller(Collection.of(problem), settings)
    controller.player.show(recording)
    return controller


def _grasp_file(document: ValidationFile) -> Path:
    """Return the grasp file that a document is about.

    Raises:
        GraspRefineError: it does not name exactly one existing file.
    """
    found = [Path(path) for path in document.files.values() if Path(path).exists()]
    if len(found) != 1:
        raise GraspRefineError(f"{document.path}: give the grasp file that it is about, too")
    return found[0]


def _grasp_of(replay: Replay, recording: Recording, hand: Hand) -> Reading:
    """Return the grasp of a simulation: the hand at the beginning of the squeeze."""
    squeezed = replay.time[replay.stage >= Stage.SQUEEZE]
    at = max(int(np.searchsorted(recording.time, squeezed[0] if len(squeezed) else np.inf)) - 1, 0)
    grasps = GraspSet(
        hand=replay.hand,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.array([replay.object]),
        scale=np.ones(1),
        hand_pose=pose_from_transform(recording.T_root[at : at + 1]),
        q=recording.q[at : at + 1],
    )
    return Reading(grasps, OURS, (), ())
