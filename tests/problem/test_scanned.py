"""Refinement on a scanned object: over all solids that it may be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.closing.hypotheses import Ends
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.chain import Chain
from grasp_refine.measures.formulas import COSTLY_M
from grasp_refine.objects.object import scanned_object
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.scanned import next_views
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.scan import Scan
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import links_of

FRONT = 0.03
"""Position on x of the face that was seen, metres."""

QUICK = gr.Config(starts=1)


def box(depth: float) -> tuple[Piece, ...]:
    """A box behind the face that was seen."""
    ends = (FRONT - depth, FRONT)
    return (hull(np.array([[x, y, z] for x in ends for y in (-0.03, 0.03) for z in (-0.05, 0.05)])),)


@pytest.fixture(scope="module")
def scan() -> Scan:
    y, z = np.meshgrid(np.linspace(-0.03, 0.03, 31), np.linspace(-0.05, 0.05, 51))
    points = np.column_stack([np.full(y.size, FRONT), y.ravel(), z.ravel()])
    normals = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    return Scan(points, normals, np.array([[0.5, 0.0, 0.0]]), np.zeros(len(points), dtype=int), 1e-3)


def scanned(scan: Scan, depths: dict[float, float]) -> gr.Object:
    """An object that may be boxes of some depths, by probability."""
    found = tuple(Hypothesis("extruded", box(depth), weight) for depth, weight in depths.items())
    return scanned_object("box", scan, found)


@pytest.fixture(scope="module")
def hand() -> gr.Hand:
    return gr.load_hand("allegro")


@pytest.fixture(scope="module")
def grasps(hand: gr.Hand) -> gr.GraspSet:
    return gr.sample_grasps(hand, gr.load_object("box:0.06,0.06,0.1"), 4, seed=1)


def test_quality_is_over_all_solids_and_what_was_not_seen_is_said(
    scan: Scan, hand: gr.Hand, grasps: gr.GraspSet, tmp_path: Path
):
    # No hand reaches around the second one.
    large = (hull(5.0 * box(0.06)[0].vertices - [4 * FRONT, 0.0, 0.0]),)
    both = Hypothesis("extruded", box(0.06), 0.6), Hypothesis("extruded", large, 0.4)
    obj = scanned_object("box", scan, both)
    found = gr.refine(hand, obj, grasps, QUICK)
    likely, quality = found.outcome["likely_quality"][:, 1], found.quality[:, 1]
    assert (quality <= 0.6).all()
    # Contact links touch the first solid; the file has how probably they touch the object.
    found.save(tmp_path / "refined.npz")
    saved = np.load(tmp_path / "refined.npz")
    touching = ~np.isnan(saved["contact_distance"])
    assert (saved["contact_probability"][touching] >= 0.6 - 1e-9).all()
    assert saved["contact_probability"].max() <= 1.0 + 1e-9
    share, link = 100 * saved["contact_probability"][0, 0], str(saved["contact_link"][0])
    assert found.outcome.likely_contact(links_of(hand), link) == f"; touches {share:.0f} % of what the object may be"
    hidden = np.flatnonzero(likely >= 0.95)
    assert len(hidden)
    for i in hidden:
        assert "of what the object may be" in found.outcome.weakness[i]
    assert "not seen" in str(found)


def test_refined_grasps_hold_more_solids_than_input_grasps(scan: Scan, hand: gr.Hand, grasps: gr.GraspSet):
    found = gr.refine(hand, scanned(scan, {0.06: 0.5, 0.045: 0.3, 0.075: 0.2}), grasps, QUICK)
    better = found.quality[:, 1] >= np.minimum(found.quality[:, 0], 0.95) - 1e-9
    assert better.all()


def test_hands_below_the_table_have_no_quality_and_refined_ones_are_above_it(
    scan: Scan, hand: gr.Hand, grasps: gr.GraspSet
):
    table = Plane(offset=-0.05)
    found = gr.refine(hand, scanned(scan, {0.06: 0.6, 0.08: 0.4}), grasps, QUICK, task=gr.Task(table=table))
    solids = {link.name: link.body for link in hand.links if link.body is not None}
    chain, bodies = Chain(hand, list(solids)), list(solids.values())
    before, after = (
        -table.heights(bodies, chain(transform_from_pose(each.hand_pose), each.q).T_world_link)[0].min(axis=1)
        for each in (found.before, found.after)
    )
    assert (before > COSTLY_M[1]).any()
    assert (found.quality[before > COSTLY_M[1], 0] == 0.0).all()
    assert (after < 1e-5).all()


def test_another_view_is_wanted_where_unseen_contacts_face(scan: Scan):
    """One contact on the face that was seen, one on the far side of each solid."""
    point = np.array([[[[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]], [[0.03, 0.0, 0.0], [-0.05, 0.0, 0.0]]]])
    normal = np.tile([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], (1, 2, 1, 1))
    touching = np.ones((1, 2, 2), dtype=bool)
    none = np.zeros((1, 2))
    ends = Ends(np.eye(4)[None], none, np.zeros((1, 2, 2)), none, touching, point, normal, np.ones(1))
    weights = np.array([0.7, 0.3])
    assert next_views(scan, ends, weights)[0] == pytest.approx([-1.0, 0.0, 0.0])
    seen = replace(ends, touching=touching & [True, False])
    assert next_views(scan, seen, weights)[0] == pytest.approx([0.0, 0.0, 0.0])


def test_simulations_say_that_they_are_of_the_first_solid(scan: Scan, hand: gr.Hand, grasps: gr.GraspSet):
    notes: list[str] = []
    problem = problem_of(hand, scanned(scan, {0.06: 0.6, 0.08: 0.4}), grasps)
    worlds_of(problem, on_note=notes.append)
    assert any("simulated as the first solid" in note for note in notes)
