"""Problems on arms: grasps of a hand become grasps of the hand on an arm, whose base stands in the object's frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text, first_of
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.grasps.on_arm import ROOM_M, ArmClearance, on_arm
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.hands.self_collision import self_penetration
from grasp_refine.objects.object import Object
from grasp_refine.problem.problem import Group, Problem, scene_of
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Surroundings, scene_depths
from grasp_refine.scene.task import Task

BLOCK_ARMS = 64
"""Number of arms that are measured at a time, which bounds the memory."""

MAX_REASONS = 5
"""Number of grasps out of reach whose reasons are noted; the others are counted."""

MAX_SUNK_M = 0.02
"""Depth of the base in a body of the scene, in metres, from which on it is reported: bases stand on tables, not in
them."""


def check_base(problem: Problem) -> None:
    """Refuse grasps of the hand alone on an arm without a place.

    Raises:
        GraspRefineError: names the option.
    """
    hand = problem.hand
    if problem.task.base is None and any(group.grasps.base_link != hand.base_link for group in problem.groups):
        raise GraspRefineError(
            f"where the base of the arm, its link '{hand.base_link}', stands is needed, in the frame of the object or "
            "the world of the scene: `base` x,y,z,roll,pitch,yaw (metres, degrees), as in `base='-0.5,0,0,0,0,0'`"
        )


def problem_on_arm(problem: Problem, *, seed: int = 0) -> Problem:
    """Return the grasps of a hand as grasps of the hand on an arm, solved by inverse kinematics.

    Args:
        problem: The hand on its arm, and grasps of the hand alone, or such as begin at the base of the arm already;
            without an arm, the problem is returned as it is.
        seed: Seed of the starts of the inverse kinematics.
    """
    hand = problem.hand
    if hand.arm is None:
        return problem
    groups, notes, beyond, count = [], [*hand.notes], 0, 0
    for group in problem.groups:
        placed, some_notes = group_on_arm(group, hand, seed=seed)
        notes += some_notes
        groups.append(placed)
        beyond, count = beyond + int(placed.scene.out_of_reach.sum()), count + len(placed.rows)
    if beyond:
        notes.append(f"{beyond} of {count_text(count, 'grasp')} out of reach of the arm")
        notes += first_of(out_of_reach_texts(problem.groups, groups, seed), MAX_REASONS)
    return replace(problem, groups=tuple(groups), notes=tuple(dict.fromkeys((*problem.notes, *notes))))


def group_on_arm(group: Group, hand: Hand, *, seed: int = 0) -> tuple[Group, tuple[str, ...]]:
    """Return the grasps of a group on an arm, and notes."""
    scene, T_object_base = group.scene, group.scene.task.T_object_base
    clearance = arm_clearance(hand, scene.object, scene.task)
    grasps, notes = on_arm(group.grasps, hand, T_object_base, clearance=clearance, seed=seed)
    notes = (*notes, *_sunk_notes(hand, T_object_base, scene))
    columns = [grasps.joint_names.index(name) for name in hand.joint_names]
    moved = scene_of(hand, scene.object, grasps, grasps.q[:, columns], scene.task)
    return replace(group, scene=replace(moved, original=scene.original), grasps=grasps), notes


def _sunk_notes(hand: Hand, T_object_base: Float[np.ndarray, "4 4"], scene: Scene) -> tuple[str, ...]:
    """Return notes where the standing links of an arm are deep in the object, the table or a body of the scene."""
    assert hand.arm is not None
    names = [link.name for link in hand.links if link.body is not None and link.name in hand.arm.standing]
    if not names:
        return ()
    return tuple(
        f"link '{link}', on which the arm stands, is {1e3 * depth:.0f} mm inside {what}: move its base (`base`)"
        for what, depth, link in deepest(hand, names, T_object_base, hand.rest, scene)
        if depth > MAX_SUNK_M
    )


def deepest(
    hand: Hand, names: Sequence[str], T_object_base: np.ndarray, q: np.ndarray, scene: Scene
) -> list[tuple[str, float, str]]:
    """Return how deep some links are in the object, the table and the bodies of a scene, which is negative outside.

    Args:
        hand: The hand on its arm.
        names: Links with collision geometry, at least one.
        T_object_base: Pose (4, 4) of the base in the object's frame.
        q: Joint values (n,).
        scene: Object, table and bodies.

    Returns:
        Name of each, the largest depth in metres, and the link that has it.
    """
    T_link = Chain(hand, tuple(names))(T_object_base[None], q[None]).T_world_link
    bodies, found = tuple(hand.links_by_name[name].solid for name in names), list[tuple[str, float, str]]()
    witness = query(Pairs.against(bodies, scene.object.body), T_link, np.broadcast_to(np.eye(4), T_link.shape))
    distance = np.where(witness.valid, witness.distance, np.inf)[0]
    found.append((scene.object.name, -float(distance.min()), names[int(distance.argmin())]))
    if scene.table is not None:
        height = scene.table.heights(bodies, T_link)[0][0]
        found.append(("the table", -float(height.min()), names[int(height.argmin())]))
    if scene.environment is not None and scene.environment.bodies:
        depths = scene_depths(scene.environment, bodies, T_link)
        name = scene.environment.bodies[depths.body[0]].name
        found.append((f"body '{name}' of the scene", float(depths.depth[0]), names[int(depths.link[0])]))
    return found


def out_of_reach_texts(alone: Sequence[Group], placed: Sequence[Group], seed: int = 0) -> list[str]:
    """Return why grasps are out of reach, a text for each: how far the palm stays away, or which link meets what.

    Args:
        alone: Grasps of the hand alone.
        placed: The same grasps on the arm.
        seed: Seed of the starts of the inverse kinematics.
    """
    texts = []
    for original, group in zip(alone, placed, strict=True):
        scene, rows = group.scene, np.flatnonzero(group.scene.out_of_reach)
        if original.grasps.base_link == scene.hand.base_link:
            continue
        label = f"{group.object} " if len(placed) > 1 else ""
        T_palm = transform_from_pose(original.grasps.hand_pose)
        for row in rows[:MAX_REASONS].tolist():
            why = _why_out_of_reach(scene, scene.T_world_root[row], scene.q[row], T_palm[row], seed)
            texts.append(f"grasp {label}{group.index[row]} out of reach: {why}")
        texts += [f"grasp {label}{group.index[row]} out of reach" for row in rows[MAX_REASONS:].tolist()]
    return texts


def _why_out_of_reach(scene: Scene, T_base: np.ndarray, q: np.ndarray, T_palm: np.ndarray, seed: int) -> str:
    hand, kinematics = scene.hand, ArmKinematics(scene.hand)
    own = q[None, ~hand.arm_joints]
    found = kinematics.solve(T_base, own, T_palm[None], seed=seed)
    solutions = found.q[0][np.isfinite(found.q[0]).all(axis=1)]
    if not len(solutions):
        metres, radians = kinematics.shortfall(T_base[None], own, T_palm[None], seed=seed)[0]
        return f"the palm stays {1e3 * metres:.0f} mm and {np.degrees(radians):.0f} degrees away"
    arm = hand.arm
    assert arm is not None
    moving = [link.name for link in hand.links if link.body is not None and link.name in arm.links - arm.standing]
    met = []
    for values in solutions:
        # A solution is as bad as its deepest collision.
        own_depths = [(float(self_penetration(hand, (pair,), values[None])[0]), *pair) for pair in kinematics.pairs]
        around = deepest(hand, moving, T_base, values, scene) if moving else []
        met.append(max([*own_depths, *((depth, link, what) for what, depth, link in around)], default=(0.0, "", "")))
    depth, first, second = min(met)
    return (
        f"{first} and {second} would be {1e3 * depth:.1f} mm in each other, in the best of "
        f"{count_text(len(solutions), 'configuration')} of the arm"
    )


def reach_of(problem: Problem, seed: int = 0) -> Callable[[GraspSet, Scene], Bool[np.ndarray, " N"]] | None:
    """Return a mask (N,) of grasps of the hand alone, in a scene, that the hand on its arm reaches; None: it has none.

    Args:
        problem: The hand on its arm.
        seed: Seed of the starts of the inverse kinematics.
    """
    hand = problem.hand
    if hand.arm is None or problem.task.base is None:
        return None

    def reaches(grasps: GraspSet, scene: Scene) -> Bool[np.ndarray, " N"]:
        clearance = arm_clearance(hand, scene.object, scene.task)
        placed, _ = on_arm(grasps, hand, scene.task.T_object_base, clearance=clearance, seed=seed)
        return np.isfinite(placed.q).all(axis=1)

    return reaches


def arm_clearance(hand: Hand, obj: Object, task: Task) -> ArmClearance:
    """Return the function that measures the distance of the moving arm links from object, table and other bodies."""
    arm = hand.arm
    assert arm is not None
    moving = arm.links - arm.standing
    links = tuple(link.name for link in hand.links if link.body is not None and link.name in moving)
    bodies = tuple(hand.links_by_name[name].solid for name in links)
    chain, pairs = Chain(hand, links), Pairs.against(bodies, obj.body) if links else None
    table, around = task.plane_under(obj), None
    if task.environment is not None:
        around = Surroundings.measured(task.environment, bodies)

    def clearance(T: Float[np.ndarray, "M 4 4"], q: Float[np.ndarray, "M n"]) -> Float[np.ndarray, " M"]:
        room = np.full(len(q), ROOM_M)
        if pairs is None:
            return room
        T_link = chain(T, q).T_world_link
        found = query(pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape), cutoff=ROOM_M)
        room = np.minimum(room, np.where(found.valid, found.distance, ROOM_M).min(axis=1))
        if table is not None:
            room = np.minimum(room, table.heights(bodies, T_link)[0].min(axis=1))
        if around is not None:
            for rows in np.split(np.arange(len(q)), range(BLOCK_ARMS, len(q), BLOCK_ARMS)):
                near = around.near(T_link[rows], ROOM_M, most=1)
                nearest = np.where(near.column >= 0, near.witness.distance, ROOM_M).min(axis=1)
                room[rows] = np.minimum(room[rows], nearest)
        return room

    return clearance
