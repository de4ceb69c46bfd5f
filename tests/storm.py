"""A storm on the viewer: random clicks, keys, drags, uploads and reloads on two pages at once.

Run `python tests/storm.py --minutes 60 --seed 0`. First all example grasps are refined. It fails if anything is written
to the log of the server or the console of a page that should not be there, if a refined grasp is lost, or if the
server's memory grows by more than 50 MB after its first quarter.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import trimesh

sys.path[:0] = [
    str(Path(__file__).parent),
    str(Path(__file__).parent.parent),
    str(Path(__file__).parent.parent / "apps"),
]

from playwright.sync_api import Error as PlaywrightError  # noqa: E402

from browser import ViserPage, headless, until  # noqa: E402
from viewer_process import Viewer, start_viewer_process  # noqa: E402

SPARED = ("Reset", "Undo", "Redo", "Upload mesh, hand or grasps", "Default settings", "Clear targets")
"""Buttons that the storm leaves alone: they take results back, as they should, or open a chooser of files."""

KEYS = ("ArrowRight", "ArrowLeft", " ", "g", "b", "f", "Escape", "Control+k", "Tab", "x")
"""Keys that are pressed."""

TABS = ("Refine", "Edit", "Validate", "Browse", "Files", "View")
ADDRESS = "Failed to open WebSocket to"
"""What a page says after the storm has typed into viser's own field of the server's address."""

GROWTH_LIMIT_MB = 50.0
"""Largest growth of the server's memory after the first quarter of the storm."""

UNSAVED = "showSaveFilePicker"
"""What viser's page complains of when a dialogue to save a file is left, by Escape or a reload."""

LOG_WORDS = ("Traceback", "Error", "Exception", "Warning")
"""Words that must not be in the log."""


