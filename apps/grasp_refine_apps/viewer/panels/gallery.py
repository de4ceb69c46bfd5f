"""Gallery: a page of the list as small pictures, drawn one after the other by a thread of their own."""

from __future__ import annotations

import io
import threading
import time
import traceback
from base64 import b64encode
from collections.abc import Callable, Mapping
from html import escape

import numpy as np
from PIL import Image

from grasp_refine.core.array_types import Int
from grasp_refine.hands.hand import Hand
from grasp_refine_apps.batch.thumbnail import thumbnail
from grasp_refine_apps.report.skeleton import Skeleton
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.listing import Listing, column_of
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.work import Works
from grasp_refine_apps.viewer.panels.table import ROWS_PER_PAGE, footer_html

WIDTH_PX, HEIGHT_PX, COLORS = 180, 156, 64
"""Size of a picture in pixels, twice that on the page's usual screens, and number of its colours."""
MAX_PICTURES = 2000
"""Maximum pictures that are kept, about 5 KB each."""
SHOW_PERIOD_S = 0.8
"""Minimum seconds between two pages with more pictures than before."""

STYLE = """<style>
.gr-gallery{font:11.5px/1.4 system-ui,sans-serif;margin:.3em .8em 1.4em}
.gr-gallery>div:first-of-type{display:grid;grid-template-columns:repeat(3,1fr);gap:5px}
.gr-gallery figure{margin:0;cursor:pointer;border:2px solid rgba(128,128,128,.25);border-radius:5px;overflow:hidden}
.gr-gallery figure.gr-open{border-color:#228be6}
.gr-gallery img,.gr-gallery .gr-wait{display:block;width:100%;aspect-ratio:180/156;background:#f9fafc}
.gr-gallery figcaption{display:flex;justify-content:space-between;padding:0 4px;white-space:nowrap;overflow:hidden}
</style>"""
"""Style sheet for both colour schemes of the page."""


class Thumbnails:
    """Pictures of grasps as they stand, the wanted ones drawn in order."""

    def __init__(self, more: Callable[[], None]) -> None:
        """Start without pictures; `more` is called when there are more, by a thread."""
        self._more, self._change = more, threading.Condition()
        self._wanted: list[tuple[Collection, int, Pose]] = []
        self._pictures: dict[int, tuple[Pose, str]] = {}
        self._rows: np.ndarray | None = None
        self._skeleton: tuple[Hand, Skeleton] | None = None
        self._closed = False
        self._thread: threading.Thread | None = None

    def of(self, collection: Collection, works: Works, numbers: Int[np.ndarray, " M"]) -> Mapping[int, str]:
        """Return the pictures of some grasps as base64 that there are, and let the others be drawn."""
        with self._change:
            if collection.row is not self._rows or len(self._pictures) > MAX_PICTURES:
                self._rows, self._pictures = collection.row, {}
            poses = {n: works[n].pose if n in works else collection.pose(n) for n in numbers.tolist()}
            known = {n: self._pictures[n] for n in poses if n in self._pictures}
            found = {n: png for n, (pose, png) in known.items() if pose.same(poses[n])}
            self._wanted = [(collection, n, pose) for n, pose in poses.items() if pose.posed and n not in found]
            if self._wanted and self._thread is None:
                self._thread = threading.Thread(target=self._run, name="viewer gallery", daemon=True)
                self._thread.start()
            self._change.notify_all()
            return found

    def stop(self) -> None:
        """Draw no more until pictures are asked for again."""
        with self._change:
            self._wanted = []

    def close(self) -> None:
        """Stop the thread after the present picture."""
        with self._change:
            self._closed = True
            self._change.notify_all()

    def _run(self) -> None:
        shown = time.monotonic()
        while True:
            with self._change:
                self._change.wait_for(lambda: self._wanted or self._closed)
                if self._closed:
                    return
                collection, number, pose = self._wanted.pop(0)
                rows = self._rows
            png = self._draw(collection, number, pose)
            with self._change:
                if rows is self._rows:
                    self._pictures[number] = pose, png
                last = not self._wanted
            if last or time.monotonic() - shown > SHOW_PERIOD_S:
                shown = time.monotonic()
                self._more()

    def _draw(self, collection: Collection, number: int, pose: Pose) -> str:
        """Draw a grasp; empty: it cannot be drawn."""
        try:
            if self._skeleton is None or self._skeleton[0] is not collection.hand:
                self._skeleton = collection.hand, Skeleton.of(collection.hand)
            obj = collection.group(number).scene.object
            (png,) = thumbnail(self._skeleton[1], obj, pose.T_object_root[None], pose.q[None])
        except Exception:  # noqa: BLE001 - one grasp that cannot be drawn must not end all others
            traceback.print_exc()
            return ""
        small = Image.open(io.BytesIO(png)).convert("RGB").resize((WIDTH_PX, HEIGHT_PX), Image.Resampling.LANCZOS)
        out = io.BytesIO()
        small.quantize(COLORS, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
        return b64encode(out.getvalue()).decode()


def gallery_html(
    collection: Collection,
    listing: Listing,
    numbers: Int[np.ndarray, " M"],
    page: int,
    number: int,
    pictures: Mapping[int, str],
    on_click: str,
) -> str:
    """Return a page of the gallery; arguments as for `table_html`, and the pictures as base64, by number.

    Below each picture are the grasp's number, the value by which the list is sorted, or else the quality, and its mark.
    """
    column = column_of(collection, listing.key) or column_of(collection, "quality_after")
    figures = []
    for n in numbers[page * ROWS_PER_PAGE : (page + 1) * ROWS_PER_PAGE].tolist():
        group, png = collection.group(n), pictures.get(n, "")
        value = "" if column is None else column.text(n)
        text = value or collection.undrawn(n).split(":")[0]
        mark = {"good": '<b class="gr-good">✓</b>', "bad": '<b class="gr-bad">✗</b>'}.get(collection.mark(n), "")
        image = f'<img alt="" src="data:image/png;base64,{png}">' if png else '<div class="gr-wait"></div>'
        figures.append(
            f'<figure data-do="open {n}"{" class=gr-open" if n == number else ""} title="{escape(collection.name(n))}">'
            f"{image}<figcaption><span>{group.index[collection.member[n]]} {mark}</span>"
            f"<span>{escape(text)}</span></figcaption></figure>"
        )
    named = "" if column is None else f"<div>Below: {escape(column.title)}. G and B mark the open grasp.</div>"
    return (
        f'{STYLE}<div class="gr-table gr-gallery" onclick="{escape(on_click)}"><div>{"".join(figures)}</div>'
        f"{named}{footer_html(collection, numbers, page)}</div>"
    )
