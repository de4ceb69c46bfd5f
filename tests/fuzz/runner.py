"""Fuzzing in a process of its own, so that one that crashes or hangs is a finding and not the end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

WALL_LIMIT_S = 300.0
"""Seconds beyond its time after which a process is ended; inputs have 10 s of CPU, machines may be busy."""


@dataclass(frozen=True)
class Finding:
    """An input that a reader did not cope with."""

    kind: str
    """Name of an exception, or crash, hang, memory, outside, message, warning, noise."""
    where: str
    """Place that tells it from others of its kind."""
    details: str
    """Traceback, message, or name of what was opened."""
    name: str
    """Name of the file."""
    content: bytes
    """Contents of the file."""


@dataclass
class Outcome:
    """Result of fuzzing one reader."""

    reader: str
    executions: int = 0
    refused: int = 0
    """Number of executions that ended in a named error."""
    endings: int = 0
    """Number of different ways, by the lines of the code, in which inputs ended."""
    findings: list[Finding] = field(default_factory=list)


def fuzz(
    reader: str, *, seed: int = 0, seconds: float = 60.0, most: int = 10**9, module: str = "fuzz.readers"
) -> Outcome:
    """Feed a reader in the READERS of a module for some seconds, or so many inputs, whichever ends first.

    A crash or a hang that the process does not survive ends it too.
    """
    outcome = Outcome(reader)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        with (folder / "noise").open("wb") as noise:
            child = subprocess.Popen(
                [sys.executable, "-m", "fuzz", "--child", module, reader, name, str(seed), str(seconds), str(most)],
                env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"},
                cwd=Path(__file__).parents[2],
                stdin=subprocess.DEVNULL,
                stdout=noise,
                stderr=noise,
            )
            try:
                code = child.wait(seconds + WALL_LIMIT_S)
            except subprocess.TimeoutExpired:
                child.kill()
                code = child.wait()
        noise_text = (folder / "noise").read_text(errors="replace")[-3000:]
        if not (folder / "current").is_file():
            raise RuntimeError(f"{reader}: {noise_text}")
        for line in (folder / "findings").read_text(encoding="utf-8").splitlines():
            found = json.loads(line)
            outcome.findings.append(Finding(**found | {"content": bytes.fromhex(found["content"])}))
        state, _, content = (folder / "current").read_bytes().partition(b"\n")
        file, outcome.executions, outcome.refused, outcome.endings = json.loads(state)
        if code != 0:
            kind = "hang" if code == -9 else "crash"
            outcome.findings.append(Finding(kind, f"exit code {code}", noise_text, file, content))
    return outcome
