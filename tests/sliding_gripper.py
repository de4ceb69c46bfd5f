"""A gripper of slides, one of which follows another, and a hinge, with links of any shape."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from made_hands import joint, link, made_hand, slide, solid

RADII = {"base": 0.02, "left": 0.012, "right": 0.011, "thumb": 0.016}
"""Radius of each link, metres; of a box, half its sides."""

OBJECTS = {"sphere": "sphere:0.03", "box": "box:0.05,0.06,0.045", "mesh": "cylinder:0.03,0.06"}
"""Object for links of each shape."""


def sliding_gripper(folder: Path, shape: str = "sphere", candidates: int = 8192) -> Hand:
    """The hand, its links of a shape out of `OBJECTS`; those of a mesh are hulls of random points."""
    folder.mkdir(exist_ok=True)
    shapes = {}
    for seed, (name, radius) in enumerate(RADII.items()):
        if shape == "mesh":
            points = np.random.default_rng(seed).normal(size=(20, 3))
            points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
            trimesh.convex.convex_hull(points).export(folder / f"{name}.stl")
        sizes = {"sphere": radius, "box": " ".join([str(2 * radius)] * 3), "mesh": f"{name}.stl"}
        shapes[name] = f"{shape} {sizes[shape]}"
    places = {"base": "0 0 -0.03", "thumb": "0 0 0.06"}
    opens = {"limits": (0, 0.05), "effort": 3}
    return made_hand(
        folder,
        *(link(name, solid(shapes[name], places.get(name))) for name in RADII),
        slide("left_slide", "base", "left", at="0.02 0 0.04", rpy="0 0.1 0", axis="1 0 0", **opens),
        slide(
            *("right_slide", "base", "right"),
            **opens, at="-0.02 0 0.04", axis="-1 0 0", follow=("left_slide", 0.8, 0.002),
        ),
        joint("thumb_turn", "base", "thumb", at="0 0.04 -0.01", axis="1 0 0", limits=(-0.5, 1.2), effort=3),
        name="gripper",
        candidates=candidates,
    )  # fmt: skip


def around_object(hand: Hand, count: int, seed: int, source: str = OBJECTS["sphere"], table: bool = False) -> Scene:
    """Random hands of which some links are in the object, or in each other, or below the table."""
    rng = np.random.default_rng(seed)
    T = exp_se3(rng.normal(size=(count, 6)) * [0.01, 0.01, 0.01, 0.3, 0.3, 0.3])
    T[:, :3, 3] += [-0.075, 0.0, -0.03] if hand.name == "allegro" else [0.0, 0.0, -0.04]
    q = rng.uniform(hand.lower, hand.upper, (count, len(hand.lower)))
    candidates = len(hand.links_by_name[hand.contacts[0].link].body.candidates.points)
    plane = Plane((0.0, 0.6, 0.8), -0.01) if table else None
    return Scene(hand, load_object(source, candidates=candidates), T, q, task=Task(table=plane))


def shallow(scene: Scene, count: int, depth: float, *, itself: bool = False) -> Scene:
    """The first hands of a scene that are in the object, or in themselves, and no deeper."""
    prepared = HandObject.of(scene)
    T = prepared.chain(scene.T_world_root, scene.q).T_world_link
    pairs, T_a, T_b = prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape)
    if itself:
        assert prepared.self_collision_pairs is not None
        pairs, (T_a, T_b) = prepared.self_collision_pairs, (T[:, side] for side in prepared.self_collision_links)
    deepest = -query(pairs, T_a, T_b).distance.min(axis=1)
    rows = np.flatnonzero((deepest > 0) & (deepest < depth))[:count]
    assert len(rows) == count
    return replace(scene, T_world_root=scene.T_world_root[rows], q=scene.q[rows])
