"""Measurement of a case: every method on the same grasps, with its cost, measures, and verdicts of all trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch

from grasp_refine.closing.motion import Motion
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.plurals import count_text
from grasp_refine.grasps.formats.folders import object_folder
from grasp_refine.grasps.grasp_set import save_npz
from grasp_refine.measures.metrics import metrics_of
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.problem import Group, Problem
from grasp_refine.problem.refine import refine_group
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.refinement.config import Config
from grasp_refine.results.document import settings
from grasp_refine.results.outcome import Outcome
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.task import Task
from grasp_refine_apps.batch.digests import Digests, sha256_of
from grasp_refine_apps.batch.work import cache_of
from grasp_refine_apps.bench.jobs import Progress, part_of
from grasp_refine_apps.bench.success.cases import PERTURBED, UNAWARE, Case, load_case, perturbed, placed
from grasp_refine_apps.bench.success.trials import AnyTrial, Found, Tried
from grasp_refine_apps.bench.timing import one_thread, warmed_up

Preference = Literal["closest", "balanced", "strongest"]
"""Methods that refine with forces, named like their `Config.prefer`."""

PREFERENCES: tuple[Preference, ...] = get_args(Preference)

MethodName = Literal["as-given", "own-stages", "geometry-only", Preference]
"""Names of the methods in rows."""

LABELS = {"as-given": "as given", "own-stages": "own stages", "geometry-only": "geometry only"}
"""Name of a method -> its label for people; `PREFERENCES` have the number of starts in theirs."""

COSTS = (
    *("cpu_s", "wall_s", "starts", "displacement_m", "contacts_moved_m", "links_kept"),
    *("moved_palm_m", "moved_palm_rad", "moved_joints_rad"),
)
"""Measures of a refinement that are kept, keys of `Outcome`; NaN where there was none."""

GROUPINGS = ("hand", "source", "object", "shape", "size")
"""Labels of grasps by which they are grouped."""

LAYOUT_VERSION = 2
"""Version of the layout of the files of cases; a new number makes all outdated."""


@dataclass(frozen=True)
class Method:
    """A method applied to grasps; all but "as-given" end with a pregrasp and a squeeze of our own."""

    name: MethodName
    """Name in rows."""
    starts: int | None = None
    """Number of starts of a grasp that may not hold; None: it is not moved."""

    @property
    def label(self) -> str:
        """Label for people."""
        return LABELS.get(self.name) or f"{self.name}, {count_text(self.starts or 0, 'start')}"

    @property
    def key(self) -> str:
        """Beginning of its entries in the file of a case, and its folder of refined grasps."""
        return f"{self.name}-{self.starts}" if self.name in PREFERENCES else self.name

    def config(self, seed: int, width: int) -> Config | None:
        """Settings of the refinement; None where there is none."""
        if self.starts is None:
            return None
        config = Config(starts=self.starts, seed=seed, width=width)
        if self.name == "geometry-only":
            return replace(config, weights=replace(config.weights, wrench=0.0))
        return replace(config, prefer=self.name)  # type: ignore[arg-type]  # one of `PREFERENCES`


def methods_of(names: tuple[MethodName, ...], starts: tuple[int, ...]) -> tuple[Method, ...]:
    """Return the methods of some names, each of `PREFERENCES` once for each of the numbers of starts."""
    found = []
    for name in dict.fromkeys(names):
        counts = starts if name in PREFERENCES else (1,) if name == "geometry-only" else (None,)
        found += [Method(name, count) for count in dict.fromkeys(counts)]
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Measured:
    """N grasps of a case, by one method."""

    method: Method
    case: str
    """Name of the case."""
    labels: Mapping[str, np.ndarray]
    """Name of `GROUPINGS` -> label of each grasp (N,); and scale: the factor (N,) by which its object was scaled."""
    values: Mapping[str, np.ndarray]
    """Number -> its value for each grasp (N,), SI units, NaN where there is none: `COSTS`, the fields of `Metrics`, and
    the measures of trials."""
    verdict: Mapping[str, np.ndarray]
    """Column of a trial -> verdict in words (N,), `HELD` for success."""


@dataclass(frozen=True)
class Measurement:
    """Settings with which cases are measured."""

    methods: tuple[Method, ...]
    """Methods; the first one is the reference. "own-stages" is left out where grasps have no others."""
    trials: tuple[AnyTrial, ...]
    """Ways to try the grasps of each method."""
    perturb: bool = False
    """Whether each grasp is tried once more, perturbed."""
    shrink: bool = False
    """Whether objects on which no grasp is found are scaled."""
    width: int = Config.width
    """Largest number of grasps that are refined at once."""
    seed: int = 0
    threads: int | None = None
    """CPU threads of the simulation; None: all cores. Refinement has one."""
    out: Path | None = None
    """Folder of results; a later run reads finished cases from it. None: nothing is kept."""
    token: str = ""
    """Name of the run: inputs are kept in memory for one run."""

    def run(self, case: Case, progress: Progress) -> list[Measured]:
        """Measure a case in this process; results in the file of the case are not computed again.

        Raises:
            GraspRefineError: an input cannot be used, or no grasp is found.
        """
        torch.set_num_threads(1)
        kept = _Kept.of(case, self)
        work = _Work(case, self, kept.found)
        with one_thread():
            for number, method in enumerate(self.methods):
                within = part_of(progress, number / len(self.methods), 1.0 / len(self.methods))
                if work.has(method):
                    work.measure(method, within)
        kept.save()
        return [self._measured(method, case, kept.found) for method in self.methods if work.has(method)]

    def _measured(self, method: Method, case: Case, found: Found) -> Measured:
        columns = [column for trial in self.trials for column in trial.columns]
        start = f"{method.key}/"
        own = {name.removeprefix(start): values for name, values in found.items() if name.startswith(start)}
        labels = {name: found[f"labels/{name}"] for name in (*GROUPINGS, "scale")}
        values = {name: values for name, values in own.items() if values.dtype.kind == "f" and values.ndim == 1}
        return Measured(method, case.name, labels, values, {name: own[name] for name in columns})


def file_of(case: str, folder: str) -> Path:
    """Path of a file of a case in the folder of results: below "cases", or below the key of a method."""
    *above, last = map(object_folder, case.split("/"))
    return Path(folder, *above, f"{last}.npz")


@dataclass(frozen=True, eq=False)
class _Kept:
    """Entries of a case, kept in a file."""

    path: Path | None
    stamp: str
    found: Found = field(default_factory=dict)

    @staticmethod
    def of(case: Case, measurement: Measurement) -> _Kept:
        """Return the results in the file of a case, if its inputs and settings are the same.

        Raises:
            GraspRefineError: an input does not exist.
        """
        if measurement.out is None:
            return _Kept(None, "")
        path = measurement.out / file_of(case.name, "cases")
        stamp = _stamp(case, measurement)
        if path.exists():
            file = load_npz(path)
            if file.name("stamp") == stamp:
                return _Kept(path, stamp, {name: values for name, values in file.entries.items() if name != "stamp"})
        return _Kept(path, stamp)

    def save(self) -> None:
        """Write the file."""
        if self.path is not None:
            save_npz(self.path, {**self.found, "stamp": np.array(self.stamp)})


def _stamp(case: Case, measurement: Measurement) -> str:
    """Hash of all that the refined grasps of a case depend on, but the methods."""
    digests, spec = Digests(), case.spec
    files = [path for name in ("grasps", "object", "scene") if (path := Path(str(getattr(spec, name)))).exists()]
    hand = None if spec.hand is None else digests.hand(spec.hand, spec, lambda line: None)[1]
    return digests.stamp(
        spec,
        named=[str(getattr(spec, name)) for name in ("object", "object_name", "scene", "index", "grasps")],
        files=[digests.file(path)["sha256"] for path in files],
        hand=hand,
        settings=[
            LAYOUT_VERSION,
            case.count,
            measurement.perturb,
            measurement.shrink,
            measurement.width,
            measurement.seed,
        ],
    )


@dataclass(eq=False)
class _Work:
    """Measurement of one case; its problem is loaded when something is missing."""

    case: Case
    measurement: Measurement
    found: Found

    @cached_property
    def _cache(self) -> InputCache:
        return cache_of(self.measurement.token)

    @cached_property
    def _problem(self) -> Problem:
        """The grasps, and the perturbed grasps."""
        problem, factor = load_case(self.case, self.measurement.seed, self._cache, shrink=self.measurement.shrink)
        groups = list(problem.groups)
        sources = [self.case.source] * len(groups)
        if self.measurement.perturb:
            groups += [perturbed(group, self.measurement.seed) for group in problem.groups]
            sources += [PERTURBED] * len(problem.groups)
        thing, counts = self.case.object, [len(group.rows) for group in groups]
        labels = {
            "hand": self.case.hand or problem.hand.name,
            "source": sources,
            "object": [group.object if thing is None else thing.name for group in groups],
            "shape": "not known" if thing is None else thing.shape,
            "size": "not known" if thing is None else thing.size,
            "scale": factor,
        }
        for name, label in labels.items():
            each = label if isinstance(label, list) else [label] * len(groups)
            self.found[f"labels/{name}"] = np.repeat(np.array(each), counts)
        return placed(problem, groups)

    def has(self, method: Method) -> bool:
        """Return whether a method is another one than "as-given" for these grasps."""
        if method.name != "own-stages":
            return True
        if "labels/stages" not in self.found:
            self.found["labels/stages"] = np.array("file" in self._problem.closing().values())
        return bool(self.found["labels/stages"])

    def measure(self, method: Method, progress: Progress) -> None:
        """Add the entries of a method that are missing."""
        key = method.key
        if f"{key}/stage_q" not in self.found:
            self.found |= {f"{key}/{name}": values for name, values in self._refined(method).items()}
        for number, trial in enumerate(self.measurement.trials):
            share = part_of(progress, number / len(self.measurement.trials), 1.0 / len(self.measurement.trials))
            name = f"{key}/stamp of {', '.join(trial.columns)}"
            stamp = np.array(sha256_of(settings(trial)))
            if not (name in self.found and self.found[name] == stamp):
                self.found |= {f"{key}/{name}": values for name, values in self._tried(method, trial, share).items()}
                self.found[name] = stamp

    def _refined(self, method: Method) -> Found:
        """Refine the grasps, if the method does; return their stages, costs and measures."""
        problem, config, parts = self._problem, method.config(self.measurement.seed, self.measurement.width), []
        outcomes: list[Outcome] = []
        for group in problem.groups:
            scene, motion, costs = group.scene, None, dict.fromkeys(COSTS, np.full(len(group.rows), np.nan))
            if config is not None:
                outcome = refine_group(group, config, prepared=self._prepared(group))
                outcomes.append(outcome)
                scene, motion = outcome.posed(scene), outcome.motion
                costs = {name: outcome[name].astype(float) for name in COSTS}
            else:
                motion = group.motion("own" if method.name == "own-stages" else "auto")
            measured = metrics_of(scene).values
            stages = {"stage_T": motion.T_world_root, "stage_q": motion.q}
            parts.append({"grasp_T": scene.T_world_root, "grasp_q": scene.q, **stages, **costs, **measured})
        if self.measurement.out is not None and config is not None:
            refined = RefinedGrasps(problem, config, Outcome.join(outcomes))
            path = self.measurement.out / file_of(self.case.name, method.key)
            path.parent.mkdir(parents=True, exist_ok=True)
            refined.save(path if len({group.object for group in problem.groups}) == 1 else path.parent, overwrite=True)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _prepared(self, group: Group) -> HandObject:
        """Geometry of hand and object; caches built once for them are not timed."""
        configs = (method.config(self.measurement.seed, self.measurement.width) for method in self.measurement.methods)
        present = [config for config in configs if config is not None]
        key = self._problem.hand, group.scene.object
        return self._cache.get("prepared", key, partial(warmed_up, group.scene, present))

    def _tried(self, method: Method, trial: AnyTrial, progress: Progress) -> Found:
        """Try the grasps of a method."""
        key, parts, problem = method.key, [], self._problem
        names = "grasp_T", "grasp_q", "stage_T", "stage_q"
        for group in problem.groups:
            T, q, stage_T, stage_q = (self.found[f"{key}/{name}"][group.place] for name in names)
            scene = replace(group.scene, T_world_root=T, q=q)
            unaware = self.case.source == UNAWARE
            tried = Tried(scene, Motion(stage_T, stage_q), Task(scene=self.case.spec.scene) if unaware else scene.task)
            share = part_of(progress, group.place[0] / len(problem), len(group.place) / len(problem))
            parts.append(trial.run(tried, self._cache, self.measurement.threads, share))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
