"""Jobs of a batch: grasp files in folders, by patterns, or listed in a TOML or CSV file."""

from __future__ import annotations

import csv
import glob
import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isnan
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from grasp_refine.assets.hub import is_on_hub
from grasp_refine.core.errors import GraspRefineError, quote_value, visible
from grasp_refine.core.names import exists, expand_user, is_folder, is_valid
from grasp_refine.core.toml_file import UNREADABLE, read_toml
from grasp_refine.grasps.formats.content import SUFFIXES
from grasp_refine.grasps.formats.folders import disambiguate, natural
from grasp_refine.grasps.formats.reading import is_other, may_be_other
from grasp_refine.objects.region_spec import VERBS, resolve_spec
from grasp_refine.problem.named_inputs import on_disk
from grasp_refine.problem.spec import NAMES_OR_PATHS, PATHS, SAMPLE, ProblemSpec

LISTS = (".toml", ".csv")
"""Suffixes of job lists."""

KEYS = tuple(field.name for field in fields(ProblemSpec) if field.name != "index")
"""Keys of a job in a list, besides its name: the options of `refine-grasp run` of these names."""


@dataclass(frozen=True)
class Job:
    """Grasps of one file, or sampled ones, with their hand and objects."""

    name: str
    """Name in results, unique in a batch. A name derived from a file may be invalid."""
    inputs: ProblemSpec
    """ProblemSpec; grasps are always given, and nothing depends on the working folder."""
    named: bool = True
    """Whether its file was named explicitly, not found in a folder or by a pattern: then it is always refined."""


def read_jobs(sources: Sequence[str], defaults: ProblemSpec, *, together: bool = False) -> list[Job]:
    """Return the jobs that some sources name; duplicates count once.

    Args:
        sources: Job lists (.toml, .csv), grasp files, folders of them at any depth, patterns such as "sets/*.npz", or
            sample:N.
        defaults: ProblemSpec that a job does not specify itself.
        together: Treat a folder as one job.

    Raises:
        GraspRefineError: a source without jobs, or a list that cannot be read; names the line.
    """
    found: list[Job] = []
    for source in sources:
        if Path(source).suffix.lower() in LISTS and not is_folder(Path(source)):
            found += _jobs_of_list(Path(source), defaults, together)
        else:
            found += _jobs(source, defaults, "", together)
    if not found:
        raise GraspRefineError(f"{', '.join(sources)}: no jobs in it")
    once = {job.inputs: job for job in reversed(found)}
    jobs = [job for job in found if once[job.inputs] is job]
    for job in jobs:
        if not job.name.strip("/"):
            raise GraspRefineError(f"'{job.name}' cannot be the name of a job: it is the folder of its results")
    names = disambiguate(job.name for job in jobs)
    return [replace(job, name=name) for job, name in zip(jobs, names, strict=True)]


def _jobs(source: str, inputs: ProblemSpec, name: str, together: bool) -> Iterator[Job]:
    """Yield a job for each grasp file of a source, with these inputs.

    Raises:
        GraspRefineError: the source has no grasp files.
    """
    if source.startswith(SAMPLE):
        yield Job(name or source.replace(":", "_"), _with_absolute_paths(replace(inputs, grasps=Path(source))))
        return
    if is_on_hub(Path(source)):
        name, source = name or Path(source).name, str(on_disk(Path(source), lambda line: None))
    path = expand_user(Path(source))
    if not glob.has_magic(source) or exists(path):
        # A missing file is reported with its job, so that the other jobs can run.
        folder = is_folder(path)
        named = together or not folder
        found = (
            [(path.stem if path.suffix and not folder else path.name, path)]
            if named
            else _grasp_files_below(path, path)
        )
    else:
        fixed = Path(*itertools.takewhile(lambda part: not glob.has_magic(part), path.parts))
        found, named = [], False
        for match in map(Path, sorted(glob.glob(str(path), recursive=True), key=natural)):
            is_one_job = together or not match.is_dir()
            found += [(_job_name(match, fixed), match)] if is_one_job else _grasp_files_below(match, fixed)
    if not found:
        what = "matches no grasp files" if glob.has_magic(source) else "no grasp files in this folder or below it"
        raise GraspRefineError(f"{source}: {what}; they end with {', '.join(SUFFIXES)}")
    for stem, file in found:
        label = stem if not name else name if len(found) == 1 else f"{name}/{stem}"
        yield Job(label, _with_absolute_paths(replace(inputs, grasps=file)), named)


