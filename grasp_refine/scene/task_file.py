"""Tasks in files: TOML of a user, and the record of a task in results."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from grasp_refine.core.arguments import is_number
from grasp_refine.core.errors import GraspRefineError, did_you_mean, quote_value
from grasp_refine.core.json_files import check_writable, save_text
from grasp_refine.core.names import exists, expand_user
from grasp_refine.core.toml_file import UNREADABLE, read_toml, toml_text
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.objects.region import Region
from grasp_refine.objects.region_spec import check_spec, is_spec, resolve_spec
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol, protocol_of_table
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.scene_file import list_scenes, load_scene
from grasp_refine.scene.task import FIELDS, Task

TASK = "task"
"""Key of the task in the record of results."""


def load_task(source: str | Path) -> Task:
    """Return a task by its name, or out of a file.

    Args:
        source: Name of a protocol or of a scene; a TOML file with the keys protocol, table, scene, base, touch and
            avoid; or a result file (.npz), or the JSON document of `refine-grasp run`, for the task of its grasps.

    Raises:
        GraspRefineError: there is none, or the file has a wrong key or value: names file, key and choices.
    """
    fields = task_fields(source)
    try:
        return Task(**fields)
    except GraspRefineError as error:
        raise GraspRefineError(f"{source}: {str(error).removeprefix('Task: ')}") from None


def as_task(task: Task | str | Path | None) -> Task:
    """Return a task that may be given by name or file, as of `load_task`; None: one without any demand.

    Raises:
        GraspRefineError: another type, or as `load_task`.
    """
    if isinstance(task, str | Path):
        return load_task(task)
    if task is not None and not isinstance(task, Task):
        raise GraspRefineError(f"task must be a Task, or the name or file of one, got {quote_value(task)}")
    return task or Task()


def save_task(task: Task, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a TOML file from which `load_task` reads the same task.

    Raises:
        GraspRefineError: the scene or a region was made in memory, or the file exists or cannot be written.
    """
    path = Path(path)
    check_writable(path, overwrite=overwrite)
    entry = task_entry(task)
    if task.environment is not None:
        if not task.environment.source:
            raise GraspRefineError(
                f"{path}: scene '{task.environment.name}' was made in memory: it has no name or file"
            )
        entry["scene"] = task.environment.source
    for name in ("touch", "avoid"):
        made = [spec for spec in entry.get(name, ()) if not is_spec(spec)]
        if made:
            raise GraspRefineError(f"{path}: {name} {made[0]} was made in memory: it has no specification")
    if (protocol := task.named_protocol) is not None and protocol in PROTOCOLS.values():
        entry["protocol"] = protocol.name
    save_text(path, toml_text(entry))


def task_entry(task: Task) -> dict[str, Any]:
    """Return the record of a task in results: the fields that it names.

    Files of regions have their whole path, so that they are found from other folders, too.
    """
    entry: dict[str, Any] = {}
    if (protocol := task.named_protocol) is not None:
        entry["protocol"] = asdict(protocol)
    if (plane := task.plane) is not None:
        flat = plane.normal == Plane.normal
        entry["table"] = plane.offset if flat else {"normal": list(plane.normal), "offset": plane.offset}
    if (around := task.environment) is not None:
        entry["scene"] = {"name": around.name, "source": around.source, "sha256": around.digest}
    if task.base is not None:
        entry["base"] = task.base
    for name, regions in (("touch", task.touch), ("avoid", task.avoid)):
        if regions is not None:
            several = (regions,) if isinstance(regions, str | Region) else regions
            specs = [one.spec if isinstance(one, Region) else one for one in several]
            entry[name] = [resolve_spec(spec, Path(), name) if is_spec(spec) else spec for spec in specs]
    return entry


def task_fields(source: str | Path) -> dict[str, Any]:
    """Return the fields of `Task` that a name or file gives, as arguments of `Task`; scenes of files are not read yet.

    Raises:
        GraspRefineError: as `load_task`.
    """
    name, scenes = str(source), list_scenes()
    if name in PROTOCOLS:
        return {"protocol": PROTOCOLS[name]}
    if name in scenes:
        return {"scene": name}
    path = expand_user(Path(source))
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = [*PROTOCOLS, *scenes]
        raise GraspRefineError(
            f"no task '{name}'{did_you_mean(name, known)} there are the protocols {', '.join(PROTOCOLS)}, the scenes "
            f"{', '.join(scenes)}, or a FILE.toml or a result file"
        )
    return _fields(reader(path), path)


