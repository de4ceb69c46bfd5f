"""Make the example grasps of robots/: put a hand around an object, close its fingers, disturb the result.

Run `python -m grasp_refine_apps.authoring.close_fingers`. Each grasp of the Allegro hand starts from a pose given
here by hand, the palm facing the object, and its fingers close joint by joint until their tips almost touch. Those of
the other hands are sampled: the best that touch with all fingertips. A small seeded disturbance then makes a grasp
only *almost* right, with some tips a centimetre away and some links inside the object: what a grasp from a generator
or a demonstration looks like, and what refinement is for.

Disturbances are drawn in a seeded order, and those with the wanted gap and depth count. The first and the third grasp
of a file are the first of these that loses the object in simulation (force-closure, closed and squeezed as `validate`
does where a file does not say how); the second and the fourth are the first one, held or not. So half of the examples
do not hold before refinement; of all such disturbances of the Allegro hand, one in seven does not. No simulation of
refined grasps takes part in the choice. Sampled grasps whose refinement does not converge are left out.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_se3, exp_so3, pose_from_transform, transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, save_npz
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.motion import closing
from grasp_refine.validation.protocol import FORCE_CLOSURE
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of
from grasp_refine.validation.world import World, build_world

HANDS = ("allegro", "leap", "shadow", "shadow_palm")
"""The hands of robots/ that come with example grasps."""
SAMPLES, KEPT = 16, 4
"""Grasps sampled of a hand and an object whose poses are not given here, and how many become examples."""

GRASP_CENTER = (0.085, 0.005, 0.028)
"""Where the object should be, between thumb and fingers of the Allegro hand: base_link's frame, metres."""
OPEN = {
    "joint_0.0": -0.15, "joint_1.0": 0.25, "joint_2.0": 0.3, "joint_3.0": 0.9,
    "joint_4.0": 0.0, "joint_5.0": 0.25, "joint_6.0": 0.3, "joint_7.0": 0.9,
    "joint_8.0": 0.15, "joint_9.0": 0.25, "joint_10.0": 0.3, "joint_11.0": 0.9,
    "joint_12.0": 1.35, "joint_13.0": 0.45, "joint_14.0": 0.0, "joint_15.0": 0.5,
}  # fmt: skip
"""The shape before closing, in radians: thumb opposite the fingers, outer fingers turned inwards."""
CLOSING = {
    "link_3.0_tip": ("joint_1.0", "joint_2.0", "joint_3.0"),
    "link_7.0_tip": ("joint_5.0", "joint_6.0", "joint_7.0"),
    "link_11.0_tip": ("joint_9.0", "joint_10.0", "joint_11.0"),
    "link_15.0_tip": ("joint_14.0", "joint_15.0"),
}
"""Fingertip -> the joints that close its finger, from the palm outwards."""
STEP = 0.005
"""Radians by which a joint closes at a time; moves a tip by at most 1.5 mm."""
CLEARANCE = 0.002
"""A link stops within this distance of the object (metres)."""

SHIFT, TURN, BEND = 0.006, np.radians(4.0), 0.09
"""Largest disturbance of the hand (metres and radians along each axis) and of each joint (radians)."""
GAP, DEPTH = (0.007, 0.015), (0.001, 0.0035)
"""Wanted after the disturbance, metres: largest distance of a fingertip, and deepest penetration of any link."""
DRAWS = 512
"""Disturbances drawn for a grasp."""
PORTION = 8
"""Grasps simulated at a time while one that loses the object is searched for."""


@dataclass(frozen=True)
class Approach:
    """From where the Allegro hand takes hold of an object."""

    point: tuple[float, float, float]
    """Where the grasp's centre goes, object frame, metres."""
    azimuth: float
    """Direction from the point to the palm, in degrees about the object's z axis from its x axis."""
    elevation: float = 0.0
    """Degrees by which the palm stands higher than the point."""
    roll: float = 0.0
    """Degrees about the palm's normal; at 0 the index finger is the uppermost, at 180 the lowest."""

    def pose(self) -> Float[np.ndarray, "4 4"]:
        """The pose of base_link in the object frame."""
        up, side = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
        # x of base_link looks out of the palm, z towards the fingertips, y towards the index finger.
        facing = np.stack([[-1.0, 0.0, 0.0], up, side], axis=1)
        R = (
            exp_so3(np.radians(self.azimuth) * up)
            @ exp_so3(-np.radians(self.elevation) * side)
            @ facing
            @ exp_so3(np.radians(self.roll) * np.array([1.0, 0.0, 0.0]))
        )
        return transform(R, np.array(self.point) - R @ np.array(GRASP_CENTER))


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
"""Embedded object -> how the Allegro hand comes to each of its grasps."""


class HandAround:
    """Distances of the links of a hand to an object, for a batch of grasps."""

    def __init__(self, hand: Hand, obj: Object) -> None:
        """Prepare the queries of all links that have geometry."""
        self.links = tuple(link.name for link in hand.links if link.body is not None)
        bodies = hand.links_by_name
        self._pairs = Pairs.against([bodies[name].solid for name in self.links], obj.body)
        self._kinematics = Kinematics(hand, self.links)

    def distances(
        self, T_object_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
    ) -> Float[np.ndarray, "N L"]:
        """Signed distance (N, L) in metres of each of `links` to the object."""
        T = self._kinematics(torch.as_tensor(T_object_root), torch.as_tensor(q)).numpy()
        return query(self._pairs, T, np.broadcast_to(np.eye(4), T.shape)).distance


