"""Make the example grasps of robots/: put a hand around an object, close its fingers, disturb the result.

Run `python -m grasp_refine_apps.authoring.close_fingers`. Each grasp of the Allegro hand starts from a pose given
here by hand, the palm facing the object, and its fingers close joint by joint until their tips almost touch. Fingers of
the other hands are sampled: the best that touch with all fingertips. A small seeded disturbance then makes a grasp
only *almost* right, with some tips a centimetre away and some links inside the object: what a grasp from a generator
or a demonstration looks like, and what refinement is for.

Disturbances are drawn in a seeded order, and accepted if gap and depth are in the given ranges. The first and
the third grasp of a file are the first accepted one that loses the object in simulation (dexgraspbench, closed and
squeezed as `validate` does for files without pregrasps and squeezes); the second and the fourth are the first accepted
one, held or not. So half of the examples do not hold before refinement; of all accepted disturbances of the Allegro
hand, one in seven does not. No simulation of refined grasps takes part in the choice. Sampled grasps whose refinement
does not converge are left out. Grippers with two jaws lose hardly any object: of them, all are the first accepted
disturbance, held or not.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import closing_motion
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import exp_se3, exp_so3, pose_from_transform, transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, save_npz
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.jaw_frame import jaw_frame
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of

HANDS = ("allegro", "franka_hand", "leap", "shadow", "shadow_palm")
"""Hands of robots/ that ship with example grasps."""
NUM_SAMPLES, NUM_EXAMPLES = 16, 4
"""Number of grasps sampled for a hand and an object without approaches here, and number kept as examples."""

GRASP_CENTER_M = (0.085, 0.005, 0.028)
"""Position (3,) of the object between thumb and fingers of the Allegro hand, base_link frame, metres."""
OPEN_RAD = {
    "joint_0.0": -0.15, "joint_1.0": 0.25, "joint_2.0": 0.3, "joint_3.0": 0.9,
    "joint_4.0": 0.0, "joint_5.0": 0.25, "joint_6.0": 0.3, "joint_7.0": 0.9,
    "joint_8.0": 0.15, "joint_9.0": 0.25, "joint_10.0": 0.3, "joint_11.0": 0.9,
    "joint_12.0": 1.35, "joint_13.0": 0.45, "joint_14.0": 0.0, "joint_15.0": 0.5,
}  # fmt: skip
"""Joint values before closing, radians: thumb opposite the fingers, outer fingers turned inwards."""
CLOSING_JOINTS = {
    "link_3.0_tip": ("joint_1.0", "joint_2.0", "joint_3.0"),
    "link_7.0_tip": ("joint_5.0", "joint_6.0", "joint_7.0"),
    "link_11.0_tip": ("joint_9.0", "joint_10.0", "joint_11.0"),
    "link_15.0_tip": ("joint_14.0", "joint_15.0"),
}
"""Fingertip -> the joints that close its finger, from the palm outwards."""
STEP_RAD = 0.005
"""Closing step of a joint, radians; moves a tip by at most 1.5 mm."""
CLEARANCE_M = 0.002
"""Distance to the object at which a link stops, metres."""

MAX_SHIFT_M, MAX_TURN_RAD, MAX_BEND_RAD = 0.006, np.radians(4.0), 0.09
"""Largest disturbance of the hand (metres and radians along each axis) and of each joint (radians, or
0.1 m per radian)."""
GAP_RANGE_M, DEPTH_RANGE_M = (0.007, 0.015), (0.001, 0.0035)
"""Accepted ranges after the disturbance, metres: largest fingertip distance, and deepest penetration of any link."""
NUM_DISTURBANCES = 512
"""Number of disturbances drawn for each grasp."""
SIMULATION_BATCH = 8
"""Number of grasps simulated at once in the search for one that loses the object."""


@dataclass(frozen=True)
class Approach:
    """Approach of the Allegro hand to an object."""

    point: tuple[float, float, float]
    """Position of the grasp centre, object frame, metres."""
    azimuth: float
    """Direction from the point to the palm, in degrees about the object's z axis from its x axis."""
    elevation: float = 0.0
    """Elevation of the palm above the point, degrees."""
    roll: float = 0.0
    """Rotation about the palm normal, degrees; at 0 the index finger is the uppermost, at 180 the lowest."""

    def pose(self) -> Float[np.ndarray, "4 4"]:
        """Return the pose (4, 4) of base_link in the object frame."""
        up, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
        # x of base_link looks out of the palm, z towards the fingertips, y towards the index finger.
        facing = np.stack([[-1.0, 0.0, 0.0], up, side], axis=1)
        R = (
            exp_so3(np.radians(self.azimuth) * up)
            @ exp_so3(-np.radians(self.elevation) * side)
            @ facing
            @ exp_so3(np.radians(self.roll) * np.array([1.0, 0.0, 0.0]))
        )
        return transform(R, np.array(self.point) - R @ np.array(GRASP_CENTER_M))


