"""What becomes of uploads: a new object under the hand, a new hand at the object, grasps on the objects they name."""

import io
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from grasp_refine.core.se3 import exp_se3
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.problem.problem import Problem
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.files import opening
from grasp_refine_apps.viewer.files.opening import MeshOptions, Opened, open_upload
from grasp_refine_apps.viewer.files.saving import grasp_file
from grasp_refine_apps.viewer.files.unpacking import UploadError
from grasp_refine_apps.viewer.files.uploads import store_upload
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.pose import Pose
from open_viewer import ignored
from refusals import refused
from uploaded import gripper_zip, zipped

pytestmark = pytest.mark.usefixtures("untried")

T = exp_se3(np.array([0.02, -0.01, 0.11, 0.4, -1.2, 0.7]))


@cache
def present() -> tuple[Scene, Pose]:
    """The Allegro hand at a ball, on a table, moved from its pose in the scene."""
    hand = load_hand("allegro", candidates=16)
    ball = load_object("sphere:0.03", candidates=64)
    regions = contact_regions(ball, avoid="above:z=0.02")
    task = Task(table=-0.03, avoid=regions.avoid)
    scene = Scene(hand, ball, np.eye(4)[None], hand.rest[None], task=task)
    return scene, Pose(T, hand.rest + 0.01)


def put(name: str, content: bytes, folder: Path, options: MeshOptions | None = None) -> Problem:
    return opened(name, content, folder, options).problem


def opened(
    name: str, content: bytes, folder: Path, options: MeshOptions | None = None, open_now: Opened | None = None
) -> Opened:
    folder = folder / f"upload {len(list(folder.iterdir()))}"
    folder.mkdir()
    return open_upload(store_upload(name, content, folder), *present(), ignored(), options, open_now)


def box(*sides: float) -> trimesh.Trimesh:
    return trimesh.creation.box(sides)


def test_a_mesh_takes_the_place_of_the_object(tmp_path: Path):
    problem = put("My Box.stl", box(0.04, 0.05, 0.06).export(file_type="stl"), tmp_path)
    scene, pose = present()
    (group,) = problem.groups
    assert problem.hand is scene.hand and group.object == "My_Box" and group.scale == 1.0
    np.testing.assert_allclose(group.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    np.testing.assert_allclose(group.scene.T_world_root[0], pose.T_object_root, atol=1e-12)
    np.testing.assert_array_equal(group.scene.q[0], pose.q)
    # The table stays; regions are of the object that was there.
    assert group.scene.table is scene.table and scene.regions is not None and group.scene.regions is None
    collection = Collection.of(problem)
    assert len(collection) == 1 and collection.label(0) == "My_Box 0"
    # Nothing is to be written beside what was uploaded.
    assert collection.files == ()


def test_a_mesh_of_an_unlikely_size_asks_for_its_unit(tmp_path: Path):
    content = box(40, 50, 60).export(file_type="stl")
    with refused(UploadError, "box.stl", "40 x 50 x 60 m ", "Mesh unit", "millimetres", "40 x 50 x 60 mm") as raised:
        put("box.stl", content, tmp_path)
    assert "`" not in str(raised.value) and str(tmp_path) not in str(raised.value)
    (group,) = put("box.stl", content, tmp_path, MeshOptions(unit="mm")).groups
    np.testing.assert_allclose(group.scene.object.mesh.extents, [0.04, 0.05, 0.06], rtol=1e-6)
    assert group.scale == 0.001


def test_a_mesh_with_holes_says_how_to_close_them(tmp_path: Path):
    ball = trimesh.creation.icosphere(2, 0.03)
    ball.update_faces(ball.triangles_center[:, 2] < 0.01)
    content = ball.export(file_type="stl")
    with refused(UploadError, "bowl", "watertight", "Mesh holes", "convex hull") as raised:
        put("bowl.stl", content, tmp_path)
    assert str(raised.value).startswith("bowl") and "--" not in str(raised.value)
    (group,) = put("bowl.stl", content, tmp_path, MeshOptions(holes="hull")).groups
    assert group.scene.object.mesh.is_watertight


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", ("4 points",)),
        (b"v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 2 4\nf 2 3 4\n", ("finite",)),
        (b"f 1 2 3\n", ()),
        (b"v 0 0 0\nf 9 9 9\n", ()),
    ],
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_bad_meshes_say_what_is_wrong(content: bytes, named: tuple[str, ...], tmp_path: Path):
    with refused(UploadError, "bad.obj", *named) as raised:
        put("bad.obj", content, tmp_path)
    assert str(tmp_path) not in str(raised.value)


