"""What a grasp file most likely means: told where it is clear, and nothing said of grasps that may be meant so."""

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from boxed_example import FILE, boxed_example
from grasp_refine.core.errors import ConventionError
from grasp_refine.core.se3 import exp_so3, inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.scene.convention_check import convention_notes, joint_notes, position_notes
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.cli import main
from refusals import assert_names, refused

XYZW = [0, 1, 2, 4, 5, 6, 3]
"""Takes x y z, qw qx qy qz to x y z, qx qy qz qw."""

FAULTS = {
    "degrees": lambda pose, q: (pose, np.degrees(q)),
    "millimetres": lambda pose, q: (pose * [1e3, 1e3, 1e3, 1, 1, 1, 1], q),
    "centimetres": lambda pose, q: (pose * [1e2, 1e2, 1e2, 1, 1, 1, 1], q),
    "x y z w": lambda pose, q: (pose[:, XYZW], q),
    "object in the hand's frame": lambda pose, q: (pose_from_transform(inverse(transform_from_pose(pose))), q),
}
"""What has to be told -> makes grasps that are written so."""


def written(*faults: str) -> tuple[np.ndarray, np.ndarray]:
    """Poses and joint values of the example, as another program might write them."""
    grasps = load_grasps(FILE)
    pose, q = grasps.hand_pose, grasps.q
    for fault in faults:
        pose, q = FAULTS[fault](pose, q)
    return pose, q


example = cache(partial(boxed_example, 64))


def scene(pose: np.ndarray, q: np.ndarray) -> Scene:
    return replace(example(), T_world_root=transform_from_pose(pose), q=q)


@pytest.mark.parametrize(
    "faults",
    [
        (),
        *((fault,) for fault in FAULTS),
        ("degrees", "x y z w"),
        ("degrees", "millimetres"),
        ("object in the hand's frame", "x y z w"),
        ("object in the hand's frame", "millimetres"),
        ("x y z w", "centimetres"),
        ("degrees", "x y z w", "millimetres"),
    ],
    ids="+".join,
)
def test_what_is_meant_is_printed_and_nothing_else(faults: tuple[str, ...]):
    text = "; ".join(convention_notes([scene(*written(*faults))]))
    assert {fault for fault in FAULTS if fault in text} == set(faults)


