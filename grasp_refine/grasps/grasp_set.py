"""Grasp sets: poses and joint values of one hand around objects.

A grasp file is one `.npz` without pickle. Version 1 holds

    schema          ()      int, 1; a file without it is read as version 1
    hand            ()      name of the hand
    base_link       ()      link of the URDF whose pose `hand_pose` gives
    joint_names     (n,)    names of the columns of `q`
    object          () or (N,)    name of the object
    scale           () or (N,)    factor that takes the object's mesh to metres
    hand_pose       (N, 7)  x y z (metres), qw qx qy qz of `base_link` in the object frame
    q               (N, n)  joint values, radians or metres

and optionally, all three or none, `target_link` (K,), `target_point_link` (N, K, 3) and
`target_point_object` (N, K, 3) in metres; NaN points mean that this grasp has no such target. Two more stages of
the motion that closes the hand may be present, each whole or not at all, in the form of `hand_pose` and `q`:
`pregrasp_pose` (N, 7) and `pregrasp_q` (N, n), the hand open, and `squeeze_pose` and `squeeze_q`, where its position
actuators are sent so that it presses; these joint values may exceed the limits. `contact_links` (N, M), names of
the links that should touch, empty where a grasp has fewer, and `contact_gaps` (N, M), the gap in metres that each
should keep, are the contact links of the grasps. Entries `label_<name>` (N,) are numbers that a generator gives its
grasps. Other entries (results, provenance) may be present too and are not read here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind, check_shape
from grasp_refine.core.array_records import join, take
from grasp_refine.core.array_types import Bool, Float, Shaped
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.json_files import check_writable
from grasp_refine.core.npz_files import NpzFile, load_npz, save_npz
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.core.short_repr import brief
from grasp_refine.grasps.poses import unit_poses, without_zero_quaternions
from grasp_refine.grasps.rows import row_numbers
from grasp_refine.hands.files.mimics import followed
from grasp_refine.hands.hand import Hand

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["GraspSet", "Stage", "Targets", "load_grasps", "match_joints", "save_npz"]

SCHEMA = 1
"""The version of grasp files that is written, and the newest that is read."""
REQUIRED = ("hand", "base_link", "joint_names", "object", "scale", "hand_pose", "q")
TARGET_KEYS = ("target_link", "target_point_link", "target_point_object")
CONTACT_KEYS = ("contact_links", "contact_gaps")
OTHER_STAGES = ("pregrasp", "squeeze")
"""Stages beside the grasp itself: attributes of a set, and prefixes of their entries in a file."""
POSE_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Names of the columns of a pose."""
LABEL_PREFIX = "label_"
"""Prefix of the entries of a file that hold labels."""
MIMIC_TOLERANCE = 1e-3
"""Greatest deviation of a mimic joint in a file from the joint that it follows, in rad or m, without a note."""


