"""Resolution of names in a specification, and checks that it is what grasps were made with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from grasp_refine.assets.hub import fetch_dataset, hub_dataset, is_on_hub
from grasp_refine.assets.locating import fetched
from grasp_refine.assets.names import find_asset
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.names import exists
from grasp_refine.grasps.formats.content import SUFFIXES, TABLE_SUFFIXES
from grasp_refine.problem.spec import ProblemSpec


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
    """Return a path, or the folder of the asset of this name if there is no such path; hf://... is of the Hub."""
    if is_on_hub(path):
        return fetch_dataset(hub_dataset(path, on_message), (*SUFFIXES, *TABLE_SUFFIXES), on_message)
    asset = None if exists(path) or path.suffix else find_asset(str(path), "grasps")
    return path if asset is None else fetched(asset, on_message)
