"""The options that say what is refined, and the scenes that they mean; every command on grasps has them."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.assets import resource_dir
from grasp_refine.commands.problem import Group, Problem
from grasp_refine.description.tree import read_tree
from grasp_refine.errors import AssetError, GraspFileError, GraspRefineError, HandError
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.shapes import EMBEDDED
from grasp_refine.grasps import GraspSet, Targets, choose_rows, load_grasps, match_joints
from grasp_refine.hand import Hand, list_hands, load_hand, needs_urdf
from grasp_refine.object_folders import find_object
from grasp_refine.objects import PRIMITIVE_FORMS, Object, load_object
from grasp_refine.plane import Plane
from grasp_refine.scene import Scene
from grasp_refine.se3 import transform_from_pose

AUTO, NEAREST = "auto", "nearest"
"""Values of --targets: those of the grasp file, if any; or the points where links are nearest to the object."""

EXAMPLE_HAND = "allegro"
"""The hand whose example is used when nobody says which."""

EXAMPLE_OBJECT = "mug"
"""The object of the example that is refined when nobody says what."""

SAMPLE = "sample:"
"""What --grasps begins with to mean so many grasps that are drawn, instead of a file."""


@dataclass(frozen=True)
class Sources:
    """Where hand, objects and grasps are."""

    hand: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    """A name that `refine-grasp hands` lists, a folder with a hand.toml or one URDF, or a .urdf file."""
    urdf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    """Another URDF for the hand, with the same names of joints and links; needed where a hand comes without one."""
    mjcf: Annotated[DisallowNone[Path | None], arg(metavar="FILE", help_behavior_hint="(default: its own)")] = None
    """The hand as an MJCF file, which is then what is simulated."""
    object: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: that of the grasp file)")] = None
    """An embedded object (mug, bottle, bowl, rounded_box), box:x,y,z, sphere:r, cylinder:r,h, a mesh file, or a folder
    of convex pieces."""
    object_name: Annotated[DisallowNone[str | None], arg(help_behavior_hint="(default: the only one)")] = None
    """Which object of the grasp file; needed when it holds several."""
    objects: Annotated[DisallowNone[Path | None], arg(help_behavior_hint="(default: none)")] = None
    """All objects of the grasp file: a folder of meshes, or of folders of pieces, named like them, or a TOML file of
    lines name = "path"."""
    scale: float = 1.0
    """Multiplies the scale that the grasp file gives for the mesh, which is 1 for sampled grasps."""
    index: Annotated[tuple[int, ...], arg(metavar="I [I ...]", help_behavior_hint="(default: all)")] = ()
    """Which grasps of the object; 0 is its first one in the file."""
    table: Annotated[DisallowNone[float | None], arg(metavar="Z", help_behavior_hint="(default: none)")] = None
    """A table at this height (metres) of the object's frame, z up, that no link may go through."""
    threshold: float = Decomposition.threshold
    """Largest concavity, 0.01 to 1, of the pieces that CoACD cuts a concave object into; lower is finer."""

    def load_from(self, path: Path, seed: int, say: Callable[[str], None]) -> Problem:
        """The grasps of a file, with the targets that it gives; `say` hears when a decomposition starts and ends.

        Raises:
            GraspRefineError: something is missing, cannot be used, or does not fit the rest.
        """
        self._check_numbers()
        grasps = load_grasps(path)
        names = self._names(grasps, path)
        chosen = {name: choose_rows(grasps, object_name=name, index=self.index or None) for name in names}
        sources = {name: self._source(name, path) for name in names}
        targets = self._targets(grasps, path)
        hand = self._hand(grasps, path)
        q, notes = match_joints(grasps, hand)
        notes = [*hand.notes, *notes]
        groups, count = [], 0
        for name, rows in chosen.items():
            index = np.asarray(self.index) if self.index else np.arange(len(rows))
            place, count = np.arange(count, count + len(rows)), count + len(rows)
            scales = grasps.scale[rows] * self.scale
            for scale in np.unique(scales):
                at = np.flatnonzero(scales == scale)
                obj = self._object(sources[name], float(scale), seed, say)
                notes += [f"{name}: {note}" for note in obj.notes]
                T = transform_from_pose(grasps.hand_pose[rows[at]])
                scene = _aimed(Scene(hand, obj, T, q[rows[at]], table=self._table()), targets, rows[at])
                groups.append(Group(name, float(scale), scene, grasps.select(rows[at]), rows[at], index[at], place[at]))
        return Problem(hand, self._files(path), tuple(groups), tuple(dict.fromkeys(notes)))

    def _check_numbers(self) -> None:
        """Refuse a scale or a table that can mean nothing."""
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise GraspRefineError(f"--scale must be positive and finite, got {self.scale:g}")
        if self.table is not None and not np.isfinite(self.table):
            raise GraspRefineError(f"--table must be a height in metres, got {self.table:g}")

    def _table(self) -> Plane | None:
        """The table, if there is one."""
        return None if self.table is None else Plane(offset=self.table)

    def _object(self, source: str | Path, scale: float, seed: int, say: Callable[[str], None]) -> Object:
        """An object, cut as the options say."""
        return load_object(
            source, scale=scale, decomposition=Decomposition(threshold=self.threshold), seed=seed, progress=say
        )

    def _files(self, path: Path) -> tuple[Path, ...]:
        """The files that grasps are read from."""
        return (path,)

    def _targets(self, grasps: GraspSet, path: Path) -> Targets | None:
        """The targets of all rows of the grasp file; None: they are to be found."""
        return grasps.targets

    def _hand(self, grasps: GraspSet, path: Path) -> Hand:
        """The hand below the base link that the grasp file names."""
        source = self.hand or grasps.hand
        if self.hand is None and source not in list_hands():
            raise GraspFileError(
                f"{path}: its hand '{source}' is none of ours ({', '.join(list_hands())}); give it with --hand"
            )
        files = {"urdf": self.urdf, "mjcf": self.mjcf}
        try:
            hand = load_hand(source, base_link=grasps.base_link, **files)
        except HandError:
            whole = load_hand(source, **files)
            links = read_tree(whole.urdf).links
            if grasps.base_link in links:
                raise
            raise GraspFileError(
                f"{path}: the grasps are for another hand ('{grasps.hand}'): their base_link '{grasps.base_link}' "
                f"is no link of hand '{whole.name}'; its links are {', '.join(links)}"
            ) from None
        if not any(link.body is not None for link in hand.links):
            raise GraspFileError(
                f"{path}: the grasps are for another hand ('{grasps.hand}'): from their base_link "
                f"'{grasps.base_link}' on, no link of hand '{hand.name}' has collision geometry"
            )
        return self._simulated(hand)

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
        if len(names) > 1 and self.objects is None:
            listing = ", ".join(f"{name} ({np.count_nonzero(grasps.object == name)})" for name in names)
            raise GraspFileError(
                f"{path}: has grasps of {len(names)} objects; choose one with --object-name, or give all their "
                f"meshes with --objects: {listing}"
            )
        return names

    def _source(self, name: str, path: Path) -> str | Path:
        """What `load_object` should load for the object `name` of the grasp file."""
        if self.object is not None:
            return self.object
        if self.objects is None:
            # Names that a file gives are never taken as paths.
            if name in EMBEDDED or ":" in name:
                return name
            raise AssetError(
                f"{path}: its object '{name}' is none of the embedded ones ({', '.join(EMBEDDED)}); give its mesh "
                f"with --object, a folder of meshes with --objects, or a primitive ({PRIMITIVE_FORMS})"
            )
        if self.objects.is_dir():
            return find_object(name, self.objects)
        listed = _read_objects(self.objects)
        if name not in listed:
            raise AssetError(f"{self.objects}: no object '{name}'; it names {', '.join(listed) or 'nothing'}")
        return listed[name]


