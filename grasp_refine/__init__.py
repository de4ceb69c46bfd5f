"""grasp-refine: refine the grasps of a robot hand with differentiable collision detection.

Importing the package loads nothing else: its names (`__all__`) are loaded when they are used. They are all that most
scripts need:

    import grasp_refine as gr

    hand, mug = gr.load_hand("allegro"), gr.load_object("mug")
    grasps = gr.sample_grasps(hand, mug, 16)      # or gr.load_grasps("mine.npz"), or gr.GraspSet.of(hand, pose, q)
    refined = gr.refine(hand, mug, grasps)
    print(refined)
    refined.save("refined.npz")

These conventions hold in every file;
`tests/test_conventions.py` runs the examples and checks each statement.

**Units.** SI everywhere: metres, radians, kilograms, newtons. Prismatic joints are in metres. Millimetres and degrees
appear only in what a person reads. A loss is a sum of squares in m^2.

**Frames.** The world frame is the object's frame: the object rests at the identity, and a table or another body is
expressed in it. `T_world_link` (4, 4) maps link coordinates to world coordinates, and frames chain by their
neighbouring names:

    point_world = T_world_link @ point_link        T_world_link = T_world_root @ T_root_link(q)

The *root* is the hand's base link. Its frame is the link's frame in the URDF; joints above it do not move. A point,
normal or twist carries its frame in its name, or is in the world frame.

**Joint values** `q` (..., n) are in the order of `hand.joint_names`, which are the independent joints: joints
that follow another one (mimic) are left out. Files name their joints; values are matched by name, never by place.

**Quaternions** are (w, x, y, z), of unit length, for active rotations: p' = q p q^-1. q and -q are the same rotation;
we write w >= 0. A pose as seven numbers is (x, y, z, qw, qx, qy, qz). Files of others may have
(x, y, z, w); ours never do. A quarter turn about z takes x to y:

    >>> from math import sqrt
    >>> import numpy as np
    >>> import grasp_refine as gr
    >>> T = gr.transform_from_pose(np.array([0.1, 0.0, 0.0, sqrt(0.5), 0.0, 0.0, sqrt(0.5)]))
    >>> gr.transform_points(T, np.array([1.0, 0.0, 0.0])).round(9).tolist()
    [0.1, 1.0, 0.0]

**Twists** are (v, w), linear part first. A *spatial* twist is expressed in the world frame, at the world's origin: a
point p of the body has the velocity V(p) = v + w x p, and T moves as exp(t xi) T. A *body* twist is expressed in the
body's frame: T moves as T exp(t xi). They are the same motion where xi_spatial = Ad(T) xi_body, with

    Ad(T) = [[R, [p] R], [0, R]]        [p] u = p x u

because T exp(xi) T^-1 = exp(Ad(T) xi). Jacobians and derivative methods are spatial, steps of descent are body twists.

**Wrenches** are (f, m), moments about the world's origin: the derivative of a loss along a spatial twist is
dL = f . v + m . w. A covector f on a point p is the wrench (f, p x f), since f . V(p) = f . v + (p x f) . w.

**Contact.** For bodies a and b, n is the unit normal from a to b, and the signed distance is d = n . (x_b - x_a) at
the witness points x_a and x_b: positive apart, where they are the closest points, and negative in penetration, where
they are the deepest ones; n points from a to b in both. Turned round, n reverses and d stays:

    >>> ball = gr.load_object("sphere:0.02").body
    >>> T_a = np.eye(4)[None, None]             # (batch, pair, 4, 4)
    >>> T_b = T_a.copy()
    >>> T_b[..., 0, 3] = 0.05                   # its centre 5 cm along x, so that the gap is 1 cm
    >>> witness = gr.query(gr.Pairs((ball,), (ball,)), T_a, T_b)
    >>> witness.normal[0, 0].round(9).tolist(), float(witness.distance[0, 0].round(9))
    ([1.0, 0.0, 0.0], 0.01)

While both bodies move, d' = n . (V_b(x_b) - V_a(x_a)), exactly: the points slide across n, which changes no distance to
first order. In a hand, a is the link and b the object, so that a link pushes the object along n. The contact margin is
the signed distance, at least 0, that is aimed at.

**Arrays** have their batch first: (batch, pair, 3) for points of pairs. Shapes stand in docstrings and annotations.
Where there is no answer, a status or a mask says so. NaN in an array of targets means that there is none. Arguments may
be lists, NumPy arrays or torch tensors of any number type; `Scene` and `metrics` take poses (N, 7) too, and one grasp
without its batch dimension:

    >>> hand = gr.load_hand("allegro")
    >>> gr.Scene(hand, gr.load_object("mug"), np.array([0.1, 0, 0, 1, 0, 0, 0]), hand.rest)
    Scene(allegro on mug: 1 grasp)

**Numbers.** float64 by default, float32 on request; collision queries run in float64 always. Seeds, device and dtype
travel with the scene: same seed, same machine, same result.

**Errors.** What a file or an argument can get wrong is a `GraspRefineError` of one
line, raised where it comes in. Not converging is a status of the result, which its `labels` say in words.
"""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")

_MODULE_OF = {name: module for module, name in re.findall(r"^from (\S+) import (\w+)", _STUB, re.MULTILINE)}
"""Modules of the names below, which are loaded when one of them is used (PEP 562)."""

__all__ = [*sorted(_MODULE_OF), "__version__"]  # noqa: PLE0604 - all are strings


def __getattr__(name: str) -> Any:
    """Load a name of the vocabulary, or read `__version__` from the installed metadata, when it is used first.

    Raises:
        AttributeError: there is no such name.
    """
    if name in _MODULE_OF:
        value = getattr(import_module(_MODULE_OF[name]), name)
    elif name == "__version__":
        value = import_module("grasp_refine.core.versions").own_version()
    else:
        raise AttributeError(f"module 'grasp_refine' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names of the vocabulary, and nothing else, for completion."""
    return __all__
