"""GIF of a refinement or a simulation as one browser sees it: its camera, its colours, its display options."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import viser
from PIL import Image

from grasp_refine.core.array_types import UInt8
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.files.animation import NOTHING_TO_SHOW
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.recording import subsample
from grasp_refine_apps.viewer.server.page import DRAW_PERIOD_S

MAX_FRAMES, MAX_SIDE_PX = 32, 720
"""Maximum frames, and pixels of a frame's longer side."""

FRAME_MS, END_MS = 120, 1200
"""Milliseconds of a frame, and of the last one."""

SETTLE_S = 4 * DRAW_PERIOD_S
"""Seconds until a frame that was drawn has reached the browser."""

RENDER_TIMEOUT_S = 15.0
"""Seconds within which a browser must draw a frame."""


def recorded_gif(
    controller: Controller,
    client: viser.ClientHandle,
    size: tuple[int, int],
    settle: Callable[[float], None],
    control: Control,
) -> bytes:
    """Show each frame, take its picture in a browser, and return the GIF; the previous view is restored.

    Args:
        controller: Shows the frames.
        client: The browser.
        size: Height and width of its scene in pixels.
        settle: Waits until the view is drawn, for some seconds at most.
        control: Progress, and interruption.

    Raises:
        GraspRefineError: there is nothing to record, or the browser does not draw.
        Stopped: the job was stopped.
    """
    state = controller.state
    if state.recording is None:
        raise GraspRefineError(NOTHING_TO_SHOW)
    frames = subsample(len(state.recording), MAX_FRAMES).tolist()
    factor = min(1.0, MAX_SIDE_PX / max(size))
    height, width = (max(round(factor * side), 2) for side in size)
    pictures = []
    controller.set(gizmo="none")
    try:
        for done, frame in enumerate(frames):
            control.report(done / len(frames), "recording a GIF")
            control.check()
            controller.player.show_frame(frame)
            settle(RENDER_TIMEOUT_S)
            time.sleep(SETTLE_S)
            pictures.append(client.get_render(height, width, transport_format="jpeg", timeout=RENDER_TIMEOUT_S))
    except (RuntimeError, TimeoutError) as error:
        raise GraspRefineError(f"there is no GIF: the browser drew no picture ({error}); try again") from None
    finally:
        if state.motion is not None:
            controller.player.show_frame(state.motion_frame)
        else:
            controller.player.scrub(state.frame)
        controller.set(gizmo=state.gizmo)
    return gif(pictures)


def gif(pictures: Sequence[UInt8[np.ndarray, "H W 3"]]) -> bytes:
    """Encode pictures of one size as a GIF that repeats."""
    convert = partial(Image.Image.convert, mode="P", palette=Image.Palette.ADAPTIVE)
    first, *others = (convert(Image.fromarray(picture[..., :3])) for picture in pictures)
    stream = io.BytesIO()
    times = [FRAME_MS] * len(others) + [END_MS]
    first.save(stream, "GIF", save_all=True, append_images=others, duration=times, loop=0)
    return stream.getvalue()
