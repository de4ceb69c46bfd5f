"""Problems from specifications: hands, objects and grasps are read and checked, then objects are decomposed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from grasp_refine.core.array_records import take
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.json_files import dumps
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.grasps.formats.ours import Ours
from grasp_refine.grasps.formats.reading import Reading, reading
from grasp_refine.grasps.grasp_set import GraspSet, Targets, load_grasps, match_joints
from grasp_refine.grasps.rows import choose_rows
from grasp_refine.hands.solid_links import check_collides
from grasp_refine.objects.object import Object, load_object, prepare
from grasp_refine.objects.source import ObjectSource, chosen_object, is_known, named_object
from grasp_refine.problem.arms import check_base, problem_on_arm, reach_of
from grasp_refine.problem.examine import examined
from grasp_refine.problem.example import example_grasps
from grasp_refine.problem.hands import HandLoader
from grasp_refine.problem.input_cache import InputCache, NoCache
from grasp_refine.problem.named_inputs import in_scene, on_disk
from grasp_refine.problem.problem import Group, Problem, scene_of
from grasp_refine.problem.recorded_objects import Recorded
from grasp_refine.problem.sampled import check_sampled, with_samples
from grasp_refine.problem.spec import AUTO, NEAREST, SAMPLE, ProblemSpec
from grasp_refine.problem.transferred import at_rest, to_transfer, with_transfers
from grasp_refine.scans.reading import is_scan
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene_file import load_scene
from grasp_refine.scene.task_spec import NO_SCENE
from grasp_refine.transfers.key_points import MANO, KeyPoints, load_key_points


def _ignore(message: str) -> None:
    """Drop a message."""


def load_problem(
    spec: ProblemSpec,
    cache: InputCache | None = None,
    *,
    seed: int = 0,
    on_message: Callable[[str], None] = _ignore,
    on_wait: Callable[[str], None] = _ignore,
) -> Problem:
    """Return the grasps of a specification with their hand and objects.

    Args:
        spec: Names and files.
        cache: Keeps files, hands and objects for the next problem; None: nothing is kept.
        seed: Seed of decompositions and of sampled grasps.
        on_message: Called when something is fetched, and when a decomposition starts and ends.
        on_wait: Called with the name of a step that takes long.

    Raises:
        ConventionError: the grasps are most likely in another convention; with `as_is` this is a warning.
        GraspRefineError: something is missing, cannot be used, or does not fit the rest.
    """
    loader = Loader(spec, seed, on_message, on_wait, cache or NoCache())
    problem = loader.prepare(loader.problem())
    for note in problem.convention_notes:
        warnings.warn(note, stacklevel=2)
    return problem


@dataclass(frozen=True)
class Loader:
    """Loads a specification: `problem` reads and checks everything, `prepare` decomposes the objects."""

    spec: ProblemSpec
    """Names and files."""
    seed: int = 0
    """Seed of decompositions and of sampled grasps."""
    on_message: Callable[[str], None] = _ignore
    """Called when something is fetched, and when a decomposition starts and ends."""
    on_wait: Callable[[str], None] = _ignore
    """Called with the name of a step that takes long."""
    cache: InputCache = field(default_factory=NoCache)
    """Cache of files, hands and objects for the next problem."""

    def __post_init__(self) -> None:
        """Take the fields of a named task, and the object of the scene, where none are specified.

        Raises:
            GraspRefineError: there is no such scene, or it has another object than the specification.
        """
        object.__setattr__(self, "spec", in_scene(self.spec.with_named_task()))

    @property
    def hands(self) -> HandLoader:
        """Loader of the hand."""
        return HandLoader(self.spec, self.cache, self.on_message)

    @stage("loading")
    def problem(self) -> Problem:
        """Read and check everything that the specification names; no object is decomposed yet.

        Raises:
            GraspRefineError: something is missing, cannot be used, or does not fit the rest.
        """
        spec = self.spec
        if str(spec.grasps).startswith(SAMPLE):
            return self.to_sample(check_sampled(spec))
        path = self.grasp_path() if spec.grasps is not None else example_grasps(spec, self.hands.load)
        return self.of_grasps(self._read_file(path), path)

    @stage("loading")
    def prepare(self, problem: Problem, *, draw: int = 0, rough: Collection[int] = ()) -> Problem:
        """Decompose the objects of a problem, several at a time, and return it with the checks that this allows.

        Grasps are sampled now where that is asked for, and joint values of arms found.

        Args:
            problem: As read.
            draw: Number of the draw, of several with one seed; each samples other grasps.
            rough: Groups whose objects are not decomposed yet, see `Object.as_hull`.

        Raises:
            ConventionError: the grasps are most likely in another convention.
            GraspRefineError: an object cannot be decomposed, or is in a body around it.
        """
        groups = list(problem.groups)
        for at in rough:
            groups[at] = groups[at].on(groups[at].scene.object.as_hull())
        problem = replace(problem, groups=tuple(groups))
        prepare((group.scene.object for group in groups), progress=self.on_message)
        if any(group.source is not None for group in problem.groups):
            problem = with_transfers(problem)
        if problem.sampled:
            seed = (self.seed, draw) if draw else self.seed
            reaches = reach_of(problem, self.seed)
            problem = with_samples(problem, self.spec.index, seed, self.on_wait, reaches)
        else:
            problem = examined(problem, as_is=self.spec.as_is)
        return problem_on_arm(problem, seed=self.seed)

    def grasp_path(self) -> Path:
        """Return the path of the grasp file, fetched where it is an asset."""
        assert self.spec.grasps is not None
        return on_disk(self.spec.grasps, self.on_message)

    def of_grasps(self, read: Reading, path: Path) -> Problem:
        """Return the problem of grasps that were read from `path` already."""
        spec, recorded = self.spec, Recorded.of(read.files)
        of_files = recorded.scene()
        spec.check()
        if spec.scene is None and of_files is not None:
            return replace(self, spec=replace(spec, scene=of_files.source)).of_grasps(read, path)
        regions_notes: tuple[str, ...] = ()
        if not (spec.touch or spec.avoid):
            touch, avoid, regions_notes = recorded.regions()
            spec = replace(spec, touch=touch, avoid=avoid)
        task = spec.read_task(self._scene)
        if of_files is not None and spec.scene != NO_SCENE:
            of_files.check(task.environment, other=spec.other_object)
        grasps = read.grasps
        names = self._names(grasps, path)
        chosen = {name: choose_rows(grasps.object, object_name=name, index=spec.index or None) for name in names}
        sources = {name: self._source(name, path, recorded) for name in names}
        grasps = replace(grasps, targets=self._targets(grasps, path))
        if spec.transfer_from is not None:
            return self._to_transfer(read, path)
        hand, whole, grasps, resting = self.hands.of_grasps(grasps, path)
        q, notes = match_joints(grasps, hand)
        notes = (
            *read.notes,
            *regions_notes,
            *hand.notes,
            *resting,
            *notes,
            *recorded.other_urdf(path, hand, chosen=bool(spec.hand)),
        )
        groups: list[Group] = []
        count = 0
        for name, rows in chosen.items():
            index = np.asarray(spec.index) if spec.index else np.arange(len(rows))
            place, count = np.arange(count, count + len(rows)), count + len(rows)
            scales = self.scales(grasps, rows)
            for scale in np.unique(scales):
                at = np.flatnonzero(scales == scale)
                some, obj = grasps.select(rows[at]), self.read_object(sources[name], float(scale))
                notes += tuple(f"{name}: {note}" for note in obj.repairs)
                scene = scene_of(hand, obj, some, q[rows[at]], task)
                groups.append(Group(name, spec.metres(scale), scene, some, rows[at], index[at], place[at]))
        notes += recorded.check_objects(groups, other=spec.other_object)
        problem = Problem(whole, self._files(path, read), tuple(groups), tuple(dict.fromkeys(notes)))
        check_base(problem)
        return problem

    def _to_transfer(self, read: Reading, path: Path) -> Problem:
        """Return the problem of grasps of another hand that `prepare` transfers to the hand.

        Raises:
            GraspRefineError: one of the hands cannot be used.
        """
        spec = self.spec
        assert spec.hand is not None  # or `check` refuses
        hand = self.hands.simulated(self.hands.load(spec.hand, None if spec.stands else spec.base_link))
        check_collides(hand)
        own, points = spec.of_source(), None
        if spec.transfer_from == MANO:
            # Grasps without a hand of ours: until they are transferred, the hand itself has their places.
            points, old = KeyPoints(read.grasps.q.reshape(len(read.grasps), -1, 3)), read.grasps
            T, q = at_rest(hand, len(old))
            pose = pose_from_transform(T)
            places = GraspSet(hand.name, hand.base_link, hand.joint_names, old.object, old.scale, pose, q)
            own, read = replace(own, hand=spec.hand, base_link=hand.base_link), replace(read, grasps=places)
        source, task = replace(self, spec=own).of_grasps(read, path), spec.read_task(self._scene)
        groups = tuple(
            to_transfer(group, hand, task, group.scene if points is None else take(points, group.rows))
            for group in source.groups
        )
        problem = Problem(self.hands.on_arm(spec.hand, hand), source.files, groups, (*source.notes, *hand.notes))
        check_base(problem)
        return problem

    def to_sample(self, count: int) -> Problem:
        """Return the problem of `count` new grasps of the hand on the object, which `prepare` samples.

        Raises:
            GraspRefineError: hand or object cannot be used.
        """
        spec = self.spec
        spec.check()
        assert spec.hand is not None and spec.object is not None  # or `check_sampled` refuses
        hand = self.hands.simulated(self.hands.load(spec.hand, None if spec.stands else spec.base_link))
        check_collides(hand)
        whole = self.hands.on_arm(spec.hand, hand)
        source = chosen_object(spec.object, self.on_message)
        scale = spec.scale * (1.0 if source.asset is None else source.asset.scale)
        obj = self.read_object(source, scale)
        none = GraspSet.of(hand, np.zeros((0, 7)), np.zeros((0, len(hand.joint_names))), object=obj.name)
        scene = scene_of(hand, obj, none, none.q, spec.read_task(self._scene))
        group = Group(obj.name, spec.metres(scale), scene, none, *(np.zeros(0, dtype=np.int64),) * 3)
        problem = Problem(whole, (hand.urdf,), (group,), hand.notes, f"{SAMPLE}{count}")
        check_base(problem)
        return problem

    def read(self, path: Path) -> Reading:
        """Return all grasps of the file `path`, with the targets of the specification.

        Raises:
            GraspFileError: it cannot be read, or the targets cannot.
        """

        def with_targets() -> Reading:
            read = self._read_file(path)
            return replace(read, grasps=replace(read.grasps, targets=self._targets(read.grasps, path)))

        spec = self.spec
        return self.cache.get("file", (path, spec.format, spec.grasp_hand, spec.urdf, spec.targets), with_targets)

    def named_objects(self, grasps: GraspSet, path: Path) -> dict[str, ObjectSource]:
        """Return the sources of the selected objects of the grasps, in the order of the file.

        Raises:
            GraspRefineError: an object is not known, or ambiguous.
        """
        return {name: self._source(name, path) for name in self._names(grasps, path)}

    def scales(self, grasps: GraspSet, rows: np.ndarray) -> np.ndarray:
        """Return the scales of the objects of some grasps of a file (N,), to the unit of the specification.

        The factor of a scene's own object is not applied twice, where the file has it already as results have.
        """
        scales, (own, factor) = grasps.scale[rows], self.spec.scene_object()
        if own is not None:
            scales = np.where(np.isclose(scales, factor, rtol=1e-9), 1.0, scales)
        return scales * self.spec.scale

    def read_object(self, source: ObjectSource, scale: float) -> Object:
        """Return an object of the specified size, still to be decomposed.

        Raises:
            GraspRefineError: it cannot be read or used.
        """
        spec, seed = self.spec, self.seed
        table = spec.table if not isinstance(spec.table, Plane) else spec.table.point_and_normal
        of_scan = {"table": table} | dict(source.record or {}) | spec.scan_arguments()
        of_scan.pop("source", None)

        def load() -> Object:
            return load_object(
                source.source,
                **of_scan,
                name=None if source.asset is None else source.asset.name,
                scale=scale,
                unit=spec.unit,
                decomposition=Decomposition(threshold=spec.threshold),
                holes=spec.holes,
                seed=seed,
            )

        key = (source.source, scale, spec.unit, spec.holes, spec.threshold, seed, dumps(of_scan))
        return self.cache.get("object", key, load)

    def environment(self) -> Environment | None:
        """Return the bodies around the object of the specified scene; None: there is none.

        Raises:
            GraspRefineError: the scene cannot be read or used.
        """
        source = self.spec.scene
        return None if source == NO_SCENE else self._scene(source) if isinstance(source, str) else source

    def _scene(self, source: str) -> Environment:
        """Return the bodies of a scene."""
        return self.cache.get("scene", source, lambda: load_scene(source, on_message=self.on_message))

    def _read_file(self, path: Path) -> Reading:
        """Return the grasps of a file, or of a folder, of any format."""
        spec = self.spec
        # Our files name their joints; for others the columns may follow from the hand.
        if spec.transfer_from == MANO:
            return Reading(load_key_points(path), Ours(), (path,), ())
        own = spec if spec.transfer_from is None else spec.of_source()
        hand = None if own.hand is None or path.suffix == ".npz" else replace(self, spec=own).hands.load(own.hand, None)
        return reading(path, format=spec.format, hand=hand)

    def _files(self, path: Path, read: Reading) -> tuple[Path, ...]:
        """Return the given path, the files in it if it is a folder, and the file of targets."""
        files = tuple(dict.fromkeys((path, *read.files)))
        return files if self.spec.targets in (AUTO, NEAREST) else (*files, Path(self.spec.targets))

    def _targets(self, grasps: GraspSet, path: Path) -> Targets | None:
        """Return the targets of all rows of the grasp file; None: contacts are selected by distance."""
        wanted = self.spec.targets
        if wanted in (AUTO, NEAREST):
            return grasps.targets if wanted == AUTO else None
        other = load_grasps(wanted)
        if other.targets is None:
            raise GraspFileError(f"{wanted}: has no targets (target_link, target_point_link, target_point_object)")
        if len(other) != len(grasps) or (other.object != grasps.object).any():
            raise GraspFileError(
                f"{wanted}: its rows must match {path}: {len(other)} against {len(grasps)} grasps"
                + ("" if len(other) != len(grasps) else ", of other objects")
            )
        return other.targets

    def _names(self, grasps: GraspSet, path: Path) -> list[str]:
        """Return the names of the objects whose grasps are selected, in the order of the file."""
        spec = self.spec
        if spec.object is not None and spec.objects is not None:
            raise GraspRefineError("`object` and `objects` exclude each other: give one of them")
        if spec.object_name is not None:
            return [spec.object_name]
        names = list(dict.fromkeys(grasps.object.tolist()))
        if len(names) > 1 and spec.objects is None and not (spec.object is None and all(map(is_known, names))):
            listing = ", ".join(f"{name} ({np.count_nonzero(grasps.object == name)})" for name in names)
            raise GraspFileError(
                f"{path}: has grasps of {len(names)} objects; choose one with `object_name`, or give all their "
                f"meshes with `objects`: {listing}"
            )
        return names

    def _source(self, name: str, path: Path, recorded: Recorded | None = None) -> ObjectSource:
        """Return the source of the object `name` of the grasp file; of a recorded scan, with its sensors."""
        spec = self.spec
        scan = None if recorded is None else recorded.scan(name)
        if spec.object is not None:
            source = chosen_object(spec.object, self.on_message)
            again = scan is not None and (
                str(Path(spec.object).absolute()) == scan["source"] or is_scan(Path(spec.object))
            )
            return replace(source, record=scan) if again else source
        if scan is not None and spec.objects is None:
            return ObjectSource(Path(scan["source"]), record=scan)
        return named_object(
            name, None if spec.objects is None else on_disk(spec.objects, self.on_message), path, self.on_message
        )
