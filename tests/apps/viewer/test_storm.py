"""A storm over the viewer: pages come, work at random and go, at the same time; nothing fails, is lost, or grows.

`storm` with more seconds is the long one: run this file as a program, with the seconds as its argument.
"""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.problem.problem import Problem
from grasp_refine_apps.commands.settings import Settings
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.panels.app import Viewer
from grasp_refine_apps.viewer.panels.browse_panel import BrowsePanel
from grasp_refine_apps.viewer.panels.session import Session
from grasp_refine_apps.viewer.server.page import open_server
from open_viewer import controller, example, settled
from websocket_page import Page, until

SECONDS, PAGES, ACTIONS = 60.0, 3, 12
"""Duration, pages at a time, and what a page does until it goes."""

PAUSE_S = 0.15
"""Longest pause of a page between two of its actions, seconds."""

GROWTH_MB = 300.0
"""Largest growth of the memory between the first third and the end: three pages at work come and go with 100 MB."""

LISTINGS = (Listing(), Listing(key="contact_error_m_before", descending=True), Listing(mark="good"))


def memory_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


class Visitor:
    """One page after the other; each acts at random."""

    def __init__(self, viewer: Viewer, number: int) -> None:
        self.viewer, self.number, self.random = viewer, number, np.random.default_rng(number)
        self.marked = ""
        """Last mark of the grasp that this visitor alone marks."""
        self.counts: dict[str, int] = {}
        self.notices: set[str] = set()

    def visit(self) -> None:
        """Open a page, act, and leave."""
        viewer = self.viewer
        with JOINING:
            known = set(viewer.sessions)
            page = Page(viewer.server, viewer.page.access.token)
            (key,) = until(lambda: set(viewer.sessions) - known)
            session = viewer.sessions[key]
        page.change(session.habits.channel, "drawn 1")
        until(lambda: len(session.panels) == 6)
        for _ in range(ACTIONS):
            act = self.random.choice(
                [self.show, self.edit, self.refine, self.pull, self.filter, self.gallery, self.mark]
            )
            act(session, page)
            self.counts[act.__name__] = self.counts.get(act.__name__, 0) + 1
            time.sleep(self.random.uniform(0.0, PAUSE_S))
            notice = session.controller.state.notice
            if notice is not None:
                self.notices.add(notice.text)
        if self.random.random() < 0.5:
            session.controller.stop()
        page.close()

    def show(self, session: Session, page: Page) -> None:
        page.change(session.habits.channel, f"{self.random.choice(['next', 'previous'])} {self.random.random()}")

    def edit(self, session: Session, page: Page) -> None:
        made, joint = session.controller, int(self.random.integers(16))
        made.editor.set_joint(joint, float(made.state.pose.q[joint] + self.random.normal(0.0, 0.05)))
        if self.random.random() < 0.3:
            made.editor.undo()

    def refine(self, session: Session, page: Page) -> None:
        session.controller.refinement.start()

    def pull(self, session: Session, page: Page) -> None:
        session.controller.simulation.pull()
        session.controller.simulation.pull_steadily(float(self.random.uniform(0.0, 10.0)), "+x")

    def filter(self, session: Session, page: Page) -> None:
        session.controller.set(listing=LISTINGS[self.random.integers(len(LISTINGS))])

    def gallery(self, session: Session, page: Page) -> None:
        browse = next(panel for panel in session.panels if isinstance(panel, BrowsePanel))
        page.change(browse.gallery, bool(self.random.random() < 0.7))

    def mark(self, session: Session, page: Page) -> None:
        self.marked = str(self.random.choice(["good", "bad"]))
        session.controller.grasps.mark(self.number, self.marked)


JOINING = threading.Lock()
"""Held while a page joins, so that it knows which session is its own."""


def storm(viewer: Viewer, seconds: float, every: float, report: Callable[[str], None]) -> list[float]:
    """Let visitors come and go for so many seconds; return the memory in MB, read after every `every` seconds.

    Raises:
        AssertionError: a visitor failed, a mark was lost, or the last pages or their threads stayed.
    """
    visitors, failures, end = [Visitor(viewer, k) for k in range(PAGES)], [], time.monotonic() + seconds

    def come_and_go(visitor: Visitor) -> None:
        try:
            while time.monotonic() < end and not failures:
                visitor.visit()
        except BaseException as error:
            failures.append(error)
            raise

    threads = [threading.Thread(target=come_and_go, args=(visitor,)) for visitor in visitors]
    for thread in threads:
        thread.start()
    memory = []
    while time.monotonic() < end and not failures:
        time.sleep(every)
        memory.append(memory_mb())
        counts = {name: sum(v.counts.get(name, 0) for v in visitors) for name in visitors[0].counts}
        notices = set().union(*(visitor.notices for visitor in visitors))
        report(f"{memory[-1]:.0f} MB, {threading.active_count()} threads, {counts}, {notices}")
    for thread in threads:
        thread.join()
    assert not failures, failures
    until(lambda: not viewer.sessions)
    assert len(viewer.controllers) <= PAGES + 1
    until(lambda: not [thread for thread in threading.enumerate() if thread.name == "viewer drawing"])
    gc.collect()
    assert sum(isinstance(each, Session) for each in gc.get_objects()) <= PAGES, "sessions of pages that are gone"
    for made in viewer.controllers:
        made.stop()
        settled(made)
        for visitor in visitors:
            assert made.state.collection.mark(visitor.number) == visitor.marked
    check_alive(viewer)
    return memory


def check_alive(viewer: Viewer) -> None:
    """Refine a grasp from its file once more, on a new page."""
    page = Page(viewer.server, viewer.page.access.token)
    (session,) = until(lambda: list(viewer.sessions.values()))
    made: Controller = session.controller
    made.grasps.show(0)
    made.editor.reset()
    made.refinement.start()
    settled(made)
    assert made.state.outcome is not None
    page.close()


# viser warns of what is drawn while a page goes.
@pytest.mark.filterwarnings("ignore:Queued a")
@pytest.mark.slow
def test_a_storm_of_pages_leaves_no_error_and_no_growth(
    problem: Problem, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mug.npz"
    path.write_bytes(problem.files[0].read_bytes())
    with Viewer(open_server("127.0.0.1", 0), controller(example(grasps=path), Settings(iterations=20))) as viewer:
        memory = storm(viewer, SECONDS, SECONDS / 12, lambda line: None)
    assert memory[-1] < min(memory[3:6]) + GROWTH_MB, memory
    assert "Traceback" not in capfd.readouterr().err


if __name__ == "__main__":
    from tempfile import TemporaryDirectory

    from grasp_refine_apps.commands.view import use_few_arenas

    use_few_arenas()
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "mug.npz"
        copy.write_bytes(example().files[0].read_bytes())
        opened = controller(example(grasps=copy), replace(Settings(), iterations=20))
        with Viewer(open_server("127.0.0.1", 0), opened) as served:
            storm(served, float(sys.argv[1]), 60.0, lambda line: print(time.strftime("%H:%M"), line, flush=True))
    print("ended well")
