"""Pictures of grasps before and after, small enough to be embedded: the hand at the object, both from one side."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.batch.thumbnail import Pose, Skeleton, skeleton, thumbnail
from grasp_refine_apps.batch.worst import Case

PATIENCE = 60.0
"""CPU seconds after which no further picture is begun; a dozen takes a few."""

Load = Callable[[Case], tuple[Hand, Object]]
"""Gives the hand and the object of a case."""


@dataclass(frozen=True)
class Picture:
    """A case, seen before and after."""

    case: Case
    """What is shown."""
    before: bytes = b""
    """A PNG."""
    after: bytes = b""
    """A PNG."""
    problem: str = ""
    """Why there are none; empty where there are."""


def draw_cases(
    cases: Sequence[Case],
    out: Path,
    load: Load,
    *,
    patience_s: float = PATIENCE,
    tell: Callable[[str, float], None] | None = None,
) -> tuple[Picture, ...]:
    """A picture of each case; of one that cannot be drawn, why.

    Args:
        cases: What is drawn.
        out: Folder of the results, which their files lie in.
        load: Called once for each case.
        patience_s: CPU seconds after which no further picture is begun.
        tell: Gets what is being drawn, and the share that is done.
    """
    begun, prepared, found = time.process_time(), cache(skeleton), []
    for number, case in enumerate(cases):
        if tell is not None:
            tell(f"drawing {case.hand} on {case.object}", number / len(cases))
        if time.process_time() - begun > patience_s:
            found.append(Picture(case, problem=f"not drawn: the others took more than {patience_s:g} s"))
            continue
        try:
            found.append(_drawn(case, out, load, prepared))
        # Whatever is wrong with one of many inputs takes its picture, not the report.
        except (GraspRefineError, OSError, ValueError, LookupError) as error:
            found.append(Picture(case, problem=f"not drawn: {' '.join(str(error).split())}"))
    return tuple(found)


def _drawn(case: Case, out: Path, load: Load, prepared: Callable[[Hand], Skeleton]) -> Picture:
    """Both pictures of a case.

    Raises:
        GraspRefineError: a file cannot be read.
    """
    hand, obj = load(case)
    path = out / case.file
    after, file = load_grasps(path).select([case.row]), load_npz(path)
    initial_pose, initial_q = (file.numbers(f"initial_{name}")[[case.row]] for name in ("pose", "q"))
    poses = []
    for grasp in (replace(after, hand_pose=initial_pose, q=initial_q), after):
        q, _ = match_joints(grasp, hand)
        poses.append(Pose(transform_from_pose(grasp.hand_pose)[0], q[0]))
    before, refined = thumbnail(prepared(hand), obj, poses)
    return Picture(case, before, refined)
