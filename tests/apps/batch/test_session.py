"""State of a batch: costs of its shards add up, and what failed is counted with its reason."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from grasp_refine_apps.batch.plan import Refused
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import note_failure, noted_failure
from grasp_refine_apps.batch.session import Session
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.processes.task import Failed


def test_costs_and_stages_add_up_and_failures_have_their_reasons(tmp_path: Path):
    shards = tuple(
        Shard(n, "group", f"shard {n}", 4, tmp_path / f"{n}.npz", "stamp", SimpleNamespace(job=job))
        for n, job in enumerate("aaab")
    )
    # It failed in an earlier run.
    note_failure(shards[1], Failed("hung", "worker 7 hung", "", 2))
    shards[0].path.write_bytes(bytes(400))
    session = Session(shards, (Refused("c", "no such hand"),), {0})
    assert (session.skipped, session.open_grasps, session.room_bytes) == (4, 12, 1200)
    with Progress(Console(file=io.StringIO()), shards, 1) as progress:
        for number, memory in ((1, 9), (2, 7)):
            spent = {"solver": (0.5, 0.25, 3)}
            session.take(shards[number], Done(4, 3, (1, 2), None, 1.0, 2.0, memory, profile=spent), progress)
        session.take(shards[3], Failed("crashed", "worker 1 was lost", "", 2), progress)
    session.wall_s = 16.0
    assert session.peak_bytes == 9
    assert session.profile == {"solver": (1.0, 0.5, 6)}
    assert session.complete_shards == list(shards[:3])
    totals = session.totals(session.failures(), 20.0, 10.0)
    assert {"shards": 4, "done": 2, "complete": 3, "skipped": 4, "failed": 2, "suspected": 0}.items() <= totals.items()
    assert (totals["grasps_per_s"], totals["cpu_s_per_grasp"]) == pytest.approx((8 / 16.0, 4.0 / 8))
    assert session.jobs() == [
        {"job": "a", "grasps": 12, "shards": 3, "complete": 3},
        {"job": "b", "grasps": 4, "shards": 1, "complete": 0},
    ]
    refused, failed = session.failures()
    assert (refused["shard"], refused["name"], refused["reason"], refused["message"]) == (
        None, "c", "refused", "no such hand"
    )  # fmt: skip
    assert (failed["shard"], failed["path"], failed["reason"], failed["tries"]) == (3, shards[3].path, "crashed", 2)
    # The next run of the command reads the note; that of what succeeded meanwhile is gone.
    assert noted_failure(shards[1]) is None
    assert Session(shards, (), {0, 1, 2}).failures() == [failed]
