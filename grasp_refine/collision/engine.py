"""Choice of the engine for collision queries: the compiled one where available, else the one in Python.

Curvatures, contact forces and steps within bounds follow it, each with a form in Python. Both engines give the same
distances up to rounding; curvatures in Python are fitted in single precision, and forces found to DAQP's tolerance. The
compiled engine is built by `pip install` where there is a C++ compiler, and for one version of coal's library: with
another it is not used, because the layout of coal's classes may differ.
"""

import os
from functools import cache
from importlib.util import find_spec
from typing import Literal, get_args

from grasp_refine.core.errors import CollisionError

Engine = Literal["auto", "native", "python"]
"""The compiled engine, the one in Python, or the fastest available."""

Chosen = Literal["native", "python"]
"""The compiled engine or the one in Python."""

VARIABLE = "GRASP_REFINE_ENGINE"
"""Environment variable that sets the engine for "auto"."""

NATIVE_MODULE = "grasp_refine.collision._native"
"""Module compiled from `native/`."""


def engines() -> tuple[Chosen, ...]:
    """Available engines, the fastest first."""
    return ("python",) if why_not_native() else ("native", "python")


@cache
def why_not_native() -> str:
    """Reason why the compiled engine is not available; empty: it is."""
    if find_spec(NATIVE_MODULE) is None:
        return "not built: with a C++ compiler, such as g++, install grasp-refine again"
    try:
        from grasp_refine.collision import native_search
    except ImportError as error:
        # Built for another system, or a library that it needs is missing.
        return f"does not load: {str(error).strip().splitlines()[0]}"
    return native_search.mismatch()


def chosen(engine: str) -> Chosen:
    """Return the engine used for `engine`, an `Engine`: "native" or "python".

    Raises:
        CollisionError: there is no such engine, or it is not available.
    """
    name, source = engine, "engine"
    if engine == "auto" and VARIABLE in os.environ:
        name, source = os.environ[VARIABLE], VARIABLE
    if name not in get_args(Engine):
        raise CollisionError(f"{source} is '{name}'; choose {', '.join(get_args(Engine))}")
    if name == "native" and why_not_native():
        raise CollisionError(
            f"{source} is 'native', which is not available ({why_not_native()}); choose auto or python"
        )
    return engines()[0] if name == "auto" else "native" if name == "native" else "python"