def test_grasps_that_lack_precision_are_left_alone():
    """Refining them is what the program is for."""
    pose, q = (np.repeat(values, 16, axis=0) for values in written())
    T, rng = transform_from_pose(pose), np.random.default_rng(0)
    ways = rng.normal(size=(2, len(T), 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    T[:, :3, :3] = exp_so3(np.radians(40.0) * ways[0]) @ T[:, :3, :3]
    T[:, :3, 3] += 0.06 * ways[1]
    assert convention_notes([scene(pose_from_transform(T), q)]) == ()


def test_hands_that_are_nowhere_near_are_reported_with_the_frame_that_is_needed():
    pose, q = written()
    (note,) = convention_notes([scene(pose + [0, 0.8, 0.3, 0, 0, 0, 0], q)])
    assert_names(note, "'base_link'")


def test_grasps_that_are_nowhere_do_not_count():
    pose, q = written("degrees")
    pose[0], q[1] = np.nan, np.inf
    one = scene(pose, q)
    assert len(convention_notes([one])) == 1
    assert convention_notes([one.masked(np.zeros(4, dtype=bool))]) == ()


def test_all_objects_of_a_file_count_together():
    """Two grasps on each of two objects are as many as four on one."""
    whole = scene(*written("x y z w"))
    parts = [replace(whole, T_world_root=whole.T_world_root[rows], q=whole.q[rows]) for rows in ([0, 1], [2, 3])]
    assert convention_notes(parts) == convention_notes([whole]) != ()


def test_values_in_radians_beyond_their_limits_are_no_degrees():
    """As degrees any of them would be within."""
    hand, (_, q) = example().hand, written()
    assert joint_notes(hand, q + 2.0) == ()
    assert joint_notes(hand, q[:0]) == ()


def test_without_an_object_positions_are_compared_with_what_is_near_any_object():
    (pose, _), (far, _) = written(), written("millimetres")
    assert position_notes(pose) == position_notes(pose[:0]) == ()
    assert len(position_notes(far)) == 1


@pytest.fixture
def file(workplace: Path) -> Path:
    """The example in millimetres and degrees."""
    pose, q = written("millimetres", "degrees")
    save_npz(workplace / "grasps.npz", replace(load_grasps(FILE), hand_pose=pose, q=q).arrays())
    return Path("grasps.npz")


def test_what_is_meant_is_read_as_it_is_with_a_warning(file: Path):
    pose, q = written("millimetres", "degrees")
    with pytest.warns(UserWarning) as told:
        problem = load_problem(ProblemSpec(grasps=file, as_is=True))
    assert [word for one in told for word in ("degrees", "millimetres") if word in str(one.message)] == [
        "degrees",
        "millimetres",
    ]
    np.testing.assert_array_equal(problem.groups[0].scene.q, q)
    np.testing.assert_allclose(problem.groups[0].scene.T_world_root[:, :3, 3], pose[:, :3])
    assert set(problem.convention_notes) <= set(problem.notes)


@pytest.mark.parametrize("fault", ["degrees", "x y z w"])
def test_arrays_in_memory_are_refused_unless_they_are_meant(fault: str):
    hand, obj = example().hand, example().object
    pose, q = written(fault)
    suspected = replace(load_grasps(FILE), hand_pose=pose, q=q)
    for call in (gr.problem_of, gr.refine, gr.evaluate):
        with refused(ConventionError, fault, "as_is"):
            call(hand, obj, suspected)
    with pytest.warns(UserWarning, match=fault):
        gr.problem_of(hand, obj, suspected, as_is=True)


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_commands_refuse_in_one_line_and_write_nothing(file: Path, capsys: pytest.CaptureFixture[str]):
    before = file.read_bytes()
    for words in (
        ["run", "--grasps", file, "--geometry-only", "--json", "new.json"],
        ["validate", file, "--no-simulate", "--json", "new.json"],
        ["convert", file, "new.npz", "--to", "ours", "--json", "new.json"],
        ["convert", file, file, "--to", "ours", "--overwrite"],
    ):
        assert run(*words) == 2
        out, error = capsys.readouterr()
        assert out == ""
        if words[2] != file:
            assert_names(error, file, "degrees", "millimetres", "--as-is")
    assert file.read_bytes() == before
    assert [path.name for path in Path().iterdir()] == [file.name]


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("fault", FAULTS)
def test_few_grasps_show_what_is_clear(fault: str, count: int):
    """Far as read, within 8 mm otherwise: each of them."""
    pose, q = (values[:count] for values in written(fault))
    assert fault in "; ".join(convention_notes([scene(pose, q)]))


def test_small_angles_in_degrees_show_where_fingers_are():
    """A flat hand on a plate: in radians its joints are 4 beyond their limits, less than a turn."""
    hand, plate = gr.load_hand("leap", candidates=16), gr.load_object("box:0.3,0.3,0.02", candidates=16)
    T, q = np.tile(np.eye(4), (4, 1, 1)), np.full((4, 16), 0.09)
    T[:, 0, 3], T[:, 2, 3] = np.linspace(-0.02, 0.02, 4), 0.06
    assert convention_notes([Scene(hand, plate, T, q)]) == ()
    (note,) = convention_notes([Scene(hand, plate, T, np.degrees(q))])
    assert_names(note, "degrees")
    # Radians that are as far beyond, where nothing is near.
    T[:, 2, 3] = 0.12
    assert convention_notes([Scene(hand, plate, T, np.degrees(q))]) == ()
