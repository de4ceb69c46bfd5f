"""OpenGL without a screen: choice of the implementation, and a context of it."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any

from grasp_refine.core.errors import GraspRefineError

_NO_GL = (
    "no picture: nothing here can render without a screen; install EGL (Debian: apt-get install libegl1 "
    "libgl1-mesa-dri) or OSMesa (apt-get install libosmesa6), or set MUJOCO_GL to egl or osmesa"
)

_OSMESA = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")

_KINDS = ("egl", "osmesa", "glfw")
_OFF = ("disable", "disabled", "off", "false", "0")
_SETTINGS = ("", *_KINDS, *_OFF, "enable", "enabled", "on", "true", "1")
"""Values of `MUJOCO_GL` that MuJoCo takes."""

_EGL_PLATFORM_DEVICE = 0x313F
"""Constant of EGL for rendering without any window system (EGL_EXT_platform_device)."""


def check_setting() -> None:
    """Refuse a value of `MUJOCO_GL` with which MuJoCo cannot be loaded, even without rendering.

    Raises:
        GraspRefineError: It cannot; names what to set or install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if wanted not in _SETTINGS:
        raise GraspRefineError(f"MuJoCo does not know MUJOCO_GL={wanted}; set it to egl or osmesa, or unset it")
    if wanted == "osmesa" and _library(*_OSMESA) is None:
        raise GraspRefineError(
            "MuJoCo cannot be loaded with MUJOCO_GL=osmesa, the library is missing: unset it, set it to egl, or "
            "install OSMesa (Debian: apt-get install libosmesa6)"
        )


def choose_gl() -> str:
    """Return the OpenGL implementation for pictures: "egl", "osmesa" or "glfw" (with a screen).

    `MUJOCO_GL` decides where it is set; else the first of EGL and OSMesa that is available; then a screen. This
    does not load PyOpenGL, which could not be loaded for another implementation afterwards.

    Raises:
        GraspRefineError: There is none, or `MUJOCO_GL` forbids it; names what to install or set.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    linux = sys.platform.startswith("linux")
    if wanted == "glfw" and linux and not screen:
        raise GraspRefineError("no picture: MUJOCO_GL=glfw needs a screen; set it to egl or osmesa, or unset it")
    if wanted in _KINDS:
        return wanted
    if wanted in _OFF:
        raise GraspRefineError(f"no picture: MUJOCO_GL={wanted} forbids OpenGL; set it to egl or osmesa, or unset it")
    if not linux:
        return "glfw"
    # The implementation of PyOpenGL may be set already.
    platform = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if platform in ("", "egl") and _egl_works():
        return "egl"
    if platform in ("", "osmesa") and _library(*_OSMESA) is not None:
        return "osmesa"
    if screen:
        return "glfw"
    raise GraspRefineError(_NO_GL)


def _library(*names: str) -> ctypes.CDLL | None:
    """Return the first of these libraries that can be loaded."""
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _egl_works() -> bool:
    """Return True if EGL has a device to render on, which may be a processor; the library alone is not enough."""
    egl = _library("libEGL.so.1", "libEGL.so")
    if egl is None:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_of = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return False
    devices, count = (pointer * 16)(), integer(0)
    if not ctypes.CFUNCTYPE(ctypes.c_uint, integer, pointer, pointer)(query)(16, devices, ctypes.byref(count)):
        return False
    display_of_device = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(display_of)
    egl.eglInitialize.argtypes = (pointer, pointer, pointer)
    for device in devices[: count.value]:
        display = display_of_device(_EGL_PLATFORM_DEVICE, device, None)
        if display and egl.eglInitialize(display, None, None):
            # It is not terminated: a display is shared by the whole process, and MuJoCo may be rendering on it.
            return True
    return False


def offscreen_context(width: int, height: int) -> Any:
    """Return a new OpenGL context without a window, of one of MuJoCo's three kinds, and make it current.

    Raises:
        GraspRefineError: There is none; names what to install or set.
    """
    kind = choose_gl()
    try:
        if kind == "egl":
            from mujoco.egl import GLContext
        elif kind == "osmesa":
            from mujoco.osmesa import GLContext
        else:
            from mujoco.glfw import GLContext
        # Only now: it fixes the implementation that PyOpenGL loads.
        from OpenGL.error import Error
    # A library that PyOpenGL does not find raises AttributeError, as an attribute of None.
    except (ImportError, AttributeError, TypeError, OSError) as error:
        raise _no_gl(kind, error) from error
    try:
        context = GLContext(width, height)
        context.make_current()
    except (Error, ImportError, RuntimeError, TypeError) as error:
        raise _no_gl(kind, error) from error
    return context


def _no_gl(kind: str, error: Exception) -> GraspRefineError:
    reason = " ".join(str(error).split())[:160]
    return GraspRefineError(f"{_NO_GL} ({kind}: {type(error).__name__} {reason})")
