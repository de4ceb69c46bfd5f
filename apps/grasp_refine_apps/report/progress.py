"""Progress of a refinement: a bar in a terminal, single lines elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from grasp_refine.core.plurals import count_text
from grasp_refine.problem.problem import Group
from grasp_refine.problem.refine import Listener


class Reporter(Listener):
    """Progress of a refinement of several groups of grasps, shown on a console; a context manager."""

    def __init__(self, console: Console) -> None:
        """Prepare the bar; nothing is printed yet."""
        self.console = console
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.fields[status]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._finished = self._total = self._iterations = 0
        self._done = "done"
        self._task = self._bar.add_task("", total=None, visible=False, status="")

    def __enter__(self) -> Reporter:
        """Show the bar, once there is something to show."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        self.console.print(escape(line), style="dim", soft_wrap=not self.console.is_terminal)

    def start(self, hand: str, total: int, iterations: int, starts: int = 0) -> None:
        """Announce the refinement of `total` grasps, each of at most `iterations`.

        Args:
            hand: Name of the hand.
            total: Number of grasps.
            iterations: Maximum number of iterations of a grasp.
            starts: Number of starts of the force-closure search; 0: there is no search.
        """
        if not self.console.is_terminal:
            most = count_text(starts, "start") if starts else count_text(iterations, "iteration")
            self.say(f"refining {count_text(total, 'grasp')} with {hand}, at most {most}")
        self._iterations, self._total, self._done = iterations, total, "good" if starts else "done"
        self._bar.update(self._task, description="refining", total=total, visible=True)

    def note(self, line: str) -> None:
        """Print a note for the user."""
        self.say(f"note: {line}")

    def wait(self, what: str) -> None:
        """Show the description of a lengthy step, in a terminal only."""
        self._bar.update(self._task, description=escape(what), total=None, visible=True)

    def simulating(self, group: Group) -> Callable[[str, float], None]:
        """Return the callback of the simulation of a group: name of the simulation, number of finished grasps."""
        total = len(group.rows)

        def show(what: str, done: float) -> None:
            self._bar.update(
                self._task,
                visible=True,
                description=f"{what}, {escape(group.object)}",
                total=total,
                completed=done,
                status=f"{int(done)}/{total} grasps",
            )

        return show

    def refining(self, groups: Sequence[Group]) -> Callable[[int, int, float], None]:
        """Return the progress callback of the refinement of groups, which begins now.

        In a force-closure search, finished grasps are good, and others may still become good.
        """
        count = sum(len(group.rows) for group in groups)
        names = list(dict.fromkeys(group.object for group in groups))
        what = escape(names[0]) if len(names) == 1 else count_text(len(names), "object")
        before, self._finished = self._finished, self._finished + count

        def progress(finished: int, iteration: int, mean_loss: float) -> None:
            # Most grasps finish late: running grasps count by their share of iterations.
            running = (count - finished) * min(iteration / self._iterations, 1.0)
            done = f"{before + finished}/{self._total} {self._done}"
            self._bar.update(
                self._task,
                completed=before + finished + running,
                description=f"refining {what}",
                status=f"{done}, iteration {iteration}, mean loss {mean_loss:.1e} m²",
            )

        return progress