@dataclass(frozen=True)
class Inputs(Sources):
    """What is refined."""

    grasps: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE|sample:N", help_behavior_hint="(default: the hand's example)")
    ] = None
    """Grasp file (.npz); or sample:N, as in sample:32, for N new grasps of --hand on --object, which --seed varies."""
    targets: str = AUTO
    """Where links should touch: a grasp file with targets; auto: as --grasps says, else anywhere; or nearest: where
    they are nearest to the object at first."""

    def load(self, seed: int, say: Callable[[str], None], wait: Callable[[str], None] = lambda what: None) -> Problem:
        """The grasps that the options mean, as `load_from`; `wait` hears what takes a while.

        Raises:
            GraspRefineError: something is missing, cannot be used, or does not fit the rest.
        """
        if str(self.grasps).startswith(SAMPLE):
            return self._sampled(str(self.grasps), seed, say, wait)
        return self.load_from(self.grasps if self.grasps is not None else self._example(), seed, say)

    def _sampled(self, asked: str, seed: int, say: Callable[[str], None], wait: Callable[[str], None]) -> Problem:
        """New grasps, as many as `asked` says."""
        from grasp_refine.grasp_sampling import sample_grasps

        count = asked.removeprefix(SAMPLE)
        if not (count.isascii() and count.isdigit() and int(count)):
            raise GraspRefineError(f"--grasps {asked}: {SAMPLE}N needs a whole number N from 1 on, as in {SAMPLE}32")
        if self.objects is not None or self.object_name is not None:
            raise GraspRefineError(f"--objects and --object-name are for grasp files; --grasps {asked} needs --object")
        if self.hand is None or self.object is None:
            raise GraspRefineError(f"--grasps {asked} needs to know of what: give --hand and --object")
        if self.targets not in (AUTO, NEAREST):
            raise GraspRefineError(f"--targets {self.targets}: has no rows for the grasps of --grasps {asked}")
        self._check_numbers()
        hand = self._simulated(load_hand(self.hand, urdf=self.urdf, mjcf=self.mjcf))
        obj, table = self._object(self.object, self.scale, seed, say), self._table()
        began = time.perf_counter()
        wait(f"sampling grasps of {hand.name} on {obj.name}")
        grasps = sample_grasps(hand, obj, int(count), seed=seed, table=table)
        notes = [*hand.notes, *(f"{obj.name}: {note}" for note in obj.notes)]
        notes.append(f"{len(grasps)} grasps were sampled in {time.perf_counter() - began:.1f} s")
        if len(grasps) < int(count):
            notes.append(f"only {len(grasps)} of {count} grasps of '{hand.name}' on '{obj.name}' were found")
        grasps = replace(grasps, scale=np.full(len(grasps), self.scale))
        rows = choose_rows(grasps, object_name=None, index=self.index or None)
        grasps = grasps.select(rows)
        scene = Scene(hand, obj, transform_from_pose(grasps.hand_pose), grasps.q, table=table)
        group = Group(obj.name, self.scale, scene, grasps, rows, rows, np.arange(len(rows)))
        return Problem(hand, (hand.urdf,), (group,), tuple(dict.fromkeys(notes)), asked)

    def _files(self, path: Path) -> tuple[Path, ...]:
        return (path,) if self.targets in (AUTO, NEAREST) else (path, Path(self.targets))

    def _example(self) -> Path:
        """The example grasps of the hand on the object that is meant."""
        hand = self.hand or EXAMPLE_HAND
        if hand not in list_hands():
            load_hand(hand)
            whole = [name for name in list_hands() if not needs_urdf(name)]
            raise GraspRefineError(
                f"--grasps FILE is needed: only hands that come with the program ({', '.join(whole)}) "
                f"have example grasps, '{hand}' has none"
            )
        examples = {}
        for path in sorted((resource_dir("robots") / hand).glob("*.npz")):
            examples |= dict.fromkeys(load_grasps(path).object.tolist(), path)
        wanted = self.object_name or self.object
        if wanted is None and not examples:
            raise GraspRefineError(f"--grasps FILE is needed: hand '{hand}' comes without example grasps")
        if wanted is None:
            return examples.get(EXAMPLE_OBJECT) or next(iter(examples.values()))
        if wanted not in examples:
            raise GraspRefineError(
                f"--grasps FILE is needed: there are no example grasps of hand '{hand}' on '{wanted}', "
                f"only on {', '.join(examples) or 'nothing'}"
            )
        return examples[wanted]

    def _targets(self, grasps: GraspSet, path: Path) -> Targets | None:
        """The targets of all rows of the grasp file; None: they are to be found."""
        if self.targets in (AUTO, NEAREST):
            return grasps.targets if self.targets == AUTO else None
        aimed = load_grasps(self.targets)
        if aimed.targets is None:
            raise GraspFileError(
                f"{self.targets}: has no targets (target_link, target_point_link, target_point_object)"
            )
        if len(aimed) != len(grasps) or (aimed.object != grasps.object).any():
            raise GraspFileError(
                f"{self.targets}: its rows must be those of {path}: {len(aimed)} against {len(grasps)} grasps"
                + ("" if len(aimed) != len(grasps) else ", of other objects")
            )
        return aimed.targets


