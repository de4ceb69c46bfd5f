"""Controller: turns commands into states, without viser.

Commands return at once, can come from any thread and never raise for user errors: they set a notice. Long jobs run in
one worker thread; listeners are called with every new state.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

from grasp_refine.core.plurals import count_text
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.jobs.background import Background
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.grasps import OpenGrasps
from grasp_refine_apps.viewer.jobs.many import ManyGrasps
from grasp_refine_apps.viewer.jobs.player import Player
from grasp_refine_apps.viewer.jobs.refinement import Refinement
from grasp_refine_apps.viewer.jobs.regions import RegionEditor
from grasp_refine_apps.viewer.jobs.simulation import Simulation
from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.jobs.targets import TargetEditor
from grasp_refine_apps.viewer.jobs.validating import world_cache
from grasp_refine_apps.viewer.meters.comparison import check_comparable
from grasp_refine_apps.viewer.meters.meter import ContactMeter
from grasp_refine_apps.viewer.meters.obstacles import ObstacleMeter, Overlap
from grasp_refine_apps.viewer.meters.region_meter import Elsewhere, RegionMeter
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.listing import Listing
from grasp_refine_apps.viewer.model.sharing import for_another_page
from grasp_refine_apps.viewer.model.state import Shelved, State


class Controller(Store):
    """Store of the state of the open grasps, with its commands in parts."""

    def __init__(
        self, collection: Collection, settings: Any, compared: Collection | None = None, *, beside: Store | None = None
    ) -> None:
        """Show the first of the open grasps that can be drawn.

        Args:
            collection: The grasps.
            settings: Options of refinement (`State.settings`).
            compared: Grasps that they are compared with; they are on the shelf, too.
            beside: Store with which the work on grasps is shared.

        Raises:
            GraspRefineError: the compared grasps are of another hand.
        """
        state = State.first(collection, collection.first, settings)
        if compared is not None:
            check_comparable(collection, compared)
            other = Shelved(compared, 0, {}, Listing())
            state = replace(state, shelf=(other,), compared=other)
        super().__init__(state, beside)
        self.noticed = 0
        """Number of the last notice that a page has shown."""
        if state.number and beside is None:
            why = collection.undrawn(0).split(":")[0]
            count = count_text(int((~collection.posed).sum()), "grasp")
            self.notify(f"{count} cannot be drawn, such as the first ({why}); Browse lists why")
        # Prepared once for refinement and simulation; for the worker alone.
        prepare, make_world = lru_cache(1)(HandObject), world_cache()
        self.contacts = ContactMeter()
        """Contacts of the shown grasp of a state."""
        self._obstacles, self._misses = ObstacleMeter(), RegionMeter()
        self.background = Background(self)
        """Decomposition of objects, and measuring."""
        self.editor = Editor(self, self.contacts)
        """Edits of poses that can be undone."""
        self.targets = TargetEditor(self, self.editor, self.background, prepare)
        """Target points of links."""
        self.regions = RegionEditor(self, self.editor)
        """Regions in which hands should touch an object."""
        self.grasps = OpenGrasps(self, self.editor, self.background)
        """Choice of the open and of the shown grasps, and their marks."""
        self.player = Player(self)
        """Frames of the refinement, and of the shown simulation or trajectory."""
        self.refinement = Refinement(self, self.editor, self.background, self.contacts, prepare)
        """Refinement of the shown grasp."""
        self.simulation = Simulation(self, self.editor, self.background, prepare, make_world)
        """Simulation and trajectory of the shown grasp."""
        self.many = ManyGrasps(self, self.background, prepare, make_world)
        """Refinement and simulation of many grasps."""
        self.on_stop, self.on_idle = self.background.stopped, self.background.resume

    def for_another_page(self) -> Controller:
        """Return a controller that begins with the same grasps and chooses its own, on the same work."""
        with self.lock:
            made = Controller(self.state.collection, self.state.settings, beside=self)
            made.become(for_another_page(self.state))
            return made

    def overlaps(self, state: State) -> tuple[Overlap, ...]:
        """Return the links of the shown hand that are in bodies around the object, the deepest first."""
        return self._obstacles(state, self.contacts.prepared(state.scene))

    def elsewhere(self, state: State) -> tuple[Elsewhere, ...]:
        """Return the links of the shown grasp that touch the object where they should not, the farthest first."""
        return self._misses(self.contacts(state), state.scene.regions)
