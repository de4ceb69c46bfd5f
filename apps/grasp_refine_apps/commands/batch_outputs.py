"""Outputs of a batch besides its result files: index, report and summary, from the result files alone."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.json_files import check_writable, save_text
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.pipeline.input_cache import InputCache
from grasp_refine_apps.batch.index import AddRows, index_writer
from grasp_refine_apps.batch.page import page
from grasp_refine_apps.batch.pictures import draw_cases
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.rows import COLUMNS, read_rows
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.batch.worst import Case
from grasp_refine_apps.commands.batch_document import save_batch
from grasp_refine_apps.commands.batch_session import Summary
from grasp_refine_apps.commands.shard_plan import Plan
from grasp_refine_apps.commands.shard_work import problem_of

REPORT = "report.html"


@dataclass(frozen=True)
class Outputs:
    """Output files of a batch."""

    out: Path
    """Folder of the result files."""
    index: Path | None
    """Path of the table of all grasps; None: only a part of the batch is done."""
    report: bool
    """Whether a report is written."""
    json: Path | None
    """Path of the summary; None: there is none."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files but those of results."""
        found = (self.index, self.out / REPORT if self.report else None, self.json)
        return tuple(path for path in found if path is not None)

    def check(self, plan: Plan) -> None:
        """Refuse outputs that cannot be written or would overwrite an input.

        Raises:
            GraspRefineError: names the file.
        """
        # The same command resumes where it stopped, and writes them again.
        check_writable(*self.files, plan.shards[0].path, overwrite=True, inside=self.out)
        inputs = {identity for path in plan.files if (identity := _identity(path)) is not None}
        for path in (*self.files, *(shard.path for shard in plan.shards)):
            if _identity(path) in inputs:
                raise GraspRefineError(f"{path}: the results would overwrite an input; give another --out or --json")

    def read(self, summary: Summary, progress: Progress) -> Summary:
        """Write the index, if there is one, and gather statistics; unreadable shards are no longer complete."""
        if self.index is None:
            return self._read(summary, lambda rows: None, progress)
        progress.wait("writing the index")
        with index_writer(self.index) as add_rows:
            found = self._read(summary, add_rows, progress)
        # One in the other format would be outdated.
        _remove_index(self.index.with_suffix({".csv": ".parquet", ".parquet": ".csv"}[self.index.suffix]))
        return found

    def _read(self, summary: Summary, add_rows: AddRows, progress: Progress) -> Summary:
        readable = []
        for shard in summary.complete:
            try:
                rows = read_rows(shard, self.out)
            except GraspFileError as error:
                progress.say(str(error))
                continue
            if rows.stamp != shard.stamp:
                progress.say(f"{shard.path}: was replaced meanwhile by the result of another batch in this folder")
                continue
            readable.append(shard)
            summary.statistics.add(rows)
            add_rows(rows)
        return replace(summary, complete=tuple(readable))

    def write(self, document: Mapping[str, Any], summary: Summary, progress: Progress) -> None:
        """Write report and summary, as far as they are enabled."""
        if self.report:
            shards = {shard.number: shard for shard in summary.complete}
            load = partial(_load_case, shards, InputCache(), document["seed"])
            worst = summary.statistics.worst()
            pictures = draw_cases(worst, self.out, load, progress=lambda what, share: progress.wait(what))
            save_text(self.out / REPORT, page(document, summary.statistics, pictures))
        if self.json is not None:
            progress.wait("writing the summary")
            save_batch(self.json, document, summary.complete)


def _identity(path: Path) -> tuple[int, int] | None:
    """Identity of a file, equal for all of its names; None: there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _remove_index(path: Path) -> None:
    """Remove an index; another file of its name stays."""
    with suppress(OSError, UnicodeDecodeError):
        if path.suffix == ".parquet":
            with path.open("rb") as file:
                ours = file.read(4) == b"PAR1"
        else:
            with path.open(encoding="utf-8") as file:
                ours = file.readline().rstrip("\n").split(",") == list(COLUMNS)
        if ours:
            path.unlink()


def _load_case(shards: Mapping[int, Shard], cache: InputCache, seed: int, case: Case) -> tuple[Hand, Object]:
    """Hand and object of one of the worst cases."""
    shard = shards[case.shard]
    problem = cache.get("problem", case.shard, lambda: problem_of(shard.task, seed, cache, lambda *sign: None))
    for group in problem.groups:
        if group.scale == case.scale:
            return problem.hand, group.scene.object
    raise GraspRefineError(f"{shard.name}: no object is of the scale {case.scale:g} any more")
