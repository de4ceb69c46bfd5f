"""`import grasp_refine as gr`: the names of the vocabulary refine, evaluate, simulate, save and show."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import Motion
from grasp_refine.core.npz_files import save_npz
from grasp_refine.forces.wrench import LEVER_M
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.results.document import run_document
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.trials import Reason, Trials
from made_results import made_trials
from plate_gripper import URDF
from refusals import refused


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> gr.Hand:
    path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(URDF)
    return gr.load_hand(path, candidates=64)


@pytest.fixture(scope="module")
def refined(gripper: gr.Hand) -> gr.RefinedGrasps:
    box = gr.load_object("box:0.05,0.06,0.07")
    grasps = replace(gr.sample_grasps(gripper, box, 3), labels={"confidence": np.array([0.5, np.nan, 1.0])})
    return gr.refine(gripper, box, grasps)


def test_what_is_saved_is_what_is_reported(refined: gr.RefinedGrasps, workplace: Path):
    refined.save("refined.npz")
    assert "gripper on box" in str(refined) and "3 of 3 grasps touch" in str(refined)
    saved = gr.load_grasps("refined.npz")
    np.testing.assert_array_equal(saved.labels["confidence"], [0.5, np.nan, 1.0])
    # Reading divides quaternions by their length, which is 1 up to rounding.
    stages = (refined.after.grasp, saved.grasp), (refined.pregrasp, saved.pregrasp), (refined.squeeze, saved.squeeze)
    for was, found in stages:
        np.testing.assert_allclose(found.pose, was.pose, rtol=0.0, atol=1e-15)
        np.testing.assert_array_equal(found.q, was.q)


def test_the_forces_of_the_squeeze_are_in_every_result_under_one_name(refined: gr.RefinedGrasps, workplace: Path):
    """They balance on the object within the stated residual: no result had any."""
    forces, center = refined.forces, refined.problem.groups[0].scene.object.center_of_mass
    residual = refined.outcome["wrench_residual"][:, 1]
    for i in range(3):
        f, r = (values[forces.grasp == i] for values in (forces.vector, forces.point - center))
        pressure = (f * forces.normal[forces.grasp == i]).sum()
        left = np.concatenate([f.sum(axis=0), np.cross(r, f).sum(axis=0) / LEVER_M])
        assert len(f) >= 2 and pressure > 10.0
        assert np.linalg.norm(left) / pressure < residual[i] + 1e-4
    refined.save("refined.npz")
    with np.load("refined.npz", allow_pickle=False) as file:
        for name in ("grasp", "link", "point", "normal", "vector"):
            np.testing.assert_array_equal(file[f"forces_{name}"], getattr(forces, name))
    document = run_document(refined.outcome, refined.config, config={}, wall_s=0.0, cpu_s=0.0)
    entries = document["grasps"][2]["forces"]
    np.testing.assert_array_equal([entry["vector"] for entry in entries], forces.vector[forces.grasp == 2])


def test_what_is_refined_is_measured_and_simulated_as_one(gripper: gr.Hand, refined: gr.RefinedGrasps):
    box = refined.problem.groups[0].scene.object
    evaluation = gr.evaluate(gripper, box, refined.after, "dexgraspbench")
    # Poses are written as quaternions: a last bit moves the contacts of faces that lie flat on each other.
    np.testing.assert_allclose(evaluation.quality, refined.quality[:, 1], atol=1e-5)
    trials = gr.simulate(refined)
    np.testing.assert_array_equal(evaluation.held, trials.held[:, 1])
    assert f"{trials.held[:, 1].sum()} of 3" in str(evaluation)
    in_drake = gr.simulate(refined, gr.Task(gr.Protocol(directions=("+x",), checks=1)), engines=["drake"])
    # Flat jaws touch in several points in MuJoCo, and in one in Drake.
    assert in_drake.held.shape == trials.held.shape
    assert (in_drake.after.closing_m != trials.after.closing_m).all()
    with refused(gr.GraspRefineError, "task="):
        _ = gr.evaluate(gripper, box, refined.after).held
    with refused(gr.GraspRefineError, "forceclosure", "dexgraspbench", "strict", "tabletop"):
        gr.simulate(refined, "forceclosure")


def test_simulations_are_in_the_order_of_the_grasps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Grasps on boxes of two sizes take turns; of each, the place of the hand stands for what was simulated."""
    grasps = gr.load_grasps(resource_dir("robots") / "allegro" / "example_rounded_box.npz")
    save_npz(tmp_path / "two.npz", replace(grasps, scale=np.where(np.arange(len(grasps)) % 2, 1.1, 1.0)).arrays())

    numbered: list[np.ndarray] = []

    def place(world: World, motion: Motion, *, numbers: np.ndarray, **others: object) -> Trials:
        numbered.append(numbers)
        x, held = motion.T_world_root[:, 1, 0, 3], np.full((len(motion), 1), Reason.HELD)
        return made_trials(held, closing_m=x, closing_rad=x, penetration_m=x)

    monkeypatch.setattr("grasp_refine.validation.robustness.judge", place)
    problem = gr.load_problem(gr.ProblemSpec(grasps=tmp_path / "two.npz", index=(0, 1, 2)))
    assert len(problem.groups) == 2
    refined = gr.refine(problem, config=gr.Config(starts=1, solver=LevenbergMarquardt(iterations=1)))
    trials = gr.simulate(refined)
    # Offsets of a protocol depend on the row of the file, before and after alike.
    assert [rows.tolist() for rows in numbered] == [[0, 2], [0, 2], [1], [1]]
    for found, wanted in ((trials.before, refined.before), (trials.after, refined.after)):
        np.testing.assert_allclose(found.closing_m, wanted.hand_pose[:, 0], atol=1e-12)


