"""The benchmark of holding: success rate of grasps in simulation after refinement, against its cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from grasp_refine.core.array_records import join
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import model_of
from grasp_refine_apps.bench.chart import Axis, Chart, Row, of_finite
from grasp_refine_apps.bench.hold.measure import GroupResult, GroupTask, methods
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Column, Report, Table

PRESETS: Mapping[str, Mapping[str, Any]] = MappingProxyType({"smoke": {"starts": (1, 2), "count": 2}})
"""Name of an experiment -> its fields of `HoldStudy`."""


@dataclass(frozen=True)
class HoldStudy:
    """Settings of a run."""

    spec: ProblemSpec
    """The grasps."""
    starts: tuple[int, ...] = (1, 6)
    """Numbers of starts."""
    count: int | None = None
    """Largest number of grasps on each object at each scale; None: all."""
    protocols: tuple[str, ...] = ("dexgraspbench", "strict")
    """Names of the protocols of the simulation, or TOML files."""
    width: int = Config.width
    """Largest number of grasps that are refined at once."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int | None = None
    """CPU threads of the simulation; None: all cores. Refinement has one."""
    workers: int = 1

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Load the grasps and return a job for each object and scale, which takes about as long for every grasp.

        Raises:
            GraspRefineError: the grasps cannot be used.
        """
        # The tensors of a batch of grasps are small.
        torch.set_num_threads(1)
        problem = load_problem(self.spec, seed=self.seed, on_message=say)
        model = model_of(problem.hand)
        stages = "file" in problem.closing().values()
        notes = [*problem.notes, *model.notes]
        if not stages:
            notes.append("the grasps have no pregrasps and squeezes: the grasps as given get ours")
        for note in notes:
            say(f"note: {note}")
        protocols = {name: load_protocol(name) for name in self.protocols}
        rest = model, methods(self.starts, stages=stages), protocols, self.width, self.seed, self.threads
        jobs = []
        for group in problem.groups:
            rows = np.arange(len(group.rows))[: self.count]
            scene = replace(group.scene.select(rows), target_link=None, target_object=None)
            motion = group.motion().select(rows) if stages else None
            jobs.append(Job(group.object, GroupTask(group.object, scene, motion, *rest).run, len(rows)))
        return jobs

    def rows(self, done: Sequence[Sequence[GroupResult]]) -> list[Row]:
        """Return the rows of each method: the pooled one, then, of several objects, one for each."""
        return rows([result for results in done for result in results], self.protocols)

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return success against time, and tables of all grasps and by object."""
        pooled = [row for row in rows if row["object"] == "all"]
        each = [{**row, "label": f"{row['object']}, {row['label']}"} for row in rows if row["object"] != "all"]
        verdicts = _verdicts(self.protocols)
        title = f"{pooled[0]['grasps']} grasps; held, and lost of those that held before"
        brief = Table(title, [METHOD, *_brief(self.protocols)], pooled)
        parts: list[Table | Chart] = [_chart(rows, self.protocols), brief]
        for heading, columns in (
            ("Grasps that hold", verdicts),
            ("Costs", COSTS),
            ("Geometry of the grasps", GEOMETRY),
        ):
            parts.append(Table(heading, [METHOD, *columns], pooled, only="page"))
        if each:
            held = _brief(self.protocols)[: len(self.protocols)]
            parts.append(Table("held by object", [METHOD, *held], each, only="terminal"))
            parts.append(Table("By object", [METHOD, *verdicts, *COSTS, *GEOMETRY], each, only="page", folded=True))
        return Report("Grasps that hold", parts)


def _key(name: str, protocol: str) -> str:
    """Key of a number under a protocol."""
    return f"{name}_{protocol.replace('-', '_')}"


