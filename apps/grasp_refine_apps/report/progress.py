"""What is said while grasps are refined: a bar in a terminal, single lines elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from grasp_refine.core.plurals import count_text


class Reporter:
    """Tells on a console how far a refinement of several groups of grasps is; a context manager."""

    def __init__(self, console: Console) -> None:
        """Say nothing yet."""
        self.console = console
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            TextColumn("{task.fields[said]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._finished = self._total = self._iterations = 0
        self._done = "done"
        self._task = self._bar.add_task("", total=None, visible=False, said="")

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
        """Announce the refinement of `total` grasps, each of at most so many `iterations`.

        Args:
            hand: Name of the hand.
            total: Number of grasps.
            iterations: Most iterations of a grasp.
            starts: From how many starts grasps are made to hold; 0: they are not.
        """
        if not self.console.is_terminal:
            most = count_text(starts, "start") if starts else count_text(iterations, "iteration")
            self.say(f"refining {count_text(total, 'grasp')} with {hand}, at most {most}")
        self._iterations, self._total, self._done = iterations, total, "good" if starts else "done"
        self._bar.update(self._task, description="refining", total=total, visible=True)

    def wait(self, what: str) -> None:
        """Show, in a terminal only, what takes a while."""
        self._bar.update(self._task, description=escape(what), total=None, visible=True)

    def telling(self, name: str, total: int) -> Callable[[str, float], None]:
        """The `tell` of `validate` for `total` grasps on the object `name`."""

        def tell(what: str, done: float) -> None:
            self._bar.update(
                self._task,
                visible=True,
                description=f"{what}, {escape(name)}",
                total=total,
                completed=done,
                said=f"{int(done)}/{total} grasps",
            )

        return tell

    def group(self, name: str, count: int) -> Callable[[int, int, float], None]:
        """The `progress` of `refine` for a group of `count` grasps on the object `name`.

        Where grasps are made to hold, those that are finished are good, and others may yet become so.
        """
        before, self._finished = self._finished, self._finished + count

        def progress(finished: int, iteration: int, mean_loss: float) -> None:
            # Most grasps finish late: those that run count by how far they are.
            running = (count - finished) * min(iteration / self._iterations, 1.0)
            done = f"{before + finished}/{self._total} {self._done}"
            self._bar.update(
                self._task,
                completed=before + finished + running,
                description=f"refining {escape(name)}",
                said=f"{done}, iteration {iteration}, mean loss {mean_loss:.1e} m²",
            )

        return progress
