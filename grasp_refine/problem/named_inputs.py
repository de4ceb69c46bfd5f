"""Resolution of names in a specification, and checks that it is what grasps were made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from grasp_refine.assets.locating import fetched
from grasp_refine.assets.names import find_asset
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.names import exists
from grasp_refine.hands.hand import Hand
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.results.result_files import fingerprint, recorded_urdf


def in_scene(spec: ProblemSpec) -> ProblemSpec:
    """Return a specification with the object of its scene, where it has none itself."""
    if spec.objects is not None:
        return spec
    obj, scale = spec.scene_object()
    if obj is None or obj == spec.object:
        return spec
    if spec.object is not None:
        raise GraspRefineError(
            f"scene {spec.scene} is of object '{obj}', not '{spec.object}': leave out `object`, or give a scene whose "
            "[object] has no name"
        )
    return replace(spec, object=obj, scale=spec.scale * scale)


def on_disk(path: Path, on_message: Callable[[str], None]) -> Path:
    """Return a path, or the folder of the asset of this name if there is no such path."""
    asset = None if exists(path) or path.suffix else find_asset(str(path), "grasps")
    return path if asset is None else fetched(asset, on_message)


def other_urdf(path: Path, hand: Hand, *, chosen: bool) -> list[str]:
    """Return a note if grasps were refined with another URDF than that of the hand.

    Raises:
        GraspFileError: they were, and this one was not `chosen` by the user, whose hand may be named as ours.
    """
    recorded = recorded_urdf(path)
    if recorded in (None, fingerprint(hand.urdf)["sha256"]):
        return []
    other = f"{path} was made with another URDF of hand '{hand.name}' than {hand.urdf}"
    if not chosen:
        raise GraspFileError(
            f"{other}: give that one with `hand` or `urdf`, or `hand='{hand.name}'` if this one is meant"
        )
    return [other]


def with_actuators(hand: Hand) -> Hand:
    """Return the hand with the actuators of its MJCF, if that is simulated."""
    if hand.collision != "mjcf" or hand.mjcf is None:
        return hand
    from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model

    # Squeezes are set points of these actuators.
    return replace(hand, actuator=mjcf_model(hand, hand.mjcf).actuator)
