"""Rows of `bench transfer`: one for each source, hand and way, over all objects."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.measures.fidelity import Likeness
from grasp_refine.validation.margins.intervals import wilson
from grasp_refine_apps.bench.transfer.measure import WAYS, Measured, Way
from grasp_refine_apps.bench.transfer.study import TransferStudy


def measured(
    way: Way,
    held: list[bool],
    pinch: list[float],
    words: list[Likeness],
    source: str = "a",
    fits: bool | list[bool] = True,
) -> Measured:
    palm = np.arange(len(held), dtype=float)
    fit = np.broadcast_to(fits, len(held))
    return Measured(way, source, "leap", np.array(held), np.array(pinch), np.array(words), palm, fit, 3.0)


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


@pytest.mark.parametrize(("fits", "more"), [([True, False, True], 1), (True, 0), (False, 0)])
def test_jaws_have_a_row_of_the_grasps_that_fit_between_them(fits: bool | list[bool], more: int) -> None:
    held, pinch, words = [True, False, False], [0.001, 0.02, 0.003], [Likeness.SAME, Likeness.OTHER, Likeness.SAME]
    rows = TransferStudy().rows([[measured(way, held, pinch, words, fits=fits) for way in WAYS]])
    assert len(rows) == len(WAYS) + more
    assert all(row["grasps"] == 3 for row in rows[: len(WAYS)])
    if more:
        assert rows[-1]["grasps"] == 2 and rows[-1]["held"] == 0.5 and rows[-1][Likeness.OTHER] == 0
        assert rows[-1]["pinch_m"] == pytest.approx(0.002) and rows[-1]["cpu_s"] == pytest.approx(1.0)
