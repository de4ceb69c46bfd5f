"""Example grasps that come with the program."""

from __future__ import annotations

from pathlib import Path

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.hands.files.source import needs_urdf
from grasp_refine.hands.hand import list_hands, load_hand
from grasp_refine.objects.source import check_object
from grasp_refine.problem.spec import SAMPLE, ProblemSpec

EXAMPLE_HAND = "allegro"
"""Hand of the example that is refined where none is specified."""

EXAMPLE_OBJECT = "mug"
"""Object of the example that is refined where none is specified."""


def example_grasps(spec: ProblemSpec) -> Path:
    """Return the file of example grasps of the hand on the object that is specified.

    Raises:
        GraspRefineError: there are none.
    """
    hand = spec.hand or EXAMPLE_HAND
    if hand not in list_hands():
        load_hand(hand)
        complete = [name for name in list_hands() if not needs_urdf(name)]
        raise GraspRefineError(
            f"`grasps` is needed, a file: only hands that come with the program ({', '.join(complete)}) "
            f"have example grasps, '{hand}' has none"
        )
    examples: dict[str, Path] = {}
    for path in sorted((resource_dir("robots") / hand).glob("*.npz")):
        examples |= dict.fromkeys(load_grasps(path).object.tolist(), path)
    wanted = spec.object_name or spec.object
    if wanted is None and not examples:
        raise GraspRefineError(f"`grasps` is needed, a file: hand '{hand}' comes without example grasps")
    if wanted is None:
        return examples.get(EXAMPLE_OBJECT) or next(iter(examples.values()))
    if wanted not in examples:
        if spec.object is not None:
            check_object(spec.object)
        raise GraspRefineError(
            f"`grasps` is needed, a file, or `grasps='{SAMPLE}16'` for new ones: there are no example grasps of hand "
            f"'{hand}' on '{wanted}', only on {', '.join(examples) or 'nothing'}"
        )
    return examples[wanted]
