"""Pictures of grasps before and after, small enough to be embedded: the hand at the object, both from one side."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.batch.thumbnail import thumbnail
from grasp_refine_apps.batch.worst import Case
from grasp_refine_apps.report.skeleton import Skeleton

TIME_LIMIT_S = 60.0
"""CPU time after which no further picture is begun, seconds; a dozen takes a few."""

Load = Callable[[Case], tuple[Hand, Object]]
"""Function that returns the hand and the object of a case."""


@dataclass(frozen=True)
class Picture:
    """A case, seen before and after."""

    case: Case
    """The case shown."""
    before: bytes = b""
    """Picture of the input grasp, PNG."""
    after: bytes = b""
    """Picture of the refined grasp, PNG."""
    problem: str = ""
    """Reason why there are no pictures; empty if there are."""


def draw_cases(
    cases: Sequence[Case],
    out: Path,
    load: Load,
    *,
    patience_s: float = TIME_LIMIT_S,
    progress: Callable[[str, float], None] | None = None,
) -> tuple[Picture, ...]:
    """Draw each case; a case that cannot be drawn gets the reason.

    Args:
        cases: The cases.
        out: Folder of the results, which contains their files.
        load: Loader of hand and object, called once for each case.
        patience_s: CPU time after which no further picture is begun, seconds.
        progress: Called with the case being drawn, and the share that is done.
    """
    begun, prepared, found = time.process_time(), cache(partial(Skeleton.of, visual=True)), []
    for number, case in enumerate(cases):
        if progress is not None:
            progress(f"drawing {case.hand} on {case.object}", number / len(cases))
        if time.process_time() - begun > patience_s:
            found.append(Picture(case, problem=f"not drawn: the others took more than {patience_s:g} s"))
            continue
        try:
            found.append(_draw_case(case, out, load, prepared))
        # A fault of one of many inputs costs its picture, not the report.
        except (GraspRefineError, OSError, ValueError, LookupError) as error:
            found.append(Picture(case, problem=f"not drawn: {' '.join(str(error).split())}"))
    return tuple(found)


def _draw_case(case: Case, out: Path, load: Load, prepared: Callable[[Hand], Skeleton]) -> Picture:
    """Draw both pictures of a case.

    Raises:
        GraspRefineError: a file cannot be read.
    """
    hand, obj = load(case)
    path = out / case.file
    after, file = load_grasps(path).select([case.row]), load_npz(path)
    pose, q = (file.numbers(f"{name}_before")[[case.row]] for name in ("hand_pose", "q"))
    initial = replace(after, hand_pose=pose, q=q)
    T = transform_from_pose(np.concatenate([initial.hand_pose, after.hand_pose]))
    q = np.concatenate([match_joints(grasps, hand)[0] for grasps in (initial, after)])
    before, refined = thumbnail(prepared(hand), obj, T, q)
    return Picture(case, before, refined)
