"""Annotations of arrays: jaxtyping checks them where it was loaded before, and is not loaded elsewhere."""

from __future__ import annotations

import subprocess
import sys

import pytest

from command_line import subprocess_environment

CALL = """
import sys
import numpy as np
from grasp_refine.core.rpy_poses import rpy_from_transform
print("jaxtyping" in sys.modules)
rpy_from_transform(np.eye({size}))
"""

HOOK = """
from jaxtyping import install_import_hook
install_import_hook("grasp_refine", "beartype.beartype")
"""


@pytest.mark.parametrize(
    ("code", "answer", "error"),
    [
        (CALL.format(size=5), "False", ""),
        (HOOK + CALL.format(size=4), "True", ""),
        (HOOK + CALL.format(size=5), "True", "TypeCheckError"),
    ],
)
def test_shapes_are_checked_where_jaxtyping_is_loaded(code: str, answer: str, error: str):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=subprocess_environment())
    assert result.stdout.split() == [answer] and error in result.stderr and bool(result.stderr) == bool(error)
