"""Collections: which grasp is which, and what their files say of each."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.refine import refine_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.plane import Plane
from grasp_refine.validation.trials import Reason
from grasp_refine_apps.commands.inputs import Inputs
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.marks import marks_path
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.present import present
from grasp_refine_apps.viewer.model.state import State
from made_results import CHANGES, STATUSES, save_example_results
from open_viewer import made_trial
from refusals import refused

EXAMPLE = resource_dir("robots") / "allegro" / "example_mug.npz"


def opened(path: Path, **options: object) -> Collection:
    return Collection.of(load_problem(ProblemSpec(**options, grasps=path)))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_example_results(tmp_path_factory.mktemp("results") / "allegro_mug.npz", 20)


def test_a_grasp_file_is_what_it_holds() -> None:
    grasps, collection = load_grasps(EXAMPLE), opened(EXAMPLE)
    assert len(collection) == len(grasps) == 4
    assert not collection.columns
    for i in range(4):
        scene = collection.scene(i)
        assert len(scene.q) == len(scene.T_world_root) == 1
        assert np.allclose(scene.T_world_root[0], transform_from_pose(grasps.hand_pose[i]), atol=1e-12)
        assert (scene.q[0] == grasps.q[i]).all()
        T, q = collection.initial(i)
        assert (T == scene.T_world_root[0]).all()
        assert (q == scene.q[0]).all()
    assert collection.label(3) == "mug 3"
    assert collection.hand.name == "allegro"


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, -0.6, 0.8), (0.0, 0.0, -1.0)])
def test_up_from_a_table_is_up_in_the_picture(normal: tuple[float, float, float]) -> None:
    collection = opened(EXAMPLE, table=Plane(normal, -0.1))
    T = collection.T_world_object(0)
    np.testing.assert_allclose(T[:3, :3] @ normal, [0, 0, 1], atol=1e-15)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0) and (collection.work(0).T_world_object == T).all()
    if normal[2] == 1.0:
        np.testing.assert_array_equal(T, np.eye(4))


def test_grasps_keep_the_requested_order(results: Path) -> None:
    collection = opened(results, index=(5, 0, 19))
    assert [collection.label(i) for i in range(3)] == ["mug 5", "mug 0", "mug 19"]
    assert collection.row.tolist() == [5, 0, 19]
    assert np.allclose(collection.columns["contact_error_m_after"].values, [5e-6, 0.0, 19e-6], atol=1e-12)


def test_a_result_file_says_where_grasps_were_and_what_they_are_worth(results: Path) -> None:
    collection = opened(results)
    with np.load(results, allow_pickle=False) as entries:
        pose, q = entries["hand_pose_before"], entries["q_before"]
    for i in (0, 7):
        T, joints = collection.initial(i)
        assert np.allclose(T, transform_from_pose(pose[i]), atol=1e-12)
        assert (joints == q[i]).all()
        assert np.linalg.norm(T[:3, 3] - collection.scene(i).T_world_root[0, :3, 3]) > 1e-3
    columns = collection.columns
    assert np.allclose(columns["quality_after"].values, 7 * np.arange(20) % 20 / 20)
    assert np.allclose(columns["quality_before"].values, columns["quality_after"].values / 2)
    assert columns["penetration_m_after"].text(10) == "0.50"
    assert columns["status"].values.tolist() == [STATUSES[i % 4].label for i in range(20)]
    assert columns["change"].values.tolist() == [CHANGES[i % 3].value for i in range(20)]
    # Contacts have distances in such a file, too: that is no measure of a grasp.
    assert "contact_distance_m_after" not in columns


def test_refined_grasps_in_memory_are_shown_as_their_result_file(tmp_path: Path) -> None:
    """`gr.view(refined)` showed the problem again: no status, no measures, nothing before."""
    config = Settings(geometry_only=True).config()
    refined = refine_problem(load_problem(ProblemSpec(grasps=EXAMPLE, index=(2, 0))), config)
    (path,) = refined.save(tmp_path / "refined.npz")
    saved, shown = opened(path), Collection.of_refined(refined)
    assert list(shown.columns) == list(saved.columns)
    assert {"status", "change", "quality_before", "displacement_m"} <= set(shown.columns)
    for key, column in saved.columns.items():
        np.testing.assert_array_equal(shown.columns[key].values, column.values)
    for i in range(2):
        one, other = shown.pose(i), saved.pose(i)
        np.testing.assert_allclose(one.T_object_root, other.T_object_root, atol=1e-12)
        np.testing.assert_allclose(shown.initial(i)[0], saved.initial(i)[0], atol=1e-12)
        np.testing.assert_array_equal(shown.initial(i)[1], refined.before.q[i])
        assert np.abs(shown.initial(i)[1] - one.q).max() > 1e-3
        np.testing.assert_array_equal(shown.recorded(i).gap, saved.recorded(i).gap)


def test_grasps_of_several_objects_keep_their_own_object_and_targets(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    for name, count in (("mug", 3), ("bottle", 4)):
        save_example_results(folder / f"allegro_{name}.npz", count, name)
    collection = opened(folder)
    assert [path.name for path in collection.files] == ["allegro_bottle.npz", "allegro_mug.npz"]
    assert collection.objects.tolist() == ["bottle"] * 4 + ["mug"] * 3
    assert collection.file_of.tolist() == [0] * 4 + [1] * 3
    assert collection.row.tolist() == [0, 1, 2, 3, 0, 1, 2]
    assert collection.label(5) == "mug 1"
    assert collection.scene(5).object.name == "mug"
    errors = collection.columns["contact_error_m_after"].values
    assert np.allclose(errors, [0, 1e-6, 2e-6, 3e-6, 0, 1e-6, 2e-6], atol=1e-12)
    # Regions are of one object.
    regions = contact_regions(collection.scene(5).object, avoid="above:z=0.06")
    changed = collection.with_regions(int(collection.group_of[5]), regions)
    assert [changed.scene(i).regions is None for i in range(7)] == [True] * 4 + [False] * 3
    collection = collection.with_mark(5, "good")
    collection.save_marks(5)
    assert marks_path(folder / "allegro_mug.npz").is_file()
    assert not marks_path(folder / "allegro_bottle.npz").exists()
    assert [opened(folder / f"allegro_{name}.npz").mark(1) for name in ("mug", "bottle")] == ["good", ""]


def test_marks_are_there_again_and_survive_a_subset(results: Path, tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    path.write_bytes(results.read_bytes())
    collection = opened(path).with_mark(4, "bad").with_mark(6, "good")
    collection.save_marks(4)
    again = opened(path, index=(6, 8))
    assert [again.mark(i) for i in range(2)] == ["good", ""]
    again.with_mark(1, "bad").save_marks(1)
    whole = opened(path)
    assert {i: whole.mark(i) for i in range(20) if whole.mark(i)} == {4: "bad", 6: "good", 8: "bad"}
    assert collection.mark(8) == ""


def test_drawn_grasps_have_no_file_and_no_marks_to_save() -> None:
    inputs = Inputs(hand="allegro", object="box:0.06,0.06,0.06", grasps=Path("sample:2"))
    collection = Collection.of(load_problem(inputs))
    marked = collection.with_mark(0, "good")
    assert marked.mark(0) == "good"
    with refused(GraspFileError):
        marked.save_marks(0)
    assert not collection.files


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"q_before": np.zeros((2, 16))}, ("hand_pose_before", "q_before", "hand_pose")),
        ({"hand_pose_before": np.zeros((20, 7))}, ("hand_pose_before", "row 0", "quaternion")),
        ({"quality_after": np.zeros(3)}, ("quality_after", "(20,)", "(3,)")),
        ({"loss_m2": np.array(["a"])}, ("loss_m2",)),
        ({"status": np.array(["\x1b[2J"] * 20)}, ("status",)),
    ],
)
def test_damaged_results_are_named(
    results: Path, tmp_path: Path, change: dict[str, np.ndarray], named: tuple[str, ...]
) -> None:
    path = tmp_path / "damaged.npz"
    with np.load(results, allow_pickle=False) as entries:
        np.savez(path, **{**entries, **change})
    with refused(GraspFileError, "damaged.npz", *named):
        opened(path)


def test_entries_of_other_programs_mean_nothing(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    with np.load(EXAMPLE, allow_pickle=False) as entries:
        np.savez(path, **entries, loss=np.zeros((3, 3)), status=np.array(7))
    assert not opened(path).columns


def test_older_results_say_where_grasps_were_in_other_words_or_not(results: Path, tmp_path: Path) -> None:
    path = tmp_path / "old.npz"
    with np.load(results, allow_pickle=False) as entries:
        before = {key: entries[key] for key in ("hand_pose_before", "q_before")}
        np.savez(path, **{key: entries[key] for key in entries.files if key not in before})
    collection = opened(path)
    assert (collection.initial(2)[1] == collection.scene(2).q[0]).all()
    assert collection.columns["quality_before"].known.all()
    with np.load(path, allow_pickle=False) as entries:
        np.savez(path, **entries, initial_pose=before["hand_pose_before"], initial_q=before["q_before"])
    assert (opened(path).initial(2)[1] == before["q_before"][2]).all()


def test_verdicts_of_a_simulation_are_columns(results: Path) -> None:
    reasons = (Reason.HELD, Reason.ROTATED)
    collection = opened(results).with_trials({number: made_trial(reasons[number % 2]) for number in range(10)})
    assert collection.columns["held"].values[:3].tolist() == ["held", "failed", "held"]
    assert collection.columns["reason"].values[:3].tolist() == ["", "rotated", ""]
    assert not collection.columns["held"].known[10:].any()
    # Later results come on top, and None takes one away.
    off_centre = replace(made_trial(Reason.HELD), label=0.1)
    collection = collection.with_trials({12: made_trial(Reason.HELD), 0: None, 1: off_centre})
    assert collection.columns["held"].known.nonzero()[0].tolist() == [*range(1, 10), 12]
    assert collection.columns["reason"].values[1] == Reason.OFF_CENTRE.label
    assert collection.work(1).trial is off_centre and collection.work(0).trial is None


def test_an_edited_grasp_loses_measures_and_status_of_its_file_and_no_other_does(results: Path) -> None:
    collection = opened(results)
    state = State.first(collection, 3, None)
    state = state.evolve(pose=Pose(state.pose.T_object_root, state.pose.q + 0.1))
    for key, column in present(state).columns.items():
        if key != "here":
            known = collection.columns[key]
            assert column.known.tolist() == [bool(known.known[i] and i != 3) for i in range(20)]
            assert (column.values == known.values)[column.known].all()


def test_files_that_are_no_grasp_files_record_nothing(results: Path, tmp_path: Path) -> None:
    """The grasp of a replay lies in no row of its file."""
    problem = load_problem(ProblemSpec(index=(3,), grasps=results))
    path = tmp_path / "replay.npz"
    for entries in ({"time": np.zeros(3)}, {"hand_pose": np.zeros((3, 7)), "provenance": np.array("{}")}):
        np.savez(path, **entries)
        collection = Collection.of(replace(problem, files=(path,)))
        assert collection.files == (path,)
        assert collection.row.tolist() == [3]
        assert not collection.columns


def test_grasps_that_cannot_be_drawn_have_a_reason_and_the_first_that_can_is_opened(tmp_path: Path) -> None:
    grasps = load_grasps(EXAMPLE)
    pose, q = grasps.hand_pose.copy(), grasps.q.copy()
    q[0, 3], pose[1, 0] = np.nan, 1e9
    np.savez(tmp_path / "mug.npz", **replace(grasps, hand_pose=pose, q=q).arrays())
    collection = opened(tmp_path / "mug.npz")
    assert collection.posed.tolist() == [False, False, True, True] and collection.first == 2
    assert [collection.undrawn(n).partition(":")[0] for n in range(4)] == ["not finite", "invalid", "", ""]
    viewer = Controller(collection, Settings())
    viewer.close()
    assert viewer.state.number == 2 and viewer.state.notice is not None
    # NaN is not equal to itself: they were all "edited".
    every = replace(viewer.state, works={n: collection.work(n) for n in range(4)})
    assert not every.unsaved and present(every) is collection


def test_a_link_names_a_grasp_by_its_label_or_its_number(results: Path) -> None:
    collection = opened(results, index=(5, 0, 19))
    assert [collection.find(text) for text in ("mug 19", "1", "mug 5")] == [2, 1, 0]
    assert [collection.find(text) for text in ("3", "mug 7", "cup 5", "", "-1", "mug")] == [None] * 6
