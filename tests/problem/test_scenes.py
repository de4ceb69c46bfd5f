"""Grasps in scenes, from sampling to result files: clear of all bodies at every stage, and measured, saved, told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.measures.metrics import metrics
from grasp_refine.problem.load import load_problem
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.surroundings import Surroundings

NAME = "ball-in-clutter"


@pytest.fixture(scope="module")
def refined() -> gr.RefinedGrasps:
    """Sampled and refined grasps of a hand on a ball among six bodies on a table."""
    hand, scene = gr.load_hand("allegro"), gr.load_scene(NAME)
    assert scene.object is not None
    ball = gr.load_object(scene.object)
    return gr.refine(hand, ball, gr.sample_grasps(hand, ball, 2, task=gr.Task(scene=scene)), task=gr.Task(scene=scene))


def slack(scene: Scene, pose: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Least distance (N,) of any link from any body beyond its margin, up to 2 cm."""
    prepared = HandObject.of(scene)
    assert scene.environment is not None
    every = np.arange(len(scene.environment.bodies))
    of = Surroundings(prepared.bodies, prepared.bounding_spheres, scene.environment, every)
    near = of.near(prepared.chain(transform_from_pose(pose), q).T_world_link, 0.02, most=1)
    return np.where(near.column[:, 0] < 0, 0.02, near.witness.distance[:, 0] - of.margin[near.column[:, 0]])


def test_hands_keep_the_margins_when_sampled_refined_and_open(refined: gr.RefinedGrasps) -> None:
    scene, before, after = refined.problem.groups[0].scene, refined.before, refined.after
    assert (slack(scene, before.hand_pose, before.q) >= 0.0).all()
    assert (slack(scene, after.hand_pose, after.q) >= -5e-4).all()
    assert (slack(scene, refined.pregrasp.pose, refined.pregrasp.q) >= -5e-4).all()
    assert (refined.outcome["scene_penetration_m"] == 0.0).all()


def test_a_hand_in_a_body_is_measured_whatever_its_margin_and_loses_its_quality(refined: gr.RefinedGrasps) -> None:
    given, after = refined.problem.groups[0].scene, refined.after
    T, prepared = transform_from_pose(after.hand_pose), HandObject.of(given)
    assert given.environment is not None
    # The lowest points of the hands, by the plane; the table is 2 cm above the lowest of all.
    T_link = prepared.chain(T, after.q).T_world_link
    lowest = Plane().lowest(prepared.bodies, T_link)
    height = (np.einsum("nlij,nlj->nli", T_link[..., :3, :3], lowest) + T_link[..., :3, 3])[..., 2].min(axis=1)
    table = next(one for one in given.environment.bodies if one.name == "table")
    up = table.body.pieces[0].bounds[1, 2]
    pose = np.eye(4)
    pose[:3, 3] = given.environment.T_world_object[:3, 3] + [0.0, 0.0, height.min() + 0.02 - up]
    raised = replace(given.environment, bodies=(replace(table, T_world_body=pose, margin=0.5),))
    found = metrics(given.hand, given.object, T, after.q, gr.Task(scene=raised))
    free = metrics(given.hand, given.object, T, after.q)
    assert found.scene_penetration_m.max() == pytest.approx(0.02, abs=1e-6)
    deepest = found.scene_penetration_m.argmax()
    assert deepest == height.argmin()
    assert found.quality[deepest] < 0.5 < free.quality[deepest]
    assert np.isnan(free.scene_penetration_m).all()


def test_results_report_their_scene_and_are_loaded_in_it(refined: gr.RefinedGrasps, tmp_path: Path) -> None:
    path = tmp_path / "ball.npz"
    refined.save(path)
    scene = load_problem(gr.ProblemSpec(grasps=path)).groups[0].scene
    assert scene.environment is not None and scene.environment.name == NAME
    assert load_problem(gr.ProblemSpec(grasps=path, scene="none")).groups[0].scene.environment is None
    other = tmp_path / "other.toml"
    other.write_text("[object]\nposition = [0, 0, 0.035]\n[table]\n")
    with pytest.raises(GraspRefineError) as error:
        load_problem(gr.ProblemSpec(grasps=path, scene=str(other)))
    assert "'other'" in str(error.value) and NAME in str(error.value)


def test_a_scene_that_was_changed_is_another_one(refined: gr.RefinedGrasps, tmp_path: Path) -> None:
    toml, path = tmp_path / "mine.toml", tmp_path / "ball.npz"
    toml.write_text('[object]\nname = "sphere:0.035"\nposition = [0, 0, 0.035]\n[table]\n')
    ball = refined.problem.groups[0].scene.object
    problem = gr.problem_of(refined.problem.hand, ball, refined.after, task=gr.Task(scene=toml))
    gr.RefinedGrasps(problem, refined.config, refined.outcome).save(path)
    found = load_problem(gr.ProblemSpec(grasps=path)).groups[0].scene.environment
    assert found is not None and found.source == str(toml)
    toml.write_text(toml.read_text() + "size = [0.5, 0.5]\n")
    with pytest.raises(GraspRefineError) as error:
        load_problem(gr.ProblemSpec(grasps=path))
    assert "mine" in str(error.value) and "`other_object`" in str(error.value)
    assert load_problem(gr.ProblemSpec(grasps=path, other_object=True)).groups[0].scene.environment is not None


def test_the_object_is_that_of_the_scene() -> None:
    spec = gr.ProblemSpec(hand="allegro", grasps=Path("sample:1"), scene="bottle-in-crate")
    assert load_problem(spec).groups[0].object == "bottle"
    with pytest.raises(GraspRefineError) as error:
        load_problem(replace(spec, object="mug"))
    assert "bottle" in str(error.value) and "mug" in str(error.value)
    with pytest.raises(GraspRefineError, match="exclude"):
        load_problem(replace(spec, table=0.0))
