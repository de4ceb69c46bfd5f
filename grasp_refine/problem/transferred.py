"""Transferred grasps as a problem: grasps of another hand become grasps of this one, on the same objects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from grasp_refine.core.array_records import index_distinct, join, take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.transfers.hand_frame import HandFrame
from grasp_refine.transfers.key_points import MANO, KeyPoints
from grasp_refine.transfers.merging import merged
from grasp_refine.transfers.mirror import mirror_plane, mirrored
from grasp_refine.transfers.source_grasps import SourceGrasps, source_grasps
from grasp_refine.transfers.transfer import Place, transfer_grasps


def to_transfer(group: Group, hand: Hand, task: Task, source: Scene | KeyPoints) -> Group:
    """Return a group whose grasps are to be transferred to a hand; until then that is at rest at the origin.

    Args:
        group: Object and numbers of the grasps.
        hand: The hand.
        task: What the grasps must do, and where.
        source: Grasps of another hand.
    """
    T, q = at_rest(hand, len(group.rows))
    return _group(replace(group, scene=replace(group.scene, task=task)), hand, T, q, source)


def at_rest(hand: Hand, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `count` poses (N, 4, 4) and joint values (N, n) of a hand at rest at the origin."""
    return np.tile(np.eye(4), (count, 1, 1)), np.tile(hand.rest, (count, 1))


def transferred(
    problem: Problem, hand: Hand, points: KeyPoints | None = None, *, place: Place = transfer_grasps
) -> Problem:
    """Return the grasps of a problem, or in their places the grasps of a human hand, transferred to a hand.

    `place` brings grasps to the hand.

    Raises:
        GraspRefineError: one of the hands is on an arm, or cannot grip.
    """
    for one in (problem.hand, hand):
        if one.arm is not None:
            raise GraspRefineError(f"{one.name} is on an arm: transfer grasps of the hand alone, then mount the hand")
    groups = tuple(
        to_transfer(group, hand, group.scene.task, group.scene if points is None else take(points, group.rows))
        for group in problem.groups
    )
    return with_transfers(replace(problem, hand=hand, groups=groups, notes=(*problem.notes, *hand.notes)), place)


def with_transfers(problem: Problem, place: Place = transfer_grasps) -> Problem:
    """Return the problem with its grasps transferred from their sources by `place`.

    Raises:
        HandError: no joint of a hand moves a link that is meant to touch.
    """
    hand = problem.groups[0].scene.hand
    sources = [group.source for group in problem.groups if group.source is not None]
    assert len(sources) == len(problem.groups)
    objects, number = index_distinct([group.scene.object for group in problem.groups])
    parts, notes = list[SourceGrasps](), list[str]()
    for group, source in zip(problem.groups, sources, strict=True):
        obj = group.scene.object
        found = source_grasps(source) if isinstance(source, Scene) else source.source_grasps(obj)
        part, some_notes = _on_side(found, hand, obj)
        # Jaws are a thumb and one finger.
        parts.append(merged(part, obj) if HandFrame.of(hand).thumb == "none" != part.thumb else part)
        notes += some_notes
    scenes = [source for source in sources if isinstance(source, Scene)]
    joints = (scenes[0].hand, np.concatenate([scene.q for scene in scenes])) if scenes else None
    prepared = HandObject(hand, objects[0], others=objects[1:])
    counts = [len(group.rows) for group in problem.groups]
    moved = place(join(*parts), prepared, np.repeat(number, counts), joints)
    groups, begin = [], 0
    for group in problem.groups:
        some = take(moved, slice(begin, begin + len(group.rows)))
        begin += len(group.rows)
        placed = _group(group, hand, some.T, some.q, source=None)
        aims: dict[str, Any] = {"target_link": some.target_link, "target_object": some.target_object}
        aims = {} if np.isnan(some.target_link).all() else aims
        groups.append(replace(placed, scene=replace(placed.scene, original=some.original, **aims)))
    notes += _too_wide(hand, groups)
    note = (
        f"{count_text(len(problem), 'grasp')} of {scenes[0].hand.name if scenes else MANO} transferred to {hand.name}"
    )
    return replace(problem, groups=tuple(groups), notes=tuple(dict.fromkeys((*problem.notes, note, *notes))))


def _too_wide(hand: Hand, groups: list[Group]) -> list[str]:
    """Return a note on the grasps whose opposing fingers are farther apart than the jaws of a gripper open."""
    jaws = jaw_frame(hand, closure_frame(hand))
    if jaws is None:
        return []
    originals = [original for group in groups if (original := group.scene.original) is not None]
    span, most = 1e3 * join(*originals).span, 1e3 * float(jaws.width.max())
    wide = span[span > most]
    if not len(wide):
        return []
    ends = " to ".join(dict.fromkeys(f"{end:.0f}" for end in (wide.min(), wide.max())))
    return [
        f"in {len(wide)} of {count_text(len(span), 'grasp')} the fingers that press against each other are {ends} mm "
        f"apart, and the jaws open {most:.0f} mm: they grip elsewhere, if at all"
    ]


def _on_side(grasps: SourceGrasps, hand: Hand, obj: Object) -> tuple[SourceGrasps, list[str]]:
    """Return grasps of a right hand for a left one, or the other way round, mirrored where the object allows; notes."""
    frame = HandFrame.of(hand)
    other = (grasps.is_left != frame.is_left) & (grasps.thumb == frame.thumb == "side")
    if not other.any():
        return grasps, []
    sides = ("left", "right") if frame.is_left else ("right", "left")
    plane = mirror_plane(obj)
    if plane is None:
        return grasps, [
            f"{obj.name} has no mirror plane: a {sides[0]} hand reaches the contacts of a {sides[1]} hand as it can"
        ]
    return mirrored(grasps, plane, other), [
        f"{obj.name}: grasps of a {sides[1]} hand are mirrored for a {sides[0]} one"
    ]


def _group(group: Group, hand: Hand, T: np.ndarray, q: np.ndarray, source: Scene | KeyPoints | None) -> Group:
    """Return a group with other grasps, of a hand, on the same object."""
    old = group.grasps
    grasps = GraspSet(hand.name, hand.base_link, hand.joint_names, old.object, old.scale, pose_from_transform(T), q)
    scene = Scene(hand, group.scene.object, T, q, task=group.scene.task)
    return replace(group, scene=scene, grasps=replace(grasps, labels=old.labels), source=source)