EXAMPLES = {
    "mug": (
        Approach((0, 0, 0.05), azimuth=180),
        Approach((0, 0, 0.045), azimuth=205, roll=180),
        Approach((0, 0, 0.055), azimuth=155, elevation=25),
        Approach((0, 0, 0.075), azimuth=180, elevation=90),
    ),
    "bottle": (
        Approach((0, 0, 0.07), azimuth=0),
        Approach((0, 0, 0.05), azimuth=90, roll=180),
        Approach((0, 0, 0.06), azimuth=200, elevation=15),
        Approach((0, 0, 0.06), azimuth=300, roll=-15),
    ),
    "rounded_box": (
        Approach((0, 0, 0), azimuth=0),
        Approach((0, 0, 0), azimuth=90),
        Approach((0, 0, 0), azimuth=180, roll=180),
        Approach((0, 0, 0.02), azimuth=0, elevation=90),
    ),
}
"""Embedded object -> approaches of the Allegro hand, one for each grasp."""


class HandObjectDistances:
    """Distances of the links of a hand to an object, for a batch of grasps."""

    def __init__(self, hand: Hand, obj: Object) -> None:
        """Prepare the queries of all links that have geometry."""
        self.links = tuple(link.name for link in hand.links if link.body is not None)
        bodies = hand.links_by_name
        self._pairs = Pairs.against([bodies[name].solid for name in self.links], obj.body)
        self._chain = Chain(hand, self.links)

    def distances(
        self, T_object_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
    ) -> Float[np.ndarray, "N L"]:
        """Signed distance (N, L) in metres of each of `links` to the object."""
        T = self._chain(T_object_root, q).T_world_link
        return query(self._pairs, T, np.broadcast_to(np.eye(4), T.shape)).distance


GEOMETRY = Config(weights=Weights(wrench=0.0))
"""Refinement of contacts alone, by which examples are chosen: how forces are searched for does not change them."""


def close(
    hand: Hand, around: HandObjectDistances, T_object_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, "N n"]:
    """Joint values (N, n) of closed Allegro hands: a joint stops when a link that it moves comes within CLEARANCE_M."""
    names = [joint for joints in CLOSING_JOINTS.values() for joint in joints]
    columns = [hand.joint_names.index(name) for name in names]
    moves = np.array([[link in _moved_links(hand, name) for link in around.links] for name in names])
    q = q.copy()
    while True:
        near = around.distances(T_object_root, q) < CLEARANCE_M
        target = np.minimum(q[:, columns] + STEP_RAD, hand.upper[columns])
        target = np.where(near @ moves.T, q[:, columns], target)
        if (target == q[:, columns]).all():
            return q
        q[:, columns] = target


def disturb(
    hand: Hand,
    around: HandObjectDistances,
    T_object_root: Float[np.ndarray, "4 4"],
    q: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "D 4 4"], Float[np.ndarray, "D n"]]:
    """Disturb one grasp a little; return the accepted poses (D, 4, 4) and joint values (D, n).

    Raises:
        RuntimeError: no disturbance has a gap and a depth in the accepted ranges.
    """
    size = np.repeat([MAX_SHIFT_M, MAX_TURN_RAD], 3)
    twist = rng.uniform(-size, size, (NUM_DISTURBANCES, 6))
    T = T_object_root @ exp_se3(twist)
    bend = MAX_BEND_RAD * hand.per_radian
    angles = np.clip(q + rng.uniform(-bend, bend, (NUM_DISTURBANCES, len(q))), hand.lower, hand.upper)
    distance = around.distances(T, angles)
    gap = distance[:, [around.links.index(contact.link) for contact in hand.contacts]].max(axis=1)
    depth = -distance.min(axis=1)
    wanted = (
        (GAP_RANGE_M[0] <= gap) & (gap <= GAP_RANGE_M[1]) & (DEPTH_RANGE_M[0] <= depth) & (depth <= DEPTH_RANGE_M[1])
    )
    if not wanted.any():
        raise RuntimeError("no disturbance has a gap and a depth in the accepted ranges: change the approach")
    return T[wanted], angles[wanted]