def _of_toml(path: Path) -> Mapping[str, Any]:
    try:
        return read_toml(path)
    except FileNotFoundError:
        raise GraspRefineError(f"{path}: no such file") from None
    except UNREADABLE as error:
        raise GraspRefineError(f"{path}: cannot be read as TOML ({error})") from None


def _of_document(path: Path) -> Mapping[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise GraspRefineError(f"{path}: cannot be read as JSON ({error})") from None
    return _recorded(found.get("config") if isinstance(found, Mapping) else None, path)


def _recorded(record: Any, path: Path) -> Mapping[str, Any]:
    """Return the record of a task in a provenance or document."""
    entry = record.get(TASK) if isinstance(record, Mapping) else None
    if not isinstance(entry, Mapping):
        raise GraspRefineError(f"{path}: records no task")
    return entry


_READERS: Mapping[str, Callable[[Path], Mapping[str, Any]]] = {
    ".toml": _of_toml,
    ".npz": lambda path: _recorded(read_provenance(path), path),
    ".json": _of_document,
}


def _fields(entry: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the fields of `Task` in a file; names of files are relative to its folder."""
    where = f"{path}: "
    for key in entry:
        if key not in FIELDS:
            raise GraspRefineError(f"{where}no key '{key}'{did_you_mean(key, FIELDS)} there are {', '.join(FIELDS)}")
    if "table" in entry and "scene" in entry:
        raise GraspRefineError(f"{where}table and scene exclude each other: a scene has its own tables")
    return {key: _VALUES[key](value, path.parent, f"{where}{key}") for key, value in entry.items()}


def _protocol(value: Any, folder: Path, where: str) -> Protocol:
    if isinstance(value, str):
        return load_protocol(_path_text(value, folder))
    if not isinstance(value, Mapping):
        raise GraspRefineError(f"{where} must be a name, a FILE.toml or a table of fields, got {quote_value(value)}")
    return protocol_of_table(value, f"{where}: ")


def _table(value: Any, folder: Path, where: str) -> Plane | float:
    if is_number(value):
        return float(value)
    if not isinstance(value, Mapping) or set(value) != {"normal", "offset"} or not is_number(value["offset"]):
        raise GraspRefineError(
            f"{where} must be a height in metres, or a table of normal and offset, got {quote_value(value)}"
        )
    return Plane(_numbers(value["normal"], folder, f"{where}.normal"), float(value["offset"]))


def _scene(value: Any, folder: Path, where: str) -> Environment | str:
    if isinstance(value, str):
        return _path_text(value, folder)
    if not isinstance(value, Mapping) or not all(isinstance(value.get(k), str) for k in ("name", "source", "sha256")):
        raise GraspRefineError(f"{where} must be the name of a scene, or a FILE.toml, got {quote_value(value)}")
    if not value["source"]:
        raise GraspRefineError(f"{where} '{value['name']}' was made in memory, and is not in this file: give it")
    found = load_scene(value["source"])
    if found.digest != value["sha256"]:
        raise GraspRefineError(f"{where} {value['source']} has changed: it has other bodies or poses than recorded")
    return found


def _numbers(value: Any, folder: Path, where: str) -> Any:
    def is_row(row: Any) -> bool:
        return isinstance(row, Sequence) and not isinstance(row, str) and all(map(is_number, row))

    if is_row(value):
        return tuple(map(float, value))
    if not (isinstance(value, Sequence) and not isinstance(value, str) and value and all(map(is_row, value))):
        raise GraspRefineError(f"{where} must be numbers, got {quote_value(value)}")
    return tuple(tuple(map(float, row)) for row in value)


def _specs(value: Any, folder: Path, where: str) -> tuple[str, ...]:
    several = [value] if isinstance(value, str) else value
    if not isinstance(several, list) or not all(isinstance(spec, str) for spec in several):
        raise GraspRefineError(f"{where} must be a region, or a list of regions, got {quote_value(value)}")
    found = tuple(resolve_spec(spec, folder, f"{where} {spec}") for spec in several)
    for spec in found:
        check_spec(spec, where)
    return found


_VALUES: Mapping[str, Callable[[Any, Path, str], Any]] = {
    "protocol": _protocol,
    "table": _table,
    "scene": _scene,
    "base": _numbers,
    "touch": _specs,
    "avoid": _specs,
}
"""Field of a task -> its reading: value, folder of the file, and place for messages."""


def _path_text(name: str, folder: Path) -> str:
    """Return a name, or the path of a file that lies beside."""
    path = folder / expand_user(Path(name))
    return str(path.absolute()) if Path(name).suffix and exists(path) else name
