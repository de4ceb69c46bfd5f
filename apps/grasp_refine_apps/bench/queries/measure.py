"""Measurement of a case: our engines, cold and warm, forward and backward, and the peers, in the same rounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import torch

from grasp_refine.collision.engine import Engine
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.derivatives import make_derivative
from grasp_refine_apps.bench.jobs import Job, Progress
from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case, draw_poses, make_pairs, nearby
from grasp_refine_apps.bench.queries.peers import PEERS, PeerName
from grasp_refine_apps.bench.timing import cpu_times, one_thread

MethodName = Literal["contact-kinematics", "distance", "direction", "analytical"]

MIN_POSES = 32
"""Smallest number of poses of a case: smaller batches are several calls, so that no single pose decides."""

MAX_PEER_POSES, MAX_PEER_QUERIES = 64, 8192
"""Largest number of poses for a peer, and of queries unless there are only 4 poses; evenly from all poses."""


@dataclass(frozen=True)
class Measurement:
    """Settings with which cases are measured."""

    methods: tuple[MethodName, ...] = ("contact-kinematics", "distance")
    """Derivative methods of the witness points."""
    peers: tuple[PeerName, ...] = tuple(peer.name for peer in PEERS)
    """Peers to compare with."""
    engines: tuple[Engine, ...] = ("auto",)
    """Our engines; ratios are to the first."""
    rounds: int = 7
    """Number of measurements of each time."""
    least_s: float = 0.004
    """Minimum CPU seconds of a measurement of a query."""
    seed: int = 0
    """Seed of bodies and poses."""

    def job(self, case: Case) -> Job:
        """Return the job of a case; its duration includes the calls of a batch and the queries of the peers."""
        peers = min(MAX_PEER_QUERIES, MAX_PEER_POSES * case.piece_pairs) if self.peers else 0
        label = f"{case.kind}, {case.pieces} x {case.vertices}, {case.state}, batch {case.batch}"
        return Job(label, partial(self.rows, case), 1.0 + 1e-3 * case.batch + 5e-4 * peers)

    def rows(self, case: Case, progress: Progress = lambda share: None) -> list[Row]:
        """Measure a case, in this process and with one thread; return the rows of our engines, then of the peers.

        Times are medians over the rounds; ratios are medians of ratios within a round, in which all are timed
        alternately.
        """
        torch.set_num_threads(1)
        with one_thread():
            return self._rows(case, progress)

    def _rows(self, case: Case, progress: Progress) -> list[Row]:
        pairs = {engine: make_pairs(case, self.seed, engine) for engine in self.engines}
        first = pairs[self.engines[0]]
        count = max(case.batch, MIN_POSES)
        T_a, T_b = draw_poses(first, STATE_DISTANCES_M[case.state], count, self.seed)
        reference = query(make_pairs(case, self.seed, "python"), T_a, T_b)
        before = {engine: query(own, T_a, nearby(T_b, self.seed)) for engine, own in pairs.items()}
        progress(0.1)
        runs: dict[tuple[str, ...], Callable[[], object]] = {}
        for engine, own in pairs.items():
            runs["engine", engine, "cold"] = partial(_query_all, own, T_a, T_b, case.batch, None)
            runs["engine", engine, "warm"] = partial(_query_all, own, T_a, T_b, case.batch, before[engine])
        runs["layer",] = partial(_forward, WitnessLayer(first, make_derivative(self.methods[0])), T_a, T_b, case.batch)
        for name in self.methods:
            runs["backward", name] = _backward(
                WitnessLayer(first, make_derivative(name)), T_a, T_b, case.batch, self.seed
            )
        if "native" in pairs:
            runs["bare",] = _bare(pairs["native"], T_a, T_b, case.batch)
        some = _peer_rows(count, case.piece_pairs)
        peers = {peer: peer.loop(first, T_a[some], T_b[some]) for peer in PEERS if peer.name in self.peers}
        runs |= {("peer", peer.name): loop for peer, loop in peers.items()}
        poses = {key: len(some) if key[0] == "peer" else count for key in runs}
        times = {key: cpu_s / poses[key] for key, cpu_s in cpu_times(runs, self.rounds, self.least_s).items()}

        backward = {
            f"backward_{name.replace('-', '_')}_us": 1e6 * float(np.median(times["backward", name]))
            for name in self.methods
        }
        # Code around the query, and the derivative, are the same for all engines.
        shared = {"layer_us": 1e6 * float(np.median(times["layer",])), **backward}

        def row(by: str, key: tuple[str, ...], num_queries: int | None, **more: Any) -> Row:
            every = poses[key] * case.piece_pairs
            asked = every if num_queries is None else num_queries
            return {
                "table": "queries",
                **asdict(case),
                "by": by,
                "peer": False,
                "warm": False,
                "poses": poses[key],
                "forward_us": 1e6 * float(np.median(times[key])),
                **dict.fromkeys(shared),
                "forward_ratio": float(np.median(times[key] / times["engine", self.engines[0], "cold"])),
                "queries_asked": asked,
                "piece_pairs": every,
                "pruned": every - asked,
                "queries_warm": 0,
                **dict.fromkeys(("distance_error_m", "distance_error_median_m", "tolerance_m")),
                **more,
            }

        rows: list[Row] = []
        asked: dict[str, int] = {}
        for engine, own in pairs.items():
            for warm in (False, True):
                answers = query(own, T_a, T_b, previous=before[engine] if warm else None)
                num_queries = int(answers.num_queries.sum())
                asked.setdefault(engine, num_queries)
                apart = int((before[engine].status == QueryStatus.SEPARATED).sum()) if warm else 0
                error = float(np.abs(answers.distance - reference.distance).max())
                counts = {"warm": warm, "queries_warm": apart, "distance_error_m": error}
                key = "engine", engine, "warm" if warm else "cold"
                rows.append(row(engine, key, num_queries, **counts, **({} if rows else shared)))
        if "native" in pairs:
            rows.append(row("bare-loop", ("bare",), asked["native"]))
        for peer, loop in peers.items():
            errors = np.abs(loop() - reference.distance[some, 0])
            found = {"distance_error_m": float(errors.max()), "distance_error_median_m": float(np.median(errors))}
            rows.append(row(peer.name, ("peer", peer.name), None, peer=True, tolerance_m=peer.tolerance_m, **found))
        return rows


def _bare(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, batch: int) -> Callable[[], None]:
    """Return a bare loop over the queries of the compiled engine at all poses, `batch` poses in a call."""
    from grasp_refine.collision.native_search import NativeSearch

    loops = []
    assert isinstance(pairs.search, NativeSearch)
    for start in range(0, len(T_a), batch):
        rows = slice(start, start + batch)
        first, second = (np.ascontiguousarray(T[rows, 0]) for T in (T_a, T_b))
        zero, limit = np.zeros(len(first), dtype=np.int64), np.full(len(first), np.inf)
        loops.append(pairs.search.bare_loop(zero, first, second, limit))

    def run() -> None:
        for loop in loops:
            loop()

    return run


def _peer_rows(count: int, piece_pairs: int) -> np.ndarray:
    """Choose poses for the peers, evenly from all."""
    most = min(count, MAX_PEER_POSES, max(4, MAX_PEER_QUERIES // piece_pairs))
    return np.linspace(0, count - 1, most).round().astype(np.int64)


def _query_all(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, batch: int, previous: Witness | None) -> None:
    """Query all poses, `batch` in a call."""
    for start in range(0, len(T_a), batch):
        rows = slice(start, start + batch)
        query(pairs, T_a[rows], T_b[rows], previous=None if previous is None else previous.rows(rows))


def _forward(layer: WitnessLayer, T_a: np.ndarray, T_b: np.ndarray, batch: int) -> list[tuple[Any, ...]]:
    """Run the layer at the poses of all calls."""
    found = []
    for start in range(0, len(T_a), batch):
        poses = [torch.from_numpy(T[start : start + batch]).requires_grad_() for T in (T_a, T_b)]
        found.append((poses, layer(*poses)))
    return found


def _backward(layer: WitnessLayer, T_a: np.ndarray, T_b: np.ndarray, batch: int, seed: int) -> Callable[[], None]:
    """Return a backward pass at all poses, with random cotangents on points, normals and distances."""
    rng = np.random.default_rng(seed)
    done = [(poses, (w.point_a, w.point_b, w.normal, w.distance)) for poses, w in _forward(layer, T_a, T_b, batch)]
    cotangents = [[torch.from_numpy(rng.normal(size=tuple(part.shape))) for part in parts] for _, parts in done]

    def run() -> None:
        for (poses, parts), cotangent in zip(done, cotangents, strict=True):
            torch.autograd.grad(parts, poses, cotangent, retain_graph=True)

    return run
