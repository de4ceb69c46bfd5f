"""Tests of what the compiled engine promises: in Python, curvatures are fitted in single precision."""

import pytest

from grasp_refine.collision.engine import chosen

COMPILED = chosen("auto") == "native"
"""Whether the tests run with the compiled engine."""

needs_compiled = pytest.mark.skipif(not COMPILED, reason="only the compiled engine rounds alike in any batch and frame")
