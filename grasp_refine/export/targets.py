"""Programs and formats that grasps are exported to, by name, and the folders that are written."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path

from grasp_refine.core.atomic_files import half_written_path
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_text
from grasp_refine.core.plurals import count_text
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.target import Readme, Target
from grasp_refine.grasps.formats.folders import disambiguate, object_folder, scale_folder

_HOMES = {
    "mjcf": ("mjcf", "Mjcf"),
    "sapien": ("urdf_folder", "UrdfFolder"),
    "drake": ("urdf_folder", "UrdfFolder"),
    "usd": ("usd", "Usd"),
    "isaac_grasp": ("isaac", "Isaac"),
    "ros2": ("ros2", "Ros2"),
    "lerobot": ("lerobot", "LeRobot"),
    "csv": ("table", "Table"),
    "parquet": ("table", "Table"),
}
"""Name of a target -> its module and class, which are loaded when it is used."""

TARGETS = tuple(_HOMES)
"""Names of the targets."""

README = "README.md"


def target(name: str) -> Target:
    """Return a target.

    Raises:
        GraspRefineError: there is none of this name.
    """
    if name not in _HOMES:
        raise GraspRefineError(f"grasps are exported to {', '.join(TARGETS)}, got {name!r}")
    module, kind = _HOMES[name]
    made: Target = getattr(import_module(f"grasp_refine.export.{module}"), kind)(name)
    return made


def export(
    parts: Sequence[ExportedGrasps], to: str, folder: str | Path, *, progress: Callable[[str], None] = lambda line: None
) -> tuple[Path, ...]:
    """Write the grasps of each object into a folder of its own; of one object, into `folder` itself.

    All folders appear at once, when they are complete, or none.

    Args:
        parts: Grasps on each object.
        to: Name of the target.
        folder: New folder.
        progress: Called with the name of each object.

    Returns:
        The folders.

    Raises:
        GraspRefineError: there is no grasp, the folder exists or cannot be written, or the program cannot take these
            grasps.
    """
    to_target, folder = target(to), Path(folder)
    parts = [part for part in parts if len(part)]
    if not parts:
        raise GraspRefineError(f"{folder}: there are no grasps to export")
    if folder.exists() or folder.is_symlink():
        raise GraspRefineError(f"{folder}: exists already; give the name of a new folder")
    names = [""]
    if len(parts) > 1:
        names = disambiguate(f"{object_folder(part.name)}_{scale_folder(part.scale)}" for part in parts)
    partial = half_written_path(folder)
    try:
        for name, part in zip(names, parts, strict=True):
            progress(part.name)
            inside = partial / name
            inside.mkdir(parents=True)
            save_text(inside / README, _readme(to_target, part, to_target.write(part, inside)))
        partial.rename(folder)
    except OSError as failure:
        raise GraspRefineError(f"{folder}: cannot be written ({failure.strerror or failure})") from failure
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return tuple(folder / name for name in names)


def _readme(to: Target, part: ExportedGrasps, readme: Readme) -> str:
    files: Mapping[str, str] = readme.files
    lines = [
        f"# {count_text(len(part), 'grasp')} of {part.hand.name} on {part.name} for {to.name}",
        "",
        *(f"- `{name}`: {what}." for name, what in files.items()),
        *(f"- {note}" for note in readme.notes),
    ]
    return "\n".join([*lines, "", f"Use: `{readme.use}`", ""])
