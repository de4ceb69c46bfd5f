"""Pictures and films of a replay, from a view that shows both hand and object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.replay.camera import View
from grasp_refine.validation.replay.caption import BAD, GOOD
from grasp_refine.validation.replay.offscreen import offscreen_context
from grasp_refine.validation.replay.replay import Replay
from grasp_refine.validation.replay.studio import CONTACT, FORCE_COLOR, studio

FORMATS = (".gif", ".png", ".webp")
"""File formats of films, by the ending of the name; .png is an animated PNG."""

FOLLOWED_DISTANCE_M, SHOWN_DISTANCE_M = 0.1, 0.2
"""Displacement of the object (metres) above which the camera no longer follows it, and above which it is not shown."""


def check_renderer() -> None:
    """Refuse to start where pictures cannot be rendered, before the work and not after it.

    Raises:
        GraspRefineError: They cannot; names what to install or set.
    """
    offscreen_context(64, 64).free()


def picture(
    model: mujoco.MjModel,
    replay: Replay,
    frame: int | None = None,
    size: tuple[int, int] = (720, 600),
    view: View | None = None,
) -> Image.Image:
    """Render a frame of a replay: the simulated shapes, their contacts, the push, and a caption.

    Args:
        model: Model of the simulation.
        replay: Recording of the model.
        frame: Number of the frame; negative numbers count from the end. By default the last with the object in sight.
        size: Width and height in pixels, the caption included.
        view: Camera pose; by default the one that shows most of hand and object.

    Raises:
        GraspRefineError: The replay is of another model, or nothing here can render; names what to install.
    """
    with studio(model, replay, size) as place:
        place.pose(_last_in_sight(replay) if frame is None else frame)
        view = place.best_view(place.corners()) if view is None else view
        return place.shoot(view)


def film(
    model: mujoco.MjModel,
    replay: Replay,
    path: str | Path,
    size: tuple[int, int] = (480, 400),
    rate: float = 20.0,
    speed: float = 1.0,
    view: View | None = None,
) -> int:
    """Save a replay as a film that loops, and return its number of pictures.

    It ends where the object, if it is lost, is out of sight.

    Args:
        model: Model of the simulation.
        replay: Recording of the model.
        path: File to write; its ending is one of `FORMATS`.
        size: Width and height in pixels, the caption included.
        rate: Pictures per second.
        speed: Factor of the playing speed; 1 is real time.
        view: Camera pose; by default the one that shows most of hand and object.

    Raises:
        GraspRefineError: As for `picture`; or the ending is not supported, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise GraspRefineError(f"{path}: a film can be saved as {', '.join(FORMATS)}, not as '{path.suffix}'")
    moved, _ = replay.displacement()
    end = replay.time[_last_in_sight(replay)]
    wanted = np.append(np.arange(replay.time[0], end - 1e-9, speed / rate), end)
    frames = np.clip(np.searchsorted(replay.time, wanted - 1e-9), 0, len(replay) - 1)
    count = len(frames)
    images = []
    with studio(model, replay, size) as place:
        if view is None:
            followed = frames[moved[frames] < FOLLOWED_DISTANCE_M]
            corners = []
            for frame in followed[:: max(len(followed) // 8, 1)]:
                place.pose(int(frame))
                corners.append(place.corners())
            view = place.best_view(np.concatenate(corners))
        for frame in frames:
            place.pose(int(frame))
            images.append(place.shoot(view))
    # The last picture stays for a second.
    durations = [round(1000 / rate)] * (count - 1) + [1000]
    with written_whole(path) as partial:
        _save_film(partial, images, durations)
    return count


def _last_in_sight(replay: Replay) -> int:
    """Return the last frame before the object is lost, or the last of all."""
    lost = replay.displacement()[0] > SHOWN_DISTANCE_M
    return max(int(lost.argmax()) - 1, 0) if lost.any() else len(replay) - 1


def _save_film(path: Path, images: list[Image.Image], durations: list[int]) -> None:
    options: dict[str, Any] = {"save_all": True, "duration": durations, "loop": 0}
    if path.suffix.lower() == ".gif":
        # One palette for all pictures, or colours flicker; no dithering, or the file is twice as large.
        width, height = images[0].size
        sample = Image.new("RGB", (width, 4 * height))
        for number in range(4):
            sample.paste(images[number * (len(images) - 1) // 3], (0, number * height))
        force = tuple(round(255 * c) for c in FORCE_COLOR)
        colors: tuple[str | tuple[int, ...], ...] = (CONTACT, GOOD, BAD, force)
        for number, color in enumerate(colors):
            # Small details have too few pixels to get a colour of their own.
            sample.paste(color, (24 * number, 0, 24 * number + 24, 24))
        palette = sample.quantize(256, dither=Image.Dither.NONE)
        images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    elif path.suffix.lower() == ".webp":
        options |= {"quality": 85, "method": 2}
    images[0].save(path, append_images=images[1:], **options)
