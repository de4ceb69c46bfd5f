"""Caption of a picture of a replay, below the image."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from grasp_refine.validation.replay.replay import Replay, Stage
from grasp_refine_apps.report.drawing import BAD, GOOD, GREY, INK, font


def state_of(replay: Replay, frame: int, contacts: int) -> str:
    """Return text on the stage of a frame, the displacement of the object and its number of contacts."""
    moved, turned = (float(values[frame]) for values in replay.displacement())
    distance = f"{1e3 * moved:.1f} mm" if moved < 1 else f"{moved:.1f} m"
    lift = 1e3 * float(np.linalg.norm(replay.lifted()[frame]))
    done = {
        Stage.CLOSE: f"closing: moved {distance}",
        Stage.SQUEEZE: f"squeezing: moved {distance}",
        Stage.PUSH: f"pushed {replay.direction}: moved {distance}",
        Stage.LIFT: f"hand lifted {lift:.1f} mm: object {distance} off",
    }[Stage(int(replay.stage[frame]))]
    noun = "contact" if contacts == 1 else "contacts"
    return f"{replay.time[frame]:.2f} s, {done}, turned {np.degrees(turned):.1f}°, {contacts} {noun}"


def caption(size: tuple[int, int], replay: Replay, frame: int, contacts: int) -> Image.Image:
    """Return the caption below the picture of a frame.

    Args:
        size: Width and height in pixels.
        replay: Replay in the picture.
        frame: Number of the frame.
        contacts: Number of contact points of the object.
    """
    page = Image.new("RGB", size, "#ffffff")
    draw, (width, height) = ImageDraw.Draw(page), size
    margin, line = round(0.02 * width), height / 2.3
    title = f"{replay.name}, {replay.hand}, {replay.direction}, {replay.setting}"
    state = state_of(replay, frame, contacts)
    color = GOOD if replay.reason == "held" else BAD
    verdict = font(0.62 * line, replay.reason, 0.25 * width)
    draw.text((width - margin, 0.62 * line), replay.reason, fill=color, font=verdict, anchor="rm")
    full = width - 2 * margin
    left = full - draw.textlength(replay.reason, font=verdict) - margin
    draw.text((margin, 0.62 * line), title, fill=INK, font=font(0.62 * line, title, left), anchor="lm")
    draw.text((margin, 1.55 * line), state, fill=GREY, font=font(0.55 * line, state, full), anchor="lm")
    return page
