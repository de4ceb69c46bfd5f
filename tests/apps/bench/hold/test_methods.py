"""Methods: what is compared, and what grasps are refined with."""

from __future__ import annotations

from grasp_refine.refinement.config import Config
from grasp_refine_apps.bench.hold.methods import AS_CAME, GEOMETRY_ONLY, OWN_STAGES, Method, methods
from grasp_refine_apps.bench.hold.presets import PRESETS, STARTS


def test_references_come_first_and_no_number_of_starts_twice():
    assert methods((6, 1, 6), stages=True) == (
        AS_CAME, OWN_STAGES, GEOMETRY_ONLY, Method("forces", 6), Method("forces", 1)
    )  # fmt: skip
    # Without stages of the file, ours are no method of their own.
    assert OWN_STAGES not in methods(STARTS, stages=False)
    labels = [method.label for method in methods((1, 2), stages=True)]
    assert labels == ["input grasps", "own stages", "geometry only", "1 start", "2 starts"]


def test_only_what_is_refined_has_settings():
    assert AS_CAME.config(0, 8) is None and OWN_STAGES.config(0, 8) is None
    geometry, forces = GEOMETRY_ONLY.config(3, 8), Method("forces", 4).config(3, 8)
    assert geometry is not None and not geometry.holds
    assert forces == Config(starts=4, seed=3, width=8) and forces.holds


def test_the_smoke_preset_takes_seconds():
    assert PRESETS["smoke"].count == 2 and max(PRESETS["smoke"].starts) == 2
