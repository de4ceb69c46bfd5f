"""Progress of a batch: a bar and a line for each worker in a terminal, a line every 30 s elsewhere."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from grasp_refine.core.plurals import count_text, whole
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.processes.task import Failed, Sign

PRINT_INTERVAL_S = 30.0
"""Interval between two lines where there is no terminal, seconds."""
SPEED_WINDOW_S = 600.0
"""Window of the speed, seconds: the remaining time is estimated from recent objects."""
MIN_SPEED_TIME_S = 2.0
"""Time before which the speed is not known, seconds."""
MAX_LISTED = 8
"""Maximum number of workers, and of failures, listed in a terminal."""


class Progress:
    """Progress of a batch, shown on a console; a context manager. To be called from one thread."""

    def __init__(
        self,
        console: Console,
        shards: Sequence[Shard],
        workers: int,
        skipped: int = 0,
        *,
        simulated: bool = False,
        work: tuple[str, str] = ("refining", "refined"),
        verdict: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare the display; nothing is printed yet.

        Args:
            console: The console.
            shards: Shards of this run.
            workers: Number of workers at a time.
            skipped: Number of grasps done before.
            simulated: Count grasps that held in simulation, else grasps that should hold.
            work: Verb for the work on the grasps, and its past participle.
            verdict: Whether the share of grasps that held, or are good, is shown.
            clock: Clock, seconds.
        """
        self.console = console
        self._shards = {shard.number: shard for shard in shards}
        self._open = set(self._shards)
        self._total = sum(shard.size for shard in shards) + skipped
        self._skipped, self._workers, self._simulated, self._clock = skipped, workers, simulated, clock
        self._work, self._verdict = work, verdict
        self._done = self._counted = self._good = self._failed = self._lost = 0
        self._active: dict[int, Sign] = {}
        self._begun = self._printed_s = clock()
        self._past: deque[tuple[float, float]] = deque([(self._begun, 0.0)])
        self._waiting = "starting the workers" if shards else ""
        self._spinner = Spinner("dots")
        self._live = Live(self, console=console, refresh_per_second=4, transient=True)

    def __enter__(self) -> Progress:
        """Show the bar, where there is a terminal."""
        self._begun = self._printed_s = self._clock()
        self._past = deque([(self._begun, 0.0)])
        if self.console.is_terminal:
            self._live.start()
        elif self._shards:
            before = f", {whole(self._skipped)} were done before" if self._skipped else ""
            now = words.grasps(self._total - self._skipped)
            shards, workers = count_text(len(self._shards), "shard"), count_text(self._workers, "worker")
            self.say(f"{self._work[0]} {now} in {shards} with {workers}{before}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        if self.console.is_terminal:
            self._live.stop()

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        self.console.print(escape(line), style="dim", soft_wrap=not self.console.is_terminal)

    def wait(self, what: str) -> None:
        """Show the description of a lengthy step without a running shard, in a terminal only."""
        self._active.clear()
        self._waiting = what

    def heartbeat(self, number: int, what: str, share: float, refined: int = 0) -> None:
        """Update a shard: its current step, the share that is done, and the number of its refined grasps."""
        # A heartbeat may arrive after the end.
        if number in self._open:
            self._waiting = ""
            self._active[number] = Sign(what, min(max(share, 0.0), 1.0), refined)
            self._note()

    def done(self, shard: Shard, done: Done) -> None:
        """Count a complete shard."""
        self._end(shard)
        self._done += done.grasps
        self._counted += done.grasps
        self._good += done.held[1] if done.held is not None else done.good[1]
        self._note()

    def failed(self, shard: Shard, failed: Failed) -> None:
        """Count a failed shard, and print its failure."""
        self._end(shard)
        self._failed += 1
        self._lost += shard.size
        # Many failures must not flood a terminal; a file may hold them all.
        if self._failed <= MAX_LISTED or not self.console.is_terminal:
            tries = f", tried {failed.tries} times" if failed.tries > 1 else ""
            line = Text.assemble((f"{shard.name} failed", "red"), f" ({failed.reason}{tries}): {failed.message}")
            self.console.print(line, soft_wrap=not self.console.is_terminal)
        elif self._failed == MAX_LISTED + 1:
            self.say("further failures are listed at the end")
        self._note()

    def _end(self, shard: Shard) -> None:
        self._active.pop(shard.number, None)
        self._open.discard(shard.number)

    @property
    def speed(self) -> float:
        """Grasps per second in the last minutes; 0: not known before some are refined."""
        if not self._refined:
            return 0.0
        now = self._clock()
        (before, at_first), grasps = self._past[0], self._running
        return (grasps - at_first) / (now - before) if now - before >= MIN_SPEED_TIME_S else 0.0

    @property
    def remaining_s(self) -> float | None:
        """Estimated remaining time, seconds; None: not known yet."""
        left = self._total - self._skipped - self._lost - self._running
        return max(left, 0.0) / self.speed if self.speed > 0 else None

    @property
    def _running(self) -> float:
        """Number of grasps done in this run, with the shares of the running shards."""
        return self._done + sum(self._shards[number].size * sign.share for number, sign in self._active.items())

    @property
    def _refined(self) -> int:
        """Number of grasps refined in this run, in complete and in running shards."""
        return self._done + sum(sign.finished for sign in self._active.values())

    def _note(self) -> None:
        """Record the progress and, where there is no terminal, print it now and then."""
        now = self._clock()
        if now - self._past[-1][0] >= SPEED_WINDOW_S / 100:
            self._past.append((now, self._running))
        while len(self._past) > 2 and now - self._past[1][0] >= SPEED_WINDOW_S:
            self._past.popleft()
        if not self.console.is_terminal and now - self._printed_s >= PRINT_INTERVAL_S:
            self._printed_s = now
            self.say(", ".join(self._facts()))

    def _facts(self) -> list[str]:
        """Facts about the whole batch, the most important first."""
        facts = [f"{whole(self._skipped + self._refined)}/{words.grasps(self._total)} {self._work[1]}"]
        if self.speed > 0:
            facts.append(words.rate(self.speed))
        if self.remaining_s is not None and self._open:
            facts.append(f"{words.duration(self.remaining_s)} left")
        if self._counted and self._verdict:
            verdict = "held" if self._simulated else "good"
            facts.append(f"{words.share(self._good, self._counted)} {verdict}")
        if self._failed:
            facts.append(f"{count_text(self._failed, 'shard')} failed")
        return facts

    def __rich__(self) -> RenderableType:
        """Return the bar, and a line for each worker."""
        finished = self._skipped + self._running + self._lost
        bar = Table.grid(expand=True)
        bar.add_row(ProgressBar(total=max(self._total, 1), completed=finished))
        lines: list[RenderableType] = []
        if self._total:
            lines += [bar, Text(" · ".join(self._facts()), no_wrap=True, overflow="ellipsis")]
        if self._waiting:
            self._spinner.update(text=Text(self._waiting, "dim", no_wrap=True, overflow="ellipsis"))
            lines.append(self._spinner)
        active = sorted(self._active.items())
        for number, sign in active[:MAX_LISTED]:
            line = Table.grid(padding=(0, 1), expand=True)
            line.add_column(width=5, justify="right")
            line.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
            line.add_row(f"{100 * sign.share:.0f} %", Text(f"{self._shards[number].name}: {sign.what}"), style="dim")
            lines.append(line)
        if len(active) > MAX_LISTED:
            lines.append(Text(f"      and {len(active) - MAX_LISTED} more", "dim"))
        return Group(*lines)
