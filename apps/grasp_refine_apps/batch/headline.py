"""Tiles above a report: what changed most between input and refined grasps, then the verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.plurals import whole
from grasp_refine.measures.measures import COMPARED, SIDES, Measure
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.histogram import Histogram

Tile = dict[str, str]
"""Number, words and tone of a tile."""


@dataclass(frozen=True)
class Verdict:
    """Numbers of grasps that pass a test, before and after; after alone where there is one side."""

    title: str
    """Name for people."""
    passed: tuple[int, ...]
    """Number of grasps that pass, on each side."""
    count: int
    """Number of grasps."""

    @property
    def effect(self) -> float:
        """Difference of the shares, from -1 to 1; positive is better."""
        return (self.passed[-1] - self.passed[0]) / max(self.count, 1)

    @property
    def tile(self) -> Tile:
        """Tile with the shares and the numbers."""
        shares = [words.share(passed, self.count) for passed in self.passed]
        numbers = " → ".join([*(share.removesuffix(" %") for share in shares[:-1]), shares[-1]])
        counts = " → ".join(map(whole, self.passed))
        return _tile(numbers, f"{self.title}: {counts} of {whole(self.count)}", self.effect)


def headline_tiles(
    verdicts: Sequence[Verdict], distributions: Mapping[str, Histogram], medians: Mapping[str, float]
) -> list[Tile]:
    """Return the tile of the largest change, then the tiles of the other verdicts.

    Changes of verdicts and of measures are compared by Cliff's delta (1993): the probability that a refined grasp is
    better than an input grasp, less the probability that it is worse. Of a verdict it is the difference of the shares.
    Changes of a median by no more than `Unit.negligible` do not count. Of equal changes, verdicts come first.

    Args:
        verdicts: The verdicts; of one side alone, the first one leads.
        distributions: Name of each entry of a measure -> its distribution, as `Measure.entries`.
        medians: Likewise, name -> median.
    """
    if any(len(each.passed) == 1 for each in verdicts):
        return [each.tile | ({"tone": "lead"} if k == 0 else {}) for k, each in enumerate(verdicts)]
    changes: list[tuple[float, Verdict | Measure]] = [(each.effect, each) for each in verdicts if each.effect]
    changes += [(effect, each) for each in COMPARED if (effect := _effect(each, distributions, medians))]
    if not changes:
        return [_tile("no change", "in any verdict, nor in the median of any measure", 0.0, lead=True)] + [
            each.tile for each in verdicts
        ]
    effect, most = max(changes, key=lambda change: abs(change[0]))
    if isinstance(most, Verdict):
        lead = most.tile
    else:
        middles = (most.text(medians[most.entries[side]]) for side in SIDES)
        number = f"{' → '.join(middles)} {most.unit.symbol}".rstrip()
        lead = _tile(number, f"{most.title}, median", effect)
    lead = {**lead, "words": f"{lead['words']}; what changed most", "tone": f"{lead['tone']} lead"}
    return [lead, *(each.tile for each in verdicts if each is not most)]


def _tile(number: str, words: str, effect: float, *, lead: bool = False) -> Tile:
    tone = "good" if effect > 0 else "bad" if effect < 0 else ""
    return {"number": number, "words": words, "tone": "lead" if lead else tone}


def _effect(measure: Measure, distributions: Mapping[str, Histogram], medians: Mapping[str, float]) -> float:
    """Return Cliff's delta of a measure, by the bins of its distributions.

    It is 0 where the medians are as good as equal, or there are none.
    """
    if measure.entries["before"] not in distributions:
        return 0.0
    before, after = (medians[measure.entries[side]] for side in SIDES)
    if not abs(after - before) > measure.unit.negligible:
        return 0.0
    old, new = (distributions[measure.entries[side]].shares(1) for side in SIDES)
    higher = float(np.sum(new * (np.cumsum(old) - old)) - np.sum(old * (np.cumsum(new) - new)))
    return higher if measure.better == "higher" else -higher
