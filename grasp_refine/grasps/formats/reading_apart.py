"""Reading in a process of its own, by libraries that run for ever or end the process on some damaged files.

The process runs a module of ours, which ends with `answer`; its output is a pickle, read as any other.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats.pickled import Refused, unpickle

TIME_LIMIT_S = 60.0
"""Time in seconds after which reading ends; a file of the allowed size takes a few."""

_REFUSED = 3
"""Exit code of a process that refuses a file, with the reason on its output."""


def read_apart(module: str, *arguments: str, damaged: str, data: bytes = b"") -> Any:
    """Return the answer of a module that runs as the main program of a process.

    Args:
        module: Full name of the module.
        arguments: Arguments of its command line.
        damaged: Message where its library fails.
        data: Its standard input.

    Raises:
        Refused: it refuses the file, or its library does not end, or ends the process.
    """
    place = os.pathsep.join([str(Path(__file__).parents[3]), *filter(None, [os.environ.get("PYTHONPATH")])])
    try:
        done = subprocess.run(
            [sys.executable, "-m", module, *arguments],
            input=data,
            capture_output=True,
            timeout=TIME_LIMIT_S,
            env={**os.environ, "PYTHONPATH": place},
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise Refused(f"{damaged}: its library does not end within {TIME_LIMIT_S:g} s") from None
    if done.returncode == _REFUSED:
        raise Refused(done.stdout.decode(errors="replace"))
    if done.returncode:
        raise Refused(f"{damaged}: its library ended with {done.returncode}")
    return unpickle(done.stdout)


def answer(read: Callable[[], Any]) -> int:
    """Write what a function reads, or why it refuses to; return the exit code of the process."""
    try:
        content = read()
    except (Refused, GraspFileError) as error:
        sys.stdout.write(str(error))
        return _REFUSED
    pickle.dump(content, sys.stdout.buffer, protocol=4)
    return 0
