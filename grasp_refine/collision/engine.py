"""Which engine answers collision queries: the compiled one where it is there, else the one in Python.

Both give the same answers to rounding. The compiled one is built by `pip install` where there is a C++ compiler, and
for one version of coal's library: with another it is left alone, because the layout of coal's classes may differ.
"""

import os
from functools import cache
from importlib.util import find_spec
from typing import Literal, get_args

from grasp_refine.core.errors import CollisionError

Engine = Literal["auto", "native", "python"]
"""The compiled engine, the one in Python, or what is there."""

Chosen = Literal["native", "python"]
"""One of the two."""

VARIABLE = "GRASP_REFINE_ENGINE"
"""Environment variable that says what "auto" means."""

COMPILED = "grasp_refine.collision._native"
"""The module that `native/` becomes."""


def engines() -> tuple[Chosen, ...]:
    """The engines that are there, the fastest first."""
    return ("python",) if why_not_native() else ("native", "python")


@cache
def why_not_native() -> str:
    """Why the compiled engine is not there; empty where it is."""
    if find_spec(COMPILED) is None:
        return "not built: with a C++ compiler, such as g++, install grasp-refine again"
    try:
        from grasp_refine.collision import native_search
    except ImportError as error:
        # Built for another system, or a library that it needs is gone.
        return f"does not load: {str(error).strip().splitlines()[0]}"
    return native_search.mismatch()


def chosen(engine: str) -> Chosen:
    """The engine that is used where `engine`, an `Engine`, is asked for: "native" or "python".

    Raises:
        CollisionError: there is no such engine, or it is not there.
    """
    asked, where = engine, "engine"
    if engine == "auto" and VARIABLE in os.environ:
        asked, where = os.environ[VARIABLE], VARIABLE
    if asked not in get_args(Engine):
        raise CollisionError(f"{where} is '{asked}'; choose {', '.join(get_args(Engine))}")
    if asked == "native" and why_not_native():
        raise CollisionError(f"{where} is 'native', which is not there ({why_not_native()}); choose auto or python")
    return engines()[0] if asked == "auto" else "native" if asked == "native" else "python"
