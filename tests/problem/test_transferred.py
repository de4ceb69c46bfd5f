"""Refinement of transfers: where the contacts of the original do not hold, the grasp may leave them, and says so."""

from __future__ import annotations

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.fidelity import Likeness
from grasp_refine.problem import refine as module
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.refine import Listener, refine_groups, refine_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.problem.transferred import transferred
from grasp_refine.refinement.config import Config


@pytest.mark.parametrize("confidence", [0.5, 0.9999])
def test_only_weak_transfers_are_refined_again_without_targets(confidence: float, monkeypatch: pytest.MonkeyPatch):
    """Each is at least as good as with its targets, and the effort of both is counted."""
    problem = load_problem(ProblemSpec(hand="allegro", transfer_from="shadow", index=(0,)))
    config, calls = Config(confidence=confidence, starts=2), []
    plain = module.refine_together

    def counted(groups, *arguments, **named):
        found = plain(groups, *arguments, **named)
        calls.append((groups, found))
        return found

    monkeypatch.setattr(module, "refine_together", counted)
    (outcome,) = refine_groups(problem.groups, config, Listener())
    (_, (first,)), *more = calls
    weak = first.quality[:, 1] < config.confidence
    assert len(more) == int(weak.any())
    np.testing.assert_array_equal(outcome.quality[~weak], first.quality[~weak])
    np.testing.assert_array_equal(outcome["iterations"][~weak], first["iterations"][~weak])
    if weak.any():
        ((again,), _) = more[0]
        assert again.scene.target_link is None
        assert again.rows.tolist() == np.flatnonzero(weak).tolist()
        assert (outcome["iterations"][weak] > first["iterations"][weak]).all()
        assert (outcome.quality[:, 1] >= first.quality[:, 1]).all()


def test_fingers_touch_beside_contacts_that_they_cannot_reach():
    """LEAP's thumb touches near the contact of Allegro's, with another point of its tip: no gap, no further starts."""
    problem = load_problem(ProblemSpec(hand="allegro", object="bottle", index=(3,)))
    refined = refine_problem(transferred(problem, load_hand("leap")), Config(starts=2))
    outcome = refined.outcome
    assert outcome.quality[0, 1] >= 0.95 and outcome.gap[0] == "" and outcome.fidelity[0] == Likeness.SAME
    assert outcome["starts"][0] == 1


@pytest.mark.parametrize(("radius", "wide"), [(0.03, False), (0.055, True)])
def test_grasps_that_are_wider_than_the_jaws_open_are_counted(radius: float, wide: bool):
    """A ball of 60 mm fits between Franka's jaws, which open by 80 mm, and one of 110 mm does not."""
    hand, ball = load_hand("allegro", candidates=128), gr.load_object(f"sphere:{radius}")
    problem = transferred(gr.problem_of(hand, ball, gr.sample_grasps(hand, ball, 3, seed=2)), load_hand("franka_hand"))
    original = problem.groups[0].scene.original
    ends = [point[opposed] for point, opposed in zip(original.point, original.opposed, strict=True)]
    span = np.array([np.linalg.norm(first - second) for first, second in ends])
    np.testing.assert_allclose(original.span, span)
    assert (span <= 2.0 * radius + 1e-6).all() and (span > 0.08).any() == wide
    (note,) = [note for note in problem.notes if "mm apart" in note] or [""]
    assert note.startswith(f"in {(span > 0.08).sum()} of 3 grasps") == wide
