"""What Python gives to the public functions is checked as on the command line: it works, or is a one-line error.

The expressions run in a process of their own, where a checker of annotations never comes before our checks.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

SETUP = """
import json, sys
from dataclasses import replace
import numpy as np, torch
from grasp_refine.scene.task import Task
from grasp_refine.hands.chain import Chain
from grasp_refine.collision.query import Pairs, query
from grasp_refine.refinement.config import Config
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.grasps.formats.reading import reading
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.mesh import load_mesh
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.grasps.grasp_set import GraspSet, load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.core.npz_files import save_npz
from grasp_refine.objects.object import load_object
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine.scene.plane import Plane
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.scene import Scene
from grasp_refine.core.se3 import body_gradient, exp_se3, pose_from_transform, transform_from_pose
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.measures.metrics import metrics
from grasp_refine.closing.motion import Motion, closing_motion
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of, validate
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.neighborhood import Fixed

hand, box = load_hand("allegro", candidates=64), load_object("rounded_box", candidates=64)
grasps = load_grasps(hand.urdf.parent / "example_rounded_box.npz")
pose, q = grasps.hand_pose, match_joints(grasps, hand)[0]
T, tensor = transform_from_pose(pose), torch.as_tensor
scene, links = Scene(hand, box, T, q), [contact.link for contact in hand.contacts]
L = len(scene.links)
quick = Config(solver=LevenbergMarquardt(iterations=2), starts=1)
ball = load_object("sphere:0.02", candidates=64).body
pairs = Pairs((ball,), (box.body,))
T_a, T_b = np.eye(4)[None, None].copy(), np.eye(4)[None, None]
T_a[..., 0, 3] = 0.1
t_a, t_b = tensor(T_a), tensor(T_b)
layer, kinematics, chain = WitnessLayer(pairs, ContactKinematics()), Kinematics(hand, links), Chain(hand, links)
protocol = Protocol(directions=("+x",), moves=1, steps_per_move=1, checks=1, steps_per_check=1)
task = Task(protocol)
world, motion = build_world(model_of(hand), box, task), closing_motion(Scene(hand, box, T[:1], q[:1]))
long = 2 * pose[:1, [0, 1, 2, 3, 4, 5, 6]]
large = T * [[2.0], [2.0], [2.0], [1.0]]

def same(a, b):
    return np.allclose(np.asarray(a), np.asarray(b), atol=1e-6)

def gradient(T_a):
    T_a = T_a.clone().requires_grad_()
    layer(T_a, t_b).distance.sum().backward()
    return T_a.grad.double()

answers = {}
for expression in json.load(sys.stdin):
    try:
        answers[expression] = ["", repr(eval(expression))]
    except GraspRefineError as error:
        answers[expression] = ["GraspRefineError", str(error)]
    except Exception as error:
        answers[expression] = [type(error).__name__, str(error)]
