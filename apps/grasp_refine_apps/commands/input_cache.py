"""Inputs whose files, hands and objects stay loaded in a process, because the next shard of a batch needs them too."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from grasp_refine.grasps.formats.reading import Reading
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object, UncutObject
from grasp_refine.objects.source import ObjectSource
from grasp_refine_apps.commands.inputs import Inputs

MOST = {"file": 2, "hand": 4, "uncut": 16, "object": 16}
"""How many of each kind are kept, or of another kind 4; the ones used last. It bounds the memory of a worker."""

Value = TypeVar("Value")


class Kept:
    """What was made before, by kind and key."""

    def __init__(self) -> None:
        """Keep nothing yet."""
        self._kinds: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, kind: str, key: Hashable, make: Callable[[], Value]) -> Value:
        """What `make` returns, or did when it was asked for last."""
        known = self._kinds.setdefault(kind, OrderedDict())
        if key not in known:
            # First, so that never more than the most are in memory.
            while len(known) >= MOST.get(kind, 4):
                known.popitem(last=False)
            known[key] = make()
        known.move_to_end(key)
        return known[key]


@lru_cache(maxsize=1)
def kept_for(batch: str) -> Kept:
    """What this process keeps for one batch; for another one files may have changed."""
    return Kept()


@dataclass(frozen=True)
class KeptInputs(Inputs):
    """Inputs that load nothing twice."""

    kept: Kept = field(default_factory=Kept, compare=False, repr=False)
    """Where it is kept."""

    @classmethod
    def of(cls, inputs: Inputs, kept: Kept) -> KeptInputs:
        """The same inputs."""
        return cls(**{option.name: getattr(inputs, option.name) for option in fields(Inputs)}, kept=kept)

    def read(self, path: Path, say: Callable[[str], None]) -> Reading:
        """All grasps of the file `path`, with the targets that are asked for.

        Raises:
            GraspFileError: it cannot be read, or the targets cannot.
        """

        def aimed() -> Reading:
            read = self._read(path, say)
            return replace(read, grasps=replace(read.grasps, targets=self._targets(read.grasps, path)))

        return self.kept.get("file", (path, self.format, self.hand, self.urdf, self.targets), aimed)

    def named_objects(self, grasps: GraspSet, path: Path, say: Callable[[str], None]) -> dict[str, ObjectSource]:
        """What to load for each object of the grasps that is meant, in the order of the file.

        Raises:
            GraspRefineError: an object is not known, or cannot be told.
        """
        return {name: self._source(name, path, say) for name in self._names(grasps, path)}

    def load_hand(self, source: str, base_link: str | None, say: Callable[[str], None]) -> Hand:
        """A hand, of the files that the options name."""
        key = (source, base_link, self.urdf, self.mjcf, self.hull_limit)
        load = super().load_hand
        return self.kept.get("hand", key, lambda: load(source, base_link, say))

    def _simulated(self, hand: Hand) -> Hand:
        simulated = super()._simulated
        return self.kept.get("simulated", (hand, self.mjcf), lambda: simulated(hand))

    def read_object(self, source: ObjectSource, scale: float) -> UncutObject:
        """An object of the size that the options say, still to be cut."""
        key = (source.source, scale, self.unit, self.holes)
        read = super().read_object
        return self.kept.get("uncut", key, lambda: read(source, scale))

    def _cut(self, objects: Sequence[UncutObject], seed: int, say: Callable[[str], None]) -> Sequence[Object]:
        cut = super()._cut

        def one(uncut: UncutObject) -> Object:
            return self.kept.get("object", (uncut, self.threshold, seed), lambda: cut([uncut], seed, say)[0])

        return [one(uncut) for uncut in objects]
