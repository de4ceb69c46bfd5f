"""One page: scene, heading with measures of the shown grasp, and tabs, of a controller of its own."""

from __future__ import annotations

import html
from threading import Event, Lock
from typing import Any

import viser

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.hands.hand import Hand
from grasp_refine_apps.viewer.drawing.colors import distance_legend
from grasp_refine_apps.viewer.drawing.glyphs import newtons_per_centimetre
from grasp_refine_apps.viewer.drawing.view import View
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.meters.comparison import compared_text
from grasp_refine_apps.viewer.meters.meter import title_of
from grasp_refine_apps.viewer.meters.obstacles import overlaps_text
from grasp_refine_apps.viewer.meters.region_meter import elsewhere_text
from grasp_refine_apps.viewer.model.contacts import distances_text
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.panels.banner import Banner
from grasp_refine_apps.viewer.panels.browse_panel import NEXT, PREVIOUS, BrowsePanel
from grasp_refine_apps.viewer.panels.display_panel import DisplayPanel
from grasp_refine_apps.viewer.panels.edit_panel import EditPanel
from grasp_refine_apps.viewer.panels.export_panel import ExportPanel
from grasp_refine_apps.viewer.panels.habits import Habits
from grasp_refine_apps.viewer.panels.refine_panel import RefinePanel
from grasp_refine_apps.viewer.panels.validate_panel import ValidatePanel
from grasp_refine_apps.viewer.server.page import SLOW_PERIOD_S, Drawer
from grasp_refine_apps.viewer.server.viser_private import Site, icons_opened, pages_of

PANELS = (
    ("Refine", RefinePanel),
    ("Edit", EditPanel),
    ("Validate", ValidatePanel),
    ("Browse", BrowsePanel),
    ("Files", ExportPanel),
    ("View", DisplayPanel),
)
"""Titles and panels of the tabs."""


PICTURE_S = 5.0
"""Longest wait in seconds until a page shows hand and object."""

GRASP_TABS = ("refine", "edit", "browse")
"""Tabs that end a replay: they show and change the grasp. Files and View also serve the replay."""


class Session:
    """Scene, heading and tabs of one page, or of all pages of a server, which show the state of a controller."""

    def __init__(self, site: Site, controller: Controller) -> None:
        """Put hand and object on the page; `complete` adds all else."""
        self.site, self.controller = site, controller
        self.panels: list[Any] = []
        self._drawers: tuple[Drawer, ...] = ()
        self._pictured, self._changing, self._closed = Event(), Lock(), False
        self.view = View(site, controller)
        self.view.draw(controller.state, bodies=True)
        self.habits = Habits(site, controller, self.view, self._change_tab, self._pictured.set)
        self.habits.draw(controller.state)

    def complete(self) -> None:
        """Add panels and the rest of the scene once the page shows hand and object, which it would draw last."""
        if isinstance(self.site, viser.ClientHandle):
            self._pictured.wait(PICTURE_S)
        with self._changing:
            if not self._closed:
                self._add_panels(self.site, self.controller)

    def _add_panels(self, site: Site, controller: Controller) -> None:
        # No browser should show buttons that cannot be used yet.
        with site.atomic(), icons_opened():
            self._heading = site.gui.add_html("")
            self.banner = Banner(site.gui)
            tabs = site.gui.add_tab_group()
            # The first tab is open at first: a replay is played on its own.
            replayed = controller.state.motion is not None
            for title, kind in sorted(PANELS, key=lambda panel: replayed and panel[0] != "Validate"):
                with tabs.add_tab(title):
                    self.panels.append(kind(site, controller))
            draws = (
                self._draw_heading,
                self.habits.draw,
                self.banner.draw,
                self._notify,
                *(panel.draw for panel in self.panels),
            )
            # Functions that draw what need not follow each iteration of a refinement.
            slow_draws = [draw for panel in self.panels for draw in getattr(panel, "slow_draws", ())]
            for draw in (*draws, *slow_draws):
                draw(controller.state)
        self._drawers = (
            Drawer([self.view.draw, *draws], controller.state),
            Drawer(slow_draws, controller.state, SLOW_PERIOD_S),
        )
        for drawer in self._drawers:
            controller.listen(drawer.draw)
        self.view.redraw = lambda: self._drawers[0].draw(controller.state)
        panels = {type(panel): panel for panel in self.panels}
        panels[ExportPanel].settle = self._drawers[0].settle
        panels[DisplayPanel].look, panels[DisplayPanel].cut = self.view.look, self.view.cut
        browse, refine, validate = panels[BrowsePanel], panels[RefinePanel], panels[ValidatePanel]
        self.habits.brush, self.habits.placeholders = browse.brush, refine.form.placeholders
        self.habits.commands |= {
            "next": lambda: browse.go(NEXT),
            "previous": lambda: browse.go(PREVIOUS),
            "play": lambda: self._play(refine, validate),
        }
        # What changed since the first drawing.
        for drawer in self._drawers:
            drawer.draw(controller.state)

    def close(self) -> None:
        """Draw no more; the controller lives on."""
        with self._changing:
            self._closed = True
        for drawer in self._drawers:
            self.controller.unlisten(drawer.draw)
        self.view.close()
        for panel in self.panels:
            if hasattr(panel, "close"):
                panel.close()
        for drawer in self._drawers:
            drawer.close()

    def _play(self, refine: RefinePanel, validate: ValidatePanel) -> None:
        """Play or pause the replay, or else the refinement."""
        (refine.timeline.bar if self.controller.state.motion is None else validate.replay).toggle()

    def _change_tab(self, tab: str) -> None:
        """End a replay when another tab is opened that is about the grasp itself."""
        job = self.controller.state.job
        if tab in GRASP_TABS:
            if job is not None and job.kind == "pull":
                self.controller.stop()
            if self.controller.state.motion is not None:
                self.controller.player.show(None)

    def _draw_heading(self, state: State) -> None:
        text = _heading(state, self.controller)
        if self._heading.content != text:
            self._heading.content = text

    def _notify(self, state: State) -> None:
        """Show a new notice; one from before the first page is shown to that page."""
        notice, pages = state.notice, pages_of(self.site).values()
        if notice is not None and notice.number != self.controller.noticed and pages:
            self.controller.noticed = notice.number
            for page in pages:
                page.add_notification(
                    "This did not work" if notice.bad else "grasp-refine",
                    notice.text,
                    color="red" if notice.bad else "blue",
                    auto_close_seconds=None if notice.bad else 8.0,
                )


