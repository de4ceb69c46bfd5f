"""Panel that lists all open grasps: sort, filter, step, open, mark."""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import replace
from functools import partial
from html import escape
from math import isfinite
from typing import Any

import numpy as np
import viser

from grasp_refine.measures.measures import COMPARED, DISPLACEMENT, MEASURES, Measure
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.measuring import unmeasured
from grasp_refine_apps.viewer.model.choice import CHOICES, chosen
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import (
    CHANGE,
    FAILED_TEXT,
    HELD,
    HELD_TEXT,
    OF_REFINEMENT,
    REASON,
    STATUS,
    VERDICT_CHOICES,
    VERDICTS,
)
from grasp_refine_apps.viewer.model.listing import (
    MARK,
    NO_MARK,
    NUMBER,
    Listing,
    first_descending,
    random_other,
    step,
    worst,
)
from grasp_refine_apps.viewer.model.marks import MARKS, Mark
from grasp_refine_apps.viewer.model.pose import Pose
from grasp_refine_apps.viewer.model.present import here_text, present, signature
from grasp_refine_apps.viewer.model.state import Job, State
from grasp_refine_apps.viewer.model.work import Work
from grasp_refine_apps.viewer.panels.export_panel import shelf_titles
from grasp_refine_apps.viewer.panels.form import plain
from grasp_refine_apps.viewer.panels.gallery import Thumbnails, gallery_html
from grasp_refine_apps.viewer.panels.histogram import brushed_range, histogram_html
from grasp_refine_apps.viewer.panels.table import ROWS_PER_PAGE, page_of, pages, table_html
from grasp_refine_apps.viewer.panels.widgets import on_change, on_choice, on_click
from grasp_refine_apps.viewer.server.viser_private import Site, click_script

PREVIOUS, NEXT, RANDOM, WORST = "◀ Previous", "Next ▶", "Random", "Weakest"
NOTHING = "nothing"
"""Label of no comparison."""
MEASURE = "Measure all"
DISTANCES = MEASURES["contact_error_m"].entries["after"], MEASURES["penetration_m"].entries["after"]
"""Keys of the columns that the contacts of a grasp fill."""
GOOD, BAD, NO = "Good", "Bad", "None"
ALL = "all"
"""Label of no filter."""
IN_FILE = "as in the file"
"""Label of no sorting."""

METRICS_STYLE = """<style>
.gr-metrics{font:13px/1.45 system-ui,sans-serif;margin:.2em .8em .6em;overflow-wrap:anywhere}
.gr-metrics table{border-collapse:collapse}
.gr-metrics td{padding:0 14px 0 0}.gr-metrics td:nth-child(n+2){text-align:right}
.gr-metrics td:last-child{font-weight:600}
</style>"""
"""Style sheet of the measures."""