@dataclass(frozen=True, eq=False)
class Targets:
    """Contact targets of links on the object; NaN where a grasp has no target for a link."""

    links: tuple[str, ...]
    """Names of the K links that should touch."""
    point_link: Float[np.ndarray, "N K 3"]
    """(N, K, 3) wanted contact points, metres, each in the frame of its link."""
    point_object: Float[np.ndarray, "N K 3"]
    """(N, K, 3) wanted contact points, metres, object frame."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class ContactLinks:
    """Contact links of grasps, at most M each, over which their contact errors are measured."""

    name: Shaped[np.ndarray, "N M"]
    """(N, M) names of links; empty where a grasp has fewer."""
    gap: Float[np.ndarray, "N M"]
    """(N, M) gaps in metres that they should keep from the object; NaN where there is no link."""

    __repr__ = brief

    @classmethod
    def of(cls, links: Sequence[str], gap: Float[np.ndarray, "N L"]) -> ContactLinks:
        """Return the links that have a gap, each once, of L links that may be listed several times."""
        names = tuple(dict.fromkeys(links))
        each = [np.fmin.reduce(gap[:, [k for k, one in enumerate(links) if one == name]], axis=1) for name in names]
        gaps = np.stack(each, axis=1) if each else np.zeros((len(gap), 0))
        # Links come first, in order.
        order = np.argsort(np.isnan(gaps), axis=1, kind="stable")
        gaps = np.take_along_axis(gaps, order, axis=1)
        most = int((~np.isnan(gaps)).sum(axis=1).max(initial=0))
        found = np.array(names, dtype=str)[order][:, :most]
        return cls(np.where(np.isnan(gaps[:, :most]), "", found), gaps[:, :most])

    def padded(self, most: int) -> ContactLinks:
        """Return the same links in `most` columns."""
        pad = ((0, 0), (0, most - self.name.shape[1]))
        return ContactLinks(np.pad(self.name, pad), np.pad(self.gap, pad, constant_values=np.nan))

    def on(self, links: Sequence[str]) -> Float[np.ndarray, "N L"]:
        """Return the gaps (N, L) of links; repeated links have theirs in the first column; NaN for all others.

        Grasps with a contact link that is not listed have none.
        """
        gap = np.full((len(self.name), len(links)), np.nan)
        for column, link in enumerate(links):
            if links.index(link) == column:
                gap[:, column] = np.fmin.reduce(np.where(self.name == link, self.gap, np.nan), axis=1, initial=np.nan)
        known = ((self.name == "") | np.isin(self.name, list(links))).all(axis=1)
        gap[~known] = np.nan
        return gap


@dataclass(frozen=True, eq=False, init=False)
class Stage:
    """Poses and joint values of the hand in N grasps, at one stage of the motion that closes it."""

    pose: Float[np.ndarray, "N 7"]
    """(N, 7) as `GraspSet.hand_pose`."""
    q: Float[np.ndarray, "N n"]
    """(N, n) joint values, radians or metres, with the columns of `GraspSet.q`."""

    __repr__ = brief

    def __init__(self, pose: ArrayLike, q: ArrayLike) -> None:
        """Take lists, arrays or torch tensors; one grasp needs no batch dimension.

        Raises:
            GraspFileError: they are not numbers.
        """
        try:
            pose, q = _batched(as_numbers("pose", pose), as_numbers("q", q))
        except GraspRefineError as error:
            raise GraspFileError(f"Stage: {error}") from None
        object.__setattr__(self, "pose", pose)
        object.__setattr__(self, "q", q)


@dataclass(frozen=True, eq=False, init=False)
class GraspSet:
    """N grasps of one hand; rows may belong to different objects.

    Arrays may be given as lists or torch tensors, object and scale as one for all; they are kept as NumPy arrays.
    """

    hand: str
    """Name of the hand, as in the file."""
    base_link: str
    """Link of the hand's URDF whose pose `hand_pose` gives."""
    joint_names: tuple[str, ...]
    """Names of the columns of `q`."""
    object: Shaped[np.ndarray, " N"]
    """(N,) object names."""
    scale: Float[np.ndarray, " N"]
    """(N,) factors that take the object's mesh to metres."""
    hand_pose: Float[np.ndarray, "N 7"]
    """(N, 7) x y z (metres), qw qx qy qz (unit) of `base_link` in the object frame."""
    q: Float[np.ndarray, "N n"]
    """(N, n) joint values, radians or metres."""
    targets: Targets | None = None
    """Contact targets, if the file has them."""
    pregrasp: Stage | None = None
    """The hand before it closes to the grasp, if the file has it."""
    squeeze: Stage | None = None
    """Set points of the hand after that, to press, if the file has them."""
    labels: Mapping[str, Float[np.ndarray, " N"]] = field(default_factory=dict)
    """Numbers (N,) that the generator gives each grasp, by name, such as confidence or success; NaN: none."""
    contact_links: ContactLinks | None = None
    """Links that should touch, as recorded by a refinement; None: not recorded."""

    @classmethod
    def of(cls, hand: Hand, pose: ArrayLike, q: ArrayLike, *, object: str = "object", scale: float = 1.0) -> GraspSet:
        """Return grasps of a hand from arrays; one grasp needs no batch dimension.

        Args:
            hand: The hand.
            pose: Poses of its base link in the object's frame, (N, 7) as x y z qw qx qy qz or (N, 4, 4), metres.
            q: Joint values (N, n) in the order of `hand.joint_names`, radians or metres.
            object: Name of the object.
            scale: Factor that takes the object's mesh to metres.

        Raises:
            GraspFileError: arrays of another shape.
        """
        check_kind("hand", hand, Hand)
        try:
            pose, joints = as_numbers("pose", pose), as_numbers("q", q)
            factor = as_numbers("scale", scale)
        except GraspRefineError as error:
            raise GraspFileError(f"GraspSet: {error}") from None
        pose = pose_from_transform(pose) if pose.shape[-2:] == (4, 4) else pose
        pose, joints = _batched(pose, joints)
        count = (len(pose),) if pose.ndim else ()
        thing = np.broadcast_to(np.asarray(object, dtype=str), np.shape(object) or count)
        factor = np.broadcast_to(factor, factor.shape or count)
        return cls(hand.name, hand.base_link, hand.joint_names, thing, factor, pose, joints)

    @staticmethod
    def join(parts: Iterable[GraspSet]) -> GraspSet:
        """Return the grasps of all parts, in that order, with the columns of the first.

        A target or label that a part lacks is NaN there.

        Raises:
            GraspFileError: there is no part, parts are of another hand, or not all of them have a stage.
        """
        sets = tuple(parts)
        if not sets:
            raise GraspFileError("there are no grasps to join")
        first = sets[0]
        for grasps in sets:
            check_kind("grasps", grasps, GraspSet)
            same = grasps.base_link == first.base_link and set(grasps.joint_names) == set(first.joint_names)
            if not (same and grasps.hand == first.hand):
                raise GraspFileError(
                    f"grasps of '{grasps.hand}' from link '{grasps.base_link}' on, with the joints "
                    f"{', '.join(grasps.joint_names)}, cannot be joined to grasps of '{first.hand}' from "
                    f"'{first.base_link}' on, with {', '.join(first.joint_names)}"
                )
            if one := grasps.other_stages.keys() ^ first.other_stages.keys():
                name = min(one)
                raise GraspFileError(
                    f"only some of the grasps have a {name}: leave it out, replace(grasps, {name}=None)"
                )
        links = tuple(dict.fromkeys(link for grasps in sets if grasps.targets for link in grasps.targets.links))
        labels = tuple(dict.fromkeys(name for grasps in sets for name in grasps.labels))
        most = max(0 if grasps.contact_links is None else grasps.contact_links.name.shape[1] for grasps in sets)
        return join(*(grasps._with_columns(first.joint_names, labels, links, most) for grasps in sets))

    def _with_columns(
        self, joint_names: tuple[str, ...], labels: tuple[str, ...], links: tuple[str, ...], most: int
    ) -> GraspSet:
        """The grasps with the joints in this order, and with all labels and target links, NaN where there are none.

        Contact links are in `most` columns; of 0 there are none.
        """
        none = np.full(len(self), np.nan)
        targets = None
        if links:
            points = np.full((2, len(self), len(links), 3), np.nan)
            if self.targets is not None:
                points[:, :, [links.index(link) for link in self.targets.links]] = (
                    self.targets.point_link,
                    self.targets.point_object,
                )
            targets = Targets(links, *points)
        nothing = ContactLinks(np.full((len(self), 0), ""), np.zeros((len(self), 0)))
        return replace(
            self.in_order(joint_names),
            targets=targets,
            contact_links=(self.contact_links or nothing).padded(most) if most else None,
            labels={name: self.labels.get(name, none) for name in labels},
        )

    def __add__(self, other: GraspSet) -> GraspSet:
        """Return these grasps and then the others, see `join`."""
        return GraspSet.join((self, other)) if isinstance(other, GraspSet) else NotImplemented

    def __getitem__(self, rows: int | slice | ArrayLike) -> GraspSet:
        """Return the grasps of a row number, a slice, a list of row numbers, or where a mask (N,) is True; a set, too.

        Raises:
            GraspFileError: rows of another kind, or out of range.
        """
        chosen = np.arange(len(self))[rows] if isinstance(rows, slice) else np.atleast_1d(np.asarray(rows))
        return self.select(chosen)

    def __iter__(self) -> Iterator[GraspSet]:
        """Yield the grasps one by one, each as a set of one."""
        return (self[row] for row in range(len(self)))

    def columns(self) -> dict[str, Shaped[np.ndarray, " N"]]:
        """Return one column (N,) per number or name of the grasps, as for `pandas.DataFrame(grasps.columns())`.

        They are object, scale, x, y, z, qw, qx, qy, qz of `hand_pose`, the joint values by name, and the labels,
        `label_<name>`.
        """
        pose = dict(zip(POSE_COLUMNS, self.hand_pose.T, strict=True))
        joints = dict(zip(self.joint_names, self.q.T, strict=True))
        labels = {LABEL_PREFIX + name: values for name, values in self.labels.items()}
        return {"object": self.object, "scale": self.scale, **pose, **joints, **labels}

    def __repr__(self) -> str:
        names = np.unique(self.object)
        on = str(names[0]) if len(names) == 1 else count_text(len(names), "object")
        with_parts = [*(["targets"] if self.targets is not None else []), *self.other_stages, *self.labels]
        more = f", with {', '.join(with_parts)}" if with_parts else ""
        return f"GraspSet({count_text(len(self), 'grasp')} of {self.hand} on {on}{more})"

    def __init__(
        self,
        hand: str,
        base_link: str,
        joint_names: Sequence[str],
        object: Sequence[str] | np.ndarray | str,
        scale: ArrayLike,
        hand_pose: ArrayLike,
        q: ArrayLike,
        targets: Targets | None = None,
        pregrasp: Stage | None = None,
        squeeze: Stage | None = None,
        labels: Mapping[str, ArrayLike] = MappingProxyType({}),
        contact_links: ContactLinks | None = None,
    ) -> None:
        """Take lists, arrays or torch tensors, check that all are of N grasps and n joints, and keep NumPy arrays.

        One grasp needs no batch dimension; arguments are the fields.

        Raises:
            GraspFileError: a part of another shape, or of another kind.
        """
        try:
            for name, value in (("hand", hand), ("base_link", base_link)):
                check_kind(name, value, str)
            names = tuple(joint_names)
            check_kind("joint_names", names, tuple[str, ...])
            pose, q = _batched(as_numbers("hand_pose", hand_pose), as_numbers("q", q))
            check_shape("hand_pose", pose, "N", 7, why="x y z qw qx qy qz")
            count = len(pose)
            unit_poses(pose, "hand_pose", GraspRefineError)
            check_shape("q", q, count, len(names), why="one row per hand_pose, one column per joint name")
            scale = np.broadcast_to(as_numbers("scale", scale), np.shape(scale) or (count,))
            check_shape("scale", scale, count)
            thing = np.broadcast_to(np.asarray(object, dtype=str), np.shape(object) or (count,))
            check_shape("object", thing, count)
            stages = {
                name: _checked_stage(name, stage, q.shape)
                for name, stage in (("pregrasp", pregrasp), ("squeeze", squeeze))
            }
            targets = _checked_targets(targets, count)
            check_kind("contact_links", contact_links, ContactLinks | None)
            check_kind("labels", labels, Mapping)
            numbers = {str(name): as_numbers(f"labels[{name!r}]", values, count) for name, values in labels.items()}
        except GraspRefineError as error:
            raise GraspFileError(f"GraspSet: {error}") from None
        fields: dict[str, Any] = {"hand": hand, "base_link": base_link, "joint_names": names, "object": thing}
        fields |= {"scale": scale, "hand_pose": pose, "q": q, "targets": targets, **stages, "labels": numbers}
        self.__dict__.update(fields, contact_links=contact_links)  # `object` is an argument here

    def __len__(self) -> int:
        """Return the number of grasps N."""
        return len(self.object)

    @property
    def grasp(self) -> Stage:
        """The grasps themselves as a stage of the motion."""
        return Stage(self.hand_pose, self.q)

    @property
    def other_stages(self) -> dict[str, Stage]:
        """Stages beside the grasp itself that the set has, by name of `OTHER_STAGES`."""
        stages = {name: getattr(self, name) for name in OTHER_STAGES}
        return {name: stage for name, stage in stages.items() if stage is not None}

    @property
    def finite(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps whose poses and joint values are finite at all stages."""
        others = [values for stage in self.other_stages.values() for values in (stage.pose, stage.q)]
        return np.logical_and.reduce([np.isfinite(values).all(axis=1) for values in (self.hand_pose, self.q, *others)])

    def select(self, indices: ArrayLike) -> GraspSet:
        """Return the grasps in the rows `indices`, in that order; or where a mask (N,) is True.

        Raises:
            GraspFileError: not a list of row numbers, or one out of range.
        """
        return take(self, row_numbers(indices, len(self)))

    def in_order(self, joint_names: tuple[str, ...]) -> GraspSet:
        """Return the grasps with the columns of their joints in this order."""
        order = [self.joint_names.index(name) for name in joint_names]
        stages: dict[str, Any] = {name: Stage(one.pose, one.q[:, order]) for name, one in self.other_stages.items()}
        return replace(self, joint_names=joint_names, q=self.q[:, order], **stages)

    def at(self, stage: Stage) -> GraspSet:
        """Return the grasps with the poses and joint values of one of their stages, for `match_joints`."""
        return replace(self, hand_pose=stage.pose, q=stage.q)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write a grasp file, .npz, which `load_grasps` and all commands read.

        Args:
            path: The file.
            overwrite: Whether an existing file is replaced.

        Raises:
            GraspRefineError: the file has another ending, exists or cannot be written.
        """
        check_kind("path", path, str | Path)
        if Path(path).suffix.lower() != ".npz":
            raise GraspFileError(f"{path}: grasp files end with .npz")
        check_writable(Path(path), overwrite=overwrite)
        save_npz(path, self.arrays())

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the entries of a grasp file with these grasps, for `save_npz`."""
        entries = {
            "schema": np.array(SCHEMA),
            "hand": np.array(self.hand),
            "base_link": np.array(self.base_link),
            "joint_names": np.array(self.joint_names, dtype=str),
            "object": self.object,
            "scale": self.scale,
            "hand_pose": self.hand_pose,
            "q": self.q,
        }
        if self.targets is not None:
            entries["target_link"] = np.array(self.targets.links, dtype=str)
            entries["target_point_link"] = self.targets.point_link
            entries["target_point_object"] = self.targets.point_object
        if self.contact_links is not None:
            entries |= dict(zip(CONTACT_KEYS, (self.contact_links.name, self.contact_links.gap), strict=True))
        for name, stage in self.other_stages.items():
            entries |= {f"{name}_pose": stage.pose, f"{name}_q": stage.q}
        return entries | {LABEL_PREFIX + name: values for name, values in self.labels.items()}


def load_grasps(path: str | Path) -> GraspSet:
    """The grasps of an `.npz` file: float64, unit quaternions, one object name and scale per row.

    Poses and joint values that are not finite are kept, and a pose whose quaternion is 0 becomes NaN, because one bad
    grasp should not cost the others.
    Nothing in the file is unpickled. Raises GraspFileError, one line, when the file is missing, not an
    `.npz`, holds pickles, is of a newer version, lacks entries, or when an entry has the wrong type, shape
    or values.
    """
    check_kind("path", path, str | Path)
    file = load_npz(path)
    _check_schema(file)
    missing = [key for key in REQUIRED if key not in file.entries]
    if missing:
        raise file.error(
            f"lacks {', '.join(missing)}; found {', '.join(sorted(file.entries)) or 'nothing'}; "
            f"needed are {', '.join(REQUIRED)}"
        )
    joint_names = file.names("joint_names")
    duplicates = sorted({name for name in joint_names if joint_names.count(name) > 1})
    if duplicates:
        raise file.error(f"joint_names holds {', '.join(duplicates)} more than once")
    grasp = _stage(file, "hand_pose", "q", None, len(joint_names))
    n = len(grasp.q)
    scale = file.per_row("scale", file.numbers("scale"), n)
    if (scale <= 0).any():
        row = int(np.argmax(scale <= 0))
        raise file.error(f"scale must be positive; row {row} has {scale[row]:g}")
    return GraspSet(
        hand=file.name("hand"),
        base_link=file.name("base_link"),
        joint_names=joint_names,
        object=file.per_row("object", file.text("object"), n),
        scale=scale,
        hand_pose=grasp.pose,
        q=grasp.q,
        targets=_targets(file, n),
        **{name: _optional_stage(file, name, n, len(joint_names)) for name in OTHER_STAGES},
        labels=_labels(file, n),
        contact_links=_contact_links(file, n),
    )


def match_joints(grasps: GraspSet, hand: Hand) -> tuple[Float[np.ndarray, "N n"], tuple[str, ...]]:
    """The joint values (N, n) of grasps in the order of `hand.joint_names`, and notes on missing and deviating ones.

    Columns are matched by name. Mimic joints in the file are ignored, because the joint that they follow determines
    them; where the file lacks that one, the first mimic joint in the file determines it. Other joints that the file
    lacks stay at the rest pose. Notes name each, and mimic joints that deviate from the joint that they follow.
    Raises GraspFileError when the file names joints that this hand cannot move.
    """
    check_kind("grasps", grasps, GraspSet)
    check_kind("hand", hand, Hand)
    joints = {joint.name: joint for joint in hand.joints}
    mimics = {name: followed(joint, joints) for name, joint in joints.items() if joint.mimic is not None}
    unknown = [name for name in grasps.joint_names if name not in mimics and name not in hand.joint_names]
    if unknown:
        raise GraspFileError(
            f"the grasps are for another hand ('{grasps.hand}'): hand '{hand.name}' has no joint "
            f"{', '.join(unknown)}; its joints are {', '.join(hand.joint_names)}"
        )
    column = {name: i for i, name in enumerate(grasps.joint_names)}
    q = np.tile(np.asarray(hand.rest, dtype=float), (len(grasps), 1))
    for i, name in enumerate(hand.joint_names):
        if name in column:
            q[:, i] = grasps.q[:, column[name]]
    notes, inferred = _name_notes(grasps, hand), {}
    for follower in grasps.joint_names:
        leads = mimics.get(follower)
        if (
            leads is not None
            and leads.joint not in column
            and leads.joint not in inferred
            and leads.multiplier
            and not leads.higher
        ):
            inferred[leads.joint] = follower
            values = (grasps.q[:, column[follower]] - leads.offset) / leads.multiplier
            q[:, hand.joint_names.index(leads.joint)] = values
    if inferred:
        pairs = ", ".join(f"{name} from {follower}" for name, follower in inferred.items())
        notes.append(f"joints that the grasp file lacks are computed from their mimic joints: {pairs}")
    lacking = [name for name in hand.joint_names if name not in column and name not in inferred]
    if lacking:
        notes.append(f"joints that the grasp file lacks stay at their rest pose: {', '.join(lacking)}")
    ignored = [name for name in grasps.joint_names if name in mimics and name not in inferred.values()]
    if ignored:
        notes.append(f"mimic joints follow their joint, not the grasp file: {', '.join(ignored)}")
    for name in ignored:
        leads = mimics[name]
        expected = leads.value(q[:, hand.joint_names.index(leads.joint)])
        with np.errstate(invalid="ignore"):
            away = np.abs(grasps.q[:, column[name]] - expected)
        off = away[np.isfinite(away)].max(initial=0.0)
        if off > MIMIC_TOLERANCE:
            notes.append(f"in the file, mimic joint {name} is up to {off:.3g} away from where {leads.joint} puts it")
    return q, tuple(notes)


def _name_notes(grasps: GraspSet, hand: Hand) -> list[str]:
    """Note that grasps name another hand than the given one, unless one name is a part of the other."""
    named, expected = (name.casefold() for name in (grasps.hand, hand.name))
    if named in expected or expected in named:
        return []
    return [f"the grasps name the hand '{grasps.hand}'; they are read as grasps of '{hand.name}'"]


def _batched(pose: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses and joint values of one grasp, or of several, with a batch dimension."""
    pose = pose[None] if pose.ndim == 1 else pose
    return pose, q[None] if q.ndim == len(pose) == 1 else q


def _checked_stage(name: str, stage: Stage | None, shape: tuple[int, ...]) -> Stage | None:
    """A stage with arrays, of as many grasps and joints as `q` of a shape (N, n)."""
    check_kind(name, stage, Stage | None)
    if stage is None:
        return None
    pose, q = as_numbers(f"{name}.pose", stage.pose), as_numbers(f"{name}.q", stage.q)
    pose, q = _batched(pose, q)
    check_shape(f"{name}.pose", pose, shape[0], 7, why="x y z qw qx qy qz, one row per grasp")
    check_shape(f"{name}.q", q, *shape, why="as the grasps have")
    return Stage(pose, q)


def _checked_targets(targets: Targets | None, count: int) -> Targets | None:
    """Targets with arrays, of as many grasps."""
    check_kind("targets", targets, Targets | None)
    if targets is None:
        return None
    links = tuple(targets.links)
    shape = count, len(links), 3
    of_links = as_numbers("targets.point_link", targets.point_link, *shape)
    return Targets(links, of_links, as_numbers("targets.point_object", targets.point_object, *shape))


def _check_schema(file: NpzFile) -> None:
    schema = file.entries.get("schema", np.array(1))
    if schema.shape != () or schema.dtype.kind not in "iu" or schema < 1:
        raise file.error(f"schema must be one integer from 1 to {SCHEMA}")
    if schema > SCHEMA:
        raise file.error(f"schema {schema} is newer than this version of grasp-refine reads ({SCHEMA}); update it")


def _stage(file: NpzFile, pose_key: str, q_key: str, n: int | None, joints: int) -> Stage:
    """The poses and joint values under two keys, of `n` grasps, or of as many as there are poses."""
    pose = file.numbers(pose_key, allowed="any")
    if pose.ndim != 2 or pose.shape[1] != 7 or not len(pose) or n not in (None, len(pose)):
        rows = "(N, 7) with N >= 1" if n is None else f"({n}, 7)"
        raise file.error(f"{pose_key} must have shape {rows}, x y z qw qx qy qz; it has {pose.shape}")
    q = file.numbers(q_key, allowed="any")
    if q.shape != (len(pose), joints):
        raise file.error(
            f"{q_key} must have shape ({len(pose)}, {joints}), one row per hand_pose and one column per "
            f"name in joint_names; it has {q.shape}"
        )
    return Stage(unit_poses(without_zero_quaternions(pose), pose_key, file.error), q)


def _optional_stage(file: NpzFile, name: str, n: int, joints: int) -> Stage | None:
    keys = f"{name}_pose", f"{name}_q"
    present = [key for key in keys if key in file.entries]
    if not present:
        return None
    if len(present) < len(keys):
        raise file.error(f"a {name} needs {' and '.join(keys)} together; found only {present[0]}")
    return _stage(file, *keys, n, joints)


def _labels(file: NpzFile, n: int) -> dict[str, Float[np.ndarray, " N"]]:
    found = {}
    for key in sorted(key for key in file.entries if key.startswith(LABEL_PREFIX)):
        values = file.numbers(key, allowed="any")
        if values.shape != (n,):
            raise file.error(f"{key} must have shape ({n},), one number per grasp; it has {values.shape}")
        found[key.removeprefix(LABEL_PREFIX)] = values
    return found


def _contact_links(file: NpzFile, n: int) -> ContactLinks | None:
    if not all(key in file.entries for key in CONTACT_KEYS):
        return None
    name, gap = file.text(CONTACT_KEYS[0]), file.numbers(CONTACT_KEYS[1], allowed="nan")
    if name.ndim != 2 or len(name) != n or gap.shape != name.shape:
        raise file.error(
            f"{' and '.join(CONTACT_KEYS)} must have one shape (N, M) for {n} grasps; they have {name.shape} and "
            f"{gap.shape}"
        )
    return ContactLinks(name, np.where(name == "", np.nan, gap))


def _targets(file: NpzFile, n: int) -> Targets | None:
    present = [key for key in TARGET_KEYS if key in file.entries]
    if not present:
        return None
    if len(present) < len(TARGET_KEYS):
        raise file.error(f"targets need {', '.join(TARGET_KEYS)} together; found only {', '.join(present)}")
    links = file.names("target_link")
    points = []
    for key in TARGET_KEYS[1:]:
        value = file.numbers(key, allowed="nan")
        if value.shape != (n, len(links), 3):
            raise file.error(f"{key} must have shape ({n}, {len(links)}, 3); it has {value.shape}")
        points.append(value)
    # A target is a pair of whole points; half of one has no meaning and would spread NaN silently.
    absent = np.isnan(np.concatenate(points, axis=-1))
    partly = absent.any(axis=-1) & ~absent.all(axis=-1)
    if partly.any():
        row, k = np.argwhere(partly)[0]
        raise file.error(
            f"the target of link '{links[k]}' in row {row} is partly NaN; "
            f"both points must be finite, or both NaN for no target"
        )
    return Targets(links, points[0], points[1])
