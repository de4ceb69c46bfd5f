"""The options that say where hand, object and grasps are, and the scenes that they mean."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.assets.locating import fetched
from grasp_refine.assets.names import find_asset
from grasp_refine.core.errors import GraspFileError, GraspRefineError, HandError
from grasp_refine.core.names import exists
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import Holes
from grasp_refine.geometry.units import UNITS, Unit
from grasp_refine.grasps.formats.listing import FormatName
from grasp_refine.grasps.formats.reading import Reading, reading
from grasp_refine.grasps.grasp_set import GraspSet, Targets, choose_rows, match_joints
from grasp_refine.grasps.rebase import rebased
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.link_geometry import HULL_LIMIT
from grasp_refine.hands.source import check_known
from grasp_refine.hands.tree import read_tree
from grasp_refine.objects.object import Object, UncutObject, cut_objects, read_object
from grasp_refine.objects.source import ObjectSource, chosen_object, is_known, named_object
from grasp_refine.pipeline.problem import Draft, Group, Problem, UncutGroup
from grasp_refine.pipeline.recorded_objects import check_objects
from grasp_refine.results.result_files import fingerprint, recorded_urdf
from grasp_refine.scene.convention_check import convention_notes
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine_apps.commands.options import INDICES, check_hull_limit


@dataclass(frozen=True)
class Sources:
    """Where hand, objects and grasps are."""

    hand: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    """A name that `refine-grasp hands` lists, a folder with a hand.toml or one URDF, a .urdf file, or an asset such as
    hands/leap."""
    urdf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    """Another URDF for the hand, with the same names of joints and links; needed where a hand comes without one."""
    mjcf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    """The hand as an MJCF file, or an asset such as shadow_mjcf, which is then what is simulated."""
    base_link: Annotated[DisallowNone[str | None], arg(metavar="LINK", help_behavior_hint="(default: as said)")] = None
    """The link that the hand begins at; joints above it do not move. By default what the grasp file or the hand.toml
    says, else the palm of a hand on an arm, else the root."""
    object: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    """An embedded object (mug, bottle, bowl, rounded_box), box:x,y,z, sphere:r, cylinder:r,h, a mesh file, a folder of
    convex pieces, or an asset such as ycb/011_banana."""
    object_name: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the only one)")] = None
    """Which object of the grasp file; needed when it holds several."""
    objects: Annotated[DisallowNone[Path | None], arg(help_behavior_hint="(default: none)")] = None
    """All objects of the grasp file: a folder of meshes, or of folders of pieces, named like them, or a TOML file of
    lines name = "path"."""
    scale: float = 1.0
    """Multiplies the scale that the grasp file gives for the mesh, which is 1 for sampled grasps."""
    unit: Annotated[DisallowNone[Unit | None], arg(help_behavior_hint="(default: m, asked about if unlikely)")] = None
    """Unit of the object's mesh after scaling."""
    holes: Holes = "refuse"
    """What becomes of an object's mesh with holes: an error, flat caps on flat holes, or its convex hull."""
    format: Annotated[DisallowNone[FormatName | None], arg(help_behavior_hint="(default: as its content says)")] = None
    """Format of the grasp file, or of the files in the folder; `refine-grasp convert --help` describes them."""
    index: Annotated[tuple[int, ...], INDICES, arg(help_behavior_hint="(default: all)")] = ()
    """Which grasps of each object; 0 is its first one in the file."""
    table: Annotated[DisallowNone[float | None], arg(metavar="Z", help_behavior_hint="(default: none)")] = None
    """A table at this height (metres) of the object's frame, z up, that no link may go through."""
    hull_limit: float = HULL_LIMIT
    """Largest distance (metres) by which the convex hull of a link's mesh may stand out of it; beyond it the mesh is
    split into its bodies, or cut. inf: hulls only."""
    threshold: float = Decomposition.threshold
    """Largest concavity, 0.01 to 1, of the pieces that CoACD cuts a concave object into; lower is finer."""
    other_object: Annotated[bool, arg(help_behavior_hint="")] = False
    """Take results that were refined on another object, or on the same one in another size."""

    def load_from(self, path: Path, seed: int, say: Callable[[str], None]) -> Problem:
        """The grasps of a file, with the targets that it gives; `say` hears when a decomposition starts and ends.

        Raises:
            GraspRefineError: something is missing, cannot be used, or does not fit the rest.
        """
        return self.cut(self.draft_from(path, say), seed, say)

    def load_read(self, read: Reading, path: Path, seed: int, say: Callable[[str], None]) -> Problem:
        """The same for grasps that were read from `path` already."""
        return self.cut(self.draft_read(read, path, say), seed, say)

    def draft_from(self, path: Path, say: Callable[[str], None]) -> Draft:
        """The first half of `load_from`: everything that is needed is read and checked."""
        path = on_disk(path, say)
        return self.draft_read(self._read(path, say), path, say)

    def draft_read(self, read: Reading, path: Path, say: Callable[[str], None]) -> Draft:
        """The first half of `load_read`."""
        self.check_numbers()
        grasps = read.grasps
        names = self._names(grasps, path)
        chosen = {name: choose_rows(grasps, object_name=name, index=self.index or None) for name in names}
        sources = {name: self._source(name, path, say) for name in names}
        targets = self._targets(grasps, path)
        hand, grasps, resting = self._hand(grasps, path, say)
        q, notes = match_joints(grasps, hand)
        notes = (*read.notes, *hand.notes, *resting, *notes, *_other_urdf(path, hand, chosen=bool(self.hand)))
        groups: list[UncutGroup] = []
        count = 0
        for name, rows in chosen.items():
            index = np.asarray(self.index) if self.index else np.arange(len(rows))
            place, count = np.arange(count, count + len(rows)), count + len(rows)
            scales = grasps.scale[rows] * self.scale
            for scale in np.unique(scales):
                at = np.flatnonzero(scales == scale)
                uncut = self.read_object(sources[name], float(scale))
                notes += tuple(f"{name}: {note}" for note in uncut.notes)
                file_scale = float(grasps.scale[rows[at[0]]])
                groups.append(UncutGroup(name, self._metres(scale), uncut, file_scale, rows[at], index[at], place[at]))
        aims = [_aim(hand, targets, group.rows) for group in groups]
        notes += check_objects(read.files, {group.key: group.uncut for group in groups}, other=self.other_object)
        files, table = self._files(path, read), self._table()

        def finish(objects: Sequence[Object]) -> Problem:
            found = []
            for group, obj, aim in zip(groups, objects, aims, strict=True):
                some = grasps.select(group.rows)
                scene = Scene(hand, obj, transform_from_pose(some.hand_pose), q[group.rows], *aim, table=table)
                found.append(Group(group.object, group.scale, scene, some, group.rows, group.index, group.place))
            cut = {group.key: obj for group, obj in zip(groups, objects, strict=True)}
            doubts = convention_notes([group.scene for group in found])
            told = dict.fromkeys((*notes, *check_objects(read.files, cut, other=True), *doubts))
            return Problem(hand, files, tuple(found), tuple(told), convention_notes=doubts)

        names_of_grasps = tuple(name for name, rows in chosen.items() for _ in rows)
        return Draft(hand, files, names_of_grasps, targets is not None, tuple(groups), finish)

    @stage("loading")
    def cut(self, draft: Draft, seed: int, say: Callable[[str], None]) -> Problem:
        """The second half of `load_from`: the objects are cut into convex pieces, several at a time."""
        return draft.finish(self._cut([group.uncut for group in draft.groups], seed, say))

    def check_numbers(self) -> None:
        """Refuse a scale, a table or a hull limit that can mean nothing.

        Raises:
            GraspRefineError: names the option.
        """
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise GraspRefineError(f"--scale must be positive and finite, got {self.scale:g}")
        if self.table is not None and not np.isfinite(self.table):
            raise GraspRefineError(f"--table must be a height in metres, got {self.table:g}")
        check_hull_limit(self.hull_limit)

    def _metres(self, scale: float) -> float:
        """What takes the mesh to metres, where `scale` takes it to the unit."""
        return float(scale) * UNITS[self.unit or "m"]

    def _table(self) -> Plane | None:
        """The table, if there is one."""
        return None if self.table is None else Plane(offset=self.table)

    def read_object(self, source: ObjectSource, scale: float) -> UncutObject:
        """An object of the size that the options say, still to be cut.

        Raises:
            GraspRefineError: it cannot be read or used.
        """
        found = read_object(source.source, scale=scale, unit=self.unit, holes=self.holes)
        return found if source.asset is None else replace(found, name=source.asset.name)

    def _cut(self, objects: Sequence[UncutObject], seed: int, say: Callable[[str], None]) -> Sequence[Object]:
        """The objects, cut as the options say."""
        return cut_objects(objects, Decomposition(threshold=self.threshold), seed=seed, progress=say)

    def _read(self, path: Path, say: Callable[[str], None]) -> Reading:
        """The grasps of a file, or of a folder, of any format."""
        # Ours name their joints; for others the hand may have to say what their columns are.
        hand = None if self.hand is None or path.suffix == ".npz" else self.load_hand(self.hand, None, say)
        return reading(path, format=self.format, hand=hand)

    def load_hand(self, source: str, base_link: str | None, say: Callable[[str], None]) -> Hand:
        """A hand, of the files that the options name."""
        return load_hand(
            source, base_link=base_link, urdf=self.urdf, mjcf=self.mjcf, hull_limit=self.hull_limit, progress=say
        )

    def _files(self, path: Path, read: Reading) -> tuple[Path, ...]:
        """What grasps are read from: the path that was given, and the files in it if it is a folder."""
        return tuple(dict.fromkeys((path, *read.files)))

    def _targets(self, grasps: GraspSet, path: Path) -> Targets | None:
        """The targets of all rows of the grasp file; None: they are to be found."""
        return grasps.targets

    def _hand(self, grasps: GraspSet, path: Path, say: Callable[[str], None]) -> tuple[Hand, GraspSet, list[str]]:
        """The hand below the base link that is asked for, the grasps told from there, and notes."""
        source = self.hand or grasps.hand
        if self.hand is None:
            check_known(source, path)
        load = cache(partial(self.load_hand, source, say=say))
        try:
            hand = load(grasps.base_link)
        except HandError:
            whole = load(None)
            links = read_tree(whole.urdf).links
            if grasps.base_link in links:
                raise
            raise GraspFileError(
                f"{path}: the grasps are for another hand ('{grasps.hand}'): their base_link '{grasps.base_link}' "
                f"is no link of hand '{whole.name}'; its links are {', '.join(links)}"
            ) from None
        notes = []
        if self.base_link is not None:
            told, hand = rebased(grasps, self.base_link, load), load(self.base_link)
            resting = [name for name in told.joint_names if name not in grasps.joint_names]
            notes = [f"joints that the grasps lack begin at rest: {', '.join(resting)}"] if resting else []
            grasps = told
        if not any(link.body is not None for link in hand.links):
            raise GraspFileError(
                f"{path}: the grasps are for another hand ('{grasps.hand}'): from their base_link "
                f"'{grasps.base_link}' on, no link of hand '{hand.name}' has collision geometry"
            )
        return self._simulated(hand), grasps, notes

    def _simulated(self, hand: Hand) -> Hand:
        """The hand as it will be simulated."""
        # A file that is given is meant to be used.
        hand = hand if self.mjcf is None else replace(hand, collision="mjcf")
        if hand.collision == "mjcf" and hand.mjcf is not None:
            from grasp_refine.validation.mjcf_model import mjcf_model

            # Squeezes are for the actuators that will press.
            hand = replace(hand, actuator=mjcf_model(hand, hand.mjcf).actuator)
        return hand

    def _names(self, grasps: GraspSet, path: Path) -> list[str]:
        """Names of the objects whose grasps are meant, in the order of the file."""
        if self.object is not None and self.objects is not None:
            raise GraspRefineError("--object and --objects exclude each other: give one of them")
        if self.object_name is not None:
            return [self.object_name]
        names = list(dict.fromkeys(grasps.object.tolist()))
        if len(names) > 1 and self.objects is None and not (self.object is None and all(map(is_known, names))):
            listing = ", ".join(f"{name} ({np.count_nonzero(grasps.object == name)})" for name in names)
            raise GraspFileError(
                f"{path}: has grasps of {len(names)} objects; choose one with --object-name, or give all their "
                f"meshes with --objects: {listing}"
            )
        return names

    def _source(self, name: str, path: Path, say: Callable[[str], None]) -> ObjectSource:
        """What `load_object` should load for the object `name` of the grasp file."""
        if self.object is not None:
            return chosen_object(self.object, say)
        return named_object(name, None if self.objects is None else on_disk(self.objects, say), path, say)


