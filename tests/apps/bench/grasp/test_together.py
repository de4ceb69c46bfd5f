"""Works in processes of their own: they begin together, and one that fails ends all."""

from __future__ import annotations

import multiprocessing
import os
import time
from functools import partial

import pytest
from grasp_refine.apps.bench.grasp.together import together

from command_line import subprocess_environment


@pytest.fixture(autouse=True)
def findable(monkeypatch: pytest.MonkeyPatch):
    """The children find this module."""
    path = os.pathsep.join([os.path.dirname(__file__), subprocess_environment()["PYTHONPATH"]])
    monkeypatch.setenv("PYTHONPATH", path)
