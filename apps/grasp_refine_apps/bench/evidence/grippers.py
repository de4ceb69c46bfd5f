"""Measure grasps of grippers before and after refinement: sampled ones, and the same ones perturbed.

Run `python -m grasp_refine_apps.bench.evidence.grippers --assets ASSETS --hands franka_hand my_gripper.urdf`. Each
gripper samples grasps on each object of `OBJECTS`; each of them is tried as it is, and moved by 5 mm in a random
direction and turned by 10 degrees about a random axis through its pads. All are refined, and simulated before and after
with our pregrasps and squeezes, under `PROTOCOLS`. Objects are scaled as objects.csv suggests or, where no grasp is
found, by ever smaller factors. Prints a table in Markdown of grasps held before and after, and lists of those that held
and hold no more, by object, with the number of those that hold where pieces may touch in several points (`multiccd`).
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
from jaxtyping import Bool

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, transform_from_pose
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.objects.object import Object, load_object
from grasp_refine.refinement.refine import refine
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.sampling.sample import sample_grasps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.motion import closing_motion
from grasp_refine.validation.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.validation.robustness import judge
from grasp_refine.validation.validate import model_of
from grasp_refine.validation.world import build_world
from grasp_refine_apps.bench.evidence.cases import read_objects

OBJECTS = (
    *("ycb_005_tomato_soup_can", "ycb_007_tuna_fish_can", "ycb_011_banana", "ycb_013_apple", "ycb_021_bleach_cleanser"),
    *("ycb_035_power_drill", "ycb_037_scissors", "ycb_044_flat_screwdriver", "ycb_051_large_clamp"),
    *("ycb_056_tennis_ball", "ycb_061_foam_brick", "ycb_065c_cups", "ycb_077_rubiks_cube", "robosuite_bottle"),
    *("robosuite_can", "robosuite_lemon", "rdg_hammer_40", "rdg_stapler_gray_d9", "rdg_mug_gray_d7", "tm_rabbit"),
)
"""Objects, names in objects.csv."""

SHIFT_M, TURN_RAD = 0.005, np.radians(10.0)
"""Perturbation of sampled grasps: distance in metres, angle in radians."""

SHRINKING, MIN_SCALE = 0.8, 0.4
"""Factor by which an object on which no grasp is found is scaled, again and again, and least factor in all."""

PROTOCOLS = {
    "friction 0.6": DEXGRASPBENCH,
    "friction 0.6, multiccd": replace(DEXGRASPBENCH, multiccd=True),
    "friction 0.3": DEXGRASPBENCH.with_friction(0.3),
    "friction 0.3, multiccd": replace(DEXGRASPBENCH, multiccd=True).with_friction(0.3),
}
"""Ways to simulate."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Grasps of a gripper on an object, sampled ones first, then as many perturbed ones."""

    hand: str
    object: str
    scale: float
    """Factor on the suggested scale of the object."""
    held: dict[str, Bool[np.ndarray, "N 2"]]
    """Protocol -> whether each grasp held before and after."""


def sampled(hand: Hand, source: str, scale: float, count: int, seed: int) -> tuple[Object, Scene, float]:
    """Return an object, sampled grasps, and the factor by which the object was scaled beyond `scale`.

    Raises:
        GraspRefineError: no grasp is found, even on the smallest object.
    """
    factor = 1.0
    while True:
        obj = load_object(source, scale=scale * factor)
        try:
            grasps = sample_grasps(hand, obj, count, seed=seed)
        except GraspRefineError:
            factor *= SHRINKING
            if factor < MIN_SCALE:
                raise
            continue
        return obj, Scene(hand, obj, transform_from_pose(grasps.hand_pose), grasps.q), factor


def perturbed(scene: Scene, seed: int) -> Scene:
    """Return the grasps of a scene, each moved by `SHIFT_M` and turned by `TURN_RAD` about the middle of its pads."""
    rng = np.random.default_rng([seed, crc32(scene.object.name.encode())])
    T = scene.T_world_root.copy()
    center = closure_frame(scene.hand).center
    for row in range(len(T)):
        direction, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        middle = T[row, :3, :3] @ center + T[row, :3, 3]
        R = exp_so3(TURN_RAD * axis)
        T[row, :3, 3] = middle + R @ (T[row, :3, 3] - middle) + SHIFT_M * direction
        T[row, :3, :3] = R @ T[row, :3, :3]
    return replace(scene, T_world_root=T)