def close(
    hand: Hand, around: HandAround, T_object_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, "N n"]:
    """Joint values (N, n) of closed Allegro hands: a joint stops when a link that it moves comes within CLEARANCE."""
    names = [joint for joints in CLOSING.values() for joint in joints]
    columns = [hand.joint_names.index(name) for name in names]
    moves = np.array([[link in _below(hand, name) for link in around.links] for name in names])
    q = q.copy()
    while True:
        near = around.distances(T_object_root, q) < CLEARANCE
        target = np.minimum(q[:, columns] + STEP, hand.upper[columns])
        target = np.where(near @ moves.T, q[:, columns], target)
        if (target == q[:, columns]).all():
            return q
        q[:, columns] = target


def disturbed(
    hand: Hand,
    around: HandAround,
    T_object_root: Float[np.ndarray, "4 4"],
    q: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "D 4 4"], Float[np.ndarray, "D n"]]:
    """Poses (D, 4, 4) and joint values (D, n) of one grasp moved a little, so that it is only almost right.

    Raises:
        RuntimeError: no disturbance leaves the gap and depth that are wanted.
    """
    size = np.repeat([SHIFT, TURN], 3)
    twist = rng.uniform(-size, size, (DRAWS, 6))
    T = T_object_root @ exp_se3(twist)
    angles = np.clip(q + rng.uniform(-BEND, BEND, (DRAWS, len(q))), hand.lower, hand.upper)
    distance = around.distances(T, angles)
    gap = distance[:, [around.links.index(contact.link) for contact in hand.contacts]].max(axis=1)
    depth = -distance.min(axis=1)
    wanted = (GAP[0] <= gap) & (gap <= GAP[1]) & (DEPTH[0] <= depth) & (depth <= DEPTH[1])
    if not wanted.any():
        raise RuntimeError("no disturbance leaves the gaps and depths that are wanted: change the approach")
    return T[wanted], angles[wanted]


def first_lost(scene: Scene, world: World) -> int | None:
    """The first grasp of a scene that loses the object in simulation; None if all hold."""
    for start in range(0, len(scene.q), PORTION):
        rows = slice(start, start + PORTION)
        some = replace(scene, T_world_root=scene.T_world_root[rows], q=scene.q[rows])
        lost = ~simulate(world, closing(some)).success
        if lost.any():
            return start + int(np.argmax(lost))
    return None


def approached(
    hand: Hand, around: HandAround, approaches: tuple[Approach, ...]
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Poses (N, 4, 4) and joint values (N, n) of an Allegro hand that comes as told and closes its fingers."""
    T = np.stack([approach.pose() for approach in approaches])
    opened = np.array([OPEN[name] for name in hand.joint_names])
    return T, close(hand, around, T, np.tile(opened, (len(T), 1)))


def sampled(
    hand: Hand, obj: Object, around: HandAround, seed: int
) -> tuple[Float[np.ndarray, "N 4 4"], Float[np.ndarray, "N n"]]:
    """Poses (N, 4, 4) and joint values (N, n) of sampled grasps that touch with all fingertips, best first."""
    grasps = sample_grasps(hand, obj, SAMPLES, seed=seed)
    T = transform_from_pose(grasps.hand_pose)
    tips = [around.links.index(contact.link) for contact in hand.contacts]
    touching = (around.distances(T, grasps.q)[:, tips] < CLEARANCE).all(axis=1)
    return T[touching], grasps.q[touching]


def example_grasps(hand: Hand, obj: Object, seed: int = 0) -> GraspSet:
    """Grasps of `obj` that are almost right, every other of which loses it in simulation: the first, the third.

    Raises:
        RuntimeError: no disturbance of a pose that is given here is as wanted.
    """
    around = HandAround(hand, obj)
    given = hand.name == "allegro"
    bases = approached(hand, around, EXAMPLES[obj.name]) if given else sampled(hand, obj, around, seed)
    world = build_world(model_of(hand), obj, FORCE_CLOSURE)
    # The object's name is part of the seed: objects do not depend on which others there are.
    rng = np.random.default_rng([seed, *obj.name.encode()])
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for base in zip(*bases, strict=True):
        scene = Scene(hand, obj, *disturbed(hand, around, *base, rng))
        first = first_lost(scene, world) if len(kept) % 2 == 0 else 0
        if first is None and given:
            raise RuntimeError("no disturbance loses the object: change the approach")
        if first is None:
            continue
        T, q = scene.T_world_root[first], scene.q[first]
        if given or refine(Scene(hand, obj, T[None], q[None])).status[0] == Status.CONVERGED:
            kept.append((T, q))
        if len(kept) == KEPT:
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


def _below(hand: Hand, joint: str) -> set[str]:
    """Names of the links that a joint moves."""
    below = {hand.joints_by_name[joint].child}
    for other in hand.joints:  # parents before children
        if other.parent in below:
            below.add(other.child)
    return below


def main(arguments: list[str] | None = None) -> None:
    """Write HAND/example_OBJECT.npz for each hand and each embedded example."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("hands", nargs="*", metavar="HAND", help=f"of which hands: {', '.join(HANDS)} [all]")
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