print(json.dumps(answers))
"""

REFUSED = {
    # names instead of what they name
    'Scene("allegro", box, T, q)': 'load_hand("allegro")',
    'Scene(hand, "mug", T, q)': 'load_object("mug")',
    'refine("scene")': "Scene",
    "refine(hand, box)": "Scene",
    "refine(scene, Descent())": "Config",
    'metrics(hand, "mug", T, q)': 'load_object("mug")',
    "contact_regions(box, avoid=3)": "3",
    "contact_regions(box, avoid=None)": "None",
    "contact_regions(box, avoid=[None])": "None",
    'match_joints("grasps.npz", hand)': 'load_grasps("grasps.npz")',
    'match_joints(grasps, "allegro")': 'load_hand("allegro")',
    'sample_grasps("allegro", box, 1)': 'load_hand("allegro")',
    'Kinematics("allegro", links)': 'load_hand("allegro")',
    "Kinematics(hand, 'palm')": "palm",
    'Chain("allegro", links)': 'load_hand("allegro")',
    'model_of("allegro")': 'load_hand("allegro")',
    "build_world(hand, box, task)": "model_of(hand)",
    'build_world(model_of(hand), "mug", task)': 'load_object("mug")',
    "simulate(model_of(hand), motion)": "build_world",
    "simulate(world, scene)": "closing_motion(scene)",
    "closing_motion(motion)": "Scene",
    'validate("scene", name="a", scale=1.0, rows=[0], index=[0])': "Scene",
    "Pairs((ball,), (box,))": "Object",
    "Pairs(ball, ball)": "tuple",
    "query(ball, T_a, T_b)": "Pairs",
    "WitnessLayer(ball, ContactKinematics())": "Pairs",
    "WitnessLayer(pairs, ContactKinematics)": "ContactKinematics",
    "load_object(box)": "Object",
    "load_object((box.mesh,))": "vertices",
    "load_hand(hand)": "Hand",
    "load_hand(None)": "None",
    "load_grasps(grasps)": "GraspSet",
    "reading(5)": "5",
    'save_npz("x.npz", grasps)': "arrays()",
    'save_npz("x.npz", {"note": object()})': "note",
    'build_body("b", [box.mesh])': "Trimesh",
    # shapes
    "Scene(hand, box, T, q[:, :5])": "(4, 16)",
    "Scene(hand, box, T[:2], q)": "(2, 16)",
    "Scene(hand, box, T[:, :3], q)": "(4, 3, 4)",
    "Scene(hand, box, T, q, target_link=np.zeros((4, 2, 3)), target_object=np.zeros((4, 2, 3)))": "scene.links",
    "Scene(hand, box, T, q, target_link=np.zeros((4, L, 3)))": "target_object",
    "Scene(hand, box, long, q[:1])": "quaternion",
    "metrics(hand, box, T, q[:, :5])": "(4, 5)",
    "query(pairs, T_a[0], T_b[0])": "(batch, 1, 4, 4)",
    "query(pairs, np.tile(T_a, (2, 1, 1, 1)), T_b)": "(2, 1, 4, 4)",
    "query(pairs, T_a, T_b, cutoff=[1.0, 2.0])": "cutoff",
    "layer(t_a[0], t_b[0])": "(batch, 1, 4, 4)",
    "layer(t_a.tile(2, 1, 1, 1), t_b)": "(2, 1, 4, 4)",
    "layer(t_a, t_b, torch.zeros(3))": "target_a",
    "layer(t_a, None)": "T_world_b",
    "kinematics(tensor(T), tensor(q)[:, :5])": "(batch, 16)",
    "kinematics(tensor(T)[0], tensor(q)[0])": "(16,)",
    "chain(T, q[:, :5])": "(batch, 16)",
    "chain(tensor(T), q)": "torch",
    "exp_se3(np.zeros(5))": "(5,)",
    "transform_from_pose(T)": "(4, 4, 4)",
    "transform_from_pose(long)": "2",
    "transform_from_pose(np.zeros(7))": "0",
    "pose_from_transform(pose)": "(4, 7)",
    "body_gradient(T, T[:, :3])": "gradient",
    "replace(grasps, q=q[:2])": "(2, 16)",
    "grasps.select([99])": "99",
    "grasps.select([0.5])": "0.5",
    "simulate(world, Motion(motion.T_world_root, motion.q[..., :5]))": "(1, 3, 5)",
    "simulate(world, motion.select(np.arange(0)))": "0 grasps",
    'validate(scene, name="a", scale=1.0, rows=[0], index=[0])': "rows",
    # values
    "Scene(hand, box, None, q)": "T_world_root",
    "Scene(hand, box, T, q.astype(str))": "q",
    "Scene(hand, box, T.astype(complex), q)": "complex128",
    'Task(table="table")': "Plane",
    "Plane(normal=(0, 0, 2))": "unit length",
    "load_object('mug', unit='millimetres')": "'mm'",
    "load_object('mug', scale='2')": "'2'",
    "load_object('mug', holes='fill')": "'cap'",
    "load_object('mug', seed=-1)": "-1",
    "load_hand('allegro', candidates=2.5)": "2.5",
    "sample_grasps(hand, box, '1')": "'1'",
    "sample_grasps(hand, box, 1, seed=-1)": "-1",
    "Config(margin='thin')": "'thin'",
    "Config(margin=np.nan)": "nan",
    "Config(margin=-0.01)": "-0.01",
    "Config(solver='adam')": "Adam",
    "Config(solver=Descent)": "Descent",
    "Config(starts=2.5)": "2.5",
    "Config(weights=1.0)": "Weights",
    "Config(dtype='float16')": "'float32'",
    "refine(scene, Config(solver=Descent(), device='tpu'))": "tpu",
    "Weights(contact=-1.0)": "contact",
    "Scales(joints='a')": "joints",
    "ContactSelection(links='index')": "'index'",
    "MaxMove(joints=np.nan)": "joints",
    "LevenbergMarquardt(widths=(1.0, 'a'))": "'a'",
    "Distance(coupling='none')": "'one-sided'",
    "Fixed(-1.0)": "fraction",
    "Protocol(directions=('up',))": "+x",
    "Protocol(mass=0.0)": "mass",
}
"""Expression -> what its one-line error must name."""

WORKS = (
    # lists, tensors on a graph, other number types, poses, one grasp
    "same(Scene(hand, box, T.tolist(), q.tolist()).T_world_root, T)",
    "same(Scene(hand, box, tensor(T).float(), tensor(q).requires_grad_()).q, q)",
    "Scene(hand, box, T.astype(np.float32), q).T_world_root.dtype == np.float64",
    "same(Scene(hand, box, pose, q).T_world_root, T)",
    "same(Scene(hand, box, pose[0], q[0]).T_world_root, T[:1])",
    "same(Scene(hand, box, T[0], q[0]).q, q[:1])",
    "same(refine(Scene(hand, box, T[0], q[0]), quick).q, refine(Scene(hand, box, T[:1], q[:1]), quick).q)",
    "refine(Scene(hand, box, T[:0], q[:0]), quick).q.shape == (0, 16)",
    "refine(Scene(hand, box, large, q), quick).labels.tolist() == ['invalid'] * 4",
    "same(metrics(hand, box, pose[0], q[0]).quality, metrics(hand, box, T, q).quality[:1])",
    "np.isnan(metrics(hand, box, large, q).quality).all()",
    "same(query(pairs, T_a.tolist(), t_b.float()).distance, 0.05)",
    "same(layer(T_a, T_b).distance, 0.05)",
    "same(layer(t_a.float(), t_b).distance, 0.05)",
    "same(gradient(t_a.float()), gradient(t_a))",
    "same(kinematics(tensor(T).float(), tensor(q).float()), chain(T, q).T_world_link)",
    "same(kinematics(T, q.tolist()), chain(T, q).T_world_link)",
    "same(exp_se3([0, 0, 0, 0, 0, 0]), np.eye(4))",
    "same(transform_from_pose(pose.tolist()), T)",
    "len(Pairs([ball], [ball]).a) == 1",
    "ContactSelection(links=['palm']).links == ('palm',)",
    "Plane(normal=np.array([0, 0, 1])) == Plane()",
    "len(GraspSet('allegro', 'palm', list(hand.joint_names), 'box', 1.0, pose.tolist(), tensor(q))) == 4",
    "len(grasps.select([True, False, False, True])) == 2",
    "save_npz('x.npz', {'a': torch.zeros(3, requires_grad=True)}) is None",
)
"""Expressions that are true."""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, str]]:
    """Expression -> name of the error that it raised, or nothing, and message or value."""
    command = [sys.executable, "-W", "error", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{SETUP}"]
    found = subprocess.run(
        command,
        input=json.dumps([*REFUSED, *WORKS]),
        cwd=tmp_path_factory.mktemp("arguments"),
        capture_output=True,
        text=True,
    )
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout)


@pytest.mark.parametrize("expression", REFUSED)
def test_what_cannot_be_meant_is_a_one_line_error(expression: str, answers: dict[str, tuple[str, str]]):
    error, message = answers[expression]
    assert error == "GraspRefineError", f"{error}: {message}"
    assert REFUSED[expression] in message and "\n" not in message and len(message) < 1000


@pytest.mark.parametrize("expression", WORKS)
def test_what_is_clear_works(expression: str, answers: dict[str, tuple[str, str]]):
    assert answers[expression] == ["", "True"] or answers[expression] == ["", "np.True_"]
