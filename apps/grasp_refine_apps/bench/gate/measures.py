"""Measurements of the ratios of the gate: alternating runs; the median over the rounds counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
import torch

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.collision.engine import chosen
from grasp_refine.core.profiling import Stopwatch
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.measures.metrics import metrics
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.results.verdict import HOLDS
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.gate.baseline import Group
from grasp_refine_apps.bench.grasp.measures import measure_grasps
from grasp_refine_apps.bench.grasp.rows import ERROR_LEVELS_M2, PARTS, contact_errors
from grasp_refine_apps.bench.grasp.tasks import Disturbance, Tasks, given_targets
from grasp_refine_apps.bench.grasp.variants import Variant
from grasp_refine_apps.bench.jobs import part_of
from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case, draw_poses, make_pairs
from grasp_refine_apps.bench.queries.measure import Measurement
from grasp_refine_apps.bench.queries.peers import fresh_coal
from grasp_refine_apps.bench.timing import REST, cpu_share, cpu_times, one_thread

ROUNDS, MIN_TIMED_S = 5, 0.02
"""Number of measurements of each time, and minimum CPU seconds of one, for which short calls are repeated."""

HAND, OBJECT, EXAMPLE = "allegro", "rounded_box", "allegro/example_rounded_box.npz"
"""The hand and the grasped object, which is convex, so that no decomposition affects the time."""

NUM_TASKS, BATCH_SIZE, NUM_SINGLES, NUM_FORCED = 256, 64, 8, 96
"""Grasps in all, refined at once, refined one at a time, and refined with forces."""

DESCENT_STEPS = 20

COAL_QUERIES = 100
"""Queries of coal that count as one unit of time."""

SEED = 0


def measure(group: Group, progress: Callable[[float], None]) -> dict[str, float]:
    """Measure the ratios of a group that are available on this machine: name -> value."""
    torch.set_num_threads(1)
    with one_thread():
        return MEASURES[group](progress)


def queries(progress: Callable[[float], None]) -> dict[str, float]:
    """Measure costs of witness queries, relative to coal and to each other."""
    usual = chosen("auto")
    engines = tuple(dict.fromkeys((usual, "python")))
    measurement = Measurement(("contact-kinematics",), ("coal-fresh",), engines, ROUNDS, MIN_TIMED_S, SEED)
    cases = (Case(batch=256), Case(batch=1), Case("concave", 16, batch=256))
    convex, single, concave = (
        {(row["by"], row["warm"]): row for row in measurement.rows(case, part_of(progress, k / 3, 1 / 3))}
        for k, case in enumerate(cases)
    )
    cold, warm = (concave[usual, state] for state in (False, True))
    # Rows have ratios to our engine, cold.
    over_coal = [1.0 / rows["coal-fresh", False]["forward_ratio"] for rows in (convex, single, concave)]
    first = convex[usual, False]
    found = {
        "convex-query": over_coal[0],
        "concave-query": over_coal[2],
        "concave-asked": cold["queries_asked"] / cold["poses"],
        "warm-asked": warm["queries_asked"] / cold["queries_asked"],
        "warm-query": warm["forward_ratio"],
        # Measured in other rounds: each relative to coal in its own rounds.
        "single-query": over_coal[1] / over_coal[0],
        "backward": first["backward_contact_kinematics_us"] / first["layer_us"],
    }
    if usual == "native":
        found["engines"] = concave["python", False]["forward_ratio"]
        found["bare-loop"] = 1.0 / concave["bare-loop", False]["forward_ratio"]
    return found


def grasps(progress: Callable[[float], None]) -> dict[str, float]:
    """Measure costs and results of refining disturbed grasps, given targets."""
    tasks = _tasks()
    cut = tasks.of(Variant(pieces=64))
    assert cut is not None  # a convex object can always be cut
    some, whole = slice(BATCH_SIZE), HandObject.of(tasks.scene)
    variant, descent = Variant(batch=BATCH_SIZE), Variant("descent", budget=DESCENT_STEPS, batch=BATCH_SIZE)
    progress(0.2)
    pairs = make_pairs(Case(), SEED, "python")
    poses = draw_poses(pairs, STATE_DISTANCES_M["near"], COAL_QUERIES, SEED)
    found: dict[str, list[Refinement]] = {}

    def run(name: str, tasks: Tasks, variant: Variant, prepared: HandObject, calls: int = 1) -> None:
        size = len(tasks) // calls
        scenes = [tasks.take(slice(start, start + size)).scene for start in range(0, len(tasks), size)]
        config = variant.config(SEED, Config.tolerance)
        found[name] = [refine(scene, config, prepared=prepared) for scene in scenes]

    times = cpu_times(
        {
            "coal": fresh_coal(pairs, *poses),
            "grasp": partial(run, "grasp", tasks.take(some), variant, whole),
            "all": partial(run, "all", tasks, replace(variant, batch=NUM_TASKS), whole),
            "single": partial(
                run, "single", tasks.take(slice(NUM_SINGLES)), replace(variant, batch=1), whole, NUM_SINGLES
            ),
            "pieces": partial(run, "pieces", cut.take(some), variant, HandObject.of(cut.scene)),
            "descent": partial(run, "descent", tasks.take(some), descent, whole),
        },
        ROUNDS,
        MIN_TIMED_S,
    )
    progress(0.9)
    watch = Stopwatch()
    with watch:
        run("grasp", tasks.take(some), variant, whole)
    scene, (every,) = tasks.scene, found["all"]
    error = measure_grasps(scene, every.T_world_root, every.q).contact_error
    solved = contact_errors(error, aimed=True)
    fine, finer = ERROR_LEVELS_M2
    steps = {name: sum(one.iterations.sum() for one in found[name]) for name in found}
    return {
        "grasp": _median(times["grasp"], times["coal"]) / BATCH_SIZE,
        "single-grasp": _median(times["single"], times["coal"]) / NUM_SINGLES,
        "pieces": _median(times["pieces"] / steps["pieces"], times["grasp"] / steps["grasp"]),
        "descent-step": _median(times["descent"] / steps["descent"], times["grasp"] / steps["grasp"]),
        "bookkeeping": cpu_share([watch], PARTS)[REST],
        "steps": steps["all"] / NUM_TASKS,
        "queries": float(every.queries.mean()),
        "solved": solved[fine],
        "solved-finely": solved[finer],
    }


def forces(progress: Callable[[float], None]) -> dict[str, float]:
    """Measure costs and results of refining disturbed grasps until they hold, with the default settings."""
    tasks = _tasks().take(slice(NUM_FORCED))
    scene = replace(tasks.scene, target_link=None, target_object=None)
    prepared, found = HandObject.of(scene), {}
    progress(0.2)
    configs = {"holding": Config(), "geometry": Variant(batch=NUM_FORCED).config(SEED, Config.tolerance)}

    def run(name: str) -> None:
        found[name] = refine(scene, configs[name], prepared=prepared)

    times = cpu_times({name: partial(run, name) for name in configs}, ROUNDS, MIN_TIMED_S)
    held = found["holding"]
    return {
        "holding": _median(times["holding"], times["geometry"]),
        "good": float((metrics(scene.hand, scene.object, held.T_world_root, held.q).quality >= HOLDS).mean()),
    }


MEASURES: Mapping[Group, Callable[[Callable[[float], None]], dict[str, float]]] = MappingProxyType(
    {"queries": queries, "grasps": grasps, "forces": forces}
)
"""Group -> its measurement."""


def _tasks() -> Tasks:
    """Return disturbed true grasps."""
    file = load_grasps(resource_dir("robots") / EXAMPLE)
    hand, obj = load_hand(HAND, base_link=file.base_link), load_object(OBJECT)
    scene = Scene(hand, obj, transform_from_pose(file.hand_pose), match_joints(file, hand)[0])
    group = Tasks(OBJECT, 1.0, scene, np.arange(len(file)))
    (tasks,) = given_targets("gate", (group,), NUM_TASKS, Disturbance(), SEED)
    return tasks


def _median(times: Sequence[float] | np.ndarray, others: Sequence[float] | np.ndarray) -> float:
    """Median over the rounds of the ratio of the times."""
    return float(np.median(np.asarray(times) / np.asarray(others)))
