"""CoACD in its own process: what it is asked for, and what becomes of its failures."""

import signal
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from grasp_refine.core.child import Ended
from grasp_refine.core.errors import MeshError
from grasp_refine.geometry import decomposition
from grasp_refine.geometry.decomposition import Decomposition, OutOfTimeError, decompose
from grasp_refine.geometry.pieces import convex_pieces
from refusals import refused

TUBE = trimesh.creation.annulus(0.2, 0.4, 0.5, sections=12)
VERTICES, FACES = np.asarray(TUBE.vertices), np.asarray(TUBE.faces, dtype=np.int64)


QUICK = Decomposition(mcts_iterations=60)


@pytest.fixture(scope="module")
def parts() -> list[np.ndarray]:
    """The tube, cut by one thread."""
    return decompose(VERTICES, FACES, QUICK, single=True, threads=1)


def test_parts_cover_the_mesh(parts):
    volume = sum(trimesh.convex.convex_hull(corners).volume for corners in parts)
    assert len(parts) > 3
    assert volume == pytest.approx(TUBE.volume, rel=0.1)


@pytest.mark.slow
def test_the_most_pieces_can_be_set():
    assert len(decompose(VERTICES, FACES, replace(QUICK, max_pieces=3), single=True)) == 3


@pytest.mark.parametrize(
    ("preprocess", "single", "modes"),
    [
        ("auto", True, ["off", "auto"]),
        ("auto", False, ["auto"]),
        ("on", True, ["on"]),
        ("off", False, ["off"]),
    ],
)
def test_one_closed_part_is_remeshed_only_after_a_failure(monkeypatch, preprocess, single, modes):
    asked = []

    def fail(vertices, faces, settings, *_):
        asked.append(settings["preprocess"])
        return None, Ended(-11, "")

    monkeypatch.setattr(decomposition, "_run", fail)
    with refused(MeshError, "CoACD", "-11"):
        decompose(VERTICES, FACES, Decomposition(preprocess=preprocess), single=single)
    assert asked == modes


def test_the_second_attempt_can_succeed(monkeypatch):
    def fail_once(vertices, faces, settings, *_):
        return (None, Ended(-11, "")) if settings["preprocess"] == "off" else ([VERTICES], Ended(0, ""))

    monkeypatch.setattr(decomposition, "_run", fail_once)
    assert len(decompose(VERTICES, FACES, Decomposition(), single=True)) == 1


def test_an_abort_inside_coacd_is_an_error_here():
    config = Decomposition()
    object.__setattr__(config, "threshold", 2.0)
    with refused(MeshError, "tube", "CoACD", "threshold > 1"):
        convex_pieces(TUBE, config, name="tube")


@pytest.mark.slow
def test_the_number_of_threads_changes_nothing(parts):
    two = decompose(VERTICES, FACES, QUICK, single=True, threads=2)
    assert [part.tobytes() for part in parts] == [part.tobytes() for part in two]


def test_a_decomposition_that_is_no_longer_wanted_ends_its_process(monkeypatch):
    started = []
    start = subprocess.Popen

    def record(*given, **options):
        started.append(start(*given, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", record)

    def refuse():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        decompose(VERTICES, FACES, Decomposition(), single=True, check=refuse)
    assert [child.returncode for child in started] == [-signal.SIGKILL]


@pytest.mark.slow
def test_more_processor_time_than_allowed_ends_the_child():
    endless = Decomposition(threshold=0.01, mcts_iterations=2000, mcts_max_depth=7, time_limit=1)
    with refused(OutOfTimeError, "1 s"):
        decompose(VERTICES, FACES, endless, single=True, threads=1)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"threshold": 1.5}, ("threshold", "0.01", "1", "1.5")),
        ({"threshold": np.nan}, ("threshold", "0.01", "1", "nan")),
        ({"preprocess_resolution": 2000}, ("preprocess_resolution", "20", "100", "2000")),
        ({"max_pieces": 0}, ("max_pieces", "-1", "1", "0")),
        ({"seed": -1}, ("seed", "0", "-1")),
        ({"time_limit": 0.5}, ("time_limit", "1", "0.5")),
    ],
)
def test_settings_out_of_range_are_refused(settings, named):
    with refused(MeshError, *named):
        Decomposition(**settings)