def test_a_hand_gets_grasps_on_the_present_object(tmp_path: Path):
    problem = put("gripper.zip", gripper_zip(), tmp_path)
    assert problem.hand.name == "gripper" and problem.sampled == "upload:gripper.zip"
    (group,) = problem.groups
    assert group.scene.object is present()[0].object and group.scene.regions is not None
    assert 1 <= len(problem) <= opening.NUM_SAMPLED_GRASPS
    # They are the same whenever the hand is uploaded.
    again = put("gripper.zip", gripper_zip(), tmp_path)
    np.testing.assert_array_equal(again.groups[0].scene.T_world_root, group.scene.T_world_root)
    assert len(Collection.of(problem)) == len(problem)


def grasps(count: int = 3, **changes: object) -> GraspSet:
    """Grasps of the Allegro hand on two boxes and on something that is nowhere."""
    hand = present()[0].hand
    q = hand.rest + 0.01 * np.arange(count)[:, None]
    made = GraspSet.of(hand, np.repeat(T[None], count, axis=0), q, object="box:0.04,0.05,0.06")
    named = np.array(["box:0.04,0.05,0.06", "vase", "box:0.04,0.05,0.06"])[:count]
    return replace(made, **{"object": named, "scale": np.array([1.0, 0.5, 0.5])[:count], **changes})


def test_grasps_are_opened_on_the_objects_that_they_name(tmp_path: Path):
    own = present()[0].hand
    saved = grasp_file(own, grasps(), "ours")
    problem = put(saved.name, saved.content, tmp_path)
    assert problem.hand is own and not problem.sampled
    collection = Collection.of(problem)
    assert [collection.label(i) for i in range(3)] == ["box:0.04,0.05,0.06 0", "vase 0", "box:0.04,0.05,0.06 1"]
    np.testing.assert_allclose(collection.scene(2).object.mesh.extents, [0.02, 0.025, 0.03])
    assert collection.scene(1).object is present()[0].object
    assert any("'vase'" in note and "'sphere:0.03'" in note for note in problem.notes)
    for i in range(3):
        np.testing.assert_allclose(collection.scene(i).q[0], own.rest + 0.01 * i, atol=1e-12)
        np.testing.assert_allclose(collection.scene(i).T_world_root[0], T, atol=1e-12)


def test_a_mesh_attaches_to_the_grasps_that_name_it(tmp_path: Path):
    """It took the place of all of them: 657 grasps became one."""
    own = present()[0].hand
    saved = grasp_file(own, grasps(), "ours")
    first = opened(saved.name, saved.content, tmp_path)
    assert first.stand_ins == {"vase"}
    mesh = box(40, 50, 60).export(file_type="stl")
    found = opened("Vase.stl", mesh, tmp_path, MeshOptions(unit="mm"), first)
    assert found.attached == "vase" and not found.stand_ins
    collection = Collection.of(found.problem, found.stand_ins)
    assert [collection.label(i) for i in range(3)] == ["box:0.04,0.05,0.06 0", "vase 0", "box:0.04,0.05,0.06 1"]
    # The file gives the vase half the size of its mesh.
    np.testing.assert_allclose(collection.scene(1).object.mesh.extents, [0.02, 0.025, 0.03], rtol=1e-6)
    assert collection.group(1).scale == pytest.approx(0.0005)
    assert collection.scene(2).object is first.problem.groups[0].scene.object
    assert not any("unknown" in note for note in found.problem.notes)
    # One of another name does not, and takes the place of the object as before.
    other = opened("bottle.stl", mesh, tmp_path, MeshOptions(unit="mm"), first)
    assert not other.attached and len(other.problem) == 1


