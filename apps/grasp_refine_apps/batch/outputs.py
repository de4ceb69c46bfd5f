"""Outputs of a batch besides its result files: index, report and summary, from the result files alone."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspFileError, GraspRefineError
from grasp_refine.core.json_files import check_writable, save_text
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.problem.input_cache import InputCache
from grasp_refine_apps.batch.document import save_batch
from grasp_refine_apps.batch.index import index_writer
from grasp_refine_apps.batch.page import page
from grasp_refine_apps.batch.pictures import draw_cases
from grasp_refine_apps.batch.plan import Plan
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import clean
from grasp_refine_apps.batch.rows import column_kinds, read_rows
from grasp_refine_apps.batch.session import Session
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.batch.work import problem_of
from grasp_refine_apps.batch.worst import Case

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
        """All files except results."""
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

    def read(self, session: Session, progress: Progress) -> None:
        """Gather statistics, and write the index, if there is one; unreadable shards are no longer complete."""
        clean(self.files)
        progress.wait("writing the index" if self.index is not None else "reading the results")
        with nullcontext() if self.index is None else index_writer(self.index) as add_rows:
            for shard in session.complete_shards:
                try:
                    rows = read_rows(shard, self.out)
                    if rows.stamp != shard.stamp:
                        raise GraspFileError(
                            f"{shard.path}: was replaced meanwhile by the result of another batch in this folder"
                        )
                except GraspFileError as error:
                    session.lose(shard, error, progress)
                    continue
                session.statistics.add(rows)
                if add_rows is not None:
                    add_rows(rows)
        if self.index is not None:
            # One in the other format would be outdated.
            _remove_index(self.index.with_suffix({".csv": ".parquet", ".parquet": ".csv"}[self.index.suffix]))

    def write_report(self, document: Mapping[str, Any], session: Session, progress: Progress) -> None:
        """Write the report, if it is enabled; one of the same results and failures stays, as its pictures take long."""
        report, shards = self.out / REPORT, session.complete_shards
        if not self.report:
            return
        found = [(shard.number, shard.stamp, shard.path.stat().st_mtime_ns) for shard in shards]
        state = hashlib.sha256(repr((found, document["failed"], document["config"])).encode()).hexdigest()
        mark = f"<!-- results {state} -->\n"
        if _ends_with(report, mark):
            progress.say(f"{REPORT} shows these results already")
            return
        load = partial(load_case, {shard.number: shard for shard in shards}, InputCache(), document["seed"])
        worst = session.statistics.worst()
        pictures = draw_cases(worst, self.out, load, progress=lambda what, share: progress.wait(what))
        save_text(report, page(document, session.statistics, pictures) + mark)

    def write_summary(
        self, document: Mapping[str, Any], totals: Callable[[], Mapping[str, Any]], session: Session, progress: Progress
    ) -> None:
        """Write the summary, if it is enabled; `totals` is called at the end, when all else is written."""
        if self.json is not None:
            progress.wait("writing the summary")
            save_batch(self.json, document, session.complete_shards, totals)


def _ends_with(path: Path, text: str) -> bool:
    """Return True if a file ends with a text."""
    with suppress(OSError), path.open("rb") as file:
        file.seek(-min(len(text.encode()), path.stat().st_size), os.SEEK_END)
        return file.read() == text.encode()
    return False


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
                ours = file.readline().rstrip("\n").split(",") == list(column_kinds())
        if ours:
            path.unlink()


def load_case(shards: Mapping[int, Shard], cache: InputCache, seed: int, case: Case) -> tuple[Hand, Object]:
    """Hand and object of one of the worst cases."""
    shard = shards[case.shard]
    problem = cache.get("problem", case.shard, lambda: problem_of(shard.task, seed, cache, lambda *sign: None))
    for group in problem.groups:
        if group.scale == case.scale:
            return problem.hand, group.scene.object
    raise GraspRefineError(f"{shard.name}: no object is of the scale {case.scale:g} any more")
