"""Surroundings that cannot be: refused or named, with the millimetres that follow from where things were put."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece, box, sphere
from grasp_refine.objects.object import Object, load_object
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene_check import body_notes, check_object, hand_notes
from grasp_refine.scene.scene_file import list_scenes, load_scene
from grasp_refine.scene.task import Task
from sliding_gripper import around_object, sliding_gripper

SIDE = 0.06


@pytest.fixture(scope="module")
def cube() -> Object:
    return load_object(f"box:{SIDE},{SIDE},{SIDE}", candidates=64)


def at(x: float, y: float, z: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def body(name: str, piece: Piece, x: float, y: float, z: float, *, movable: bool = False) -> EnvironmentBody:
    return EnvironmentBody(name, build_body(name, [piece], candidates=16), at(x, y, z), movable=movable)


def on_table(height: float, thickness: float = 0.04, *more: EnvironmentBody) -> Environment:
    """A table, and the cube, which lies on another side than in its mesh, with its lower side at a height above it."""
    table = body("table", box([1.0, 1.0, thickness]), 0.0, 0.0, -thickness / 2)
    pose = at(0.0, 0.0, height + SIDE / 2)
    pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    return Environment((table, *more), pose)


def millimetres(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"(-?[\d.]+) mm", text)]


@pytest.mark.parametrize("depth", [0.0, 0.002, 0.0049, 0.0051, 0.028, 1.0])
def test_a_table_through_the_object_is_refused_with_its_depth(cube: Object, depth: float) -> None:
    table = Plane(offset=-SIDE / 2 + depth)
    if depth > 0.005:
        with pytest.raises(GraspRefineError) as refused:
            check_object(cube, table, None)
        assert millimetres(str(refused.value))[0] == pytest.approx(1e3 * depth, abs=0.06)
        # The way out: the height at which it would stand.
        assert "`table=-0.0300`" in str(refused.value)
        return
    notes = check_object(cube, table, None)
    assert [millimetres(note)[0] for note in notes] == pytest.approx([1e3 * depth] if depth else [], abs=0.06)


@pytest.mark.parametrize("thickness", [0.004, 0.04, 0.4])
def test_an_object_is_sunk_by_as_much_as_it_must_be_raised(cube: Object, thickness: float) -> None:
    # Through a thin plate the shortest way out may be down.
    depth = min(0.028, 0.5 * (thickness + SIDE))
    with pytest.raises(GraspRefineError, match="'table'") as refused:
        check_object(cube, None, on_table(-depth, thickness))
    assert millimetres(str(refused.value))[0] == pytest.approx(1e3 * depth, abs=0.06)
    (note,) = check_object(cube, None, on_table(-0.003, thickness))
    assert millimetres(note) == pytest.approx([3.0], abs=0.06)
    assert check_object(cube, None, on_table(0.0, thickness)) == ()


def test_a_body_in_the_object_is_refused(cube: Object) -> None:
    beside = body("ball", sphere(0.02), SIDE / 2 + 0.02 - 0.012, 0.0, SIDE / 2)
    with pytest.raises(GraspRefineError, match="'ball'") as refused:
        check_object(cube, None, on_table(0.0, 0.04, beside))
    assert millimetres(str(refused.value))[0] == pytest.approx(12.0, abs=0.06)


def test_an_object_floats_by_the_way_down_to_what_is_below(cube: Object) -> None:
    (note,) = check_object(cube, None, on_table(0.1))
    assert millimetres(note) == pytest.approx([100.0], abs=0.06)
    # A wall that touches it holds nothing.
    wall = body("wall", box([0.1, 0.02, 1.0]), 0.0, SIDE / 2 + 0.01 - 5e-6, 0.2)
    (note,) = check_object(cube, None, on_table(0.1, 0.04, wall))
    assert millimetres(note) == pytest.approx([100.0], abs=0.06)
    assert check_object(cube, None, on_table(0.004)) == ()
    (note,) = check_object(cube, Plane(offset=-SIDE / 2 - 0.1), None)
    assert millimetres(note) == pytest.approx([100.0], abs=0.06)
    beside = Environment((body("post", box([0.1, 0.1, 0.1]), 1.0, 0.0, 0.0),), np.eye(4))
    (note,) = check_object(cube, None, beside)
    assert "fall" in note
    assert check_object(cube, None, Environment((), np.eye(4))) == ()


def test_neighbours_in_each_other_are_named_and_walls_may_cross() -> None:
    balls = [body(f"ball {k}", sphere(0.02), 0.3 + 0.03 * k, 0.0, 0.02, movable=True) for k in range(2)]
    sunk = body("tin", sphere(0.02), -0.3, 0.0, 0.013)
    walls = [body(f"wall {k}", box([0.02, 0.2, 0.2]), -0.3, 0.3, 0.09) for k in range(2)]
    notes = body_notes(on_table(0.0, 0.04, *balls, sunk, *walls))
    assert [note.split("'")[1::2] for note in notes] == [["ball 0", "ball 1"], ["table", "tin"]]
    assert [millimetres(note)[0] for note in notes] == pytest.approx([10.0, 7.0], abs=0.06)


def test_a_neighbour_of_another_unit_is_named() -> None:
    (note,) = body_notes(on_table(0.0, 0.04, body("bottle", sphere(5.85), 0.0, 50.0, 5.85, movable=True)))
    assert "bottle" in note and "11.7" in note


@pytest.mark.parametrize("name", list_scenes())
def test_scenes_that_come_with_the_program_can_be(name: str) -> None:
    scene = load_scene(name)
    assert check_object(scene.load_object(), None, scene) == () and body_notes(scene) == ()


def test_a_scene_has_its_own_object_in_its_own_size(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text('[object]\nname = "rounded_box"\nscale = 0.75\nposition = [0, 0, 0.03375]\n[table]\n')
    scene = load_scene(path)
    own, whole = scene.load_object(), load_object("rounded_box", candidates=64)
    np.testing.assert_allclose(own.mesh.extents, 0.75 * whole.mesh.extents, rtol=1e-9)
    assert check_object(own, None, scene) == ()
    shifted = replace(own, mesh=own.mesh.copy().apply_translation([0.002, 0.0, 0.0]))
    for other in (whole, load_object("mug", scale=0.75), shifted):
        with pytest.raises(GraspRefineError, match="load_object"):
            check_object(other, None, scene)
    anonymous = replace(scene, object=None)
    with pytest.raises(GraspRefineError, match="11"):
        check_object(whole, None, anonymous)  # which is sunk by the rest of its size
    with pytest.raises(GraspRefineError, match="names no object"):
        anonymous.load_object()


def test_a_note_says_that_all_palms_are_in_the_table(tmp_path: Path) -> None:
    hand = sliding_gripper(tmp_path, "box", candidates=64)
    scene = around_object(hand, 3, 0)
    lowest = Plane().heights([hand.links_by_name[hand.palm].solid], scene.T_world_root[:, None])[0][:, 0]
    (note,) = hand_notes(replace(scene, task=Task(table=float(lowest.max()) + 0.05)))
    assert millimetres(note) == [pytest.approx(50.0, abs=0.6)]
    assert hand_notes(replace(scene, task=Task(table=float(lowest.max()) + 0.015))) == ()
    assert hand_notes(replace(scene, task=Task())) == ()
    # In a scene the note names the body in which a palm is deepest.
    T = scene.T_world_root.copy()
    T[1, 0, 3] += 0.5
    sizes = enumerate((("a", 0.05), ("b", 0.08)))
    bodies = [body(name, sphere(r), *T[row, :3, 3], movable=True) for row, (name, r) in sizes]
    beside = Task(scene=Environment(tuple(bodies), np.eye(4)))
    apart = replace(scene, T_world_root=T, task=beside).select(np.array([0, 1]))
    (note,) = hand_notes(apart)
    assert "'b'" in note and "'a'" not in note
