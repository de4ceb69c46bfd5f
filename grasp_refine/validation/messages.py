"""What MuJoCo has to say: its warnings go to no file, its errors fit into one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def unlogged() -> Iterator[None]:
    """While it lasts, MuJoCo's warnings are written nowhere; what was done with them before is done again afterwards.

    MuJoCo would write them to a file MUJOCO_LOG.TXT in the user's current folder. It has one handler for the whole
    process and calls it from any thread.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_unheard)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def complaint(error: ValueError) -> str:
    """What MuJoCo complains of, in one line."""
    text = str(error).strip()
    while text.startswith(("XML Error: ", "Error: ")):
        text = text.partition(": ")[2]
    return ", ".join(" ".join(line.split()) for line in text.splitlines() if line.strip())


def _unheard(message: str) -> None:
    """Does nothing with a warning."""
