"""Messages of MuJoCo: its warnings are not written to a file, its errors fit into one line."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

MUJOCO_ERRORS = (
    ValueError,
    TypeError,
    RuntimeError,
    MemoryError,
    OverflowError,
    mujoco.FatalError,
    mujoco.UnexpectedError,
)
"""Exceptions of MuJoCo on a file that it cannot read or compile."""


@contextmanager
def unlogged() -> Iterator[None]:
    """Discard MuJoCo's warnings within the context; the previous handler is restored afterwards.

    MuJoCo would write them to a file MUJOCO_LOG.TXT in the user's current folder. It has one handler for the whole
    process and calls it from any thread.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(_ignore)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model without messages.

    MuJoCo warns in Python of what its own later versions will not read, such as `settotalmass`: no matter of the hand.

    Raises:
        ValueError: MuJoCo cannot compile it.
    """
    with unlogged(), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return spec.compile()


def one_line(error: Exception) -> str:
    """Return the message of an error of MuJoCo in one line."""
    text = str(error).strip()
    while text.startswith(("XML Error: ", "Error: ")):
        text = text.partition(": ")[2]
    return ", ".join(" ".join(line.split()) for line in text.splitlines() if line.strip())


def _ignore(message: str) -> None:
    """Ignore a warning."""
