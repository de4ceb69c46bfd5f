"""What a batch is asked to refine: grasp files in folders, by patterns, or listed in a TOML or CSV file."""

from __future__ import annotations

import csv
import glob
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isnan
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from grasp_refine.commands.inputs import AUTO, NEAREST, SAMPLE, Inputs
from grasp_refine.errors import GraspRefineError
from grasp_refine.formats.folders import natural
from grasp_refine.formats.reading import SUFFIXES

LISTS = (".toml", ".csv")
"""Endings of job lists."""

KEYS = tuple(field.name for field in fields(Inputs) if field.name != "index")
"""What a job list may say of a job, besides its name: the options of `refine-grasp run` of these names."""


@dataclass(frozen=True)
class Job:
    """Grasps of one file, or sampled ones, with their hand and objects."""

    name: str
    """What it is called in results; no two jobs of a batch are called the same."""
    inputs: Inputs
    """What is refined; the grasps are always given, and nothing depends on the working folder."""
    origin: str
    """Where it was asked for, for messages."""


def read_jobs(sources: Sequence[str], defaults: Inputs) -> list[Job]:
    """The jobs that some sources name.

    Args:
        sources: Job lists (.toml, .csv), grasp files, folders of them at any depth, patterns such as "sets/*.npz", or
            sample:N.
        defaults: What a job does not say itself.

    Raises:
        GraspRefineError: a source that names nothing, or a list that cannot be read; names the line.
    """
    found: list[tuple[str, Inputs, str]] = []
    for source in sources:
        if Path(source).suffix.lower() in LISTS and not Path(source).is_dir():
            found += _listed(Path(source), defaults)
        else:
            found += [
                (name, replace(defaults, grasps=path), source) for name, path in _files(source, empty_is_error=True)
            ]
    if not found:
        raise GraspRefineError(f"{', '.join(sources)}: no jobs in it")
    names = _distinct([name for name, _, _ in found])
    return [Job(name, _anywhere(inputs), origin) for name, (_, inputs, origin) in zip(names, found, strict=True)]


def _files(source: str, *, empty_is_error: bool) -> list[tuple[str, Path]]:
    """Name and path of each grasp file that a path, a folder or a pattern means."""
    if source.startswith(SAMPLE):
        return [(source.replace(":", "_"), Path(source))]
    path = Path(source).expanduser()
    matches = [path] if path.exists() or not glob.has_magic(source) else _matches(str(path))
    found = []
    for match in matches:
        if match.is_dir():
            inside = [file for file in match.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file()]
            # Not the temporary files of another batch.
            inside = [file for file in inside if not file.name.startswith(".")]
            inside.sort(key=lambda file: natural(file.relative_to(match).as_posix()))
            found += [(file.relative_to(match).with_suffix("").as_posix(), file) for file in inside]
        else:
            # A file that is not there is told with its job, so that the others can go on.
            found.append((match.stem, match))
    if not found and empty_is_error:
        kinds = ", ".join(SUFFIXES)
        what = "matches no grasp files" if glob.has_magic(source) else "no grasp files in this folder or below it"
        raise GraspRefineError(f"{source}: {what}; they end with {kinds}")
    return found


def _matches(pattern: str) -> list[Path]:
    return [Path(name) for name in sorted(glob.glob(pattern, recursive=True), key=natural)]


def _listed(path: Path, defaults: Inputs) -> Iterator[tuple[str, Inputs, str]]:
    """Name, inputs and origin of each job of a list."""
    rows, common = _read_toml(path) if path.suffix.lower() == ".toml" else (_read_csv(path), {})
    defaults = replace(defaults, **_values(common, path, f"{path}: [defaults]"))
    for number, row in enumerate(rows, 1):
        where = f"{path}: job {number}"
        row = dict(row)
        name = row.pop("name", "")
        if not isinstance(name, str):
            raise GraspRefineError(f"{where}: name must be text, got {name!r}")
        inputs = replace(defaults, **_values(row, path, where))
        if inputs.grasps is None:
            raise GraspRefineError(f'{where}: says no grasps = "FILE" (or a folder, a pattern, or sample:N)')
        files = _files(str(inputs.grasps), empty_is_error=True)
        for stem, file in files:
            yield (name if len(files) == 1 else f"{name}/{stem}") if name else stem, replace(inputs, grasps=file), where


