"""Measurements of a case: our engines, cold and warm, forward and backward, and the peers, in the same rounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import torch

from grasp_refine.collision.engine import Engine
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine_apps.bench.queries.bodies import make_pairs
from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case
from grasp_refine_apps.bench.queries.peers import PEERS, Loop, Peer
from grasp_refine_apps.bench.queries.poses import draw_poses, nearby
from grasp_refine_apps.bench.timing import cpu_times, one_thread

MethodName = Literal["contact-kinematics", "distance", "direction", "analytical"]

METHODS: Mapping[MethodName, Derivative] = MappingProxyType(
    {
        "contact-kinematics": ContactKinematics(),
        "distance": Distance(),
        "direction": Direction(),
        "analytical": Analytical(),
    }
)
"""Name -> derivative method."""

MIN_POSES = 32
"""Smallest number of poses of a case: smaller batches are several calls, so that no single pose decides."""

MAX_PEER_POSES, MAX_PEER_QUERIES = 64, 8192
"""Largest number of poses for a peer, and of queries unless there are only 4 poses; evenly from all poses."""


@dataclass(frozen=True, eq=False)
class CaseResult:
    """Results of a case."""

    case: Case
    engines: dict[tuple[str, bool], EngineResult]
    """Engine, and whether it was warm -> its results."""
    backward_s: dict[MethodName, np.ndarray]
    """Method -> CPU seconds of a backward pass per pose, in each round."""
    layer_s: np.ndarray
    """CPU seconds of a forward pass of the torch layer per pose, in each round."""
    bare_s: np.ndarray | None
    """CPU seconds per pose, in each round, of a bare loop in C++ over the queries of the compiled engine, cold; None:
    that engine is not compared."""
    peers: dict[str, PeerResult]
    """Peer -> its results."""


@dataclass(frozen=True, eq=False)
class EngineResult:
    """Results of an engine at all poses."""

    forward_s: np.ndarray
    """CPU seconds per pose, in each round."""
    poses: int
    num_queries: int
    """Narrow-phase queries at all poses."""
    warm: int
    """Poses whose first query had a warm start of GJK."""
    error: float
    """Largest difference of a signed distance from that of the engine in Python, cold, in metres."""


@dataclass(frozen=True, eq=False)
class PeerResult:
    """Results of a peer at some of the poses."""

    forward_s: np.ndarray
    poses: int
    errors: np.ndarray
    """Differences (N,) of its signed distances from ours, in metres."""


@dataclass(frozen=True)
class CaseJob:
    """The measurement of one case."""

    case: Case
    engines: tuple[Engine, ...]
    methods: tuple[MethodName, ...]
    peers: tuple[str, ...]
    rounds: int
    """Number of measurements of each time."""
    least_s: float
    """Minimum CPU seconds of a measurement."""
    seed: int

    @property
    def work(self) -> float:
        """Approximate duration: the calls of a batch, and the queries of the peers."""
        peers = min(MAX_PEER_QUERIES, MAX_PEER_POSES * self.case.piece_pairs) if self.peers else 0
        return 1.0 + 1e-3 * self.case.batch + 5e-4 * peers

    @property
    def label(self) -> str:
        """Label of the job, for a progress bar."""
        case = self.case
        return f"{case.kind}, {case.pieces} x {case.vertices}, {case.state}, batch {case.batch}"

    def do(self, progress: Callable[[float], None]) -> CaseResult:
        """Measure the case, in this process and with one thread of torch."""
        torch.set_num_threads(1)
        with one_thread():
            return self._measured(progress)

    def _measured(self, progress: Callable[[float], None]) -> CaseResult:
        case = self.case
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
        runs["layer",] = partial(_forward, WitnessLayer(first, METHODS[self.methods[0]]), T_a, T_b, case.batch)
        for name in self.methods:
            runs["backward", name] = _backward(WitnessLayer(first, METHODS[name]), T_a, T_b, case.batch, self.seed)
        if "native" in pairs:
            runs["bare",] = _bare(pairs["native"], T_a, T_b, case.batch)
        some = _peer_rows(count, case.piece_pairs)
        loops: dict[str, Loop] = {}
        for peer in _chosen(self.peers):
            loops[peer.name] = peer.loop(first, T_a[some], T_b[some])
            runs["peer", peer.name] = loops[peer.name]
        times = cpu_times(runs, self.rounds, self.least_s)
        return CaseResult(
            case,
            {
                (engine, warm): self._answers(own, T_a, T_b, before[engine] if warm else None, reference, times)
                for engine, own in pairs.items()
                for warm in (False, True)
            },
            {name: times["backward", name] / count for name in self.methods},
            times["layer",] / count,
            times["bare",] / count if "native" in pairs else None,
            {
                name: PeerResult(times["peer", name] / len(some), len(some), loop() - reference.distance[some, 0])
                for name, loop in loops.items()
            },
        )

    def _answers(
        self,
        pairs: Pairs,
        T_a: np.ndarray,
        T_b: np.ndarray,
        previous: Witness | None,
        reference: Witness,
        times: Mapping[tuple[str, ...], np.ndarray],
    ) -> EngineResult:
        found = query(pairs, T_a, T_b, previous=previous)
        apart = 0 if previous is None else int((previous.status == QueryStatus.SEPARATED).sum())
        state = "cold" if previous is None else "warm"
        return EngineResult(
            forward_s=times["engine", pairs.engine, state] / len(T_a),
            poses=len(T_a),
            num_queries=int(found.num_queries.sum()),
            warm=apart,
            error=float(np.abs(found.distance - reference.distance).max()),
        )


def _bare(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, batch: int) -> Callable[[], None]:
    """Return a bare loop over the queries of the compiled engine at all poses, `batch` poses in a call."""
    loops = []
    assert pairs.native is not None
    for start in range(0, len(T_a), batch):
        rows = slice(start, start + batch)
        first, second = (np.ascontiguousarray(T[rows, 0]) for T in (T_a, T_b))
        zero, limit = np.zeros(len(first), dtype=np.int64), np.full(len(first), np.inf)
        loops.append(pairs.native.bare_loop(zero, first, second, limit, None))

    def run() -> None:
        for loop in loops:
            loop()

    return run


def _chosen(names: tuple[str, ...]) -> list[Peer]:
    return [peer for peer in PEERS if peer.name in names]


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