def _heading(state: State, controller: Controller) -> str:
    """Name and measures of the shown grasp as HTML."""
    collection = state.collection
    name = f"{collection.hand.name} on {collection.label(state.number)}"
    lines = [f"<b>{html.escape(name)}</b>{badge(collection.hand)}"]
    if state.motion is not None:
        lines.append(html.escape(state.motion.text(state.motion_frame)))
    elif state.shown.posed:
        found = controller.contacts(state)
        lines.append(distances_text(found.contact_error, found.penetration, title_of(state)))
        if compared := compared_text(state, controller.contacts):
            lines.append(f'<span style="color:var(--gr-good)">{html.escape(compared)}</span>')
        if overlaps := overlaps_text(controller.overlaps(state)):
            lines.append(f'<span style="color:var(--gr-bad)">{html.escape(overlaps)}</span>')
        if elsewhere := elsewhere_text(controller.elsewhere(state)):
            lines.append(f'<span style="color:var(--gr-bad)">{html.escape(elsewhere)}</span>')
        if state.display.forces:
            total = state.pressure_n
            scale = newtons_per_centimetre(found.prepared.object.body, total)
            lines.append(f"forces: an arrow of 1 cm is {scale:.2g} N, all press with {total:g} N")
    else:
        why = state.collection.undrawn(state.number).split(":")[0] or "its pose is not finite"
        lines.append(f'<span style="color:var(--gr-bad)">not drawn: {html.escape(why)}</span>')
    style = "padding:0.3em 1em;line-height:1.5;font-size:0.9em;overflow-wrap:anywhere"
    return f'<div style="{style}">{"<br>".join(lines)}{SCALE}</div>'


def badge(hand: Hand) -> str:
    """Return HTML on a hand with simplified shapes, and the option for the maker's; empty for other hands."""
    if not hand.urdf.is_relative_to(resource_dir("robots")):
        return ""
    name = hand.urdf.stem
    style = "margin-left:.6em;padding:0 .5em;border:1px solid currentColor;border-radius:.8em;font-size:.8em"
    advice = (
        f"Rounded boxes and cylinders of the published dimensions, which are also what collides. For the maker's "
        f"shapes start it with --hand hands/{name}, which 'refine-grasp assets fetch {name}' fetches, or with --urdf."
    )
    return (
        f'<span style="{style}" title="{html.escape(advice)}" aria-label="{html.escape(advice)}">simplified hand</span>'
    )


def _scale() -> str:
    """Colours of distances in one line of HTML."""
    swatch = "display:inline-block;width:0.8em;height:0.8em;border-radius:50%;vertical-align:-0.05em"
    parts = [
        f'<span><span style="{swatch};background:rgb{color}"></span> {text}</span>' for text, color in distance_legend()
    ]
    return (
        '<div style="display:flex;justify-content:space-between;font-size:0.78em;opacity:0.85;margin-top:0.2em">'
        f"{''.join(parts)}</div>"
    )


SCALE = _scale()
"""Legend of the colours of points and lines between links and object."""