def _read_toml(path: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The [[job]] tables, and what [defaults] says."""
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise GraspRefineError(f"{path}: cannot be read as a TOML job list ({_reason(error)})") from None
    unknown = [key for key in raw if key not in ("job", "defaults")]
    if unknown:
        raise GraspRefineError(
            f"{path}: '{unknown[0]}' means nothing here; a job list has [defaults] and [[job]] tables"
        )
    jobs, common = raw.get("job", []), raw.get("defaults", {})
    if not (isinstance(jobs, list) and all(isinstance(job, dict) for job in jobs) and isinstance(common, dict)):
        raise GraspRefineError(f"{path}: jobs are [[job]] tables, what they share is a [defaults] table")
    return jobs, common


def _read_csv(path: Path) -> list[dict[str, Any]]:
    """The rows below the header; empty cells are left out."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            rows = list(reader)
            header = reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise GraspRefineError(f"{path}: cannot be read as a CSV job list ({_reason(error)})") from None
    _check_keys(header, f"{path}: its header")
    for number, row in enumerate(rows, 1):
        if None in row or None in row.values():
            raise GraspRefineError(f"{path}: job {number}: has not as many cells as the header, {len(header)}")
    return [{key: cell.strip() for key, cell in row.items() if cell.strip()} for row in rows]


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _check_keys(keys: Sequence[str], where: str) -> None:
    """Refuse what no job has."""
    for key in keys:
        if key not in (*KEYS, "name"):
            raise GraspRefineError(f"{where}: '{key}' is nothing that a job has; there are name, {', '.join(KEYS)}")


def _values(raw: Mapping[str, Any], path: Path, where: str) -> dict[str, Any]:
    """The fields of `Inputs` that a table gives."""
    _check_keys(list(raw), where)
    hints = get_type_hints(Inputs)
    return {key: _value(value, hints[key], path.parent, f"{where}: {key}") for key, value in raw.items()}


def _value(value: Any, hint: Any, folder: Path, where: str) -> Any:
    """A value of a list as its field holds it; paths are relative to the list, where something lies there."""
    kinds = [kind for kind in _alternatives(hint) if kind is not type(None)]
    choices = [choice for kind in kinds if get_origin(kind) is Literal for choice in get_args(kind)]
    if float in kinds:
        try:
            number = float(value) if not isinstance(value, bool) else float("nan")
        except (TypeError, ValueError):
            number = float("nan")
        if isnan(number):
            raise GraspRefineError(f"{where} must be a number, got {value!r}")
        return number
    if not isinstance(value, str) or not value:
        raise GraspRefineError(f"{where} must be text, got {value!r}")
    if choices and value not in choices:
        raise GraspRefineError(f"{where} must be one of {', '.join(choices)}, got '{value}'")
    near = folder / Path(value).expanduser()
    is_pattern = glob.has_magic(value) and not value.startswith(SAMPLE)
    there = not choices and (near.exists() or (is_pattern and bool(glob.glob(str(near), recursive=True))))
    value = str(near) if there else value
    return Path(value) if Path in kinds else value


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """The types of a field, without what is annotated to them."""
    if hasattr(hint, "__metadata__"):
        return _alternatives(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return tuple(kind for part in get_args(hint) for kind in _alternatives(part))
    return (hint,)


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, and a number after those that came before."""
    taken: set[str] = set()
    found = []
    for name in names:
        new, number = name, 2
        while new in taken:
            new, number = f"{name}_{number}", number + 1
        taken.add(new)
        found.append(new)
    return found


def _anywhere(inputs: Inputs) -> Inputs:
    """The same, with absolute paths: a worker may run in another folder."""

    def absolute(value: Any) -> Any:
        if value is None or str(value).startswith(SAMPLE):
            return value
        path = Path(value).expanduser()
        return type(value)(path.absolute()) if path.exists() else value

    given = {name: absolute(getattr(inputs, name)) for name in ("urdf", "mjcf", "objects", "grasps")}
    # Names win over folders of the same name; only what can be nothing else is a path.
    for name in ("hand", "object"):
        value = getattr(inputs, name)
        is_path = value is not None and (Path(value).suffix or "/" in value) and ":" not in value
        given[name] = absolute(value) if is_path else value
    given["targets"] = inputs.targets if inputs.targets in (AUTO, NEAREST) else absolute(inputs.targets)
    return replace(inputs, **given)