class BrowsePanel:
    """Table of grasps with its commands."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self._lock = threading.RLock()
        self._listing, self._page = Listing(), 0
        self._collection: Collection | None = None
        """Current grasps with their work."""
        self._signature: Hashable = None
        self._work: Work | None = None
        self._number, self._last_click = -1, ""
        self._listed: np.ndarray = np.zeros(0, dtype=int)
        self._random = np.random.default_rng()

        gui = server.gui
        self.metrics = gui.add_html("")
        self.steps = gui.add_button_group(
            "Open",
            (PREVIOUS, NEXT, RANDOM, WORST),
            hint="Open another grasp of the list below; the weakest has the lowest quality or, where that is unknown, "
            "the largest wrench residual, penetration or contact error",
        )
        self.marks = gui.add_button_group(
            "Mark", (GOOD, BAD, NO), hint="Your mark of this grasp; kept in a .marks.csv file beside the grasps"
        )
        self.beside: Any = gui.add_checkbox(
            "Before and after", False, hint="Draw the input grasp beside the one that is shown"
        )
        self.compared: Any = gui.add_dropdown(
            "Compare with",
            (NOTHING,),
            visible=False,
            hint="Draw the grasp of the same number of other open grasps as a ghost, and show its numbers",
        )
        self.gallery: Any = gui.add_checkbox("Pictures", False, hint="A page of the list as small pictures")
        # Clicks on the table, which is HTML, arrive as values of this widget, which is hidden.
        self.clicks = gui.add_text("click", "", visible=False)
        self.table = gui.add_html("")
        self.measure = gui.add_button(MEASURE, hint="Compute quality and penetration of the grasps whose file has none")
        with gui.add_folder("Several at once"):
            self.which: Any = gui.add_dropdown("Grasps", CHOICES, hint="Which grasps the buttons below refine or test")
            self.refine = gui.add_button(
                "Refine", hint="Refine these grasps as they stand, with the settings of Refine"
            )
            self.test = gui.add_button("Test", hint="Simulate them, by the protocol of Validate")
            self.bar: Any = gui.add_progress_bar(0.0, visible=False)
            self.doing = gui.add_markdown("", visible=False)
            self.stop = gui.add_button("Stop", visible=False, hint="Stop after this grasp; finished results are kept")
        with gui.add_folder("Sort and filter", expand_by_default=False):
            self.measure_of: Any = gui.add_dropdown("Histogram", ("-",), hint="Measure whose histogram is drawn below")
            self.histogram = gui.add_html("")
            self.key: Any = gui.add_dropdown("Sort by", (IN_FILE,), hint="Or click a header of the table")
            self.descending: Any = gui.add_checkbox("Largest first", False, hint="Or click the header once more")
            self.filters: dict[str, Any] = {
                "object": gui.add_dropdown("Object", (ALL,), hint="List grasps of this object only"),
                "status": gui.add_dropdown("Status", (ALL,), hint="Status of the refinement"),
                "change": gui.add_dropdown("Change", (ALL,), hint="What the refinement changed"),
                "held": gui.add_dropdown("Simulation", (ALL,), hint="Verdict of MuJoCo here, or in the file"),
                "mark": gui.add_dropdown("Marked", (ALL, *MARKS, NO_MARK), hint="Your mark of the grasps"),
            }
            self.download = gui.add_button("Download marks", hint="All marks as a table of comma-separated values")
        self._edited: Pose | None = None
        """Pose of the shown grasp whose distances are in the table, if it was edited."""
        self.slow_draws = (self._draw_edited,)
        self._thumbnails = Thumbnails(self._show_more)
        self._connect()

    def draw(self, state: State) -> None:
        """Show a state."""
        with self._lock:
            self._draw_job(state.job)
            self._draw_compared(state)
            new = signature(state)
            other = self._collection is None or not self._collection.same_grasps(state.collection)
            changed = new != self._signature
            listed = changed or self._listing != state.listing
            if not listed and self._number == state.number and self.beside.value == state.side_by_side:
                return
            if changed or self._collection is None:
                self._collection, self._signature = self._with_distances(present(state), state), new
            if listed:
                self._listed = state.listing.numbers(self._collection)
                if self._listing != state.listing and not other:
                    self._page = 0
                self._listing = state.listing
                self._draw_choices(self._collection)
            self._work = state.work
            if other or self._number != state.number:
                self._page = page_of(self._listed, state.number)
            # A grasp that is marked may leave the list.
            self._page = min(self._page, pages(self._listed) - 1)
            self._number = state.number
            self.beside.value = state.side_by_side
            self._draw_table()

    def _draw_edited(self, state: State) -> None:
        """Update the distances of a grasp that is being edited."""
        with self._lock:
            if state.number == self._number and state.pose is not self._edited and self._collection is not None:
                before, self._collection = self._collection, self._with_distances(self._collection, state)
                if self._collection is not before:
                    self._draw_table()

    def _with_distances(self, collection: Collection, state: State) -> Collection:
        """Return the collection with the distances of the shown grasp if it was edited, as the heading has them."""
        work, self._edited = state.work, state.pose
        if not work.changed or work.outcome is not None or not work.pose.posed:
            return collection
        found = self._controller.contacts(state)
        for key, value in zip(DISTANCES, (found.contact_error, found.penetration), strict=True):
            if column := collection.columns.get(key):
                values = column.values.copy()
                values[state.number] = value
                collection = collection.with_columns(column.with_values(values))
        return collection

    def close(self) -> None:
        """Draw no more pictures."""
        self._thumbnails.close()

    def _show_more(self) -> None:
        """Show pictures that were drawn meanwhile."""
        with self._lock:
            if self.gallery.value:
                self._draw_table()

    def _connect(self) -> None:
        """Connect the widgets to commands."""
        on_change(self.clicks, self._click)
        on_change(self.key, lambda label: self._sort(self._keys().get(label, NUMBER)))
        on_change(self.descending, lambda descending: self._list(descending=descending))
        on_change(self.measure_of, lambda title: self._choose_histogram())
        on_change(self.gallery, lambda shown: self._show_gallery())
        on_change(self.beside, lambda beside: self._controller.set(side_by_side=beside))
        on_change(self.compared, self._compare)
        for name, widget in self.filters.items():
            on_change(widget, partial(self._filter, name))
        on_choice(self.steps, self.go)
        on_choice(self.marks, self._mark)
        on_click(self.measure, self._controller.background.measure)
        on_click(self.refine, lambda: self._controller.many.refine(self._chosen()))
        on_click(self.test, lambda: self._controller.many.test(self._chosen()))
        on_click(self.stop, self._controller.stop)
        self.download.on_click(self._send_marks)

    def _compare(self, title: str) -> None:
        titles = shelf_titles(self._controller.state)[1:]
        self._controller.grasps.compare(titles.index(title) if title in titles else None)

    def _draw_compared(self, state: State) -> None:
        """Show what the open grasps can be compared with, and are."""
        titles = (NOTHING, *shelf_titles(state)[1:])
        if self.compared.options != titles:
            self.compared.options = titles
        self.compared.visible = len(titles) > 1
        compared = state.compared
        shown = NOTHING
        for title, each in zip(titles[1:], state.shelf, strict=True):
            if compared is not None and each.collection.same_grasps(compared.collection):
                shown = title
        if self.compared.value != shown:
            self.compared.value = shown

    # list

    def _list(self, **changes: Any) -> None:
        """List other grasps, or in another order."""
        self._controller.set(listing=replace(self._controller.state.listing, **changes))

    def _sort(self, key: str) -> None:
        """Sort by a column, the best first; by the same one again: in reverse."""
        collection, listing = self._collection, self._controller.state.listing
        if collection is not None:
            again = key == listing.key
            down = not listing.descending if again else first_descending(collection, key)
            self._list(key=key, descending=down)

    def _filter(self, name: str, value: str) -> None:
        self._list(**{name: "" if value == ALL else value})

    def _keys(self) -> dict[str, str]:
        """Label of each column in the list of sortings -> its key."""
        columns = {} if self._collection is None else self._collection.columns
        return {IN_FILE: NUMBER, **{column.title: key for key, column in columns.items()}, "Mark": MARK}

    def brush(self, text: str) -> None:
        """List a range of a measure: "KEY LEFT RIGHT", places in its histogram; clients can send arbitrary text."""
        key, *places = text.split(" ")
        with self._lock:
            collection, listing = self._collection, self._controller.state.listing
        column = None if collection is None else collection.columns.get(key)
        try:
            left, right = map(float, places[:2])
        except ValueError:
            return
        if column is not None and not column.is_text and isfinite(left + right):
            self._controller.set(listing=listing.with_range(key, brushed_range(column, left, right)))

    def _draw_histogram(self, collection: Collection) -> None:
        """Update the histogram, and the choice of its measure."""
        titles = {column.title: column for column in collection.columns.values() if not column.is_text}
        if self.measure_of.options != tuple(titles or ("-",)):
            self.measure_of.options = tuple(titles or ("-",))
        column = titles.get(self.measure_of.value)
        self.measure_of.visible = self.histogram.visible = column is not None
        if column is not None:
            self.histogram.content = histogram_html(column, self._listed, self._listing.range_of(column.key))

    def _choose_histogram(self) -> None:
        with self._lock:
            if self._collection is not None:
                self._draw_histogram(self._collection)

    # commands

    def _click(self, click: str) -> None:
        """Handle a click on the table; clients can send arbitrary text."""
        what, _, rest = click.partition(" ")
        value = rest.split(" ")[0]
        with self._lock:
            # Two clicks at once may both arrive as the second.
            if click == self._last_click:
                return
            self._last_click = click
            if what == "page" and value.isascii() and value.isdigit():
                self._page = min(int(value[:9]), pages(self._listed) - 1)
                self._draw_table()
        if what == "sort" and value in self._keys().values():
            self._sort(value)
        if what == "open" and value.isascii() and value.isdigit():
            self._controller.grasps.show(int(value[:9]))

    def go(self, where: str) -> None:
        """Open another grasp of the list."""
        with self._lock:
            collection, listed = self._collection, self._listed
        # Keys may come faster than states are drawn.
        number = self._controller.state.number
        if collection is None or not len(listed):
            return
        if where == WORST:
            found = worst(collection, listed)
        elif where == RANDOM:
            found = random_other(listed, number, self._random)
        else:
            found = step(listed, number, 1 if where == NEXT else -1)
        if found is None:
            self._controller.notify(f"the weakest grasp is not known yet: press {MEASURE} first", bad=True)
        else:
            self._controller.grasps.show(found)

    def _mark(self, what: str) -> None:
        """Mark the grasp that is shown."""
        marks: dict[str, Mark] = {GOOD: "good", BAD: "bad"}
        self._controller.grasps.mark(self._controller.state.number, marks.get(what, ""))

    def _send_marks(self, event: viser.GuiEvent) -> None:
        """Send the marks to the browser that requests them."""
        collection = self._collection
        if event.client is None or collection is None:
            return
        for marks in collection.marks:
            name = "grasps.marks.csv" if marks.path is None else marks.path.name
            if marks.by_row:
                event.client.send_file_download(name, marks.text.encode())
        if not any(marks.by_row for marks in collection.marks):
            self._controller.notify("no grasp is marked yet", bad=True)

    def _chosen(self) -> tuple[int, ...]:
        """Numbers of the chosen grasps."""
        found = chosen(self._controller.state, self.which.value)
        if not found:
            self._controller.notify(f"no grasp is {self.which.value}: choose others", bad=True)
        return found

    # widgets

    def _draw_job(self, job: Job | None) -> None:
        """Show the progress of a command on several grasps."""
        ours = job is not None and job.kind == "batch"
        self.refine.disabled = self.test.disabled = job is not None and job.kind != "measure"
        self.bar.visible = self.doing.visible = self.stop.visible = ours
        if ours and job is not None:
            self.bar.value = round(100.0 * (job.share or 0.0))
            self.doing.content = job.what

    def _draw_table(self) -> None:
        """Update the table and the line above it."""
        collection, number = self._collection, self._number
        if collection is not None:
            script, place = click_script(self.clicks), (self._listing, self._listed, self._page, number)
            if self.gallery.value:
                here = self._listed[self._page * ROWS_PER_PAGE :][:ROWS_PER_PAGE]
                pictures = self._thumbnails.of(collection, self._controller.state.works, here)
                self.table.content = gallery_html(collection, *place, pictures, script)
            else:
                self.table.content = table_html(collection, *place, script)
            self.metrics.content = metrics_html(collection, number, self._work)

    def _show_gallery(self) -> None:
        """Show pictures, or the table."""
        with self._lock:
            if not self.gallery.value:
                self._thumbnails.stop()
            self._draw_table()

    def _draw_choices(self, collection: Collection) -> None:
        """Update the choices of the filters."""
        keys = self._keys()
        if self.key.options != tuple(keys):
            self.key.options = tuple(keys)
        chosen = next((label for label, key in keys.items() if key == self._listing.key), IN_FILE)
        choices = {"object": (ALL, *dict.fromkeys(collection.objects.tolist()))}
        for key in (STATUS.key, CHANGE.key):
            column = collection.columns.get(key)
            choices[key] = (ALL,) if column is None else (ALL, *np.unique(column.values[column.known]).tolist())
        here = (HELD_TEXT, FAILED_TEXT) if HELD.key in collection.columns else ()
        in_file = [choice for choice, (key, _) in VERDICT_CHOICES.items() if key in collection.columns]
        choices["held"] = (ALL, *here, *in_file)
        for name, options in choices.items():
            if self.filters[name].options != options:
                self.filters[name].options = options
        shown = {name: len(options) > 2 for name, options in choices.items()}
        shown |= {"mark": True}
        for name, widget in self.filters.items():
            widget.visible, widget.value = shown[name], getattr(self._listing, name) or ALL
        self._draw_histogram(collection)
        self.key.value = chosen
        self.descending.value = self._listing.descending
        self.measure.visible = bool(unmeasured(self._controller.state.collection).any())


def metrics_html(collection: Collection, number: int, work: Work | None = None) -> str:
    """Return name, status, change, verdict and measures of a grasp as HTML; of a refined one, before and after."""
    done = "" if work is None else here_text(work)
    heading = [f"<b>{escape(collection.label(number))}</b> {escape(done or 'as in its file')}"]
    held, reason = (collection.columns.get(column.key) for column in (HELD, REASON))
    texts = [column.text(number) for one in OF_REFINEMENT if (column := collection.columns.get(one.key)) is not None]
    heading += [escape(text) for text in texts if text]
    moved = collection.columns.get(DISPLACEMENT.name)
    if moved is not None and moved.known[number]:
        heading.append(f"{DISPLACEMENT.title} {moved.text(number)} {moved.unit}")
    if held is not None and held.known[number]:
        why = f" ({reason.text(number)})" if reason is not None and reason.known[number] else ""
        failed = held.values[number] == FAILED_TEXT
        heading.append(escape(f"{'failed' if failed else 'held'} in simulation{why}"))
    verdicts = [column for one in VERDICTS if (column := collection.columns.get(one.key)) is not None]
    heading += [escape(f"{one.text(number)} in {one.label}") for one in verdicts if one.known[number]]
    if collection.mark(number):
        heading.append(f"marked {escape(collection.mark(number))}")
    rows = [row for measure in COMPARED if (row := _row(collection, measure, number))]
    if not rows:
        text = _without_measures(collection, number, edited=work is not None and work.changed)
    else:
        refined = any(len(row) > 2 for row in rows)
        head = ("", "before", "after") if refined else ()
        text = "<table>" + "".join(_line(row) for row in ([head] if head else []) + rows) + "</table>"
    return f'{METRICS_STYLE}<div class="gr-metrics">{" · ".join(heading)}<br>{text}</div>'


def _without_measures(collection: Collection, number: int, *, edited: bool) -> str:
    """Text on a grasp without measures."""
    if why := collection.undrawn(number):
        return plain(why)
    if collection.group_of[number] in collection.rough:
        return "its object is not cut yet"
    if edited:
        return "not measured"
    return "not measured yet" if unmeasured(collection)[number] else "could not be measured"


def _row(collection: Collection, measure: Measure, number: int) -> tuple[str, ...]:
    """Name and value of a measure, or name, value before and value after; empty where it is not known."""
    before, after = (collection.columns.get(entry) for entry in measure.entries.values())
    if after is None or not after.known[number]:
        return ()
    if before is None or not before.known[number]:
        return after.title, after.text(number)
    return after.title, before.text(number), after.text(number)


def _line(row: tuple[str, ...]) -> str:
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
