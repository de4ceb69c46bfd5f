"""What tests of the command line share: calls in a process of its own, and refusals of bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import grasp_refine
import grasp_refine_apps
from grasp_refine_apps.cli import main

PROGRAM = "import sys; from grasp_refine_apps.cli import main; sys.exit(main())"


def subprocess_environment() -> dict[str, str]:
    """The environment of a process that imports what is imported here."""
    sources = {str(Path(package.__file__).parents[1]) for package in (grasp_refine, grasp_refine_apps)}
    return os.environ | {"PYTHONPATH": os.pathsep.join(sorted(sources))}


def interruptible() -> None:
    """For `preexec_fn`: tests that run in the background of a script, or under nohup, inherit ignored signals."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command = [sys.executable, "-c", PROGRAM, *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=subprocess_environment())


def refused(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """The one line on stderr with which a command line is refused, without its prefix."""
    before = set(Path().rglob("*"))
    assert main([str(argument) for argument in arguments]) == 2
    out, error = capfd.readouterr()
    assert out == "" or (arguments[0] == "view" and out.count("\n") == 1), "only the viewer tells its address first"
    assert error.count("\n") == 1, error
    assert error.startswith("refine-grasp: error: ")
    assert set(Path().rglob("*")) == before, "bad input must leave no file"
    return error.removeprefix("refine-grasp: error: ").rstrip("\n")


def document(*arguments: str | Path) -> dict[str, Any]:
    """What a run writes as JSON."""
    Path("bench.json").unlink(missing_ok=True)
    assert main([*map(str, arguments), "--json", "bench.json"]) == 0
    return json.loads(Path("bench.json").read_text())