def measure(hand: Hand, name: str, source: str, scale: float, count: int, seed: int) -> Measured:
    """Return what holds of the grasps of a gripper on an object."""
    obj, scene, factor = sampled(hand, source, scale, count, seed)
    moved = perturbed(scene, seed)
    scene = replace(
        scene,
        T_world_root=np.concatenate([scene.T_world_root, moved.T_world_root]),
        q=np.concatenate([scene.q, moved.q]),
    )
    prepared = HandObject(hand, obj)
    found = refine(scene, prepared=prepared)
    after = replace(scene, T_world_root=found.T_world_root, q=found.q)
    model = model_of(hand)
    driven = replace(hand, actuator=model.actuator)
    motions = [closing_motion(replace(each, hand=driven), prepared) for each in (scene, after)]
    held: dict[str, Bool[np.ndarray, "N 2"]] = {}
    for label, protocol in PROTOCOLS.items():
        world = build_world(model, obj, protocol)
        trials = [judge(world, motion, threads=1, first_failure=True) for motion in motions]
        held[label] = np.stack([each.success for each in trials], axis=1)
    return Measured(hand.name, name, factor, held)


def tables(measured: list[Measured]) -> Iterator[str]:
    """Lines of the tables."""
    yield "| gripper | grasps | " + " | ".join(PROTOCOLS) + " |"
    yield "|---|---|" + "---|" * len(PROTOCOLS)
    hands = list(dict.fromkeys(each.hand for each in measured))
    for hand in hands:
        of_hand = [each for each in measured if each.hand == hand]
        for kind, part in (("sampled", 0), ("perturbed", 1)):
            cells, count = [], 0
            for label in PROTOCOLS:
                held = np.concatenate([np.split(each.held[label], 2)[part] for each in of_hand])
                count, gone = len(held), int((held[:, 0] & ~held[:, 1]).sum())
                before, after = 100.0 * held.mean(axis=0)
                cells.append(f"{before:.1f} → {after:.1f} %, {gone} lost")
            yield f"| {hand} | {count} {kind} | " + " | ".join(cells) + " |"
    yield ""
    for label in PROTOCOLS:
        lost, other = Counter[str](), 0
        for each in measured:
            before, after = each.held[label].T
            rows = before & ~after
            if rows.any():
                lost[f"{each.hand} on {each.object}"] += int(rows.sum())
            several = label if "multiccd" in label else f"{label}, multiccd"
            other += int((rows & each.held[several][:, 1]).sum())
        listed = ", ".join(f"{what} ({count})" for what, count in lost.items()) or "none"
        yield f"- {label}: {sum(lost.values())} lost, {other} of them hold with multiccd: {listed}"
    scaled = {f"{each.hand} on {each.object} by {each.scale:.2f}" for each in measured if each.scale != 1.0}
    yield f"- scaled: {', '.join(sorted(scaled)) or 'none'}"


def main(arguments: list[str] | None = None) -> None:
    """Measure the chosen grippers on the chosen objects, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--assets", type=Path, required=True, help="folder with objects and objects.csv")
    parser.add_argument("--hands", nargs="+", default=["franka_hand"], help="grippers: names or files [franka_hand]")
    parser.add_argument("--objects", nargs="+", default=OBJECTS, help="objects of objects.csv [20 of them]")
    parser.add_argument("--count", type=int, default=4, help="sampled grasps of each gripper on each object [4]")
    parser.add_argument("--seed", type=int, default=0, help="seed of samples and perturbations [0]")
    options = parser.parse_args(arguments)
    cases = {case.name: case for case in read_objects(options.assets)}
    measured = []
    hands: list[Hand] = [load_hand(name) for name in options.hands]
    for hand in hands:
        for name in options.objects:
            case = cases[name]
            try:
                measured.append(measure(hand, name, case.source, case.scale, options.count, options.seed))
            except GraspRefineError as error:
                print(f"{hand.name} on {name}: {error}", flush=True)
                continue
            counts = ", ".join(str(values.sum(axis=0).tolist()) for values in measured[-1].held.values())
            print(f"{hand.name} on {name} x {measured[-1].scale:.2f}: {counts}", flush=True)
    print("\n".join(["", *tables(measured)]))


if __name__ == "__main__":
    main()
