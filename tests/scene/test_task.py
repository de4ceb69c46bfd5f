"""Tasks: what grasps must do and where, as values, by name, and in files that say the same again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.hands.chain import Chain
from grasp_refine.objects.object import load_object
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.task import Task
from grasp_refine.scene.task_file import load_task, save_task, task_entry
from refusals import refused

SCENE = "mug-on-table"

TASKS = {
    "nothing": Task(),
    "named": Task("hugs"),
    "of its own": Task(replace(PROTOCOLS["strict"].with_mass(1.0), directions=("+x", "-z"))),
    "with density": Task(replace(PROTOCOLS["hugs"], name="heavy", largest_mass=2.0)),
    "on a table": Task("tabletop", table=-0.25),
    "on a slope": Task(table=Plane((0.6, 0.0, 0.8), 0.1)),
    "on an arm": Task(base=[-0.5, 0.1, 0.0, 0.0, 0.0, 90.0], touch="above:z=0.01", avoid=["below:z=0"]),
    "on a turned base": Task(base=np.array([[0.0, -1, 0, 0.3], [1, 0, 0, 0], [0, 0, 1, -0.1], [0, 0, 0, 1]])),
    "everywhere": Task(touch=(), avoid=()),
}


@pytest.mark.parametrize("name", TASKS)
def test_a_file_has_the_same_task(tmp_path: Path, name: str) -> None:
    save_task(TASKS[name], tmp_path / "task.toml")
    found = load_task(tmp_path / "task.toml")
    assert found == TASKS[name]


def test_a_file_has_the_same_scene(tmp_path: Path) -> None:
    task = Task("strict", scene=SCENE)
    save_task(task, tmp_path / "task.toml")
    assert task_entry(load_task(tmp_path / "task.toml")) == task_entry(task)


def test_a_name_is_that_of_a_protocol_or_of_a_scene(tmp_path: Path) -> None:
    assert not set(PROTOCOLS) & set(gr.list_scenes())
    assert all(gr.load_task(name) == gr.Task(protocol) for name, protocol in PROTOCOLS.items())
    found = gr.load_task(SCENE).environment
    assert found is not None and found.name == SCENE
    with refused(GraspRefineError, "'stict'", "strict", SCENE, ".toml"):
        gr.load_task("stict")
    with refused(GraspRefineError, "nothing.toml"):
        gr.load_task(tmp_path / "nothing.toml")


def test_files_beside_a_task_are_found_from_everywhere(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('based_on = "strict"\nmass = 0.5\n')
    (tmp_path / "desk.toml").write_text("[object]\nposition = [0, 0, 0.1]\n[[table]]\nsize = [1, 1]\n")
    (tmp_path / "task.toml").write_text('protocol = "mine.toml"\nscene = "desk.toml"\n')
    task = load_task(tmp_path / "task.toml")
    assert task.named_protocol == replace(PROTOCOLS["strict"], name="mine", mass=0.5)
    assert task.environment is not None and task.environment.name == "desk"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("friction = 0.5", ("friction", "protocol", "avoid")),
        ("tabel = 0.0", ("tabel", "table")),
        ("[protocol]\nmas = 1.0", ("mas", "mass")),
        ('[protocol]\nbased_on = "soft"', ("based_on", "soft", "strict")),
        ("protocol = 1", ("protocol", "1")),
        ('table = "low"', ("table", "low")),
        ("table = inf", ("table", "inf")),
        ("table = { offset = 0.1 }", ("table", "normal")),
        ("base = [1, 2]", ("base",)),
        ('base = "here"', ("base", "here")),
        ("touch = 1", ("touch", "1")),
        ('avoid = "ball:1"', ("avoid", "ball")),
        ('scene = "mug-on-tabel"', ("mug-on-tabel", SCENE)),
        (f'scene = "{SCENE}"\ntable = 0.0', ("table", "scene")),
    ],
)
def test_what_a_file_cannot_mean_is_refused_by_name(tmp_path: Path, text: str, named: tuple[str, ...]) -> None:
    (tmp_path / "task.toml").write_text(text)
    with refused(GraspRefineError, "task.toml", *named):
        load_task(tmp_path / "task.toml")


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"protocol": 1}, "protocol"),
        ({"table": "low"}, "table"),
        ({"table": float("nan")}, "table"),
        ({"base": np.eye(3)}, "base"),
        ({"base": 2.0 * np.eye(4)}, "base"),
        ({"touch": [1]}, "touch"),
        ({"scene": 2}, "scene"),
    ],
)
def test_a_field_of_another_type_is_refused_by_name(values: dict, named: str) -> None:
    with refused(GraspRefineError, named):
        Task(**values)


def test_what_was_made_in_memory_has_no_file(tmp_path: Path) -> None:
    around = replace(gr.load_scene(SCENE), source="")
    with refused(GraspRefineError, SCENE, "memory"):
        save_task(Task(scene=around), tmp_path / "task.toml")
    assert not list(tmp_path.iterdir())


def test_the_test_is_a_lift_in_a_scene_and_pushes_elsewhere() -> None:
    assert Task().test(patches=False).name == "dexgraspbench" and Task(table=0.0).test(patches=False).directions
    assert Task(scene=SCENE).test(patches=False).name == "scene"
    assert Task("strict", scene=SCENE).test(patches=True).name == "strict"
    assert [Task().test(patches=patches).multiccd for patches in (False, True)] == [False, True]


def test_a_base_stands_in_the_world_of_the_scene() -> None:
    base = [0.3, 0.2, 0.1, 0.0, 0.0, 90.0]
    around = gr.load_scene(SCENE)
    alone, within = Task(base=base).T_object_base, Task(base=base, scene=around).T_object_base
    np.testing.assert_allclose(alone[:3, 3], [0.3, 0.2, 0.1])
    np.testing.assert_allclose(alone @ [1, 0, 0, 0], [0, 1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(around.T_world_object @ within, alone, atol=1e-15)


def test_regions_are_as_in_the_scene_unless_the_task_names_some() -> None:
    mug = load_object("mug", candidates=16)
    around = replace(gr.load_scene(SCENE), touch=("above:z=0",))

    def touched(task: Task) -> list[str]:
        found = task.on(mug).regions
        return [] if found is None else [region.spec for region in found.touch]

    assert touched(Task(scene=around)) == ["above:z=0"]
    assert touched(Task(scene=around, touch="below:z=0.01")) == ["below:z=0.01"]
    assert touched(Task(scene=around, touch=())) == []
    with refused(GraspRefineError, "above:z=9", "mug"):
        Task(touch="above:z=9").on(mug)


def test_a_scan_shows_the_table_of_a_task_that_names_none() -> None:
    mug = load_object("mug", candidates=16)
    normal = np.array([0.0, -0.6, 0.8])
    plane = np.array([0.3, 0.08, -0.04]), normal
    scan = gr.Scan(np.zeros((0, 3)), np.zeros((0, 3)), np.array([[0.0, 0.0, 0.5]]), np.zeros(0, dtype=int), 0.0, plane)
    seen = replace(mug, scan=scan)
    table = Task().on(seen).plane
    assert table is not None and np.dot(table.normal, plane[0]) == pytest.approx(table.offset)
    np.testing.assert_allclose(table.normal, normal)
    assert Task(table=-0.1).on(seen).plane == Plane(offset=-0.1)
    assert Task(scene=gr.load_scene(SCENE)).on(seen).plane is None
    assert Task().on(mug).plane is None
    # No sampled hand goes through it.
    hand = gr.load_hand("allegro")
    grasps = gr.sample_grasps(hand, seen, 4, seed=0)
    scene = gr.problem_of(hand, seen, grasps).groups[0].scene
    T = Chain(hand, scene.links)(scene.T_world_root, scene.q).T_world_link
    assert table.heights([hand.links_by_name[name].solid for name in scene.links], T)[0].min() > -0.001


def test_a_task_takes_the_place_of_what_it_names() -> None:
    under = Task("strict", table=0.1, touch="above:z=0")
    assert Task("hugs").over(under) == replace(under, protocol=PROTOCOLS["hugs"])
    assert Task(table=0.2).over(under) == replace(under, table=Plane(offset=0.2))
    within = Task(scene=SCENE).over(under)
    assert within.environment is not None and within.table is None and within.named_protocol == PROTOCOLS["strict"]
