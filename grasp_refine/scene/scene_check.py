"""Check that the surroundings of an object can be: nothing is inside of it, and something is below it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.units import PLAUSIBLE_DIAGONALS_M, size_text
from grasp_refine.hands.chain import Chain
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.environment import Environment, swept
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import scene_depths

DEEP_M = 0.005
"""Largest depth in metres of an object in a table or a body of the scene; deeper ones are refused."""

OVERLAP_M = 0.0005
"""Depth in metres of an object in a table or a body up to which it stands on it or touches it."""

NEIGHBOUR_M = 0.001
"""Depth in metres of bodies in each other up to which they touch."""

FLOATS_M = 0.005
"""Gap in metres below an object from which on it floats."""

FAR_M = 5.0
"""Largest gap in metres below an object that is measured, and largest size of a body that needs no note."""

SUNK_M = 0.02
"""Depth in metres of palms in a table or a body from which on a note says so, if it is that of all grasps."""

OTHER_SHARE = 1e-3
"""Share of the diagonal by which the bounds of an object may differ from the scene's own."""

MAX_STEPS, TOLERANCE_M = 30, 2e-5
"""Most steps of a lift, and accuracy of lifts and gaps in metres."""

MAX_NAMED = 5
"""Most pairs of bodies in each other that are named, the deepest."""


