"""One attempt at a shard, which always ends with a result: the work done, or the reason of the failure."""

from __future__ import annotations

import pickle
from traceback import format_exception

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.shard import Done, Failed, Heartbeat, Shard, Work

_MAX_MESSAGE_CHARACTERS, _MAX_TRACEBACK_CHARACTERS = 500, 20_000


def attempt(work: Work, shard: Shard, heartbeat: Heartbeat) -> Done | Failed:
    """Work on a shard; return its result, or a Failed for any exception, which can be pickled whatever was raised."""
    try:
        done = work(shard, heartbeat)
        pickle.dumps(done)
        return done
    except Exception as error:
        return Failed(shard.number, "error", message_of(error), traceback_of(error), tries=1)


def message_of(error: BaseException) -> str:
    """One-line message of an exception, with its type unless it is a GraspRefineError."""
    try:
        text = str(error)
    except Exception:
        text = "its message cannot be printed"
    name = "" if isinstance(error, GraspRefineError) else type(error).__name__
    line = ": ".join(filter(None, [name, " ".join(text.split())]))
    return line if len(line) <= _MAX_MESSAGE_CHARACTERS else f"{line[:_MAX_MESSAGE_CHARACTERS]} ..."


def traceback_of(error: BaseException) -> str:
    """Traceback of an exception; of a long one the end."""
    text = "".join(format_exception(error)).strip()
    return text if len(text) <= _MAX_TRACEBACK_CHARACTERS else f"... {text[-_MAX_TRACEBACK_CHARACTERS:]}"
