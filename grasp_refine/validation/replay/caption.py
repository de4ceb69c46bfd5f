"""Caption of a picture of a replay, below the image."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from grasp_refine.validation.replay.replay import Replay, Stage

INK, FAINT = "#1b2430", "#5b6675"
"""Colours of the title and of the state."""
GOOD, BAD = "#1b8a3a", "#c62828"
"""Colours of a grasp that held, and of one that failed."""


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


def write_caption(page: Image.Image, top: int, replay: Replay, frame: int, contacts: int) -> None:
    """Write the caption on the part of a page from `top` (pixels) on.

    Args:
        page: Page with the image.
        top: Lower edge of the image in pixels.
        replay: Replay in the image.
        frame: Number of the frame.
        contacts: Number of contact points of the object.
    """
    draw = ImageDraw.Draw(page)
    width, height = page.size
    margin, line = round(0.02 * width), (height - top) / 2.3
    title = f"{replay.name}, {replay.hand}, {replay.direction}, {replay.setting}"
    state = state_of(replay, frame, contacts)
    color = GOOD if replay.reason == "held" else BAD
    verdict = _font(replay.reason, 0.25 * width, 0.62 * line)
    draw.text((width - margin, top + 0.62 * line), replay.reason, fill=color, font=verdict, anchor="rm")
    full = width - 2 * margin
    left = full - draw.textlength(replay.reason, font=verdict) - margin
    draw.text((margin, top + 0.62 * line), title, fill=INK, font=_font(title, left, 0.62 * line), anchor="lm")
    draw.text((margin, top + 1.55 * line), state, fill=FAINT, font=_font(state, full, 0.55 * line), anchor="lm")


def _font(text: str, width: float, size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font of that size in pixels, or smaller, so that the text is not wider than `width` pixels."""
    font = ImageFont.load_default(size)
    length = font.getlength(text)
    return font if length <= width else ImageFont.load_default(max(size * width / length, 6.0))
