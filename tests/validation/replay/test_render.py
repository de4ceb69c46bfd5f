"""Pictures and films: hand and object are seen in them, and what they say is right."""

import ctypes
import os
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.export import export_xml
from grasp_refine.validation.replay.offscreen import choose_gl
from grasp_refine.validation.replay.render import FORMATS, check_renderer, film, picture
from grasp_refine.validation.replay.replay import Stage
from recorded_gripper import Recorded, recorded_gripper
from refusals import refused


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return recorded_gripper()


@pytest.fixture(scope="module")
def gl() -> str:
    """The kind of OpenGL that is here; .ci/run installs one."""
    try:
        check_renderer()
    except GraspRefineError as error:
        pytest.skip(str(error))
    return choose_gl()


def shares(image: Image.Image) -> dict[str, float]:
    """Of the picture: how much is orange, as the object; grey and not light, as the hand; red, as the arrow."""
    red, green, blue = np.moveaxis(np.asarray(image.convert("RGB")).astype(int), 2, 0)
    orange = (red - blue > 60) & (green - blue > 20)
    return {
        "object": orange.mean(),
        "hand": ((abs(red - blue) < 25) & (red < 205) & (red > 60)).mean(),
        "push": ((red - green > 90) & (abs(green - blue) < 45)).mean(),
        "contact": ((blue - red > 110) & (green > red)).mean(),
    }


def test_hand_and_object_are_in_the_picture(recorded: Recorded, gl: str) -> None:
    image = picture(recorded.model, recorded.replay, size=(320, 280))
    assert image.size == (320, 280) and image.mode == "RGB"
    found = shares(image)
    assert found["object"] > 0.02 and found["hand"] > 0.05 and found["push"] > 0.001, found
    assert found["contact"] > 0.00003, found
    before = shares(picture(recorded.model, recorded.replay, 0, size=(320, 280)))
    assert before["push"] == 0 and before["contact"] == 0, before
    assert before["object"] > 0.02, before


def test_the_same_frame_gives_the_same_picture(recorded: Recorded, gl: str) -> None:
    one, two = (picture(recorded.model, recorded.replay, -1, size=(240, 200)) for _ in range(2))
    assert one.tobytes() == two.tobytes()
    assert one.tobytes() != picture(recorded.model, recorded.replay, 0, size=(240, 200)).tobytes()
    assert recorded.model.vis.global_.fovy == 45, "the model is left as it was"


def test_an_exported_model_is_drawn_like_its_original(recorded: Recorded, gl: str, tmp_path: Path) -> None:
    export_xml(recorded.spec, recorded.model, recorded.replay, tmp_path / "replay.xml")
    exported = mujoco.MjModel.from_xml_path(str(tmp_path / "replay.xml"))
    ours, theirs = (np.asarray(picture(m, recorded.replay, size=(240, 200))) for m in (recorded.model, exported))
    assert np.mean(np.abs(ours.astype(int) - theirs) > 8) < 0.01


def test_a_lost_object_is_shown_while_it_is_in_sight(recorded: Recorded, gl: str, tmp_path: Path) -> None:
    qpos = recorded.replay.qpos.copy()
    qpos[150:, 1] += np.arange(76)
    lost = replace(recorded.replay, qpos=qpos, reason="moved")
    assert shares(picture(recorded.model, lost, size=(240, 200)))["object"] > 0.01
    count = film(recorded.model, lost, tmp_path / "lost.gif", size=(200, 160), rate=10)
    assert count == 7, "0.6 s at 10 pictures a second, both ends counted"


@pytest.mark.parametrize("ending", FORMATS)
def test_a_film_has_pictures_that_differ(recorded: Recorded, gl: str, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"film{ending}"
    count = film(recorded.model, recorded.replay, path, size=(200, 160), rate=5)
    with Image.open(path) as image:
        assert image.n_frames == count == 6
        assert image.size == (200, 160) and image.info.get("loop") == 0
        frames = []
        for frame in range(count):
            image.seek(frame)
            frames.append(np.asarray(image.convert("RGB")).astype(int))
    assert all(np.abs(a - b).max() > 20 for a, b in zip(frames, frames[1:], strict=False))
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_an_object_that_is_lifted_high_stays_in_sight(recorded: Recorded, gl: str, tmp_path: Path) -> None:
    """What is lifted with the hand is not lost, however far from its start."""
    replay = recorded.replay
    lift = np.where(replay.stage == Stage.PUSH, np.linspace(-0.3, 0.4, len(replay)).clip(0), 0.0)
    qpos, mocap_pos = replay.qpos.copy(), replay.mocap_pos.copy()
    root = replay.qpos_names.index("hand z")
    qpos[:, 2], qpos[:, root], mocap_pos[:, 2] = qpos[0, 2] + lift, qpos[:, root] + lift, mocap_pos[:, 2] + lift
    qpos[:, :2], qpos[:, 3:7] = qpos[0, :2], qpos[0, 3:7]
    stage = np.where(replay.stage == Stage.PUSH, Stage.LIFT, replay.stage)
    lifted = replace(replay, qpos=qpos, mocap_pos=mocap_pos, stage=stage, force=np.zeros(3), direction="lift")
    assert film(recorded.model, lifted, tmp_path / "lift.gif", size=(200, 160), rate=5) == 6
    with Image.open(tmp_path / "lift.gif") as image:
        image.seek(5)
        assert shares(image)["object"] > 0.002


def test_what_cannot_be_drawn_is_named(recorded: Recorded, tmp_path: Path) -> None:
    with refused(GraspRefineError, "film.mp4", ".gif, .png, .webp"):
        film(recorded.model, recorded.replay, tmp_path / "film.mp4")
    with refused(GraspRefineError, "100 x 100", "200 x 160"):
        picture(recorded.model, recorded.replay, size=(100, 100))
    with refused(GraspRefineError, "model"):
        picture(recorded.model, replace(recorded.replay, qpos_names=("a", *recorded.replay.qpos_names[1:])))


def test_without_opengl_one_line_says_what_to_install(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)

    def missing(name: str) -> ctypes.CDLL:
        raise OSError(name)

    monkeypatch.setattr(ctypes, "CDLL", missing)
    monkeypatch.setattr(sys, "platform", "linux")
    with refused(GraspRefineError, "apt-get install libegl1", "libosmesa6", "MUJOCO_GL"):
        picture(recorded.model, recorded.replay)


def test_mujoco_gl_is_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", " EGL ")
    assert choose_gl() == "egl"
    monkeypatch.setenv("MUJOCO_GL", "off")
    with refused(GraspRefineError, "MUJOCO_GL=off", "egl", "osmesa"):
        check_renderer()
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with refused(GraspRefineError, "MUJOCO_GL=glfw", "egl", "osmesa"):
        check_renderer()


def test_a_kind_that_cannot_be_loaded_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = "egl" if "mujoco.osmesa" in sys.modules else "osmesa"
    monkeypatch.setenv("MUJOCO_GL", kind)
    # Somebody has loaded PyOpenGL for something else.
    monkeypatch.setitem(os.environ, "PYOPENGL_PLATFORM", "glx")
    with refused(GraspRefineError, "EGL", f"({kind}: "):
        check_renderer()