def _grasp_files_below(folder: Path, within: Path) -> list[tuple[str, Path]]:
    """Name and path of each grasp file in a folder and below it, also behind links; names are relative to `within`."""
    found, seen = [], set()
    for place, folders, files in os.walk(folder, followlinks=True):
        real = os.path.realpath(place)
        if real in seen:
            folders.clear()
            continue
        seen.add(real)
        # Hidden files are partial files of another batch.
        found += [Path(place, file) for file in files if not file.startswith(".")]
    found = [file for file in found if file.suffix.lower() in SUFFIXES and file.is_file()]
    found = [file for file in found if _is_job(file)]
    found.sort(key=lambda file: natural(file.relative_to(folder).as_posix()))
    return [(_job_name(file, within), file) for file in found]


def _is_job(file: Path) -> bool:
    """Return whether a file in a folder is a job: one that cannot be read is, and fails with its reason."""
    try:
        return not (may_be_other(file) and is_other(file))
    except Exception:
        return True


def _job_name(file: Path, within: Path) -> str:
    """Name of a file found in a folder, relative to `within`."""
    return file.relative_to(within).with_suffix("").as_posix()


def _jobs_of_list(path: Path, defaults: ProblemSpec, together: bool) -> Iterator[Job]:
    """Yield the jobs of a list."""
    rows, common = _read_toml(path) if path.suffix.lower() == ".toml" else (_read_csv(path), {})
    defaults = replace(defaults, **_values(common, path, f"{path}: [defaults]"))
    for number, row in enumerate(rows, 1):
        where = f"{path}: job {number}"
        row = dict(row)
        name = row.pop("name", "")
        if not isinstance(name, str):
            raise GraspRefineError(f"{where}: name must be text, got {quote_value(name)}")
        if not is_valid(name):
            raise GraspRefineError(
                f"{where}: '{visible(name)}' cannot be the name of a job: it holds control characters"
            )
        inputs = replace(defaults, **_values(row, path, where))
        if inputs.grasps is None:
            raise GraspRefineError(f'{where}: needs grasps = "FILE" (or a folder, a pattern, or sample:N)')
        yield from _jobs(str(inputs.grasps), inputs, name, together)


