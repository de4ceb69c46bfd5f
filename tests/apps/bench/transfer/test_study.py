"""Rows of `bench transfer`: one for each source, hand and way, over all objects."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.measures.fidelity import Likeness
from grasp_refine.validation.margins.intervals import wilson
from grasp_refine_apps.bench.transfer.measure import WAYS, Measured, Way
from grasp_refine_apps.bench.transfer.study import TransferStudy


def measured(way: Way, held: list[bool], pinch: list[float], words: list[Likeness], source: str = "a") -> Measured:
    palm = np.arange(len(held), dtype=float)
    return Measured(way, source, "leap", np.array(held), np.array(pinch), np.array(words), palm, 3.0)


def test_rows_are_over_all_objects_of_a_source() -> None:
    same, other = Likeness.SAME, Likeness.OTHER
    one = [measured(way, [True, True], [0.001, np.nan], [same, other]) for way in WAYS]
    two = [measured(way, [False], [0.003], [same]) for way in WAYS]
    rows = TransferStudy().rows([one, two, [measured(way, [True], [np.nan], [other], "b") for way in WAYS]])
    assert [(row["source"], row["way"]) for row in rows] == [(source, way) for source in "ab" for way in WAYS]
    first, last = rows[0], rows[-1]
    assert first["grasps"] == 3 and first["held"] == pytest.approx(2 / 3)
    assert (first["held_lower"], first["held_upper"]) == pytest.approx([float(end) for end in wilson(np.array(2), 3)])
    assert first["pinch_m"] == pytest.approx(0.002) and first["pinched"] == pytest.approx(2 / 3)
    assert (first[Likeness.SAME], first[Likeness.OTHER], first[Likeness.MOVED]) == (2, 1, 0)
    assert first["cpu_s"] == pytest.approx(2.0), "of a grasp"
    assert last["pinch_m"] is None and last["pinched"] == 0.0
