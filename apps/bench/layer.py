"""What one pass of the witness layer costs: 64 pairs, forward and backward, in CPU milliseconds.

Run `python -m grasp_refine.apps.bench.layer`. Poses are random, then moved along the witness normal so that the
signed distance is uniform in [-2, 8] mm, which is where refinement spends its time. Both bodies get gradients,
points, normal and distance all have random cotangents, and every call is cold (no `previous`). The peer, timed
in the same run, is a plain loop of `coal.distance` over the pieces that a brute-force minimum would have to ask.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from itertools import product

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import hull
from grasp_refine.se3 import exp_se3, inverse
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance

METHODS = {"distance": Distance(), "contact-kinematics": ContactKinematics()}


def convex_body(seed: int, vertices: int = 200) -> Body:
    """A random ellipsoid-like hull, 10 cm long."""
    directions = np.random.default_rng(seed).normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return build_body("convex", [hull(directions * [0.05, 0.03, 0.02])], seed=seed)


def ring_body(seed: int, pieces: int = 20) -> Body:
    """A 12 cm ring of convex wedges: a concave body whose pieces all matter somewhere."""
    edges = np.linspace(0.0, 2.0 * np.pi, pieces + 1)
    parts = []
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        corners = [
            (radius * np.cos(angle), radius * np.sin(angle), height)
            for radius, angle, height in product((0.035, 0.06), (start, (start + stop) / 2, stop), (-0.015, 0.015))
        ]
        parts.append(hull(corners))
    return build_body("ring", parts, seed=seed)


def near_contact(pairs: Pairs, batch: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random poses (batch, 1, 4, 4) of both bodies with signed distances in [-2, 8] mm."""
    rng = np.random.default_rng(seed)
    T_a = exp_se3(rng.normal(size=(batch, 1, 6)) * [0.02, 0.02, 0.02, 2, 2, 2])
    T_b = exp_se3(rng.normal(size=(batch, 1, 6)) * [0.05, 0.05, 0.05, 2, 2, 2])
    wanted = rng.uniform(-0.002, 0.008, size=(batch, 1))
    for _ in range(5):
        found = query(pairs, T_a, T_b)
        T_b[..., :3, 3] += (wanted - found.distance)[..., None] * found.normal
    return T_a, T_b


def cpu_ms(run: Callable[[], object], repeats: int) -> float:
    """CPU time of a call in milliseconds, the median of several."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        run()
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def plain_coal(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> Callable[[], None]:
    """A loop of `coal.distance` with fresh requests over all piece pairs, as a user would write it."""
    import coal

    def shapes(body: Body) -> list[coal.ConvexBase]:
        result = []
        for piece in body.pieces:
            points = coal.StdVec_Vec3s()
            points.extend(list(piece.vertices))
            result.append(coal.Convex.convexHull(points, True, "Qt"))
        return result

    side_a, side_b = shapes(pairs.a[0]), shapes(pairs.b[0])
    relative = inverse(T_a[:, 0]) @ T_b[:, 0]

    def run() -> None:
        identity = coal.Transform3s()
        for T in relative:
            pose = coal.Transform3s(T[:3, :3], T[:3, 3])
            for a, b in product(side_a, side_b):
                coal.distance(a, identity, b, pose, coal.DistanceRequest(), coal.DistanceResult())

    return run


def measure(kind: str, method: str, batch: int, repeats: int, seed: int) -> dict:
    """One row: the cost of the layer for a pair of bodies of one kind."""
    make = {"convex": convex_body, "concave": ring_body}[kind]
    pairs = Pairs((make(seed),), (make(seed + 1),))
    poses = near_contact(pairs, batch, seed)
    layer = WitnessLayer(pairs, METHODS[method])
    T_a, T_b = (torch.from_numpy(T).requires_grad_() for T in poses)
    rng = np.random.default_rng(seed)
    cotangents = [torch.from_numpy(rng.normal(size=(batch, 1, *tail))) for tail in ((3,), (3,), (3,), ())]
    found: list[Witness] = []

    def forward() -> None:
        found.append(layer(T_a, T_b))

    def backward() -> None:
        w = found.pop()
        torch.autograd.grad((w.point_a, w.point_b, w.normal, w.distance), (T_a, T_b), cotangents)

    for _ in range(5):
        forward()
        backward()
    forward_ms = cpu_ms(forward, repeats)
    backward_ms = cpu_ms(backward, repeats)

    def both() -> None:
        forward()
        backward()

    total_ms = cpu_ms(both, repeats)
    asked = query(pairs, *poses).asked
    return {
        "kind": kind,
        "pieces": len(pairs.a[0].pieces),
        "method": method,
        "batch": batch,
        "forward_ms": forward_ms,
        "backward_ms": backward_ms,
        "total_ms": total_ms,
        "queries_per_pair": float(asked.mean()),
        "plain_coal_ms": cpu_ms(plain_coal(pairs, *poses), max(1, repeats // 20)),
    }


def main() -> None:
    """Print the table, and write it as JSON if asked."""
    parser = argparse.ArgumentParser(prog="python -m grasp_refine.apps.bench.layer", description=__doc__)
    parser.add_argument("--batch", type=int, default=64, help="pairs in one call (default 64)")
    parser.add_argument("--repeats", type=int, default=200, help="timed calls, of which the median counts")
    parser.add_argument("--seed", type=int, default=0, help="seed of bodies and poses")
    parser.add_argument("--json", help="also write the rows to this file")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = [
        measure(kind, method, arguments.batch, arguments.repeats, arguments.seed)
        for kind in ("convex", "concave")
        for method in METHODS
    ]
    table = Table(title=f"witness layer, {arguments.batch} pairs, median CPU ms of {arguments.repeats} calls")
    for column in rows[0]:
        table.add_column(column.replace("_", " "), justify="left" if column in ("kind", "method") else "right")
    for row in rows:
        table.add_row(*(f"{value:.2f}" if isinstance(value, float) else str(value) for value in row.values()))
    Console().print(table)
    if arguments.json:
        document = {"schema": 1, "command": "bench layer", "cpus": os.cpu_count(), "rows": rows}
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(document, file, indent=1)


if __name__ == "__main__":
    main()
