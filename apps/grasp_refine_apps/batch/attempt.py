"""One try of a shard, of which always something comes that can be told: what was done, or why it failed."""

from __future__ import annotations

import pickle
from traceback import format_exception

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.shard import Done, Failed, Heartbeat, Shard, Work

_LONGEST_MESSAGE, _LONGEST_TRACEBACK = 500, 20_000


def attempt(work: Work, shard: Shard, heartbeat: Heartbeat) -> Done | Failed:
    """What comes of a shard; whatever the work raises is a Failed, which can be pickled whatever was raised."""
    try:
        done = work(shard, heartbeat)
        pickle.dumps(done)
        return done
    except Exception as error:
        return Failed(shard.number, "error", message_of(error), traceback_of(error), tries=1)


def message_of(error: BaseException) -> str:
    """One line: what a GraspRefineError says; of any other, its type, too."""
    try:
        said = str(error)
    except Exception:
        said = "it cannot say what went wrong"
    name = "" if isinstance(error, GraspRefineError) else type(error).__name__
    line = ": ".join(filter(None, [name, " ".join(said.split())]))
    return line if len(line) <= _LONGEST_MESSAGE else f"{line[:_LONGEST_MESSAGE]} ..."


def traceback_of(error: BaseException) -> str:
    """Where it was raised; of a long one the end."""
    text = "".join(format_exception(error)).strip()
    return text if len(text) <= _LONGEST_TRACEBACK else f"... {text[-_LONGEST_TRACEBACK:]}"
