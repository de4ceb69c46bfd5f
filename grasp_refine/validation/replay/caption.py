"""What a picture of a replay says below the photo."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from grasp_refine.validation.replay.replay import Replay, Stage

INK, FAINT = "#1b2430", "#5b6675"
GOOD, BAD = "#1b8a3a", "#c62828"


def state_of(replay: Replay, frame: int, contacts: int) -> str:
    """What is done in a frame, and where the object is, which touches something at so many places."""
    moved, turned = (float(values[frame]) for values in replay.displacement())
    way = f"{1e3 * moved:.1f} mm" if moved < 1 else f"{moved:.1f} m"
    lift = 1e3 * float(np.linalg.norm(replay.lifted()[frame]))
    done = {
        Stage.CLOSE: f"closing: moved {way}",
        Stage.SQUEEZE: f"squeezing: moved {way}",
        Stage.PUSH: f"pushed {replay.direction}: moved {way}",
        Stage.LIFT: f"hand lifted {lift:.1f} mm: object {way} off",
    }[Stage(int(replay.stage[frame]))]
    noun = "contact" if contacts == 1 else "contacts"
    return f"{replay.time[frame]:.2f} s, {done}, turned {np.degrees(turned):.1f}°, {contacts} {noun}"


def write_caption(page: Image.Image, top: int, replay: Replay, frame: int, contacts: int) -> None:
    """Write what is seen on the part of a page from `top` (pixels) on.

    Args:
        page: What is written on.
        top: Where the photo ends.
        replay: What is shown.
        frame: Which frame of it.
        contacts: At how many places the object touches something.
    """
    draw = ImageDraw.Draw(page)
    width, height = page.size
    margin, line = round(0.02 * width), (height - top) / 2.3
    title = f"{replay.name}, {replay.hand}, {replay.direction}, {replay.setting}"
    state = state_of(replay, frame, contacts)
    color = GOOD if replay.reason == "held" else BAD
    verdict = _fitting(replay.reason, 0.25 * width, 0.62 * line)
    draw.text((width - margin, top + 0.62 * line), replay.reason, fill=color, font=verdict, anchor="rm")
    room = width - 2 * margin
    left = room - draw.textlength(replay.reason, font=verdict) - margin
    draw.text((margin, top + 0.62 * line), title, fill=INK, font=_fitting(title, left, 0.62 * line), anchor="lm")
    draw.text((margin, top + 1.55 * line), state, fill=FAINT, font=_fitting(state, room, 0.55 * line), anchor="lm")


def _fitting(text: str, room: float, size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font of that size in pixels, or smaller, so that the text is not wider than `room`."""
    font = ImageFont.load_default(size)
    length = font.getlength(text)
    return font if length <= room else ImageFont.load_default(max(size * room / length, 6.0))
