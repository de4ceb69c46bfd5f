"""Exported folders: their programs find the grasps, the object and the task as they are here."""

from __future__ import annotations

import csv
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.export.targets import TARGETS, export, target
from grasp_refine.hands.chain import Chain
from grasp_refine.problem.exports import exported_grasps, of_file
from grasp_refine.problem.problem import Problem
from plate_gripper import URDF
from refusals import refused
from running_processes import PATIENCE_S

LIMIT = '<limit lower="-0.07" upper="0" effort="1" velocity="1"/>'
MIMIC = URDF.replace(LIMIT, f'{LIMIT}<mimic joint="l" multiplier="-1"/>').replace('effort="1"', 'effort="40"')
"""Gripper whose right plate follows the left one."""


@pytest.fixture(scope="module")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> gr.Hand:
    path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(MIMIC)
    return gr.load_hand(path, candidates=64)


def _box() -> gr.Object:
    return gr.load_object("box:0.05,0.06,0.07")


def problem_of(gripper: gr.Hand, protocol: str) -> Problem:
    """Grasps of a box that hold, and one that is beside it."""
    grasps = gr.sample_grasps(gripper, _box(), 3)
    beside = grasps.hand_pose.copy()
    beside[1, :3] += 1.0
    return gr.problem_of(gripper, _box(), replace(grasps, hand_pose=beside), task=gr.Task(protocol), as_is=True)


