"""Outputs of a batch: a result that another batch replaced is missing, and counts as a failure."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from batch_rows import shard
from grasp_refine_apps.batch.outputs import Outputs
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.session import Session
from made_results import refined, save_refined


def test_results_of_another_batch_and_damaged_ones_are_failures(tmp_path: Path):
    shards = tuple(shard(number, tmp_path / f"{number}.npz", 1) for number in range(3))
    for one, stamp in zip(shards, ("stamp", "of other settings", "stamp"), strict=True):
        save_refined(one.path, refined("bottle", slice(1)), stamp=stamp)
    shards[2].path.write_bytes(shards[2].path.read_bytes()[:-100])
    session = Session(tuple(replace(one, task=None) for one in shards), (), {0, 1, 2})
    with Progress(Console(file=io.StringIO()), (), 1) as progress:
        Outputs(tmp_path, tmp_path / "index.csv", False, None).read(session, progress)
    assert session.complete == {0}
    assert [one["path"] for one in session.failures()] == [shards[1].path, shards[2].path]
    assert len((tmp_path / "index.csv").read_text().splitlines()) == 2, "a header and one grasp"