def rows(results: Sequence[GroupResult], protocols: Sequence[str]) -> list[Row]:
    """Return flat rows.

    Args:
        results: Results of the methods, which are the same, in the same order, for each group of grasps; the first
            method decides which grasps held before.
        protocols: Names of the protocols of the simulation.
    """
    names = list(dict.fromkeys(one.method for one in results))
    objects = list(dict.fromkeys(one.object for one in results))
    found = []
    for method in names:
        for name in ("all", *(objects if len(objects) > 1 else ())):
            before, after = (
                [one for one in results if one.method == which and name in ("all", one.object)]
                for which in (names[0], method)
            )
            about = {"method": method.name, "starts": method.starts, "label": method.label, "object": name}
            found.append({**about, **_statistics(before, after, protocols)})
    return found


def _statistics(before: Sequence[GroupResult], after: Sequence[GroupResult], protocols: Sequence[str]) -> Row:
    values = join(*(one.values for one in after))
    quality = np.nan_to_num(values["quality"])
    # Grasps that could not be measured count as the worst.
    depth, own, residual = (
        np.nan_to_num(values[name], nan=np.inf) for name in ("penetration_m", "self_penetration_m", "wrench_residual")
    )
    return {
        "grasps": len(depth),
        **_held(before, after, protocols, quality),
        "cpu_ms_median": of_finite(np.median, values["cpu_ms"]),
        "cpu_ms_mean": of_finite(np.mean, values["cpu_ms"]),
        "wall_ms_median": of_finite(np.median, values["wall_ms"]),
        "wall_ms_mean": of_finite(np.mean, values["wall_ms"]),
        "stages_cpu_ms": of_finite(np.mean, values["stages_cpu_ms"]),
        "penetration_mean_m": float(depth.mean()),
        "penetration_q95_m": float(np.quantile(depth, 0.95, method="higher")),
        "self_penetration_max_m": float(own.max()),
        "contact_gap_median_m": of_finite(np.median, values["contact_gap_m"]),
        "wrench_residual_median": float(np.median(residual)),
        "wrench_residual_q75": float(np.quantile(residual, 0.75, method="higher")),
        "moved_palm_median_m": of_finite(np.median, values["moved_palm_m"]),
        "moved_palm_median_rad": of_finite(np.median, values["moved_palm_rad"]),
        "moved_joints_median_rad": of_finite(np.median, values["moved_joints_rad"]),
        "quality_median": float(np.median(quality)),
        "starts_mean": of_finite(np.mean, values["starts"]),
    }


def _held(
    before: Sequence[GroupResult], after: Sequence[GroupResult], protocols: Sequence[str], quality: np.ndarray
) -> Row:
    """Outcome of the simulation by protocol, and how well the quality predicts it."""
    found: dict[str, Row] = {name: {} for name in ("success", "lost", "auc", "reasons")}
    for protocol in protocols:
        first, reason = (np.concatenate([one.reason[protocol] for one in parts]) for parts in (before, after))
        held_before, held = first == Reason.HELD, reason == Reason.HELD
        lost = float((~held[held_before]).mean()) if held_before.any() else None
        counts = {one.label: int((reason == one).sum()) for one in Reason if one != Reason.HELD}
        reasons = {label: count for label, count in counts.items() if count}
        for name, value in zip(found, (float(held.mean()), lost, auc(quality, held), reasons), strict=True):
            found[name][_key(name, protocol)] = value
    return {key: value for columns in found.values() for key, value in columns.items()}


def auc(score: np.ndarray, success: np.ndarray) -> float | None:
    """Probability that a random success has a higher score than a random failure; ties count half.

    Args:
        score: Scores (N,).
        success: True for successes (N,).

    Returns:
        The area under the curve of hits against false alarms; None where all or none are successes.
    """
    yes, no = score[success], score[~success]
    if not len(yes) or not len(no):
        return None
    order = np.sort(no)
    below, upto = np.searchsorted(order, yes, "left"), np.searchsorted(order, yes, "right")
    return float((below + upto).mean() / (2 * len(no)))


# report


