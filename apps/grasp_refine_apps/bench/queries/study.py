"""Benchmark of witness queries: cost of each case, and skipped work of a refinement, by its own counters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from grasp_refine.hands.self_collision import candidate_pairs, classify_pairs
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.chart import Axis, Chart, Row, group_rows
from grasp_refine_apps.bench.jobs import Job, Progress
from grasp_refine_apps.bench.queries.cases import Case, nearby
from grasp_refine_apps.bench.queries.measure import Measurement
from grasp_refine_apps.bench.queries.peers import PEERS
from grasp_refine_apps.bench.report import Column, Note, Report, Table
from grasp_refine_apps.bench.timing import one_thread

PALM_DEVIATIONS = (0.005, 0.05)
"""Standard deviations of the palms of disturbed grasps, in metres and radians; the latter of their joints, too."""

SWEPT = {"batch": "poses in a call", "vertices": "vertices of a piece", "pieces": "pieces of a body"}
"""Quantities with a chart where they vary -> their names."""

CASE = tuple(case.name for case in fields(Case))
"""Keys of a row that say its case."""

MAX_PANELS = 4
"""Largest number of panels of a chart."""

INTRO = """Costs of finding the closest or deepest points of two bodies, and of their derivatives in the motion of both,
in CPU time per pose. Bodies are generated: convex is an ellipsoid against another, mixed an ellipsoid against a coil of
convex pieces, concave two coils. They are 200 mm apart (far), 4 mm apart (near), touching, 1 mm deep (shallow) or 5 mm
deep. Warm queries use the answer a step of about 1 mm and 1° away. All measurements of a case alternate, several times.

