"""Results of slow functions of the library that many tests call with the same arguments, each computed once.

The tests of these functions call them where they are defined, not as the modules below import them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import trimesh

from grasp_refine.geometry import body
from grasp_refine.geometry.covering import Covering
from grasp_refine.hands import hand
from grasp_refine.hands.files import link_geometry
from grasp_refine.hands.files.shape import Primitive
from grasp_refine.objects import object, seen


def arrays(value: Any) -> Iterator[Any]:
    """Arrays and other values that a value consists of."""
    if isinstance(value, trimesh.Trimesh):
        yield from (np.asarray(value.vertices), np.asarray(value.faces))
    elif is_dataclass(value):
        for each in fields(value):
            yield from arrays(getattr(value, each.name))
    elif isinstance(value, list | tuple):
        yield len(value)
        for each in value:
            yield from arrays(each)
    else:
        yield value


def digest(value: Any) -> bytes:
    """Hash of the content of a value."""
    found = hashlib.blake2b()
    for each in arrays(value):
        array = isinstance(each, np.ndarray)
        found.update(f"{each.dtype} {each.shape}".encode() + each.tobytes() if array else f"{each!r};".encode())
    return found.digest()


def once(function: Callable[..., Any], kept: Callable[[Any], bool] = lambda found: True) -> Callable[..., Any]:
    """Return the function with its results remembered by the content of its arguments, read only, where they are kept.

    Places to store results and to report progress are no part of the content.
    """
    known: dict[bytes, Any] = {}

    def remembering(*given: Any, **options: Any) -> Any:
        named = [(name, value) for name, value in options.items() if name not in ("cache", "progress", "name")]
        key = digest((given, named))
        if key in known:
            return known[key]
        found = function(*given, **options)
        if kept(found):
            known[key] = found
            for each in arrays(found):
                if isinstance(each, np.ndarray):
                    each.flags.writeable = False
        return found

    return remembering


def is_hull(found: Covering) -> bool:
    """Whether the pieces of a mesh are its hull: others are in a cache, and are reported."""
    return len(found.pieces) == 1 and not found.trouble


@contextmanager
def remembered() -> Iterator[None]:
    """Remember pieces and bodies of links and objects, surface points, and solids of scans."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(body, "sample", once(body.sample))
        patch.setattr(hand, "build_body", once(hand.build_body))
        patch.setattr(object, "build_body", once(object.build_body))
        patch.setattr(link_geometry, "covering", once(link_geometry.covering, is_hull))
        patch.setattr(Primitive, "piece", once(Primitive.piece))
        patch.setattr(seen, "complete", once(seen.complete))
        yield