def on_disk(path: Path, say: Callable[[str], None]) -> Path:
    """The same, or where the files of an asset of this name lie, if nothing else is called so."""
    asset = None if exists(path) or path.suffix else find_asset(str(path), "grasps")
    return path if asset is None else fetched(asset, say)


def _other_urdf(path: Path, hand: Hand, *, chosen: bool) -> list[str]:
    """What to say where grasps were refined with another URDF than that which they are now looked at with.

    Raises:
        GraspFileError: they were, and nobody has `chosen` this one: a user's hand may be called like one of ours.
    """
    recorded = recorded_urdf(path)
    if recorded in (None, fingerprint(hand.urdf)["sha256"]):
        return []
    other = f"{path} was made with another URDF of hand '{hand.name}' than {hand.urdf}"
    if not chosen:
        raise GraspFileError(
            f"{other}: give that one with --hand or --urdf, or --hand {hand.name} if this one is meant"
        )
    return [other]


def _aim(hand: Hand, targets: Targets | None, rows: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    """`target_link` and `target_object` of a scene with some rows of a grasp file; None each without targets.

    Raises:
        GraspFileError: a link has no target column.
    """
    if targets is None:
        return None, None
    links = links_of(hand)
    columns = list(links)
    points = np.full((2, len(rows), len(columns), 3), np.nan)
    for k, link in enumerate(targets.links):
        if link not in columns:
            raise GraspFileError(
                f"target link '{link}' is no link with collision geometry of hand '{hand.name}', or comes more "
                f"often than its contact points; there are {', '.join(links)}"
            )
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at], points[1, :, at] = targets.point_link[rows, k], targets.point_object[rows, k]
    return points[0], points[1]
