"""grasp-refine: refine the grasps of a robot hand with differentiable collision detection.

Importing the package loads nothing else: its names (`__all__`) are loaded when they are used. They are all that most
scripts need:

    import grasp_refine as gr

    hand, mug = gr.load_hand("allegro"), gr.load_object("mug")
    grasps = gr.sample_grasps(hand, mug, 16)      # or gr.load_grasps("mine.npz"), or gr.GraspSet.of(hand, pose, q)
    refined = gr.refine(hand, mug, grasps)
    print(refined)
    refined.save("refined.npz")

These conventions hold in every file;
`tests/test_conventions.py` runs the examples and checks each statement.

**Units.** SI everywhere: metres, radians, kilograms, newtons. Prismatic joints are in metres. Millimetres and degrees
appear only in what a person reads. A loss is a sum of squares in m^2.

**Frames.** The world frame is the object's frame: the object rests at the identity, and a table or another body is
expressed in it. `T_world_link` (4, 4) maps link coordinates to world coordinates, and frames chain by their
neighbouring names:

    point_world = T_world_link @ point_link        T_world_link = T_world_root @ T_root_link(q)

The *root* is the hand's base link. Its frame is the link's frame in the URDF; joints above it do not move. A point,
normal or twist carries its frame in its name, or is in the world frame.

**Joint values** `q` (..., n) are in the order of `hand.joint_names`, which are the independent joints: joints
that follow another one (mimic) are left out. Files name their joints; values are matched by name, never by place.

**Quaternions** are (w, x, y, z), of unit length, for active rotations: p' = q p q^-1. q and -q are the same rotation;
we write w >= 0. A pose as seven numbers is (x, y, z, qw, qx, qy, qz). Files of others may have
(x, y, z, w); ours never do. A quarter turn about z takes x to y:

    >>> from math import sqrt
    >>> import numpy as np
    >>> import grasp_refine as gr
    >>> T = gr.transform_from_pose(np.array([0.1, 0.0, 0.0, sqrt(0.5), 0.0, 0.0, sqrt(0.5)]))
    >>> gr.transform_points(T, np.array([1.0, 0.0, 0.0])).round(9).tolist()
    [0.1, 1.0, 0.0]

**Twists** are (v, w), linear part first. A *spatial* twist is expressed in the world frame, at the world's origin: a
point p of the body has the velocity V(p) = v + w x p, and T moves as exp(t xi) T. A *body* twist is expressed in the
body's frame: T moves as T exp(t xi). They are the same motion where xi_spatial = Ad(T) xi_body, with

    Ad(T) = [[R, [p] R], [0, R]]        [p] u = p x u

because T exp(xi) T^-1 = exp(Ad(T) xi). Jacobians and derivative methods are spatial, steps of descent are body twists.

**Wrenches** are (f, m), moments about the world's origin: the derivative of a loss along a spatial twist is
dL = f . v + m . w. A covector f on a point p is the wrench (f, p x f), since f . V(p) = f . v + (p x f) . w.

**Contact.** For bodies a and b, n is the unit normal from a to b, and the signed distance is d = n . (x_b - x_a) at
the witness points x_a and x_b: positive apart, where they are the closest points, and negative in penetration, where
they are the deepest ones; n points from a to b in both. Turned round, n reverses and d stays:

    >>> ball = gr.load_object("sphere:0.02").body
    >>> T_a = np.eye(4)[None, None]             # (batch, pair, 4, 4)
    >>> T_b = T_a.copy()
    >>> T_b[..., 0, 3] = 0.05                   # its centre 5 cm along x, so that the gap is 1 cm
    >>> witness = gr.query(gr.Pairs((ball,), (ball,)), T_a, T_b)
    >>> witness.normal[0, 0].round(9).tolist(), float(witness.distance[0, 0].round(9))
    ([1.0, 0.0, 0.0], 0.01)

While both bodies move, d' = n . (V_b(x_b) - V_a(x_a)), exactly: the points slide across n, which changes no distance to
first order. In a hand, a is the link and b the object, so that a link pushes the object along n. The contact margin is
the signed distance, at least 0, that is aimed at.

**Arrays** have their batch first: (batch, pair, 3) for points of pairs. Shapes stand in docstrings and annotations.
Where there is no answer, a status or a mask says so. NaN in an array of targets means that there is none. Arguments may
be lists, NumPy arrays or torch tensors of any number type; `Scene` and `metrics` take poses (N, 7) too, and one grasp
without its batch dimension:

    >>> hand = gr.load_hand("allegro")
    >>> gr.Scene(hand, gr.load_object("mug"), np.array([0.1, 0, 0, 1, 0, 0, 0]), hand.rest)
    Scene(allegro on mug: 1 grasp)

**Numbers.** float64 by default, float32 on request; collision queries run in float64 always. Seeds, device and dtype
travel with the scene: same seed, same machine, same result.

**Errors.** What a file or an argument can get wrong is a `GraspRefineError` of one
line, raised where it comes in. Not converging is a status of the result, which its `labels` say in words.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from grasp_refine.closing.motion import Motion as Motion
    from grasp_refine.closing.motion import closing_motion as closing_motion
    from grasp_refine.collision.query import Pairs as Pairs
    from grasp_refine.collision.query import Witness as Witness
    from grasp_refine.collision.query import query as query
    from grasp_refine.core.errors import GraspRefineError as GraspRefineError
    from grasp_refine.core.se3 import pose_from_transform as pose_from_transform
    from grasp_refine.core.se3 import transform_from_pose as transform_from_pose
    from grasp_refine.core.se3 import transform_points as transform_points
    from grasp_refine.grasps.formats.format import Format as Format
    from grasp_refine.grasps.formats.format import Part as Part
    from grasp_refine.grasps.formats.listing import add_format as add_format
    from grasp_refine.grasps.formats.reading import load_grasps as load_grasps
    from grasp_refine.grasps.formats.source import Source as Source
    from grasp_refine.grasps.grasp_set import ContactLinks as ContactLinks
    from grasp_refine.grasps.grasp_set import GraspSet as GraspSet
    from grasp_refine.grasps.grasp_set import Stage as Stage
    from grasp_refine.grasps.grasp_set import Targets as Targets
    from grasp_refine.grasps.grasp_set import match_joints as match_joints
    from grasp_refine.hands.arm_file import load_arm as load_arm
    from grasp_refine.hands.hand import Hand as Hand
    from grasp_refine.hands.hand import list_hands as list_hands
    from grasp_refine.hands.hand import load_hand as load_hand
    from grasp_refine.hands.kinematics import Kinematics as Kinematics
    from grasp_refine.hands.mount import mount as mount
    from grasp_refine.measures.formulas import MeasuredGrasps as MeasuredGrasps
    from grasp_refine.measures.measures import COUNT as COUNT
    from grasp_refine.measures.measures import METRE as METRE
    from grasp_refine.measures.measures import RADIAN as RADIAN
    from grasp_refine.measures.measures import RATIO as RATIO
    from grasp_refine.measures.measures import SECOND as SECOND
    from grasp_refine.measures.measures import SHARE as SHARE
    from grasp_refine.measures.measures import Measure as Measure
    from grasp_refine.measures.measures import Unit as Unit
    from grasp_refine.measures.measures import add_measure as add_measure
    from grasp_refine.motion.plan import TrajectoryOptions as TrajectoryOptions
    from grasp_refine.motion.trajectory_files import PlannedTrajectories as PlannedTrajectories
    from grasp_refine.objects.object import Object as Object
    from grasp_refine.objects.object import load_object as load_object
    from grasp_refine.objects.object import prepare as prepare
    from grasp_refine.objects.region import Box as Box
    from grasp_refine.objects.region import Faces as Faces
    from grasp_refine.objects.region import HalfSpace as HalfSpace
    from grasp_refine.objects.region import Region as Region
    from grasp_refine.problem.facade import Evaluation as Evaluation
    from grasp_refine.problem.facade import evaluate as evaluate
    from grasp_refine.problem.facade import margins as margins
    from grasp_refine.problem.facade import problem_of as problem_of
    from grasp_refine.problem.facade import refine as refine
    from grasp_refine.problem.facade import simulate as simulate
    from grasp_refine.problem.facade import transfer as transfer
    from grasp_refine.problem.facade import view as view
    from grasp_refine.problem.load import load_problem as load_problem
    from grasp_refine.problem.margins import GraspMargins as GraspMargins
    from grasp_refine.problem.problem import Problem as Problem
    from grasp_refine.problem.refine import refine_problem as refine_problem
    from grasp_refine.problem.refined import RefinedGrasps as RefinedGrasps
    from grasp_refine.problem.spec import ProblemSpec as ProblemSpec
    from grasp_refine.problem.term_check import check_term as check_term
    from grasp_refine.problem.trajectories import follow_trajectories as follow_trajectories
    from grasp_refine.problem.trajectories import plan_trajectories as plan_trajectories
    from grasp_refine.refinement.config import Config as Config
    from grasp_refine.refinement.max_move import MaxMove as MaxMove
    from grasp_refine.refinement.solvers.adam import Adam as Adam
    from grasp_refine.refinement.solvers.descent import Descent as Descent
    from grasp_refine.refinement.solvers.first_order import FirstOrder as FirstOrder
    from grasp_refine.refinement.solvers.iterate import Solver as Solver
    from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
    from grasp_refine.refinement.solvers.rows import JointRows as JointRows
    from grasp_refine.refinement.solvers.rows import LinkRows as LinkRows
    from grasp_refine.refinement.solvers.status import Status as Status
    from grasp_refine.refinement.terms.term import Setup as Setup
    from grasp_refine.refinement.terms.term import State as State
    from grasp_refine.refinement.terms.term import Term as Term
    from grasp_refine.refinement.terms.torch_term import TorchTerm as TorchTerm
    from grasp_refine.refinement.terms.weights import Weights as Weights
    from grasp_refine.sampling.sample import sample_grasps as sample_grasps
    from grasp_refine.scans.hypothesis import Hypothesis as Hypothesis
    from grasp_refine.scans.scan import Scan as Scan
    from grasp_refine.scene.contact_selection import ContactSelection as ContactSelection
    from grasp_refine.scene.environment import Environment as Environment
    from grasp_refine.scene.protocols.protocol import Protocol as Protocol
    from grasp_refine.scene.scene import Scene as Scene
    from grasp_refine.scene.scene_file import list_scenes as list_scenes
    from grasp_refine.scene.scene_file import load_scene as load_scene
    from grasp_refine.scene.task import Task as Task
    from grasp_refine.scene.task_file import load_task as load_task
    from grasp_refine.scene.task_file import save_task as save_task
    from grasp_refine.transfers.key_points import KeyPoints as KeyPoints
    from grasp_refine.validation.margins.factors import Factors as Factors
    from grasp_refine.witness.analytical import Analytical as Analytical
    from grasp_refine.witness.autograd import WitnessLayer as WitnessLayer
    from grasp_refine.witness.contact_kinematics import ContactKinematics as ContactKinematics
    from grasp_refine.witness.direction import Direction as Direction
    from grasp_refine.witness.distance import Distance as Distance
    from grasp_refine.witness.finite_difference import FiniteDifference as FiniteDifference
    from grasp_refine.witness.rigid import Rigid as Rigid
    from grasp_refine.witness.zeroth_order import ZerothOrder as ZerothOrder

    __version__: str

_HOMES = {
    "closing.motion": (
        "Motion",
        "closing_motion",
    ),
    "collision.query": (
        "Pairs",
        "Witness",
        "query",
    ),
    "core.errors": ("GraspRefineError",),
    "core.se3": (
        "pose_from_transform",
        "transform_from_pose",
        "transform_points",
    ),
    "grasps.formats.format": (
        "Format",
        "Part",
    ),
    "grasps.formats.listing": ("add_format",),
    "grasps.formats.reading": ("load_grasps",),
    "grasps.formats.source": ("Source",),
    "grasps.grasp_set": (
        "ContactLinks",
        "GraspSet",
        "Stage",
        "Targets",
        "match_joints",
    ),
    "hands.arm_file": ("load_arm",),
    "hands.hand": (
        "Hand",
        "list_hands",
        "load_hand",
    ),
    "hands.kinematics": ("Kinematics",),
    "hands.mount": ("mount",),
    "measures.formulas": ("MeasuredGrasps",),
    "measures.measures": (
        "COUNT",
        "METRE",
        "RADIAN",
        "RATIO",
        "SECOND",
        "SHARE",
        "Measure",
        "Unit",
        "add_measure",
    ),
    "motion.plan": ("TrajectoryOptions",),
    "motion.trajectory_files": ("PlannedTrajectories",),
    "objects.object": (
        "Object",
        "load_object",
        "prepare",
    ),
    "objects.region": ("Box", "Faces", "HalfSpace", "Region"),
    "problem.facade": (
        "Evaluation",
        "evaluate",
        "margins",
        "problem_of",
        "refine",
        "simulate",
        "transfer",
        "view",
    ),
    "problem.load": ("load_problem",),
    "problem.margins": ("GraspMargins",),
    "problem.problem": ("Problem",),
    "problem.refine": ("refine_problem",),
    "problem.refined": ("RefinedGrasps",),
    "problem.spec": ("ProblemSpec",),
    "problem.term_check": ("check_term",),
    "problem.trajectories": (
        "follow_trajectories",
        "plan_trajectories",
    ),
    "refinement.config": ("Config",),
    "refinement.max_move": ("MaxMove",),
    "refinement.solvers.adam": ("Adam",),
    "refinement.solvers.descent": ("Descent",),
    "refinement.solvers.first_order": ("FirstOrder",),
    "refinement.solvers.iterate": ("Solver",),
    "refinement.solvers.levenberg_marquardt": ("LevenbergMarquardt",),
    "refinement.solvers.rows": (
        "JointRows",
        "LinkRows",
    ),
    "refinement.solvers.status": ("Status",),
    "refinement.terms.term": (
        "Setup",
        "State",
        "Term",
    ),
    "refinement.terms.torch_term": ("TorchTerm",),
    "refinement.terms.weights": ("Weights",),
    "sampling.sample": ("sample_grasps",),
    "scans.hypothesis": ("Hypothesis",),
    "scans.scan": ("Scan",),
    "scene.contact_selection": ("ContactSelection",),
    "scene.environment": ("Environment",),
    "scene.protocols.protocol": ("Protocol",),
    "scene.scene": ("Scene",),
    "scene.scene_file": (
        "list_scenes",
        "load_scene",
    ),
    "scene.task": ("Task",),
    "scene.task_file": (
        "load_task",
        "save_task",
    ),
    "transfers.key_points": ("KeyPoints",),
    "validation.margins.factors": ("Factors",),
    "witness.autograd": ("WitnessLayer",),
    "witness.contact_kinematics": ("ContactKinematics",),
    "witness.analytical": ("Analytical",),
    "witness.direction": ("Direction",),
    "witness.distance": ("Distance",),
    "witness.finite_difference": ("FiniteDifference",),
    "witness.rigid": ("Rigid",),
    "witness.zeroth_order": ("ZerothOrder",),
}
"""Modules of the names below, which are loaded when one of them is used (PEP 562)."""

_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [*sorted(_MODULE_OF), "__version__"]  # noqa: PLE0604 - all are strings


def __getattr__(name: str) -> Any:
    """Load a name of the vocabulary, or read `__version__` from the installed metadata, when it is used first.

    Raises:
        AttributeError: there is no such name.
    """
    if name in _MODULE_OF:
        value = getattr(import_module(f"grasp_refine.{_MODULE_OF[name]}"), name)
    elif name == "__version__":
        value = import_module("grasp_refine.core.versions").own_version()
    else:
        raise AttributeError(f"module 'grasp_refine' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names of the vocabulary, and nothing else, for completion."""
    return __all__