def test_no_grasps_are_refined_to_none(gripper: gr.Hand, refined: gr.RefinedGrasps, workplace: Path):
    box, grasps = refined.problem.groups[0].scene.object, refined.before
    none = gr.refine(gripper, box, grasps.select(np.zeros(0, dtype=int)))
    assert len(none.after) == len(none.quality) == 0 and "0 of 0 grasps" in str(none)
    with refused(gr.GraspRefineError, "none.npz", "no grasps"):
        none.save("none.npz")
    assert not (workplace / "none.npz").exists()


def test_the_suffix_says_what_is_written(refined: gr.RefinedGrasps, workplace: Path):
    """`save("x.csv")` wrote a zip."""
    assert refined.save("mine.csv") == (Path("mine.csv"),)
    with open("mine.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = refined.columns()
    assert list(rows[0]) == list(columns) and [row["status"] for row in rows] == refined.status.tolist()
    np.testing.assert_array_equal([float(row["quality_after"]) for row in rows], refined.quality[:, 1])
    np.testing.assert_array_equal([float(row["qw"]) for row in rows], refined.after.hand_pose[:, 3])
    for name in ("mine.zip", "mine", "mine.json"):
        with refused(gr.GraspRefineError, name, ".npz", ".csv", ".parquet"):
            refined.save(name)
        assert not Path(name).exists()
    with refused(gr.GraspRefineError, "mine.csv"):
        refined.save("mine.csv")


def test_a_specification_takes_text_and_paths(workplace: Path, pytestconfig: pytest.Config):
    """`ProblemSpec(grasps="dir")` was an AttributeError."""
    if pytestconfig.getoption("jaxtyping_packages"):
        pytest.skip("checked annotations refuse another type first")
    example = resource_dir("robots") / "allegro" / "example_mug.npz"
    as_text = gr.load_problem(gr.ProblemSpec(grasps=str(example), object="mug", index=[1]))
    as_path = gr.load_problem(gr.ProblemSpec(grasps=example, object="mug", index=(1,)))
    np.testing.assert_array_equal(as_text.groups[0].scene.q, as_path.groups[0].scene.q)
    spec = gr.ProblemSpec(hand=Path("my.urdf"), urdf="other.urdf", mjcf="my.xml", objects="meshes", grasps="sample:3")
    assert spec.hand == "my.urdf" and spec.grasps == Path("sample:3")
    assert (spec.urdf, spec.mjcf, spec.objects) == (Path("other.urdf"), Path("my.xml"), Path("meshes"))
    with refused(gr.GraspRefineError, "ProblemSpec: table", "'high'"):
        gr.ProblemSpec(table="high")


def test_bad_arguments_are_refused_by_name(gripper: gr.Hand, refined: gr.RefinedGrasps):
    box, grasps = refined.problem.groups[0].scene.object, refined.after
    with refused(gr.GraspRefineError, "object", "grasps"):
        gr.refine(gripper, box)
    with refused(gr.GraspRefineError, "several", "box (2)", "mug (1)"):
        gr.refine(gripper, box, replace(grasps, object=np.array(["box", "mug", "box"])))
    with refused(gr.GraspRefineError, "elsewhere", gripper.base_link):
        gr.refine(gripper, box, replace(grasps, base_link="elsewhere"))
    with refused(gr.GraspRefineError, "alone"):
        gr.refine(refined.problem, box, grasps)


def test_every_name_of_the_vocabulary_is_there_and_has_a_docstring():
    for name in gr.__all__:
        assert name == "__version__" or getattr(gr, name).__doc__, name
    assert set(gr.__all__) <= set(dir(gr))
    with pytest.raises(AttributeError, match="nonsense"):
        gr.nonsense  # noqa: B018


def test_a_refinement_proves_the_task_that_it_was_for(gripper: gr.Hand, workplace: Path):
    """A push along x alone; another task counts where it names something: lifted, the box is on the same table."""
    box, push = gr.load_object("box:0.05,0.06,0.07"), gr.Protocol("push", mass=0.2, directions=("+x",), checks=1)
    task = gr.Task(push, table=-0.0355)
    refined = gr.refine(gripper, box, gr.sample_grasps(gripper, box, 2, task=task), gr.Config(starts=1), task=task)
    assert (refined.task.protocol, refined.task.table) == (push, task.table)
    own = gr.simulate(refined)
    assert own.protocol.name == "push" and own.after.directions == ("+x",) and own.before.directions == ("+x",)
    (pushed,), (lifted,) = (worlds_of(refined.problem.for_task(name)) for name in (None, "tabletop"))
    assert pushed.mass == pytest.approx(0.2) and "table" not in [pushed.model.geom(i).name for i in range(2)]
    assert lifted.model.geom("table").pos[2] == pytest.approx(-0.0355) and lifted.mass == pytest.approx(0.1)
    refined.save("refined.npz")
    again = gr.load_task("refined.npz")
    assert (again.protocol, again.table) == (push, task.table)
    with refused(gr.GraspRefineError, "base"):
        gr.simulate(refined, gr.Task(base=[0.0, 0.0, 0.0]))


def test_engines_without_a_protocol_are_refused(gripper: gr.Hand, refined: gr.RefinedGrasps):
    """Else nothing would be simulated, and no grasp would have held."""
    with refused(gr.GraspRefineError, "protocol"):
        gr.evaluate(gripper, gr.load_object("box:0.05,0.06,0.07"), refined.after, engines=["drake"])


def test_grasps_of_another_hand_are_refused_by_its_name(refined: gr.RefinedGrasps):
    with refused(gr.GraspRefineError, "'gripper'", "'allegro'"):
        gr.refine(gr.load_hand("allegro"), gr.load_object("box:0.05,0.06,0.07"), refined.after)


def test_grams_are_suspected(refined: gr.RefinedGrasps):
    for mass in (0.2, 200.0):
        notes: list[str] = []
        worlds_of(refined.problem.for_task(gr.Task(gr.Protocol("heavy", mass=mass))), on_note=notes.append)
        assert any("200 kg" in note for note in notes) == (mass == 200.0)


def test_a_table_that_pushes_do_not_simulate_is_noted(refined: gr.RefinedGrasps):
    for task, count in ((gr.Task("strict", table=-0.1), 1), (gr.Task("tabletop", table=-0.1), 0), (None, 0)):
        notes: list[str] = []
        worlds_of(refined.problem.for_task(task), on_note=notes.append)
        found = [note for note in notes if "table is not simulated" in note]
        assert len(found) == count and all("strict" in note for note in found)


def test_margins_stand_on_the_table_of_the_task(gripper: gr.Hand, refined: gr.RefinedGrasps):
    """They once knew no table, so that hands opened as if there was none."""
    box, task = gr.load_object("box:0.05,0.06,0.07"), gr.Task(gr.Protocol(checks=1), table=-0.0355)
    alone = replace(refined.after[:1], pregrasp=None, squeeze=None)
    found = gr.margins(gripper, box, alone, task, draws=1, with_limits=False)
    (scene,) = (group.scene for group in found.problem.groups)
    assert found.protocol.checks == 1 and scene.table is not None and scene.table.offset == -0.0355