def _aimed(scene: Scene, targets: Targets | None, rows: np.ndarray) -> Scene:
    """The scene with the targets of some rows of a grasp file, one column per link of the scene."""
    if targets is None:
        return scene
    columns = list(scene.links)
    points = np.full((2, len(rows), len(columns), 3), np.nan)
    for k, link in enumerate(targets.links):
        if link not in columns:
            raise GraspFileError(
                f"target link '{link}' is no link with collision geometry of hand '{scene.hand.name}', or comes more "
                f"often than its contact points; there are {', '.join(scene.links)}"
            )
        at = columns.index(link)
        # A link with several contact points has as many columns.
        columns[at] = ""
        points[0, :, at], points[1, :, at] = targets.point_link[rows, k], targets.point_object[rows, k]
    return replace(scene, target_link=points[0], target_object=points[1])


def _read_objects(path: Path) -> Mapping[str, str | Path]:
    """Object name -> what to load, from a TOML file; paths are relative to it."""
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file or folder of objects") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise AssetError(f'{path}: cannot be read as TOML lines name = "path" ({error})') from None
    for name, value in raw.items():
        if not isinstance(value, str) or not value:
            raise AssetError(f"{path}: {name} must be a path in quotes, got {value!r}")
    return {name: value if value in EMBEDDED or ":" in value else path.parent / value for name, value in raw.items()}
