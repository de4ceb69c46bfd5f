"""Distances and witness points: queried in all states and with all settings, and checked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.array_records import join
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine_apps.bench.mujoco_distance import MujocoBodies
from grasp_refine_apps.bench.stability.bodies import make_pairs
from grasp_refine_apps.bench.stability.cases import Forward, State, Task
from grasp_refine_apps.bench.stability.judging import FAULTS, AnswerFaults, judge, tolerance
from grasp_refine_apps.bench.stability.poses import PosedBodies, PoseSampler, pose_samplers
from grasp_refine_apps.bench.stability.rows import Cell

MUJOCO_TOLERANCE = 4 * float(np.finfo(np.float32).eps)
"""Allowed error of MuJoCo, as a share of size and distance: it keeps vertices in single precision."""


def forward_cells(task: Task) -> Iterator[Cell]:
    """Check the distances and points of a task, state after state; impossible states have no cells."""
    made = make_pairs(task.kind, task.diagonal, task.seed)
    every = [
        (poser, MujocoBodies(poser.a, poser.b, poser.diagonal, precise=True)) for poser in pose_samplers(made, task)
    ]
    for state in task.states:
        able = [(poser, other) for poser, other in every if poser.can_be(state)]
        if able or made.refused:
            yield from _state_cells(task, state, able, made.refused)


def _state_cells(
    task: Task, state: State, pairs_of_bodies: Sequence[tuple[PoseSampler, MujocoBodies]], refused: Sequence[str]
) -> Iterator[Cell]:
    """Make the cells of a state, of the pairs of bodies that can be in it; bodies that could not be built count too."""
    able, others = [poser for poser, _ in pairs_of_bodies], [other for _, other in pairs_of_bodies]
    each = -(-task.queries // (len(able) + len(refused)))
    blank = Cell(
        kind=task.kind,
        diagonal=task.diagonal,
        state=state,
        measure="forward",
        dtype="float64",
        queries=each * (len(able) + len(refused)),
        refused=each * len(refused),
        refusal="; ".join(dict.fromkeys(refused)) or None,
    )
    posed = [bodies for poser in able if (bodies := poser.pose(state, each)) is not None]
    second = _second_opinion(others, posed, task.mujoco) if able and task.mujoco else {}
    for way in task.forwards:
        cells = [replace(blank, **vars(way), translation=far) for far in task.translations]
        cells[0], second = replace(cells[0], **second), {}
        if not able:
            yield from cells
            continue
        try:
            pairs = Pairs(tuple(poser.a for poser in able), tuple(poser.b for poser in able), engine=way.engine)
        except GraspRefineError as error:
            yield from (replace(cell, refused=cell.queries, refusal=str(error)) for cell in cells)
            continue
        try:
            found = _answers(pairs, posed, way, task.translations)
        except GraspRefineError as error:
            # Bodies that could be built and poses that are finite have an answer: to refuse them is a fault.
            yield from (replace(cell, failed=cell.queries - cell.refused, where=str(error)) for cell in cells)
            continue
        for step, (cell, far) in enumerate(zip(cells, task.translations, strict=True)):
            rows = slice(step * each, (step + 1) * each)
            judged = [
                judge(
                    found.pairs(p).rows(rows),
                    bodies.truth,
                    pairs.piece_pairs,
                    *bodies.moved(far),
                    poser.diagonal,
                    way.dtype,
                )
                for p, (bodies, poser) in enumerate(zip(posed, able, strict=True))
            ]
            yield _counted(cell, judged, able)


def _answers(pairs: Pairs, posed: Sequence[PosedBodies], way: Forward, translations: Sequence[float]) -> Witness:
    """Query (len(translations) * N, P) answers at all N poses of P pairs at the first translation, the second, ..."""
    poses = [
        np.stack([np.concatenate([bodies.moved(far)[side] for far in translations]) for bodies in posed], axis=1)
        for side in (0, 1)
    ]
    layer = WitnessLayer(pairs, ContactKinematics())
    parts = []
    for start in range(0, len(poses[0]), way.batch):
        T_a, T_b = (T[start : start + way.batch] for T in poses)
        if way.dtype == "float32":
            parts.append(layer(*(torch.from_numpy(T.astype(np.float32)) for T in (T_a, T_b))).detached())
        else:
            parts.append(query(pairs, T_a, T_b))
    return join(*parts)


def _second_opinion(others: Sequence[MujocoBodies], posed: Sequence[PosedBodies], most: int) -> dict[str, Any]:
    """Count queries of MuJoCo, at no more than `most` poses, and its wrong answers, as entries of a cell."""
    asked = wrong = 0
    for other, bodies in zip(others, posed, strict=True):
        some = slice(-(-most // len(others)))
        T_a, T_b, true = bodies.T_a[some], bodies.T_b[some], bodies.truth.distance[some]
        if other.model is not None:
            found = other.loop(T_a, T_b)()
            position = np.maximum(*(np.linalg.norm(T[:, :3, 3], axis=1) for T in (T_a, T_b)))
            allowed = tolerance(other.unit, position) + MUJOCO_TOLERANCE * (other.unit + np.abs(true))
            asked, wrong = asked + len(found), wrong + int((np.abs(found - true) > allowed).sum())
    return {"mujoco_queries": asked, "mujoco_wrong": wrong}


def _counted(cell: Cell, judged: Sequence[AnswerFaults], able: Sequence[PoseSampler]) -> Cell:
    """Total the counts of all pairs of bodies in the cell."""

    def count(name: str) -> int:
        return sum(int(getattr(one, name).sum()) for one in judged)

    counts: dict[str, Any] = {name: count(name) for name in (*FAULTS, "collapsed")}
    errors = np.concatenate([one.error for one in judged])
    shares = np.concatenate([one.error / one.tolerance for one in judged])
    points = np.concatenate([one.points_error for one in judged])
    compared = np.isfinite(errors).any()
    return replace(
        cell,
        **counts,
        points_compared=count("compared"),
        error_max=float(np.nanmax(shares)) if compared else None,
        distance_error_max_m=float(np.nanmax(errors)) if compared else None,
        points_error_max=float(np.nanmax(points)) if compared else None,
        where="; ".join(filter(None, map(_first_wrong, judged, able))) or None,
    )


def _first_wrong(judged: AnswerFaults, poser: PoseSampler) -> str:
    """Location of the first wrong answer of a pair of bodies; empty: none."""
    wrong = judged.wrong
    return f"{poser.a.name} and {poser.b.name}: pose {int(wrong.argmax())} of {len(wrong)}" if wrong.any() else ""
