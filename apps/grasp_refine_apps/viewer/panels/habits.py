"""Habits of the page that are not widgets: keys, links, the title of the tab, dark mode, and the camera of one page.

The other half is page_head.html, which runs in the page.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from html import escape
from typing import Any
from urllib.parse import unquote

import viser

from grasp_refine_apps.viewer.drawing.camera import VIEWS
from grasp_refine_apps.viewer.drawing.view import ASPECT_RATIO, View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.server.page import TITLE, set_theme
from grasp_refine_apps.viewer.server.viser_private import Site, widget_id

KEYS: Mapping[str, tuple[str, str, str]] = {
    "next": ("→", "ArrowRight", "Next grasp of the list in Browse"),
    "previous": ("←", "ArrowLeft", "Previous grasp of the list"),
    "play": ("Space", " ", "Play or pause the refinement or the replay"),
    "good": ("G", "g", "Mark the grasp good, or take the mark back"),
    "bad": ("B", "b", "Mark the grasp bad, or take the mark back"),
    "fit": ("F", "f", "Look at hand and object from where palm and contacts are seen"),
    **{
        view: (str(k), str(k), f"Look at the {view}" if VIEWS[view] is None else f"Look from the {view}")
        for k, view in enumerate(VIEWS, 1)
    },
    "undo": ("Ctrl Z", "Ctrl+z", "Undo"),
    "redo": ("Ctrl Y", "Ctrl+y", "Redo"),
}
"""Command -> its key for people, the key in the page, and its description."""

ASPECT_TOLERANCE = 0.04
"""Difference of a scene's aspect ratio, as a share, from which on its first camera is fitted to it."""

ALIASES = {"Ctrl+Shift+z": "redo"}
"""Further keys in the page -> their command."""


class Habits:
    """Exchange of habits with pages: received, and sent on request."""

    def __init__(
        self,
        server: Site,
        controller: Controller,
        view: View,
        change_tab: Callable[[str], None],
        drawn: Callable[[], None],
    ) -> None:
        """Make the hidden widgets, in the container that is open.

        Args:
            server: The page.
            controller: Receiver of the commands on grasps.
            view: The scene, with the cameras of the pages.
            change_tab: Called with the lower-case title of a tab that was opened.
            drawn: Called when the page shows hand and object.
        """
        self._controller, self._view, self._change_tab = controller, view, change_tab
        self.placeholders: Callable[[], Mapping[str, str]] = dict
        """Texts in empty fields, by the ids of their widgets; set by the panels."""
        self.brush: Callable[[str], None] = lambda text: None
        """Called with the measure and the places of a brush over its histogram; set by the panels."""
        self._fitted: set[int] = set()
        self.commands: dict[str, Callable[[], object]] = {
            "good": lambda: self._mark("good"),
            "bad": lambda: self._mark("bad"),
            "undo": controller.editor.undo,
            "redo": controller.editor.redo,
            "drawn": drawn,
        }
        """Commands by their names, must return at once; the panels add next, previous and play."""
        self._last = ""
        self.channel = server.gui.add_text("page", "", visible=False)
        self.page = server.gui.add_html("")

        # Asynchronous, so that commands come in the order of the keys, see `panels.widgets`.
        async def received(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None and event.target.value != self._last:
                self._last = event.target.value
                self.receive(event.target.value, event.client)

        self.channel.on_update(received)
        for name, (key, _, text) in KEYS.items():
            if name != "fit" and name not in VIEWS:
                command = server.gui.add_command(text, description=f"Key {key}")
                command.on_trigger(partial(self._run, name))

    def receive(self, message: str, client: Any) -> None:
        """Do what a page sent; clients can send arbitrary text."""
        what, _, rest = message.partition(" ")
        value = rest.split(" ")[0]
        if what in self.commands:
            self.commands[what]()
        elif what == "open":
            number = self._controller.state.collection.find(unquote(value))
            if number is not None:
                self._controller.grasps.show(number)
        elif what == "scheme":
            set_theme(client.gui, dark=value == "dark")
        elif what == "simple":
            self._view.simple = True
        elif what == "brush":
            self.brush(rest)
        elif what == "tab":
            self._change_tab(value)
        elif what == "moved":
            self._view.moved(client)
        elif what in ("fit", "ready", *VIEWS):
            self._fit_to(client, value, what)

    def draw(self, state: State) -> None:
        """Show a state."""
        page = {
            "channel": widget_id(self.channel),
            "keys": {key: name for name, (_, key, _) in KEYS.items()} | ALIASES,
            "grasp": state.collection.name(state.number),
            "number": state.number,
            "title": title(state.collection),
            "placeholders": dict(self.placeholders()),
        }
        content = f'<div id="gr-page" hidden data-page="{escape(json.dumps(page))}"></div>'
        if self.page.content != content:
            self.page.content = content

    def _run(self, name: str, event: object) -> None:
        """Run a command of the palette."""
        if name in self.commands:
            self.commands[name]()

    def _mark(self, mark: Any) -> None:
        """Mark the shown grasp; once more: take the mark back."""
        state = self._controller.state
        self._controller.grasps.mark(state.number, "" if state.collection.mark(state.number) == mark else mark)

    def _fit_to(self, client: Any, value: str, what: str) -> None:
        """Fit the camera of a page whose scene has this aspect ratio; the first time only if it is unusual."""
        try:
            aspect = float(value)
        except ValueError:
            return
        always = what != "ready" or client.client_id in self._fitted
        if 0.1 < aspect < 10.0 and (always or abs(aspect / ASPECT_RATIO - 1) > ASPECT_TOLERANCE):
            self._fitted.add(client.client_id)
            if what == "ready":
                self._view.ready(client, aspect)
            else:
                self._view.look(client, what, aspect)


def title(collection: Collection) -> str:
    """Title of the browser's tab: the name of the file first."""
    problem = collection.problem
    named = problem.files and not problem.sampled
    return f"{problem.files[0].name if named else collection.title} – {TITLE}"


def keys_html() -> str:
    """List of the keys as HTML."""
    rows = "".join(
        f"<tr><td><kbd>{escape(key)}</kbd></td><td>{escape(text)}</td></tr>" for key, _, text in KEYS.values()
    )
    style = "padding:0.2em 1em 0.8em;font-size:0.85em;line-height:1.6"
    return f'<div style="{style}"><b>Keys</b> (or all commands: Ctrl K)<table>{rows}</table></div>'