def _chart(rows: Sequence[Row], protocols: Sequence[str]) -> Chart:
    """Chart success against CPU time of a grasp; grasps that are not refined are levels."""
    points = [
        {
            "object": row["object"],
            "line": protocol if row["cpu_ms_mean"] is not None else f"{protocol}, {row['label']}",
            "s": None if row["cpu_ms_mean"] is None else 1e-3 * row["cpu_ms_mean"],
            "success": row[_key("success", protocol)],
        }
        for protocol in protocols
        for row in rows
    ]
    return Chart(
        "Success against CPU time",
        points,
        Axis("s", "CPU time of refining a grasp", "s"),
        (Axis("success", "grasps that hold", "%", log=False),),
        lambda row: row["line"],
        lambda row: row["object"],
        note="From left to right: geometry only, then the numbers of starts. Dashed: grasps that are not refined.",
    )


METHOD = Column("label", "refined")


def _brief(protocols: Sequence[str]) -> list[Column]:
    """Columns for a terminal."""
    heads = {"dexgraspbench": "dex\u00adgrasp\u00adbench", "tabletop": "table\u00adtop"}
    first = protocols[0]
    return [
        *(Column(_key("success", name), f"held, {heads.get(name, name)}", "%", ".1f", "higher") for name in protocols),
        Column(_key("lost", first), f"lost, {heads.get(first, first)}", "%", ".1f", "lower"),
        Column("cpu_ms_mean", "CPU mean", "ms", ".0f", "lower"),
        Column("penetration_mean_m", "pen. mean", "mm", ".3f", "lower"),
        Column("self_penetration_max_m", "self max", "mm", ".2f", "lower"),
        Column("contact_gap_median_m", "gap", "mm", ".3f", "lower"),
        Column("wrench_residual_median", "resi\u00addual", form=".0e", better="lower"),
        Column("moved_palm_median_m", "moved", "mm", ".1f"),
        Column("moved_palm_median_rad", "", "°", ".1f"),
        Column(_key("auc", first), "AUC", form=".2f", better="higher"),
    ]


def _verdicts(protocols: Sequence[str]) -> list[Column]:
    return [
        column
        for name in protocols
        for column in (
            Column(_key("success", name), name, "%", ".1f", "higher", "grasps that hold"),
            Column(_key("lost", name), "lost", "%", ".1f", "lower", "of the input grasps that held"),
            Column(_key("auc", name), "AUC", "", ".3f", "higher", "of the quality against success"),
            Column(_key("reasons", name), "failed", "", _reasons, hint="grasps by reason of failure"),
        )
    ]


def _reasons(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items()) or "–"


COSTS = (
    Column("cpu_ms_mean", "CPU", "ms", ".1f", "lower", "of refining a grasp, mean"),
    Column("cpu_ms_median", "median", "ms", ".1f", "lower", "CPU of refining a grasp, median"),
    Column("wall_ms_mean", "wall", "ms", ".1f", "lower", "of refining a grasp, mean"),
    Column("wall_ms_median", "median", "ms", ".1f", "lower", "wall time of refining a grasp, median"),
    Column("stages_cpu_ms", "stages, CPU", "ms", ".1f", hint="of finding pregrasp and squeeze of a grasp, mean"),
    Column("starts_mean", "starts", "", ".2f", hint="number of starts of a grasp, mean"),
    Column("moved_palm_median_m", "moved", "mm", ".1f", hint="the base link, median"),
    Column("moved_palm_median_rad", "turned", "°", ".1f", hint="the base link, median"),
    Column("moved_joints_median_rad", "joints", "°", ".1f", hint="the joint that moved most, median"),
)
GEOMETRY = (
    Column("penetration_mean_m", "pen.", "mm", ".4f", "lower", "deepest penetration of any link, mean"),
    Column("penetration_q95_m", "p95", "mm", ".4f", "lower", "19 of 20 are smaller"),
    Column("self_penetration_max_m", "self", "mm", ".4f", "lower", "links in each other, worst"),
    Column("contact_gap_median_m", "gap", "mm", ".4f", "lower", "of the worst of the links that touch, median"),
    Column("wrench_residual_median", "residual", "", ".1e", "lower", "wrench residual, median"),
    Column("wrench_residual_q75", "q75", "", ".1e", "lower", "three of four are smaller"),
    Column("quality_median", "quality", "", ".3f", "higher", "median"),
)
