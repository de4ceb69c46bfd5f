"""The options that say what is refined: grasps of a file, the hand's example, or new ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import DisallowNone, arg

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.formats.reading import Reading
from grasp_refine.grasps.grasp_set import GraspSet, Targets, choose_rows, load_grasps
from grasp_refine.hands.hand import Hand, list_hands, load_hand, needs_urdf
from grasp_refine.objects.object import Object
from grasp_refine.objects.source import check_object, chosen_object
from grasp_refine.pipeline.problem import Draft, Group, Problem, UncutGroup
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.commands.options import flag
from grasp_refine_apps.commands.sources import Sources

AUTO, NEAREST = "auto", "nearest"
"""Values of --targets: those of the grasp file, if any; or the points where links are nearest to the object."""

EXAMPLE_HAND = "allegro"
"""The hand whose example is used when nobody says which."""

EXAMPLE_OBJECT = "mug"
"""The object of the example that is refined when nobody says what."""

SAMPLE = "sample:"
"""What --grasps begins with to mean so many grasps that are drawn, instead of a file."""


@dataclass(frozen=True)
class Inputs(Sources):
    """What is refined."""

    grasps: Annotated[
        DisallowNone[Path | None], arg(metavar="FILE|sample:N", help_behavior_hint="(default: the hand's example)")
    ] = None
    """Grasp file, or a folder of them: ours (.npz), or of another program (see --format); or sample:N, as in sample:32,
    for N new grasps of --hand on --object, which --seed varies."""
    targets: str = AUTO
    """Where links should touch: a grasp file with targets; auto: as --grasps says, else anywhere; or nearest: where
    they are nearest to the object at first."""

    def load(self, seed: int, say: Callable[[str], None], wait: Callable[[str], None] = lambda what: None) -> Problem:
        """The grasps that the options mean, as `load_from`; `wait` hears what takes a while.

        Raises:
            GraspRefineError: something is missing, cannot be used, or does not fit the rest.
        """
        return self.cut(self.draft(seed, say, wait), seed, say)

    @stage("loading")
    def draft(self, seed: int, say: Callable[[str], None], wait: Callable[[str], None] = lambda what: None) -> Draft:
        """The first half of `load`: everything that is needed is read and checked, no object is cut."""
        if str(self.grasps).startswith(SAMPLE):
            return self.draft_sampled(self.sample_count(), seed, say, wait)
        return self.draft_from(self.grasps if self.grasps is not None else self._example(), say)

    def sample_count(self) -> int:
        """How many grasps are to be sampled.

        Raises:
            GraspRefineError: that is not said as it should be, or not of what.
        """
        asked = str(self.grasps)
        count = asked.removeprefix(SAMPLE)
        if not (count.isascii() and count.isdigit() and int(count)):
            raise GraspRefineError(f"--grasps {asked}: {SAMPLE}N needs a whole number N from 1 on, as in {SAMPLE}32")
        if self.objects is not None or self.object_name is not None:
            raise GraspRefineError(f"--objects and --object-name are for grasp files; --grasps {asked} needs --object")
        if self.object is not None:
            check_object(self.object)
        lacking = [flag(name) for name in ("hand", "object") if getattr(self, name) is None]
        if lacking:
            raise GraspRefineError(f"--grasps {asked} needs a hand and an object: give {' and '.join(lacking)}")
        if self.targets not in (AUTO, NEAREST):
            raise GraspRefineError(f"--targets {self.targets}: has no rows for the grasps of --grasps {asked}")
        return int(count)

    def draft_sampled(
        self, count: int, seed: int, say: Callable[[str], None], wait: Callable[[str], None], draw: int = 0
    ) -> Draft:
        """New grasps of the hand on the object, which are sampled once it is cut.

        Args:
            count: How many.
            seed: Of what is drawn.
            say: Hears when a decomposition of the hand's links starts and ends.
            wait: Hears what takes a while.
            draw: Which of several draws; each gives other grasps.

        Raises:
            GraspRefineError: hand or object cannot be used.
        """
        self.check_numbers()
        assert self.hand is not None and self.object is not None  # or `sample_count` refuses
        hand = self._simulated(self.load_hand(self.hand, self.base_link, say))
        source = chosen_object(self.object, say)
        scale = self.scale * (1.0 if source.asset is None else source.asset.scale)
        uncut = self.read_object(source, scale)

        def finish(objects: Sequence[Object]) -> Problem:
            return self._sampled(hand, objects[0], scale, count, (seed, draw) if draw else seed, wait)

        none = np.zeros(0, dtype=np.int64)
        group = UncutGroup(uncut.name, self._metres(scale), uncut, self._metres(scale), none, none, none)
        return Draft(hand, (hand.urdf,), (uncut.name,), False, (group,), finish, f"{SAMPLE}{count}")

    def _sampled(
        self,
        hand: Hand,
        obj: Object,
        scale: float,
        count: int,
        seed: int | tuple[int, int],
        wait: Callable[[str], None],
    ) -> Problem:
        """So many new grasps of a hand on an object, `scale` of its source."""
        from grasp_refine.sampling.sample import sample_grasps

        table = self._table()
        began = time.perf_counter()
        wait(f"sampling grasps of {hand.name} on {obj.name}")
        grasps = sample_grasps(hand, obj, count, seed=seed, table=table)
        notes = [*hand.notes, *(f"{obj.name}: {note}" for note in obj.notes)]
        notes.append(f"sampled {count_text(len(grasps), 'grasp')} in {time.perf_counter() - began:.1f} s")
        if len(grasps) < count:
            notes.append(f"found only {len(grasps)} of {count_text(count, 'grasp')} of '{hand.name}' on '{obj.name}'")
        grasps = replace(grasps, scale=np.full(len(grasps), self._metres(scale)))
        rows = choose_rows(grasps, object_name=None, index=self.index or None)
        grasps = grasps.select(rows)
        scene = Scene(hand, obj, transform_from_pose(grasps.hand_pose), grasps.q, table=table)
        group = Group(obj.name, self._metres(scale), scene, grasps, rows, rows, np.arange(len(rows)))
        return Problem(hand, (hand.urdf,), (group,), tuple(dict.fromkeys(notes)), f"{SAMPLE}{count}")

    def _files(self, path: Path, read: Reading) -> tuple[Path, ...]:
        files = super()._files(path, read)
        return files if self.targets in (AUTO, NEAREST) else (*files, Path(self.targets))

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
        examples: dict[str, Path] = {}
        for path in sorted((resource_dir("robots") / hand).glob("*.npz")):
            examples |= dict.fromkeys(load_grasps(path).object.tolist(), path)
        wanted = self.object_name or self.object
        if wanted is None and not examples:
            raise GraspRefineError(f"--grasps FILE is needed: hand '{hand}' comes without example grasps")
        if wanted is None:
            return examples.get(EXAMPLE_OBJECT) or next(iter(examples.values()))
        if wanted not in examples:
            if self.object is not None:
                check_object(self.object)
            raise GraspRefineError(
                f"--grasps FILE is needed, or --grasps {SAMPLE}16 for new ones: there are no example grasps of hand "
                f"'{hand}' on '{wanted}', only on {', '.join(examples) or 'nothing'}"
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
