"""Make the documentation's pictures of the viewer: a refined grasp, and a push that the hand does not withstand.

Run `python -m grasp_refine_apps.viewer.pictures` after changes of the viewer's appearance. It writes
`overview.png` and `replay.png` beside this file. It needs playwright, which the extra 'test' installs, and chromium.
"""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING

from PIL import Image

if TYPE_CHECKING:
    from playwright.sync_api import Page

FOLDER = Path(__file__).parent
WIDTH, HEIGHT = 1400, 900
"""Pixels of the window."""
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Options with which Chromium draws without a graphics card."""
EXAMPLE = "1"
"""The first example grasp that holds before it is refined."""
FRICTION = "0.15"
"""Coefficient of friction with which this grasp loses the object in two directions."""
SLIPPING = "1.0"
"""Time of the replay in seconds at which the object is turning in the hand."""


def save(page: Page, name: str) -> None:
    """Save a picture of the page."""
    page.wait_for_timeout(3000)
    image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    palette = image.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2)
    image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(FOLDER / name, optimize=True)
    print(f"wrote {FOLDER / name}")


def make_pictures(page: Page) -> None:
    """Use the viewer as a person would, and save both pictures."""
    # A notification on slow graphics, which is not part of our page.
    close = page.locator(".mantine-Notification-closeButton")
    if close.count():
        close.first.click()
    page.get_by_role("button", name="Start").click()
    page.get_by_text("Converged", exact=True).wait_for()
    save(page, "overview.png")
    page.get_by_role("button", name="Reset").first.click()
    page.get_by_role("tab", name="Validate").click()
    page.locator("xpath=//label[normalize-space(.)='Friction']/following::input[1]").fill(FRICTION)
    page.wait_for_timeout(500)
    page.get_by_role("button", name="Test in MuJoCo").click()
    page.get_by_text("Does not hold", exact=False).wait_for()
    page.get_by_text("+z", exact=True).last.click()
    page.get_by_text("it is lost", exact=False).first.wait_for(timeout=60_000)
    page.wait_for_timeout(4000)
    # At the end of the replay the object is out of sight.
    seconds = page.locator("xpath=//label[normalize-space(.)='Seconds']/following::input[@type='text'][1]").last
    seconds.fill(SLIPPING)
    seconds.blur()
    page.mouse.move(10, 10)  # away from the button, whose hint would be shown
    save(page, "replay.png")


def main() -> None:
    """Write both pictures."""
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "grasp_refine_apps.cli", "view", "--index", EXAMPLE, "--port", "0", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as viewer, sync_playwright() as playwright:
        try:
            assert viewer.stdout is not None
            address = viewer.stdout.readline().split()[0]
            browser = playwright.chromium.launch(executable_path=which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            # Also without a graphics card everything is drawn.
            page.goto(f"{address}&drawing=full")
            page.wait_for_timeout(8000)
            make_pictures(page)
            browser.close()
        finally:
            viewer.terminate()


if __name__ == "__main__":
    main()
