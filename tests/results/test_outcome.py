"""Outcomes of refinements, and their JSON document."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.json_files import dumps
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.refine import Config, Scene, refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.document import run_document
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.scene.contact_selection import ContactSelection
from made_results import error_in_millimetres, with_measures, with_status


def test_join_and_select_keep_grasps_whole():
    first, second = error_in_millimetres(2), error_in_millimetres(3, ("can",))
    joined = Outcome.join([first, second]).select(np.array([4, 0]))
    assert joined.object.tolist() == ["can", "mug"]
    assert joined.index.tolist() == [2, 0]
    np.testing.assert_array_equal(joined["contact_error_m"][0], second["contact_error_m"][2])


def test_the_outcome_measures_a_refinement():
    """A hand far from its targets: errors, points and movement against what they are by definition."""
    hand, ball = load_hand("allegro", candidates=64), load_object("sphere:0.04", candidates=64)
    T = np.eye(4)
    T[:3, 3] = (-0.09, 0.0, -0.03)
    q = np.where(np.arange(len(hand.rest)) == 3, hand.upper + 0.1, hand.rest)
    scene = Scene(hand, ball, T[None], q[None])
    config = Config(solver=Descent(iterations=40), contact_selection=ContactSelection(reach=0.2), nearest=True)
    refinement = refine(scene, config)
    motion = closing_motion(replace(scene, T_world_root=refinement.T_world_root, q=refinement.q))
    outcome = compare(
        scene, refinement, motion, margin=0.0, name="ball", scale=2.0, row=np.array([5]), index=np.array([1])
    )
    np.testing.assert_allclose(outcome.stage_pose[:, 1], outcome.hand_pose, atol=1e-12)
    np.testing.assert_array_equal(outcome.stage_q[:, 1], refinement.q)
    measured = metrics(hand, ball, refinement.T_world_root, refinement.q)
    np.testing.assert_allclose(outcome["wrench_residual"][:, 1], measured.wrench_residual, rtol=1e-9)
    np.testing.assert_allclose(outcome.quality[:, 1], measured.quality, rtol=1e-6)
    assert outcome["starts"].tolist() == [1] and outcome.aimed.all()
    assert outcome.usable.all()
    # Of two measures of the refined grasp alone, that of the input is another.
    assert metrics(hand, ball, T[None], q[None]).limits_violated == [1] and outcome["limits_violated"] == [0]
    assert (outcome.object[0], outcome.scale[0], outcome.row[0], outcome.index[0]) == ("ball", 2.0, 5, 1)
    with_target = ~np.isnan(outcome.target_point_link[0, :, 0])
    # Witness points on a ball lie on it, along the normal that looks into it.
    on_ball = outcome.contact_point_object[0, with_target]
    np.testing.assert_allclose(np.linalg.norm(on_ball, axis=1), 0.04)
    np.testing.assert_allclose(outcome.contact_normal[0, with_target], -on_ball / 0.04, atol=1e-9)
    assert np.isnan(outcome.contact_point_object[0, ~with_target]).all()
    np.testing.assert_allclose(
        outcome["moved_palm_m"][0], np.linalg.norm(refinement.T_world_root[0, :3, 3] - T[:3, 3]), rtol=1e-12
    )
    miss = np.linalg.norm(outcome.contact_point_link - outcome.target_point_link, axis=-1)[0, with_target]
    assert (miss <= outcome["contact_error_m"][0, 1] + 1e-12).all()
    assert (miss.mean() <= outcome["contact_error_mean_m"][0, 1] + 1e-12).all()
    before, after = outcome["contact_error_m"][0]
    assert after < before


def test_a_document_has_si_units_and_null_for_nan():
    outcome = with_status(error_in_millimetres(2), g1=Status.NO_TARGET)
    quality = np.array([[0.4, 0.85], [0.97, np.nan]])
    outcome = with_measures(outcome, moved_palm_m=np.array([0.004, np.nan]), quality=quality)
    document = run_document(outcome, Config(seed=3), config={"a": Path("b")}, wall_s=1.5, cpu_s=2.0)
    read = json.loads(dumps(document), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert read["config"] == {"a": "b"}
    assert read["totals"] == {
        "n": 2, "converged": 1, "good_before": 1, "good_after": 0, "success_before": None, "success_after": None,
        "changes": {"kept": 2, "contacts moved": 0, "other links": 0, "other grasp": 0},
        "good_inputs": 1, "good_inputs_moved": 1, "good_inputs_displacement_median_m": 0.007,
        "wall_s": 1.5, "cpu_s": 2.0,
    }  # fmt: skip
    first, second = read["grasps"]
    assert (first["index"], first["row"], first["status"], first["starts"]) == (0, 100, "converged", 2)
    assert "may slip" in first["advice"] and "`starts`" in first["advice"]
    assert (first["change"], first["displacement_m"], first["links_kept"]) == ("kept", 0.007, 1.0)
    assert second["advice"] == Status.NO_TARGET.advice
    assert first["quality"] == {"before": 0.4, "after": 0.85} and second["quality"] == {"before": 0.97, "after": None}
    assert second["contact_error_m"] == {"before": 0.01, "after": 0.001}
    assert second["contact_error_mean_m"] == {"before": 0.005, "after": 0.0005}
    assert second["wrench_residual"] == {"before": 0.2, "after": 0.05}
    assert second["simulation"] == {"before": None, "after": None}
    assert second["penetration_m"] == {"before": 0.002, "after": 0.0001}
    assert second["moved_palm_m"] is None and second["moved_slides_m"] is None
    assert second["moved_palm_rad"] == pytest.approx(np.radians(5))
    assert second["moved_joints_rad"] == pytest.approx(np.radians(6))