def surroundings_notes(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Return the notes of `check_object`, `hand_notes` and `body_notes` on the surroundings of objects.

    Args:
        scenes: Grasps of a hand on objects, all on one table or in one environment.

    Raises:
        GraspRefineError: as `check_object`.
    """
    notes = [note for one in scenes for note in check_object(one.object, one.task.plane, one.environment)]
    notes += [note for one in scenes for note in hand_notes(one)]
    if scenes and scenes[0].environment is not None:
        notes += body_notes(scenes[0].environment)
    return tuple(dict.fromkeys(notes))


def check_object(obj: Object, table: Plane | None, environment: Environment | None) -> tuple[str, ...]:
    """Return notes on the place of an object on its table or in its scene, with millimetres.

    Notes are on overlaps of up to `DEEP_M`, on an object that floats, and on one that is too large for a hand. Bodies
    are compared with the pieces of the object, once it is decomposed.

    Args:
        obj: The object at the origin.
        table: A plane in the object's frame.
        environment: Bodies around the object.

    Raises:
        GraspRefineError: the object is deeper than `DEEP_M` in the table or in a body, or is another one, or of
            another size, than that of the scene.
    """
    if environment is not None:
        _check_own(obj, environment)
    found = list(_depths(obj, table, environment))
    deep = [text for depth, text in found if depth > DEEP_M]
    if deep:
        raise GraspRefineError(f"{'; '.join(deep)} (up to {1e3 * DEEP_M:g} mm are accepted)")
    notes = [text for depth, text in found if depth > OVERLAP_M]
    if environment is not None and np.linalg.norm(obj.mesh.extents) > PLAUSIBLE_DIAGONALS_M[1]:
        notes.append(f"{obj.name} is {size_text(obj.mesh.extents)}, no size for a hand: see its scale and unit")
    return (*notes, *_floating(obj, table, environment))


def body_notes(environment: Environment) -> tuple[str, ...]:
    """Return notes on bodies of a scene that are in each other, the deepest first, or larger than `FAR_M`.

    Bodies of boxes that cannot be pushed, such as walls, dividers and tables, may cross.
    """
    names = [body.name for body in environment.bodies]
    first, second = _near_pairs(environment)
    depth = np.zeros(len(first))
    if len(first):
        bodies, T = [body.body for body in environment.bodies], environment.T_object_body
        pairs = Pairs(tuple(bodies[i] for i in first), tuple(bodies[j] for j in second))
        found = query(pairs, T[None, first], T[None, second], cutoff=0.0)
        depth = np.where(found.valid, -found.distance, 0.0)[0]
    order = [k for k in np.argsort(-depth, kind="stable").tolist() if depth[k] > NEIGHBOUR_M]
    notes = [
        f"'{names[first[k]]}' and '{names[second[k]]}' are {1e3 * depth[k]:.1f} mm in each other"
        for k in order[:MAX_NAMED]
    ]
    if len(order) > MAX_NAMED:
        notes.append(f"{len(order) - MAX_NAMED} more pairs of bodies are in each other")
    for name, body in zip(names, environment.bodies, strict=True):
        extents = np.ptp(_box(body.body, np.eye(4)), axis=0)
        if extents.max() > FAR_M:
            notes.append(f"'{name}' is {size_text(extents)}: see its scale and unit")
    return tuple(notes)


def hand_notes(scene: Scene) -> tuple[str, ...]:
    """Return a note where the palm of every grasp is deeper than `SUNK_M` in the table, or in a body of the scene."""
    hand, posed = scene.hand, scene.masked(scene.posed)
    palm = hand.links_by_name[hand.palm]
    if palm.body is None or not scene.posed.any():
        return ()
    T = Chain(hand, (hand.palm,))(posed.T_world_root[scene.posed], posed.q[scene.posed]).T_world_link
    where, depth = "", np.zeros(len(T))
    if scene.task.plane is not None:
        where, depth = "the table", -scene.task.plane.heights((palm.solid,), T)[0][:, 0]
    elif scene.environment is not None and scene.environment.bodies:
        found = scene_depths(scene.environment, (palm.solid,), T)
        where, depth = f"'{scene.environment.bodies[found.body[found.depth.argmax()]].name}'", found.depth
    if not (depth > SUNK_M).all():
        return ()
    return (f"the palm of every grasp is in {where}, {1e3 * depth.min():.0f} mm deep or more",)


def _check_own(obj: Object, environment: Environment) -> None:
    """Refuse another object than that of the scene, or another size of it.

    Raises:
        GraspRefineError: names both sizes, and the ways out.
    """
    if environment.object is None:
        return
    # Bounds do not depend on the treatment of holes.
    own = load_object(environment.object, scale=environment.scale, unit="m", holes="hull")
    share = float(np.linalg.norm(own.mesh.extents)) * OTHER_SHARE
    if np.abs(own.mesh.bounds - obj.mesh.bounds).max() > share:
        raise GraspRefineError(
            f"{obj.name} is {size_text(obj.mesh.extents)}, or has another origin than the object of scene "
            f"{environment.name}: {environment.object}, {size_text(own.mesh.extents)}: leave out `scale` and `unit`, "
            "or take scene.load_object(); a scene whose [object] has no name takes any"
        )


def _depths(obj: Object, table: Plane | None, environment: Environment | None) -> Iterator[tuple[float, str]]:
    """Yield depths of an object in metres in the table and in bodies, above 0, and texts on them."""
    if table is not None:
        height = _height(obj, table)
        yield (
            -height,
            f"{obj.name} is {-1e3 * height:.1f} mm deep in the table at {table.offset:g} m: give "
            f"`table={round(table.offset + height, 4) + 0.0:.4f}` or less",
        )
    if environment is None or not environment.bodies or obj.rough:
        return
    names, depths = [one.name for one in environment.bodies], -_distances(obj.body, environment)
    for at in np.flatnonzero(depths > OVERLAP_M).tolist():
        depth, lift = float(depths[at]), _lift(obj.body, environment, at)
        if lift <= 2.0 * depth:
            yield lift, f"{obj.name} is sunk {1e3 * lift:.1f} mm into '{names[at]}': raise it by as much"
        else:
            yield depth, f"{obj.name} and '{names[at]}' are {1e3 * depth:.1f} mm in each other: move one of them"


def _floating(obj: Object, table: Plane | None, environment: Environment | None) -> tuple[str, ...]:
    """Return a note on the gap below an object, if it is above `FLOATS_M`."""
    if table is not None:
        height = _height(obj, table)
        return (f"{obj.name} floats {1e3 * height:.1f} mm above the table",) if height > FLOATS_M else ()
    if environment is None or not environment.bodies or obj.rough or _is_supported(obj.body, environment):
        return ()
    gap = _gap_below(obj.body, environment)
    if gap <= FLOATS_M:
        return ()
    if gap >= FAR_M:
        return (f"nothing is below {obj.name} in scene {environment.name}: it would fall",)
    return (f"{obj.name} floats {1e3 * gap:.1f} mm above the body below it in scene {environment.name}",)


def _height(obj: Object, table: Plane) -> float:
    """Return the signed distance in metres of the object's surface from the table."""
    return float(np.min(obj.mesh.vertices @ np.asarray(table.normal)) - table.offset)


def _distances(
    body: Body, environment: Environment, shift: float = 0.0, chosen: Int[np.ndarray, " K"] | None = None
) -> Float[np.ndarray, " K"]:
    """Return signed distances (K,) in metres of bodies of a scene from the object, which is shifted up."""
    rows = np.arange(len(environment.bodies)) if chosen is None else chosen
    T_body, T = environment.T_object_body[rows], np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, 3] = shift * environment.up
    pairs = Pairs(tuple(environment.bodies[k].body for k in rows.tolist()), (body,) * len(rows))
    found = query(pairs, T_body[None], T[None], cutoff=FLOATS_M)
    return np.where(found.valid, found.distance, np.inf)[0]


