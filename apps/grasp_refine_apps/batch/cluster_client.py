"""Connection to the scheduler of a Dask cluster."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from distributed import Client
from distributed.comm.addressing import get_address_host_port

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.attempt import message_of

ANSWER_LIMIT_S = 8.0
"""Time limit for an answer of the scheduler, seconds."""


@contextmanager
def connect(address: str) -> Iterator[Client]:
    """Connect to the scheduler at `address`, or to the one that wrote the file of that name; its log is not shown.

    Raises:
        GraspRefineError: No scheduler answers.
    """
    with _silenced_log():
        try:
            if address.endswith(".json"):
                address = str(json.loads(Path(address).read_text(encoding="utf-8"))["address"])
            # A client that finds no scheduler leaves threads behind, so the connection is tested first.
            socket.create_connection(get_address_host_port(address), ANSWER_LIMIT_S).close()
            client = Client(address, timeout=ANSWER_LIMIT_S, set_as_default=False)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise GraspRefineError(
                f"{address}: no Dask scheduler answers ({message_of(error)}); start one with `dask scheduler` and give "
                "its address, such as tcp://host:8786, or the file that it writes with --scheduler-file"
            ) from error
        with client:
            yield client


@contextmanager
def _silenced_log() -> Iterator[None]:
    """Silence the log of Dask meanwhile: users get messages of our own."""
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