def memory_mb(viewer: Viewer) -> float:
    """Resident memory of the server in MB."""
    for line in Path(f"/proc/{viewer.process.pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1e3
    raise AssertionError("the server has ended")


class Storm:
    """Random actions on one page."""

    def __init__(self, page: ViserPage, random: np.random.Generator, folder: Path) -> None:
        """Prepare the files to upload."""
        self.page, self._random, self._uploads = page, random, []
        for name, content in (
            ("box.stl", trimesh.creation.box((0.04, 0.05, 0.06)).export(file_type="stl")),
            ("huge.stl", trimesh.creation.box((400.0, 5.0, 6.0)).export(file_type="stl")),
            ("bad.npz", b"PK\x03\x04 no archive"),
            ("bad.zip", b"PK\x05\x06" + bytes(18)),
            ("empty.obj", b""),
            ("evil.urdf", b'<robot name="x"><link name="a"><visual><geometry><mesh filename="/etc/passwd"/></geometry>'
             b"</visual></link></robot>"),
        ):  # fmt: skip
            (folder / name).write_bytes(content)
            self._uploads.append(folder / name)

    def act(self) -> str:
        """Do something; return what it was."""
        kinds = ("key", "click", "tab", "drag", "wheel", "check", "slide", "upload", "reload")
        kind = str(self._random.choice(kinds, p=(0.25, 0.28, 0.12, 0.1, 0.08, 0.07, 0.07, 0.02, 0.01)))
        try:
            getattr(self, f"_{kind}")()
        except PlaywrightError:
            # What was aimed at went away meanwhile.
            return f"{kind}, in vain"
        return kind

    def _key(self) -> None:
        self.page.page.keyboard.press(str(self._random.choice(KEYS)))

    def _click(self) -> None:
        buttons = [button for button in self.page.page.locator("button:visible").all() if self._free(button)]
        if buttons:
            buttons[self._random.integers(len(buttons))].click(timeout=1500)

    def _free(self, button) -> bool:
        return button.is_enabled(timeout=1000) and not any(word in button.inner_text(timeout=1000) for word in SPARED)

    def _tab(self) -> None:
        self.page.page.get_by_role("tab", name=str(self._random.choice(TABS)), exact=True).click(timeout=1500)

    def _drag(self) -> None:
        start, end = self._random.uniform((50, 50), (900, 850), (2, 2)).tolist()
        mouse = self.page.page.mouse
        mouse.move(*start)
        mouse.down()
        mouse.move(*end, steps=3)
        mouse.up()

    def _wheel(self) -> None:
        self.page.page.mouse.move(*self._random.uniform((50, 50), (1350, 850)).tolist())
        self.page.page.mouse.wheel(0, float(self._random.uniform(-400, 400)))

    def _check(self) -> None:
        boxes = self.page.page.locator("input[type=checkbox]:visible").all()
        if boxes:
            boxes[self._random.integers(len(boxes))].click(timeout=1500)

    def _slide(self) -> None:
        tracks = self.page.page.locator(".mantine-Slider-track:visible").all()
        box = tracks[self._random.integers(len(tracks))].bounding_box(timeout=1000) if tracks else None
        if box is not None:
            self.page.page.mouse.click(box["x"] + self._random.uniform() * box["width"], box["y"] + box["height"] / 2)

    def _upload(self) -> None:
        self.page.page.get_by_role("tab", name="Files", exact=True).click(timeout=1500)
        with self.page.page.expect_file_chooser(timeout=3000) as chosen:
            self.page.page.get_by_role("button", name="Upload mesh, hand or grasps").click(timeout=1500)
        chosen.value.set_files(self._uploads[self._random.integers(len(self._uploads))])

    def _reload(self) -> None:
        self.page.reload()


def refined(page: ViserPage) -> int:
    """How many rows of the list are marked as refined or edited here."""
    rows = page.page.locator(".gr-table tbody tr").all_inner_texts()
    return sum(any(word in ("R", "E", "RT", "ET") for word in row.split()) for row in rows)


def back_to_the_example(page: ViserPage) -> None:
    """Open the example again, which uploads may have put aside."""
    page.page.keyboard.press("Escape")
    page.tab("Files")
    if page.row("Show").count():
        page.row("Show").get_by_role("combobox").click()
        options = page.page.get_by_role("option").all_inner_texts()
        wanted = next((option for option in options if "example" in option), None)
        assert wanted is not None, f"the example is not among what is open: {options}"
        page.page.get_by_role("option", name=wanted, exact=True).click()
    page.tab("Browse")


def main() -> None:
    """Let the storm loose, then count what is left."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as name, headless() as browser:
        folder = Path(name)
        viewer = start_viewer_process(folder)
        try:
            pages = [ViserPage(browser) for _ in range(2)]
            for page in pages:
                page.open(viewer.address, 0.1)
            pages[0].tab("Browse")
            pages[0].page.get_by_role("button", name="Refine", exact=True).last.click()
            until(lambda: refined(pages[0]) == 4, "all four refined")
            storms = [Storm(page, random, folder) for page in pages]
            began, done, first = time.monotonic(), Counter(), None
            while (share := (time.monotonic() - began) / (60.0 * options.minutes)) < 1.0:
                done[storms[random.integers(2)].act()] += 1
                assert viewer.process.poll() is None, f"the server ended: {viewer.output()}"
                if first is None and share > 0.25:
                    first = memory_mb(viewer)
            growth = memory_mb(viewer) - (first or 0.0)
            print(f"{sum(done.values())} actions: {dict(done.most_common())}")
            print(f"memory: {first:.0f} MB after a quarter, {growth:+.1f} MB at the end")
            errors = [error for page in pages for error in page.errors if UNSAVED not in error and ADDRESS not in error]
            pages[0].reload()
            back_to_the_example(pages[0])
            until(lambda: refined(pages[0]) == 4, f"four refined grasps in the list: {pages[0].text()[:2000]}")
            bad = [line for line in viewer.output().splitlines() if any(word in line for word in LOG_WORDS)]
            assert not bad, f"in the log: {viewer.output()[-4000:]}"
            assert not errors, f"in the console: {errors[:10]}"
            assert growth < GROWTH_LIMIT_MB, f"memory grew by {growth:.0f} MB"
            print("no error in the log or the console, no result lost")
        finally:
            viewer.process.terminate()
            viewer.process.wait(20.0)


if __name__ == "__main__":
    main()