@pytest.mark.parametrize("protocol", ["dexgraspbench", "tabletop"])
def test_a_plain_mujoco_gives_the_verdicts_of_the_program(gripper: gr.Hand, protocol: str, tmp_path: Path):
    problem = problem_of(gripper, protocol)
    export(exported_grasps(problem, closing="own"), "mjcf", tmp_path / "scene")
    verdict = gr.evaluate(problem)
    script = [sys.executable, "-I", str(tmp_path / "scene" / "simulate.py")]
    said = subprocess.run(script, cwd="/", capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    held = verdict.validated.success
    assert held.any() and not held.all()
    words = [f"grasp {k}: {'held' if success else 'lost'}" for k, success in enumerate(held)]
    assert said.stdout.splitlines() == [*words, f"{held.sum()} of {len(held)} held"], said.stderr
    assert said.returncode == 1


def test_key_frames_put_every_link_where_the_kinematics_of_the_hand_has_it(gripper: gr.Hand, tmp_path: Path):
    (part,) = exported_grasps(problem_of(gripper, "dexgraspbench"))
    export([part], "mjcf", tmp_path / "scene")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene" / "scene.xml"))
    data = mujoco.MjData(model)
    chain = Chain(gripper, [link.name for link in gripper.links])
    for at, stage in enumerate(("pregrasp", "grasp")):
        T = chain(part.motion.T_world_root[:, at], part.motion.q[:, at]).T_world_link
        for row in range(len(part)):
            mujoco.mj_resetDataKeyframe(model, data, model.key(f"{stage}_{row}").id)
            mujoco.mj_kinematics(model, data)
            for link, T_link in zip(gripper.links, T[row], strict=True):
                if f"hand/{link.name}" in {model.body(body).name for body in range(model.nbody)}:
                    np.testing.assert_allclose(data.body(f"hand/{link.name}").xpos, T_link[:3, 3], atol=1e-9)
    visual = model.geom("object_visual")
    assert visual.contype == visual.conaffinity == 0
    assert model.body("object").mass == pytest.approx(0.1)


def test_a_table_has_joints_by_name_those_that_follow_too_and_the_planned_forces(gripper: gr.Hand, tmp_path: Path):
    refined = gr.refine(gripper, _box(), gr.sample_grasps(gripper, _box(), 2))
    (folder,) = refined.export("csv", tmp_path / "table")
    with (folder / "grasps.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row, pose, q, open_q in zip(rows, refined.after.hand_pose, refined.after.q, refined.pregrasp.q, strict=True):
        written = [float(row[name]) for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
        np.testing.assert_allclose(written, pose, rtol=0.0, atol=1e-15)
        assert float(row["l"]) == q[0] and float(row["r"]) == -q[0]
        assert float(row["pregrasp_r"]) == -open_q[0]
        assert float(row["quality"]) > 0.5
    again = gr.load_grasps(folder / "grasps.toml", hand=gripper)
    np.testing.assert_allclose(again.hand_pose, refined.after.hand_pose, rtol=0.0, atol=1e-15)
    assert again.q.tolist() == refined.after.q.tolist() and again.joint_names == refined.after.joint_names
    with (folder / "contacts.csv").open() as file:
        contacts = list(csv.DictReader(file))
    for number in range(2):
        forces = [[float(one[f"vector_{axis}"]) for axis in "xyz"] for one in contacts if int(one["grasp"]) == number]
        assert np.linalg.norm(np.sum(forces, axis=0)) < 0.02 * np.linalg.norm(forces, axis=1).sum()


def test_the_forces_of_chosen_grasps_of_a_file_stay_with_them(gripper: gr.Hand, tmp_path: Path):
    refined = gr.refine(gripper, _box(), gr.sample_grasps(gripper, _box(), 3))
    refined.save(tmp_path / "three.npz")
    spec = gr.ProblemSpec(
        grasps=tmp_path / "three.npz", hand=str(gripper.urdf), object="box:0.05,0.06,0.07", index=(2, 0)
    )
    (part,) = of_file(gr.load_problem(spec))
    assert part.forces is not None
    for row, original in enumerate(part.index):
        mine, theirs = part.forces.grasp == row, refined.forces.grasp == original
        np.testing.assert_array_equal(part.forces.vector[mine], refined.forces.vector[theirs])
    np.testing.assert_array_equal(part.values["quality"], refined.quality[part.index, 1])


def test_grasps_on_several_objects_get_a_folder_each(gripper: gr.Hand, tmp_path: Path):
    (part,) = exported_grasps(problem_of(gripper, "dexgraspbench"))
    folders = export([part, replace(part, scale=0.5)], "csv", tmp_path / "both")
    assert len(set(folders)) == 2
    assert all((folder / "README.md").is_file() and (folder / "grasps.csv").is_file() for folder in folders)


def test_what_cannot_be_exported_leaves_nothing(gripper: gr.Hand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (part,) = exported_grasps(problem_of(gripper, "dexgraspbench"))
    with refused(GraspRefineError, "usd_of_old", *TARGETS):
        target("usd_of_old")
    (tmp_path / "there").mkdir()
    with refused(GraspRefineError, "there", "new folder"):
        export([part], "csv", tmp_path / "there")
    with refused(GraspRefineError, "no grasps"):
        export([], "csv", tmp_path / "none")
    (tmp_path / "file").write_text("")
    with refused(GraspRefineError, "cannot be written"):
        export([part], "csv", tmp_path / "file" / "inside")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "there"]


def test_poses_of_the_palm_are_of_the_base_link_without_an_arm(gripper: gr.Hand):
    (part,) = exported_grasps(problem_of(gripper, "dexgraspbench"))
    np.testing.assert_array_equal(part.palm_poses, pose_from_transform(part.motion.T_world_root))


def test_the_urdf_of_a_hand_has_its_kinematics_pieces_masses_and_drives(gripper: gr.Hand, tmp_path: Path):
    """As MuJoCo reads the written file, which did not write it."""
    (part,) = exported_grasps(problem_of(gripper, "dexgraspbench"))
    export([part], "sapien", tmp_path / "folder")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "folder" / "hand.urdf"))
    data = mujoco.MjData(model)
    task = dict(np.load(tmp_path / "folder" / "task.npz"))
    names = [str(name) for name in task["joints"]]
    assert names[6:] == ["l", "r"]
    limits = ET.parse(tmp_path / "folder" / "hand.urdf").iterfind("joint/limit")
    assert [float(one.get("velocity")) for one in limits][6:] == [1.0, 1.0]
    # One servo moves both plates.
    np.testing.assert_array_equal(task["force_limit"][6:], 20.0)
    assert task["stiffness"][6:].sum() == pytest.approx(gripper.actuator.kp[0])
    assert (task["stiffness"] > 0).all() and (task["damping"] > 0).all()
    links = [link.name for link in gripper.links]
    chain = Chain(gripper, links)
    # The first row is the pregrasp, the 10th behind it the grasp.
    for at, targets in ((0, task["close"][:, 0]), (1, task["close"][:, 10])):
        T = chain(part.motion.T_world_root[:, at], part.motion.q[:, at]).T_world_link
        for row in range(len(part)):
            start = np.eye(4)
            start[:3, 3] = task["start"][row, :3]
            start[:3, :3] = gr.transform_from_pose(task["start"][row])[:3, :3]
            for name, value in zip(names, targets[row], strict=True):
                data.qpos[model.joint(name).qposadr[0]] = value
            mujoco.mj_kinematics(model, data)
            for link, T_link in zip(links, T[row], strict=True):
                found = (start @ np.append(data.body(link).xpos, 1.0))[:3]
                np.testing.assert_allclose(found, T_link[:3, 3], atol=1e-9)
    thing = tmp_path / "folder" / "object.urdf"
    assert float(ET.parse(thing).find("link/inertial/mass").get("value")) == pytest.approx(0.1, rel=1e-9)
    points = mujoco.MjModel.from_xml_path(str(thing)).mesh_vert.astype(float)
    np.testing.assert_allclose(np.sort(np.ptp(points, axis=0)), [0.05, 0.06, 0.07], rtol=1e-5)


@pytest.mark.parametrize(
    ("program", "package", "engine"), [("sapien", "sapien", "physx"), ("drake", "pydrake", "drake")]
)
def test_other_engines_simulate_their_folders_alone(
    program: str, package: str, engine: str, gripper: gr.Hand, tmp_path: Path
):
    pytest.importorskip(package, reason=f"it is not installed: pip install 'grasp-refine[{engine}]'")
    problem = problem_of(gripper, "dexgraspbench")
    export(exported_grasps(problem, closing="own"), program, tmp_path / "folder")
    verdict = gr.evaluate(problem, engines=[engine]).validated.success
    script = [sys.executable, "-I", "-W", "ignore", str(tmp_path / "folder" / "simulate.py")]
    said = subprocess.run(script, cwd="/", capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    words = [f"grasp {k}: {'held' if success else 'lost'}" for k, success in enumerate(verdict)]
    assert said.stdout.splitlines()[: len(words)] == words, said.stderr
