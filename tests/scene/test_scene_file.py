"""Scene files: bodies and poses as they are written, and refusals that name key, value and choices."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.objects.object import load_object
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.scene_file import list_scenes, load_scene


def read(tmp_path: Path, text: str) -> Environment:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return load_scene(path)


def corners(environment: Environment, name: str) -> np.ndarray:
    """Lower and upper corner (2, 3) of a body in the world."""
    (body,) = (one for one in environment.bodies if one.name == name)
    bounds = np.array([piece.transformed(body.T_world_body).bounds for piece in body.body.pieces])
    return np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])


def test_bodies_are_where_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    for number, x in enumerate((0.0, 0.1)):
        import trimesh

        trimesh.creation.box([0.1, 0.02, 0.02]).apply_translation([x, 0, 0]).export(tmp_path / f"parts/{number}.obj")
    scene = read(
        tmp_path,
        """
        margin = 0.005
        object = {name = "mug", position = [0.1, 0.0, 0.7], rpy = [0, 0, 90]}
        [table]
        position = [0, 0, 0.7]
        size = [0.8, 0.6]
        [[wall]]
        position = [0, 0.2, 0.7]
        [[wall]]
        position = [0.3, 0, 0.7]
        rpy = [0, 0, -90]
        margin = 0.0
        [bin]
        size = [0.2, 0.3, 0.1]
        thickness = 0.01
        [[body]]
        name = "post"
        cylinder = [0.02, 0.3]
        pose = [0.2, 0.1, 0.85, 0.7071, 0, 0.7071, 0]
        [[body]]
        sphere = 0.03
        movable = true
        density = 1000
        [[body]]
        pieces = "parts"
        """,
    )
    found = scene
    assert (scene.object, found.name) == ("mug", "mine")
    assert [body.name for body in found.bodies] == ["table", "bin", "wall", "wall 2", "post", "sphere", "parts"]
    assert [body.margin for body in found.bodies] == [0.005, 0.005, 0.005, 0.0, 0.005, 0.005, 0.005]
    assert corners(found, "table") == pytest.approx(np.array([[-0.4, -0.3, 0.66], [0.4, 0.3, 0.7]]))
    assert corners(found, "wall") == pytest.approx(np.array([[-0.5, 0.2, 0.7], [0.5, 0.22, 1.2]]))
    assert corners(found, "wall 2") == pytest.approx(np.array([[0.3, -0.5, 0.7], [0.32, 0.5, 1.2]]))
    assert corners(found, "bin") == pytest.approx(np.array([[-0.11, -0.16, -0.01], [0.11, 0.16, 0.1]]))
    assert corners(found, "post") == pytest.approx(np.array([[0.05, 0.08, 0.83], [0.35, 0.12, 0.87]]), abs=2e-4)
    assert corners(found, "parts") == pytest.approx(np.array([[-0.05, -0.01, -0.01], [0.15, 0.01, 0.01]]))
    # A ball of 3 cm of water, as a mesh of the ball.
    assert found.bodies[5].mass == pytest.approx(4 / 3 * np.pi * 0.03**3 * 1e3, rel=0.02)
    turned = transform_from_pose(np.array([0.1, 0.0, 0.7, np.sqrt(0.5), 0, 0, np.sqrt(0.5)]))
    assert found.T_world_object == pytest.approx(turned)
    # The object sees its own frame: 0.2 m along y of the world is along its x.
    assert found.T_object_body[2][:3, 3] == pytest.approx([0.2, 0.1, 0.0])
    assert found.up == pytest.approx([0.0, 0.0, 1.0])


DIGESTED = """lift = 0.1
[object]
name = "mug"
position = [0, 0, 0.5]
avoid = "above:z=0.01"
[table]
position = [0, 0, 0.5]
[[body]]
name = "ball"
sphere = 0.03
position = [0.1, 0, 0.5]
margin = 0.002
movable = true
mass = 0.2
[[body]]
name = "post"
box = [0.1, 0.1, 0.1]
position = [0.3, 0, 0.5]
"""


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("0.5]", "0.7]", True),
        ('name = "mug"', 'name = "bottle"', True),
        ("sphere = 0.03", "sphere = 0.031", False),
        ("[0.1, 0, 0.5]", "[0.1, 0.001, 0.5]", False),
        ("margin = 0.002", "margin = 0.004", False),
        ("mass = 0.2", "mass = 0.3", False),
        ("movable = true\nmass = 0.2\n", "", False),
        ('"ball"', '"tin"', False),
        ("lift = 0.1", "lift = 0.2", False),
        ("above:z=0.01", "above:z=0.02", False),
        ("avoid", "touch", False),
        ("0.5]\navoid", "0.5]\nrpy = [90, 0, 0]\navoid", False),
    ],
)
def test_the_digest_is_of_what_is_where_around_the_object(tmp_path: Path, old: str, new: str, same: bool) -> None:
    assert old in DIGESTED
    first, second = read(tmp_path, DIGESTED), read(tmp_path, DIGESTED.replace(old, new))
    assert (first.digest == second.digest) == same
    assert replace(first, bodies=first.bodies[::-1]).digest == first.digest


@pytest.mark.parametrize("name", list_scenes())
def test_in_the_scenes_that_come_with_the_program_the_object_rests_on_something_and_is_in_nothing(name: str) -> None:
    scene = load_scene(name)
    assert scene.object is not None and scene.name == scene.source == name
    obj, T = load_object(scene.object).body, scene.T_object_body[None]
    pairs = Pairs(tuple(one.body for one in scene.bodies), (obj,) * len(scene.bodies))
    found = query(pairs, T, np.broadcast_to(np.eye(4), T.shape))
    assert found.distance.min() == pytest.approx(0.0, abs=1e-6)
    # What supports it is below: the normal from body to object points up.
    assert found.normal[0, found.distance[0].argmin()] == pytest.approx(scene.up, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[table]", ("[object]", "missing")),
        ("object = 3", ("[object]", "3")),
        ('[object]\nname = "mugg"', ("mugg", "did you mean mug?")),
        ('[object]\nname = "mug"\nmesh = "mug.obj"', ("name", "mesh")),
        ('[object]\nname = "mug"\n[tabel]', ("tabel", "did you mean table?")),
        ('[object]\nname = "mug"\n[table]\nheigth = 1', ("[table]", "heigth")),
        ('[object]\nname = "mug"\npositon = [0, 0, 1]', ("positon", "did you mean position?")),
        ('[object]\nname = "mug"\nposition = [0, 1]', ("position", "3 numbers", "[0, 1]")),
        ('[object]\nname = "mug"\nposition = [0, 1, nan]', ("position", "nan")),
        ('[object]\nname = "mug"\npose = [0, 0, 0, 1, 1, 0, 0]', ("quaternion", "1.41421")),
        ('[object]\nname = "mug"\npose = [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]', ("pose", "rotation", "2.0")),
        ('[object]\nname = "mug"\npose = [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]', ("rotation", "-1.0")),
        ('[object]\nname = "mug"\npose = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[1,0,0,1]]', ("0, 0, 0, 1",)),
        ('[object]\nname = "mug"\npose = [[1,0,0,0],[0,1,0,0],[0,0,1],[0,0,0,1]]', ("pose", "4 x 4")),
        ('[object]\nname = "mug"\npose = [1, 2, 3, 4]', ("pose", "4 numbers", "1")),
        ('[object]\nname = "mug"\npose = [0, 0, 0, 1, 0, 0, 0]\nrpy = [0, 0, 1]', ("pose", "rpy")),
        ('[object]\nname = "mug"\n[[body]]\nname = "x"', ("[[body]] 1", "box", "capsule", "mesh")),
        ('[object]\nname = "mug"\n[[body]]\nbox = [1, 1, 1]\nsphere = 1', ("box and sphere",)),
        ('[object]\nname = "mug"\n[[body]]\nbox = [1, 0, 1]', ("[[body]] 1 box", "above 0")),
        ('[object]\nname = "mug"\n[[body]]\nmesh = "none.stl"', ("mesh", "none.stl")),
        ('[object]\nname = "mug"\n[[body]]\nsphere = 1\nmargin = -1', ("margin", "-1")),
        ('[object]\nname = "mug"\n[[body]]\nsphere = 1\nmass = 1', ("movable", "mass")),
        ('[object]\nname = "mug"\n[[body]]\nsphere = 1\nmovable = 1', ("movable", "true or false")),
        ('[object]\nname = "mug"\n[[body]]\nsphere = 1\nunit = "mm"', ("sphere", "metres")),
        ('[object]\nname = "mug"\nunit = "foot"', ("unit", "foot", "mm")),
        ('[object]\nname = "mug"\n[table]\nname = "a"\n[[body]]\nsphere = 1\nname = "a"', ("two bodies", "'a'")),
        ('body = 1\n[object]\nname = "mug"', ("body", "[[body]]")),
        ("[object", ("TOML",)),
    ],
)
def test_wrong_files_are_refused_by_name(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(GraspRefineError) as error:
        read(tmp_path, text)
    assert all(word in str(error.value) for word in ("mine.toml", *words)), error.value
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GraspRefineError, match=r"none\.toml"):
        load_scene(tmp_path / "none.toml")


def test_pose_as_a_matrix_is_that_of_its_quaternion(tmp_path: Path) -> None:
    """To the digits that are written; the rotation is orthonormal."""
    given = transform_from_rpy([0.1, -0.2, 0.3, 20.0, -30.0, 110.0])
    file = tmp_path / "scene.toml"
    file.write_text(f'[object]\nname = "mug"\npose = {np.round(given, 5).tolist()}\n')
    T = load_scene(str(file)).T_world_object
    np.testing.assert_allclose(T, given, atol=1e-5)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    file.write_text(f'[object]\nname = "mug"\npose = {pose_from_transform(given).tolist()}\n')
    np.testing.assert_allclose(T, load_scene(str(file)).T_world_object, atol=1e-5)
