"""The object that a grasp file gives by a scene: in the file itself, in a file beside it, or by its path.

A scene is a dict of `scene` (name -> dict of `pose` (7,), `scale` and `file_path`) and `task` with `obj_name`; older
ones have `interest_obj_name` instead. Scenes called "floating" have their only object at the origin.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from grasp_refine.core.names import is_file
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.formats.stages import ORIGIN_POSE

FLOATING_SCENE = re.compile(r"(?:^|/)([^/]+)/floating/scale([0-9]{2,4})(?:_[^/]*)?(?:\.npy)?$")
"""Path of a scene of nothing but one object: its name and hundredths of its scale."""


def object_in_scene(source: Source) -> tuple[dict[str, Any], Sequence[str]]:
    """Pose, name and scale of the object, as `grasps_of_stages` takes them, and notes.

    Raises:
        GraspFileError: there is neither a scene nor a file of one, and its path does not give the object.
    """
    held = source.content
    if held.get("scene_cfg") is not None:
        return _object_of_task(source, held["scene_cfg"]), ()
    if held.get("scene_path") is None:
        raise source.error("has no object: it has neither obj_pose, scene_cfg nor scene_path")
    name = source.text(held["scene_path"], "scene_path")
    tried = PurePosixPath(name.replace("\\", "/"))
    below = PurePosixPath(*[part for part in tried.parts if part not in ("/", "..")])
    # A path in a file of someone else is only searched around that file, as around / would be anywhere, and only if it
    # is that of an array.
    for folder in source.path.absolute().parents[:-1] if below.suffix == ".npy" else ():
        if source.within is not None and not folder.is_relative_to(source.within.absolute()):
            break
        if is_file(folder / below):
            scene = folder / below
            return _object_of_task(Source(scene, load_content(scene)), None), ()
    floating = FLOATING_SCENE.search(str(below))
    if floating is None:
        raise source.error(
            f"its object is in the scene file {name}, which does not exist: searched in all folders from "
            f"{Path(source.path).absolute().parent} up"
        )
    return {
        "object_pose": ORIGIN_POSE,
        "object_name": floating[1],
        "scale": int(floating[2]) / 100,
    }, [
        f"the scene file {name} does not exist: by its path, the object is '{floating[1]}' at the origin, with "
        f"scale {int(floating[2]) / 100:g}"
    ]


def _object_of_task(source: Source, scene: Any) -> dict[str, Any]:
    """The object of the task of a scene, by default of the file's contents themselves."""
    scene = source.content if scene is None else scene
    if not isinstance(scene, Mapping) or not isinstance(scene.get("scene"), Mapping):
        raise source.error("scene_cfg must be a dict with a dict 'scene' of objects")
    objects, task = scene["scene"], scene.get("task")
    name = task.get("obj_name") if isinstance(task, Mapping) else scene.get("interest_obj_name")
    if not isinstance(name, str) or not isinstance(objects.get(name), Mapping):
        raise source.error(f"its scene has no object {name!r}; it has {', '.join(map(str, objects)) or 'none'}")
    found = objects[name]
    lacking = [key for key in ("pose", "scale") if found.get(key) is None]
    if lacking:
        raise source.error(f"object {name!r} of its scene lacks {', '.join(lacking)}")
    return {
        "object_pose": source.numbers(found["pose"], "pose of the object").ravel(),
        "object_name": source.object_name(name, "obj_name"),
        "scale": source.scale(found["scale"], "scale of the object"),
    }
