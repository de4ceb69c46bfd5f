"""Regions of objects, from sampling to result files: contacts are in them, or the grasp says that they are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.measures.metrics import metrics
from grasp_refine.problem.load import load_problem
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.results.verdict import advice
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M
from grasp_refine_apps.batch.jobs import read_jobs
from grasp_refine_apps.commands.inputs import Inputs
from refusals import refused

AVOID = "above:z=0.015"
"""Upper third of the box, on whose sides half of the example grasps have a finger."""

TOLERANCE_M = 5e-4
"""Distance in metres from a region that costs no quality."""


@pytest.fixture(scope="module")
def hand() -> gr.Hand:
    return gr.load_hand("allegro")


@pytest.fixture(scope="module")
def block() -> gr.Object:
    return gr.load_object("rounded_box")


@pytest.fixture(scope="module")
def given(hand: gr.Hand) -> gr.GraspSet:
    """Grasps of the example."""
    grasps = gr.load_grasps(resource_dir("robots") / "allegro" / "example_rounded_box.npz")
    return grasps.select(np.arange(len(grasps))[:4])


@pytest.fixture(scope="module")
def refined(hand: gr.Hand, block: gr.Object, given: gr.GraspSet) -> gr.RefinedGrasps:
    """The example, refined away from the top."""
    return gr.refine(hand, block, given, gr.Config(starts=2), task=gr.Task(avoid=AVOID))


def contact_heights(refined: gr.RefinedGrasps) -> np.ndarray:
    """Heights (K,) of all points of the object at which links touch after refinement."""
    outcome = refined.outcome
    return outcome.contact_point_object[..., 2][outcome.contact_distance <= CONTACT_DISTANCE_M]


def test_contacts_slide_out_of_what_they_should_avoid(refined: gr.RefinedGrasps, given: gr.GraspSet) -> None:
    before, after = refined.outcome["region_miss_m"].T
    assert (before > 1e-3).any() and (after <= TOLERANCE_M).all()
    assert contact_heights(refined).max() <= 0.015 + TOLERANCE_M
    assert (refined.quality[:, 1] > 0.9).all()
    # Without knowing of it, they do not.
    hand, block = refined.problem.hand, refined.problem.groups[0].scene.object
    free = gr.refine(hand, block, given, gr.Config(starts=1))
    assert contact_heights(free).max() > 0.02 and np.isnan(free.outcome["region_miss_m"]).all()
    assert "touch only where" in str(refined) and "touch only where" not in str(free)


def test_every_link_that_touches_counts(refined: gr.RefinedGrasps) -> None:
    """The measure is that of all links within the contact distance, by hand and through the facade."""
    scene = refined.problem.groups[0].scene
    found = metrics(scene.hand, scene.object, scene.T_world_root, scene.q, scene.task)
    np.testing.assert_allclose(found.region_miss_m, refined.outcome["region_miss_m"][:, 0])
    evaluated = gr.evaluate(scene.hand, scene.object, refined.before, gr.Task(avoid=AVOID))
    np.testing.assert_allclose(evaluated.validated.metrics.region_miss_m, found.region_miss_m)
    assert (evaluated.quality[found.region_miss_m > 2.5e-3] == 0.0).all()


def test_grasps_that_cannot_reach_a_region_say_so(hand: gr.Hand, block: gr.Object, given: gr.GraspSet) -> None:
    still = gr.Config(starts=1, max_move=MaxMove(1e-3, 0.01, 0.01))
    refined = gr.refine(hand, block, given, still, task=gr.Task(touch="below:z=-0.03"))
    miss = refined.outcome["region_miss_m"][:, 1]
    assert (miss > 0.01).any() and (refined.quality[miss > 2.5e-3, 1] == 0.0).all()
    links = refined.problem.groups[0].scene.links
    for row in np.flatnonzero(miss > TOLERANCE_M):
        text = refined.outcome.weakness[row]
        assert f"touches {1e3 * miss[row]:.1f} mm outside of below:z=-0.03" in text
        assert any(text.startswith(link) for link in links)
        assert text in advice(refined.outcome, refined.config)[row]
        assert text in str(refined).replace("\n", " ")


def test_sampled_hands_touch_where_they_should(hand: gr.Hand, block: gr.Object) -> None:
    around = gr.Environment((), np.eye(4), touch=("below:z=-0.01",))
    grasps = gr.sample_grasps(hand, block, 4, task=gr.Task(scene=around))
    found = gr.evaluate(hand, block, grasps, gr.Task(touch="below:z=-0.01")).validated.metrics
    anywhere = gr.evaluate(
        hand, block, gr.sample_grasps(hand, block, 4), gr.Task(touch="below:z=-0.01")
    ).validated.metrics
    assert (found.contact_number >= 2).all()
    assert np.median(found.region_miss_m) < 5e-3 < np.median(anywhere.region_miss_m)


def test_results_find_their_regions_again(refined: gr.RefinedGrasps, tmp_path: Path) -> None:
    (path,) = refined.save(tmp_path / "refined.npz")
    again = load_problem(gr.ProblemSpec(grasps=path))
    assert again.groups[0].scene.regions is not None and again.groups[0].scene.regions.text == f"avoid {AVOID}"
    other = load_problem(gr.ProblemSpec(grasps=path, touch=("below:z=0.02",)))
    assert other.groups[0].scene.regions is not None and other.groups[0].scene.regions.text == "touch below:z=0.02"


def test_scene_files_and_job_lists_have_regions(tmp_path: Path, block: gr.Object) -> None:
    (tmp_path / "faces.txt").write_text("0 1")
    scene = tmp_path / "scene.toml"
    scene.write_text('[object]\nname = "rounded_box"\ntouch = "faces:faces.txt"\navoid = ["above:z=0.01"]\n')
    environment = gr.load_scene(scene)
    assert environment.touch == (f"faces:{tmp_path / 'faces.txt'}",) and environment.avoid == ("above:z=0.01",)
    before = environment.digest
    (tmp_path / "faces.txt").write_text("0 1 2")
    assert gr.load_scene(scene).digest != before
    assert replace(environment, touch=(), avoid=()).digest == gr.Environment((), np.eye(4)).digest
    jobs = tmp_path / "jobs.toml"
    jobs.write_text('[[job]]\ngrasps = "sample:2"\nhand = "allegro"\ntouch = ["faces:faces.txt", "above:x=0"]\n')
    (job,) = read_jobs([str(jobs)], Inputs())
    assert job.inputs.touch == (f"faces:{tmp_path / 'faces.txt'}", "above:x=0")
    scene.write_text('[object]\nname = "rounded_box"\ntouch = "abve:z=0.1"\n')
    with refused(GraspRefineError, "scene.toml", "[object] touch", "did you mean above"):
        gr.load_scene(scene)
    jobs.write_text('[[job]]\ngrasps = "sample:2"\navoid = 3\n')
    with refused(GraspRefineError, "jobs.toml", "avoid", "3"):
        read_jobs([str(jobs)], Inputs())