def test_meshes_in_the_zip_of_grasps_are_their_objects(tmp_path: Path):
    own = present()[0].hand
    saved = grasp_file(own, grasps(), "ours")
    files = {"grasps.npz": saved.content, "meshes/VASE.stl": box(0.04, 0.05, 0.06).export(file_type="stl")}
    found = opened("all.zip", zipped(files), tmp_path)
    assert not found.stand_ins and len(found.problem) == 3
    np.testing.assert_allclose(
        Collection.of(found.problem).scene(1).object.mesh.extents, [0.02, 0.025, 0.03], rtol=1e-6
    )


@pytest.mark.parametrize("to", ["dexgraspbench", "bodex"])
def test_a_zip_of_another_format_comes_back(to: str, tmp_path: Path):
    own = present()[0].hand
    saved = grasp_file(own, grasps(1), to)
    collection = Collection.of(put(saved.name, saved.content, tmp_path))
    assert len(collection) == 1
    order = [collection.hand.joint_names.index(name) for name in own.joint_names]
    np.testing.assert_allclose(collection.scene(0).q[0, order], own.rest, atol=1e-6)


def test_grasps_of_a_hand_that_is_not_here_are_refused(tmp_path: Path):
    """A name in a file is never a path on this machine."""
    saved = grasp_file(present()[0].hand, grasps(hand="../../home/me/hand"), "ours")
    with refused(UploadError, "'../../home/me/hand'"):
        put("grasps.npz", saved.content, tmp_path)


def test_names_of_objects_are_no_paths(tmp_path: Path):
    box(0.04, 0.05, 0.06).export(tmp_path / "secret.stl")
    named = grasps(1, object=np.array([str(tmp_path / "secret.stl")]))
    saved = grasp_file(present()[0].hand, named, "ours")
    assert Collection.of(put("grasps.npz", saved.content, tmp_path)).scene(0).object is present()[0].object


def test_scenes_of_uploads_come_with_them(tmp_path: Path):
    """A grasp file of some programs names another file; one of this machine is not read because an upload says so."""
    scene = {"scene": {"mug": {"pose": np.eye(1, 7, 3)[0], "scale": 0.5}}, "task": {"obj_name": "mug"}}
    (tmp_path / "scenes").mkdir()
    np.save(tmp_path / "scenes" / "mug.npy", np.array(scene, dtype=object))
    rows = np.tile(np.r_[np.eye(1, 7, 3)[0], present()[0].hand.rest], (1, 1, 3, 1))
    held = {"robot_pose": rows, "joint_names": list(present()[0].hand.joint_names), "scene_path": ["scenes/mug.npy"]}
    stream = io.BytesIO()
    np.save(stream, np.array(held, dtype=object))
    with refused(UploadError, "scenes/mug.npy"):
        put("grasp.npy", stream.getvalue(), tmp_path)


def test_numbers_of_grasps_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    saved = grasp_file(present()[0].hand, grasps(), "ours")
    monkeypatch.setattr(opening, "MAX_OBJECTS", 2)
    with refused(UploadError, "grasps.npz", "3 objects", "2"):
        put("grasps.npz", saved.content, tmp_path)
    monkeypatch.setattr(opening, "MAX_GRASPS", 2)
    with refused(UploadError, "grasps.npz", "3 grasps", "2"):
        put("grasps.npz", saved.content, tmp_path)


def test_what_is_no_grasp_file_says_so(tmp_path: Path):
    with refused(UploadError, "bad.npy") as raised:
        put("bad.npy", b"\x93NUMPY" + bytes(100), tmp_path)
    assert str(tmp_path) not in str(raised.value)
    # Pickles that would run something are refused by their reader.
    with refused(UploadError, "bad.pkl", "system"):
        put("bad.pkl", b"cos\nsystem\n(S'true'\ntR.", tmp_path)