def _lift(body: Body, environment: Environment, at: int) -> float:
    """Return the distance up in metres over which the object leaves a body.

    Pieces that overlap by a depth do so until they have moved by that depth at least, in whatever direction.
    """
    lift = 0.0
    for _ in range(MAX_STEPS):
        depth = -float(_distances(body, environment, lift, np.array([at]))[0])
        if depth <= TOLERANCE_M:
            return lift
        lift += depth
    return np.inf


def _is_supported(body: Body, environment: Environment) -> bool:
    """Return whether a body is met, or met more deeply, when the object sinks by `FLOATS_M`."""
    here, below = _distances(body, environment), _distances(body, environment, -FLOATS_M)
    return bool(((below <= 0.0) & (below < here - OVERLAP_M)).any())


def _gap_below(body: Body, environment: Environment) -> float:
    """Return the distance down in metres, up to `FAR_M`, at which the object meets a body."""

    def meets(distance: float) -> bool:
        down = -distance * environment.up
        moved = replace(body, pieces=tuple(swept(piece, down) for piece in body.pieces))
        return bool((_distances(moved, environment)[beside] <= 0.0).any())

    # What is met already, as a wall is, holds nothing.
    beside = _distances(body, environment) > 0.0
    low, high = 0.0, FAR_M
    if not meets(high):
        return high
    while high - low > TOLERANCE_M:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if meets(middle) else (middle, high)
    return high


def _near_pairs(environment: Environment) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs (P,) of bodies that may not cross and whose bounding boxes do, the first before the second."""
    placed = zip(environment.bodies, environment.T_object_body, strict=True)
    boxes = np.array([_box(one.body, T) for one, T in placed]).reshape(-1, 2, 3)
    built = np.array(
        [
            not one.movable and all(piece.radius == 0.0 and len(piece.vertices) == 8 for piece in one.body.pieces)
            for one in environment.bodies
        ]
    )
    rows, columns = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for k, (low, high) in enumerate(boxes):
        rest = boxes[k + 1 :]
        meets = ((rest[:, 0] <= high) & (rest[:, 1] >= low)).all(axis=1)
        near = np.flatnonzero(meets & ~(built[k] & built[k + 1 :]))
        rows.append(np.full(len(near), k))
        columns.append(k + 1 + near)
    return np.concatenate(rows), np.concatenate(columns)


def _box(body: Body, T: np.ndarray) -> np.ndarray:
    """Return the corners (2, 3) of the bounding box of a body."""
    corners = np.array([piece.transformed(T).bounds for piece in body.pieces])
    return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])