def find_first_lost(scene: Scene, world: World) -> int | None:
    """Index of the first grasp of a scene that loses the object in simulation; None if all hold."""
    for start in range(0, len(scene.q), SIMULATION_BATCH):
        rows = slice(start, start + SIMULATION_BATCH)
        some = replace(scene, T_world_root=scene.T_world_root[rows], q=scene.q[rows])
        lost = ~simulate(world, closing_motion(some)).success
        if lost.any():
            return start + int(np.argmax(lost))
    return None


def close_on_approaches(
    hand: Hand, around: HandObjectDistances, approaches: tuple[Approach, ...]
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Poses (N, 4, 4) and joint values (N, n) of an Allegro hand that approaches as given and closes its fingers."""
    T = np.stack([approach.pose() for approach in approaches])
    opened = np.array([OPEN_RAD[name] for name in hand.joint_names])
    return T, close(hand, around, T, np.tile(opened, (len(T), 1)))


def sample_touching(
    hand: Hand, obj: Object, around: HandObjectDistances, seed: int
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Poses (N, 4, 4) and joint values (N, n) of sampled grasps that touch with all fingertips, best first."""
    grasps = sample_grasps(hand, obj, NUM_SAMPLES, seed=seed)
    T = transform_from_pose(grasps.hand_pose)
    tips = [around.links.index(contact.link) for contact in hand.contacts]
    touching = (around.distances(T, grasps.q)[:, tips] < CLEARANCE_M).all(axis=1)
    return T[touching], grasps.q[touching]


def example_grasps(hand: Hand, obj: Object, seed: int = 0) -> GraspSet:
    """Return almost right grasps of `obj`; the first and the third lose it in simulation.

    Raises:
        RuntimeError: no disturbance of an approach given here is accepted.
    """
    around = HandObjectDistances(hand, obj)
    by_hand = hand.name == "allegro"
    bases = (
        close_on_approaches(hand, around, EXAMPLES[obj.name]) if by_hand else sample_touching(hand, obj, around, seed)
    )
    jaws = jaw_frame(hand, closure_frame(hand)) is not None
    world = build_world(model_of(hand), obj, Task(DEXGRASPBENCH))
    # The object's name is part of the seed, so that the examples of an object do not depend on the other objects.
    rng = np.random.default_rng([seed, *obj.name.encode()])
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for base in zip(*bases, strict=True):
        scene = Scene(hand, obj, *disturb(hand, around, *base, rng))
        first = find_first_lost(scene, world) if len(kept) % 2 == 0 and not jaws else 0
        if first is None and by_hand:
            raise RuntimeError("no disturbance loses the object: change the approach")
        if first is None:
            continue
        T, q = scene.T_world_root[first], scene.q[first]
        if by_hand or refine(Scene(hand, obj, T[None], q[None]), GEOMETRY).status[0] == Status.CONVERGED:
            kept.append((T, q))
        if len(kept) == NUM_EXAMPLES:
            break
    T, q = map(np.stack, zip(*kept, strict=True))
    return GraspSet(
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        object=np.full(len(q), obj.name),
        scale=np.ones(len(q)),
        hand_pose=pose_from_transform(T),
        q=q,
    )


def _moved_links(hand: Hand, joint: str) -> set[str]:
    """Names of the links that a joint moves."""
    below = {hand.joints_by_name[joint].child}
    for other in hand.joints:  # parents before children
        if other.parent in below:
            below.add(other.child)
    return below


def main(arguments: list[str] | None = None) -> None:
    """Write HAND/example_OBJECT.npz for each hand and each embedded example."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("hands", nargs="*", metavar="HAND", help=f"hands: {', '.join(HANDS)} [all]")
    parser.add_argument("--out", type=Path, default=None, help="folder of hands to write to [robots]")
    parser.add_argument("--seed", type=int, default=0, help="seed of samples and disturbances [0]")
    options = parser.parse_args(arguments)
    for hand in map(load_hand, options.hands or HANDS):
        folder = (options.out or resource_dir("robots")) / hand.name
        folder.mkdir(parents=True, exist_ok=True)
        for name in EXAMPLES:
            grasps = example_grasps(hand, load_object(name), options.seed)
            path = folder / f"example_{name}.npz"
            save_npz(path, grasps.arrays())
            print(f"{path}: {len(grasps)} grasps")


if __name__ == "__main__":
    main()
