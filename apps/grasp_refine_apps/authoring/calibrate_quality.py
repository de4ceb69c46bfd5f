"""Fit the calibration of the quality: simulate grasps of many hands and generators, and print coefficients.

Run `python -m grasp_refine_apps.authoring.calibrate_quality ASSETS [--samples FILE] [--every N]`, where ASSETS is a
folder of hands, objects and grasps such as `../shared/assets`. Under each of `TASKS`, each grasp is simulated as it
came, with its geometry refined, and refined for the task: what people will ask about. Refined grasps of generators are
also simulated with weak actuators, for what strains them. The reliability is reported for each task, on each set with a
fit on all others, where a set is one generator with one hand. Grasps of the ends of long objects, and of a handle, have
contacts close together, about which objects turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit

from grasp_refine.closing.motion import Motion
from grasp_refine.core.array_records import join, take
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.forces.calibration import Calibration
from grasp_refine.forces.squeeze import squeezed
from grasp_refine.measures.formulas import MeasuredGrasps, room
from grasp_refine.measures.geometry import measure
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.problem import Group
from grasp_refine.problem.refine import refine_group
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.world import build_world
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.validate import model_of

RIDGE = 1e-2
"""Weight of the squared coefficients, of standardised shortcomings."""
BINS = 10
"""Number of bins of the reliability."""

WEAK_LIMITS_NM = (0.03, 0.05, 0.08, 0.12, 0.2)
"""Torque limits of weak actuators, N m."""
MAX_WEIGHT = 100.0
"""Largest weight of what strains actuators."""

NUM_SAMPLED = 8
"""Number of grasps sampled for a hand and an object."""
SAMPLED_OBJECTS = ("mug", "bottle", "bowl", "rounded_box", "sphere:0.035", "box:0.05,0.05,0.12")
"""Objects for sampled grasps."""
NUM_AT_ENDS = 12
"""Number of grasps sampled for a hand and the end of an object."""
OWN_HANDS = ("allegro", "leap", "shadow_palm", "franka_hand")
"""Included hands, for sampled grasps and for grasps at ends."""
ENDS = {
    "mug": "box:0.0405,-0.03,0,0.08,0.03,0.09",
    "bottle": "above:z=0.16",
    "bowl": "above:x=0.045",
    "box:0.05,0.05,0.2": "above:z=0.085",
    "cylinder:0.02,0.24": "above:z=0.1",
}
"""Objects, and the end of each that is touched: of a mug its handle."""


KILOGRAM = replace(DEXGRASPBENCH.with_mass(1.0), name="1 kg")
"""Protocol of objects of 1 kg."""
TASKS = (Task(DEXGRASPBENCH), Task(STRICT), Task(KILOGRAM), Task(TABLETOP))
"""Tasks that the quality is calibrated for."""


@dataclass(frozen=True)
class Source:
    """Grasps of one generator with one hand."""

    name: str
    """Name of generator and hand, by which grasps are left out."""
    spec: ProblemSpec
    """Hand, objects and grasps."""
    weak: bool = True
    """Whether refined grasps are also simulated with weak actuators."""


def sources(assets: Path, every: int = 1) -> Iterator[Source]:
    """Return all sources of a folder of assets, with one of `every` grasps of each."""
    grasps, hands = assets / "grasps" / "normalised", assets / "hands"
    shadow = str(hands / "shadow" / "shadow_right.urdf")
    pieces = assets / "grasps" / "bodex_shadow" / "example_object"
    meshes, cube = assets / "objects", "box:0.075,0.075,0.075"
    bodex, dexgraspnet, leap = range(0, 80, 4), range(0, 60, 6), range(0, 768, 16)
    yield Source(
        "BODex, Shadow",
        ProblemSpec(hand=shadow, objects=pieces, index=tuple(bodex[::every]), grasps=grasps / "bodex_shadow.npz"),
    )
    yield Source(
        "DexGraspNet, Shadow",
        ProblemSpec(
            hand="shadow", objects=meshes, index=tuple(dexgraspnet[::every]), grasps=grasps / "dexgraspnet_shadow.npz"
        ),
    )
    yield Source(
        "FRoGGeR, Allegro",
        ProblemSpec(
            hand="allegro", objects=meshes, object_name="077_rubiks_cube", grasps=grasps / "frogger_allegro.npz"
        ),
    )
    yield Source(
        "LEAP", ProblemSpec(hand="leap", object=cube, index=tuple(leap[::every]), grasps=grasps / "leap_cube.npz")
    )
    own = {name: str(hands / name / f"{name}.urdf") for name in ("barrett", "robotiq3f")}
    for name, hand in {**{name: name for name in OWN_HANDS}, **own}.items():
        for obj in SAMPLED_OBJECTS:
            yield Source(
                f"sampled, {name}",
                ProblemSpec(hand=hand, object=obj, grasps=Path(f"sample:{max(NUM_SAMPLED // every, 1)}")),
                weak=False,
            )
    for name in OWN_HANDS:
        for obj, end in ENDS.items():
            sampled = Path(f"sample:{max(NUM_AT_ENDS // every, 1)}")
            yield Source(f"ends, {name}", ProblemSpec(hand=name, object=obj, touch=(end,), grasps=sampled), weak=False)


@dataclass(frozen=True, eq=False)
class Samples:
    """N grasps with their shortcomings and verdicts."""

    source: np.ndarray
    """Name of the source (N,)."""
    task: np.ndarray
    """Name of the protocol (N,)."""
    shortcomings: np.ndarray
    """Shortcomings (N, K), as of `Quality.shortcomings`."""
    held: np.ndarray
    """True (N,) where a grasp held."""


def shortcomings_of(scene: Scene) -> np.ndarray:
    """Return the shortcomings (N, K) of the grasps of a scene; NaN where links are in the table."""
    nothing = np.full((len(scene.q), len(scene.links), 3), np.nan)
    geometry = measure(HandObject.of(scene), scene.T_world_root, scene.q, nothing, nothing)
    grasps = MeasuredGrasps(scene.hand, scene.object, scene.links, scene.T_world_root, scene.q, geometry, scene.task)
    return np.where(room(grasps)[:, None] < 1.0, np.nan, grasps.quality.shortcomings)


def samples(source: Source) -> Samples:
    """Simulate the grasps of a source under each task: input grasps, geometry refined, and refined for the task."""
    problem = load_problem(source.spec)
    model, config = model_of(problem.hand), Config()
    geometry = replace(config, weights=replace(config.weights, wrench=0.0))
    names, shortcomings, held = [], [], []
    for group, task in product(problem.groups, TASKS):
        group = replace(group, scene=replace(group.scene, task=task.over(group.scene.task)))
        world, prepared = build_world(model, group.scene.object, group.scene.task), HandObject.of(group.scene)
        cases = [(group.scene, group.motion()), *(refined(group, each, prepared) for each in (geometry, config))]
        for scene, motion in cases:
            names += [world.protocol.name] * len(scene.q)
            shortcomings.append(shortcomings_of(scene))
            held.append(simulate(world, motion).success)
        for limit in WEAK_LIMITS_NM if source.weak and task == TASKS[0] else ():
            # The last case is that of refined grasps.
            actuator = replace(problem.hand.actuator, force_limit=np.full(len(problem.hand.joint_names), limit))
            weak = replace(scene, hand=replace(problem.hand, actuator=actuator))
            pressing = np.concatenate([motion.q[:, :2], squeezed(weak)[:, None]], axis=1)
            slight = build_world(model_of(weak.hand), weak.object, weak.task)
            names += [world.protocol.name] * len(weak.q)
            shortcomings.append(shortcomings_of(weak))
            held.append(simulate(slight, replace(motion, q=pressing)).success)
    count = sum(map(len, held))
    return Samples(np.full(count, source.name), np.array(names), np.concatenate(shortcomings), np.concatenate(held))


def refined(group: Group, config: Config, prepared: HandObject) -> tuple[Scene, Motion]:
    """Return the refined grasps of a group, and the motion that closes the hand to them."""
    outcome = refine_group(group, config, prepared=prepared)
    return outcome.posed(group.scene), outcome.motion


def fit(found: Samples) -> Calibration:
    """Return the logistic model of most likelihood, with a ridge; no weight is below 0.

    The weights of the last two shortcomings, what strains actuators and how the object yields, are fitted to the grasps
    that have the one and not the other, and all others to grasps that have neither: where actuators are strong and
    contacts well apart, nothing changes.
    """
    found = take(found, np.isfinite(found.shortcomings).all(axis=1))
    excess = found.shortcomings[:, -2:] > 0.0
    plain = ~excess.any(axis=1)
    ample = fit_ample(found.shortcomings[plain, :-2], found.held[plain])
    weights = []
    for column in range(2):
        some = take(found, excess[:, column] & ~excess[:, 1 - column])
        odds = ample.offset - ample.costs(some.shortcomings[:, :-2]).sum(axis=1)
        weights.append(fit_weight(odds, np.sqrt(some.shortcomings[:, column - 2]), some.held))
    return Calibration(ample.offset, (*ample.weights, *weights))


def fit_weight(odds: Float[np.ndarray, " N"], root: Float[np.ndarray, " N"], held: Bool[np.ndarray, " N"]) -> float:
    """Return the weight of most likelihood of one more predictor (N,), at least 0, with the log odds by all others."""

    def loss(weight: float) -> float:
        less = odds - weight * root
        return float((np.logaddexp(0.0, less) - held * less).sum()) + RIDGE * weight

    return float(minimize_scalar(loss, bounds=(0.0, MAX_WEIGHT), method="bounded").x)


def fit_ample(shortcomings: Float[np.ndarray, "N K"], found_held: Bool[np.ndarray, " N"]) -> Calibration:
    """Return the logistic model of most likelihood, with a ridge, of known shortcomings; no weight is below 0."""
    roots, held = np.sqrt(shortcomings), found_held.astype(float)
    scale = roots.std(axis=0) + 1e-12
    scaled = roots / scale

    def loss(coefficients: np.ndarray) -> tuple[float, np.ndarray]:
        odds = coefficients[0] - scaled @ coefficients[1:]
        excess = (expit(odds) - held) / len(held)
        ridge = RIDGE * coefficients[1:] / scaled.shape[1]
        value = np.mean(np.logaddexp(0.0, odds) - held * odds) + 0.5 * ridge @ coefficients[1:]
        return value, np.concatenate([[excess.sum()], ridge - scaled.T @ excess])

    bounds = [(None, None)] + [(0.0, None)] * scaled.shape[1]
    best = minimize(loss, np.ones(1 + scaled.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    return Calibration(float(best[0]), tuple((best[1:] / scale).tolist()))


def left_out(found: Samples) -> np.ndarray:
    """Return the probability (N,) of each grasp by a fit on all other sources."""
    probability = np.full(len(found.held), np.nan)
    for name in dict.fromkeys(found.source.tolist()):
        at = found.source == name
        probability[at] = fit(take(found, ~at)).probability(found.shortcomings[at])
    return probability


def report(found: Samples) -> str:
    """Return coefficients, reliability and error of the fit as text."""
    known = np.isfinite(found.shortcomings).all(axis=1)
    probability, held = left_out(found)[known], found.held[known]
    calibration = fit(found)
    weights = ", ".join(f"{weight:.2f}" for weight in calibration.weights)
    lines = [
        f"{len(found.held)} grasps, {found.held.mean():.1%} held; {np.count_nonzero(~known)} without forces, "
        f"{np.count_nonzero(found.held[~known])} of which held",
        f"Calibration(offset={calibration.offset:.2f}, weights=({weights}))",
        "left out: estimated, held, number of grasps",
    ]
    number = np.minimum((BINS * probability).astype(int), BINS - 1)
    for bin in np.unique(number):
        at = number == bin
        ends = f"{bin / BINS:.1f} to {(bin + 1) / BINS:.1f}"
        lines.append(f"  {ends}: {probability[at].mean():.3f}  {held[at].mean():.3f}  {at.sum()}")
    lines.append(f"Brier score {np.mean((probability - held) ** 2):.4f}, of the mean alone {held.var():.4f}")
    for names in (found.task[known], found.source[known]):
        for name in dict.fromkeys(names.tolist()):
            at = names == name
            error = np.mean((probability[at] - held[at]) ** 2)
            lines.append(
                f"  {name}: {probability[at].mean():.3f} estimated, {held[at].mean():.3f} held, {at.sum()} grasps, "
                f"Brier {error:.4f} of {held[at].var():.4f}"
            )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate, fit and print."""
    parser = argparse.ArgumentParser(description="Fit the calibration of the quality of grasps.")
    parser.add_argument("assets", type=Path, help="folder of hands, objects and grasps")
    parser.add_argument(
        "--samples", type=Path, help="keep shortcomings and verdicts in this .npz, or take them from it"
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="take one of N grasps of each set")
    options = parser.parse_args(arguments)
    if options.samples is not None and options.samples.exists():
        with np.load(options.samples) as file:
            found = Samples(*(file[field.name] for field in fields(Samples)))
    else:
        parts = []
        for source in sources(options.assets, options.every):
            try:
                parts.append(samples(source))
                print(f"{source.name}, {source.spec.object or 'its objects'}: {len(parts[-1].held)} grasps", flush=True)
            except GraspRefineError as error:
                print(f"{source.name}: left out, {error}", flush=True)
        found = join(*parts)
        if options.samples is not None:
            with written_whole(options.samples) as path:
                np.savez(path, **vars(found))
    print(report(found))


if __name__ == "__main__":
    main()