def _read_toml(path: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Read the [[job]] tables, and the [defaults] table."""
    try:
        raw = read_toml(path)
    except UNREADABLE as error:
        raise GraspRefineError(f"{path}: cannot be read as a TOML job list ({_reason(error)})") from None
    unknown = [key for key in raw if key not in ("job", "defaults")]
    if unknown:
        raise GraspRefineError(f"{path}: '{unknown[0]}' is unknown; a job list has [defaults] and [[job]] tables")
    jobs, common = raw.get("job", []), raw.get("defaults", {})
    if not (isinstance(jobs, list) and all(isinstance(job, dict) for job in jobs) and isinstance(common, dict)):
        raise GraspRefineError(f"{path}: jobs must be [[job]] tables, and their shared inputs a [defaults] table")
    return jobs, common


def _read_csv(path: Path) -> list[dict[str, Any]]:
    """Read the rows below the header; empty cells are left out."""
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
            raise GraspRefineError(f"{path}: job {number}: needs as many cells as the header, {len(header)}")
    return [{key: cell.strip() for key, cell in row.items() if cell.strip()} for row in rows]


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _check_keys(keys: Sequence[str], where: str) -> None:
    """Refuse unknown keys."""
    for key in keys:
        if key not in (*KEYS, "name"):
            raise GraspRefineError(f"{where}: '{key}' is no key of a job; there are name, {', '.join(KEYS)}")


def _values(raw: Mapping[str, Any], path: Path, where: str) -> dict[str, Any]:
    """Convert a table to fields of `ProblemSpec`."""
    _check_keys(list(raw), where)
    if "name" in raw:
        raise GraspRefineError(f"{where}: the name of a job must be unique; give it in [[job]]")
    hints = get_type_hints(ProblemSpec)
    return {key: _value(key, value, hints[key], path.parent, f"{where}: {key}") for key, value in raw.items()}


def _value(key: str, value: Any, hint: Any, folder: Path, where: str) -> Any:
    """Convert a value of a list to the type of its field; paths are relative to the list, if they exist there."""
    if key in VERBS or hint == tuple[str, ...]:
        # One, or a list of several.
        specs = value if isinstance(value, list) else [value]
        if not all(isinstance(spec, str) and spec for spec in specs):
            raise GraspRefineError(f"{where} must be a text or a list of texts, got {quote_value(value)}")
        return tuple(resolve_spec(spec, folder, where) if key in VERBS else spec for spec in specs)
    kinds = [kind for kind in _alternatives(hint) if kind is not type(None)]
    choices = [choice for kind in kinds if get_origin(kind) is Literal for choice in get_args(kind)]
    if float in kinds:
        try:
            number = float(value) if not isinstance(value, bool) else float("nan")
        except (TypeError, ValueError, OverflowError):
            number = float("nan")
        if isnan(number):
            raise GraspRefineError(f"{where} must be a number, got {quote_value(value)}")
        return number
    if int in kinds:
        if isinstance(value, bool) or not re.fullmatch(r"[0-9]{1,9}", str(value)):
            raise GraspRefineError(f"{where} must be a whole number, got {quote_value(value)}")
        return int(value)
    if bool in kinds:
        # A cell of a CSV file is text.
        truth = {"true": True, "false": False}.get(value.lower()) if isinstance(value, str) else value
        if not isinstance(truth, bool):
            raise GraspRefineError(f"{where} must be true or false, got {quote_value(value)}")
        return truth
    if not isinstance(value, str) or not value:
        raise GraspRefineError(f"{where} must be text, got {quote_value(value)}")
    if not is_valid(value):
        raise GraspRefineError(f"{where} holds control characters: {quote_value(value)}")
    if choices and value not in choices:
        raise GraspRefineError(f"{where} must be one of {', '.join(choices)}, got '{value}'")
    if choices or value.startswith(SAMPLE) or not (Path in kinds or (key in NAMES_OR_PATHS and _is_path(value))):
        return value if Path not in kinds else Path(value)
    near = folder / expand_user(Path(value))
    there = exists(near) or (glob.has_magic(value) and bool(glob.glob(str(near), recursive=True)))
    value = str(near) if there else value
    return Path(value) if Path in kinds else value


def _is_path(name: str) -> bool:
    """Return True if a hand, object or targets can only be a path: names take precedence over folders of that name."""
    return ":" not in name and ("/" in name or bool(Path(name).suffix))


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Types of a field, without annotations."""
    if hasattr(hint, "__metadata__"):
        return _alternatives(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return tuple(kind for part in get_args(hint) for kind in _alternatives(part))
    return (hint,)


def _with_absolute_paths(inputs: ProblemSpec) -> ProblemSpec:
    """Return the inputs with absolute paths: a worker may run in another folder."""

    def absolute(value: Any) -> Any:
        if value is None or str(value).startswith(SAMPLE):
            return value
        path = expand_user(Path(value))
        return type(value)(path.absolute()) if exists(path) else value

    absolutes = {name: absolute(getattr(inputs, name)) for name in PATHS}
    for name in NAMES_OR_PATHS:
        value = getattr(inputs, name)
        absolutes[name] = absolute(value) if isinstance(value, str) and _is_path(value) else value
    for name in VERBS:
        absolutes[name] = tuple(
            resolve_spec(spec, Path(), f"`{name}` {spec}") for spec in map(str, getattr(inputs, name))
        )
    return replace(inputs, **absolutes)