Ratios are to the first engine, cold. bare-loop is a loop in C++ over the queries of the compiled engine. Coal and
MuJoCo query every pair of pieces, in a loop in Python over a library in C++; MuJoCo keeps vertices in single precision.
"""

SKIPPED = """The program skips work that has no effect. Counted is what a refinement did, by its own counters, and what
it would have done if every iteration of every grasp had queried every pair of pieces, if grasps that are done had
stayed in the batch, and so on."""


@dataclass(frozen=True)
class QueryStudy:
    """Settings of a run."""

    cases: tuple[Case, ...] = ()
    """Cases to measure."""
    examples: tuple[tuple[str, str], ...] = ()
    """Hands and objects whose example grasps show the savings of skips."""
    count: int = 16
    """Grasps of each example: the example grasps, then disturbed copies."""
    measurement: Measurement = field(default_factory=Measurement)
    """Settings with which cases are measured."""
    workers: int = 1

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each case, and for each example of a hand on an object.

        Raises:
            GraspRefineError: a hand or an object without an example.
        """
        found = [self.measurement.job(case) for case in self.cases]
        for hand, obj in self.examples:
            (group,) = load_problem(
                ProblemSpec(hand=hand, object=obj), seed=self.measurement.seed, on_message=say
            ).groups
            scene = several(group.scene, self.count, self.measurement.seed)
            work = partial(skips, f"{hand}, {obj}", scene, self.measurement.seed)
            found.append(Job(f"{hand}, {obj}", work, 4.0))
        return found

    def rows(self, done: Sequence[Any]) -> list[Row]:
        """Return the rows of all cases, then of the skips."""
        return [row for rows in done for row in rows]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return charts over the quantities that vary, ratios to the peers, all numbers, and the skips."""
        queries, skipped = ([row for row in rows if row["table"] == name] for name in ("queries", "skips"))
        parts: list[Table | Chart | Note] = []
        if queries:
            parts = [Note(INTRO), *_charts(queries), _printed(queries)]
        if skipped:
            parts.append(Table("Skipped work", SKIPS, skipped, note=SKIPPED))
        return Report("Witness queries", parts)


def several(scene: Scene, count: int, seed: int) -> Scene:
    """Return `count` grasps: the grasps of the scene, then copies of them, each disturbed at random."""
    own = len(scene.q)
    rows = np.arange(count) % own
    T, q = scene.T_world_root[rows], scene.q[rows]
    again = np.arange(count) >= own
    noise = PALM_DEVIATIONS[1] * np.random.default_rng(seed).normal(size=q.shape)
    T = np.where(again[:, None, None], nearby(T, seed, PALM_DEVIATIONS), T)
    return replace(
        scene, T_world_root=T, q=np.clip(np.where(again[:, None], q + noise, q), scene.hand.lower, scene.hand.upper)
    )


def skips(name: str, scene: Scene, seed: int, progress: Progress) -> list[Row]:
    """Refine grasps and count the work, and the work without skipping.

    Args:
        name: Names of hand and object.
        scene: The grasps.
        seed: Seed of the solver.
        progress: Called with the share that is done.
    """
    prepared, hand = HandObject.of(scene), scene.hand
    with one_thread():
        found = refine(scene, Config(seed=seed), prepared=prepared)
    pairs = [group for group in (prepared.pairs, prepared.self_collision_pairs) if group is not None]
    judged = classify_pairs(hand)
    apart = set(candidate_pairs(hand)) - {*judged.nearly_always}
    # Each start is evaluated before its first iteration.
    evaluated = int((found.iterations + found.starts).sum())
    every = evaluated * sum(
        len(a.pieces) * len(b.pieces) for each in pairs for a, b in zip(each.a, each.b, strict=True)
    )
    counts = (
        ("far links, pieces that cannot win", "queries", every, found.queries.sum()),
        ("grasps that are done", "iterations", len(scene.q) * found.iterations.max(), found.iterations.sum()),
        ("links that never meet", "pairs of links", len(apart), len(judged.checked)),
        ("links without bodies", "frames", len(hand.links), len(prepared.chain.links)),
    )
    return [
        {
            "table": "skips",
            "skip": skip,
            "unit": unit,
            "scene": name,
            "without": int(without),
            "with": int(with_),
            "saved_share": 1.0 - float(with_) / float(without) if without else 0.0,
        }
        for skip, unit, without, with_ in counts
    ]


def _methods(rows: Sequence[Row]) -> list[str]:
    """Keys of the times of backward passes."""
    return [key for key in rows[0] if key.startswith("backward_")]


def _method(key: str) -> str:
    """Name of the derivative method in such a key."""
    return key.removeprefix("backward_").removesuffix("_us").replace("_", " ")


def _two_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 9.95 else f"{value:.1f}" if value >= 0.995 else f"{value:.2f}"


def _charts(rows: Sequence[Row]) -> Iterator[Chart]:
    """Chart times over each quantity that varies; a panel for all cases that differ only in it."""
    for axis, name in SWEPT.items():
        fixed = [key for key in CASE if key != axis]
        panels = {
            ", ".join(f"{key} {value}" for key, value in zip(fixed, values, strict=True)): group
            for values, group in group_rows(rows, fixed).items()
        }
        swept = [panel for panel, group in panels.items() if len({row[axis] for row in group}) > 1][:MAX_PANELS]
        points = [
            {"panel": panel, "line": line, axis: row[axis], "s": 1e-6 * time}
            for panel in swept
            for row in panels[panel]
            for line, time in _times(row)
            if time is not None
        ]
        if points:
            yield Chart(
                f"Time of a query over {name}",
                points,
                Axis(axis, name),
                (Axis("s", "CPU time per pose", "s"),),
                lambda row: row["line"],
                lambda row: row["panel"],
            )


def _times(row: Row) -> Iterator[tuple[str, float | None]]:
    """Yield the lines that a row has a point on, and its times in microseconds."""
    yield (f"{row['by']}, warm" if row["warm"] else row["by"]), row["forward_us"]
    for key in _methods([row]):
        yield f"backward, {_method(key)}", row[key]


def _printed(rows: Sequence[Row]) -> Table:
    """Make a table with a line for each case: times of the first engine, and multiples of them for the others."""
    others = list(dict.fromkeys(row["by"] for row in rows if row["by"] != rows[0]["by"]))
    lines = []
    for group in group_rows(rows, CASE).values():
        cold, warm = (next(row for row in group if row["warm"] == which) for which in (False, True))
        ratios = {row["by"]: row["forward_ratio"] for row in group if not row["warm"]}
        per_pose = cold["queries_asked"] / cold["poses"]
        bodies = f"{cold['kind']} {cold['pieces']}x{cold['vertices']}"
        lines.append({**cold, **ratios, "bodies": bodies, "warm_us": warm["forward_us"], "per_pose": per_pose})
    what = {peer.name: peer.what for peer in PEERS}
    return Table(
        f"CPU µs of a witness query by engine {rows[0]['by']}; of others, multiples",
        (
            Column("bodies", "bodies", hint="pieces by vertices of each"),
            Column("state", "state"),
            Column("batch", "batch", form="d"),
            Column("forward_us", "for\u00adward", form=_two_digits),
            Column("warm_us", "warm", form=_two_digits),
            Column("per_pose", "asks", form=".2f", hint="queries of pieces per pose"),
            *(Column(key, f"back {_method(key).split()[-1][:4]}", form=_two_digits) for key in _methods(rows)),
            *(Column(name, name.replace("-", " "), form=_two_digits, hint=what.get(name, "")) for name in others),
        ),
        lines,
        note=_errors(rows),
    )


def _errors(rows: Sequence[Row]) -> str:
    """Describe the largest difference of each peer's distances from ours, and the peer's tolerance."""
    worst: dict[str, Row] = {}
    for row in rows:
        if row["peer"] and row["distance_error_m"] >= worst.get(row["by"], row)["distance_error_m"]:
            worst[row["by"]] = row
    errors = (f"{name} {row['distance_error_m']:.0e} (its {row['tolerance_m']:.0e})" for name, row in worst.items())
    return f"Largest difference of signed distances from ours, and its own tolerance, in m: {'; '.join(errors)}."


SKIPS = (
    Column("skip", "skipped"),
    Column("scene", "where"),
    Column("unit", "counted"),
    Column("without", "without", form="d", hint="count if it were done"),
    Column("with", "with", form="d", hint="count as the program is"),
    Column("saved_share", "saved", "%", ".0f", hint="of the count"),
)
"""Columns of the table of skips."""
