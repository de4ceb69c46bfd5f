"""What `MUJOCO_GL` may be, before MuJoCo itself stumbles over it."""

import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay import offscreen
from refusals import refused


@pytest.mark.parametrize("value", ["", "egl", " EGL ", "glfw", "off", "disable", "1"])
def test_what_mujoco_takes_passes(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    offscreen.check_setting()


def test_nothing_set_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    offscreen.check_setting()


def test_an_unknown_value_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with refused(GraspRefineError, "MUJOCO_GL=vulkan", "egl", "osmesa"):
        offscreen.check_setting()


def test_osmesa_needs_its_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr(offscreen, "_library", lambda *names: None)
    with refused(GraspRefineError, "libosmesa6"):
        offscreen.check_setting()
