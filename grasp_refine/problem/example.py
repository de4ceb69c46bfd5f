"""Example grasps that come with the program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.files.source import needs_urdf
from grasp_refine.hands.hand import list_hands
from grasp_refine.objects.source import check_object_name
from grasp_refine.problem.spec import SAMPLE, ProblemSpec

EXAMPLE_HAND = "allegro"
"""Hand of the example that is refined where none is specified."""

PREFIX = "example_"
"""Beginning of the names of their files; the object follows."""

EXAMPLE_OBJECT = "mug"
"""Object of the example that is refined where none is specified."""


def example_grasps(spec: ProblemSpec, check_hand: Callable[[str, str | None], object]) -> Path:
    """Return the file of example grasps of the hand on the object that is specified.

    Args:
        spec: Names.
        check_hand: Refuses a hand that does not exist.

    Raises:
        GraspRefineError: there are none.
    """
    hand = spec.grasp_hand or EXAMPLE_HAND
    if hand not in list_hands():
        check_hand(hand, None)
        complete = [name for name in list_hands() if not needs_urdf(name)]
        raise GraspRefineError(
            f"`grasps` is needed, a file: only hands that come with the program ({', '.join(complete)}) "
            f"have example grasps, '{hand}' has none"
        )
    files = sorted((resource_dir("robots") / hand).glob(f"{PREFIX}*.npz"))
    examples = {path.stem.removeprefix(PREFIX): path for path in files}
    wanted = spec.object_name or spec.object
    if wanted is None and not examples:
        raise GraspRefineError(f"`grasps` is needed, a file: hand '{hand}' comes without example grasps")
    if wanted is None:
        return examples.get(EXAMPLE_OBJECT) or next(iter(examples.values()))
    if wanted not in examples:
        if spec.object is not None:
            check_object_name(spec.object)
        raise GraspRefineError(
            f"`grasps` is needed, a file, or `grasps='{SAMPLE}16'` for new ones: there are no example grasps of hand "
            f"'{hand}' on '{wanted}', only on {', '.join(examples) or 'nothing'}"
        )
    return examples[wanted]
