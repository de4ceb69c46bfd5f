"""Edits of the regions in which hands should touch an object: they hold for all open grasps on it."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import Object
from grasp_refine.objects.region import ContactRegions
from grasp_refine.objects.region_spec import contact_regions
from grasp_refine_apps.viewer.jobs.editor import Editor
from grasp_refine_apps.viewer.jobs.store import Store
from grasp_refine_apps.viewer.model.painting import Camera, PaintedFaces, given_regions, seen_faces


class RegionEditor:
    """Edits of regions; commands take up to a second with many faces, and wait for each other."""

    def __init__(self, store: Store, editor: Editor) -> None:
        """Start with what the state has."""
        self._store, self._editor = store, editor
        self._changing = Lock()
        self._faces: PaintedFaces | None = None

    def set(self, touch: str, avoid: str) -> None:
        """Set the regions by lines of specifications; empty: none."""

        def change(obj: Object, now: ContactRegions) -> ContactRegions:
            known = (*now.touch, *now.avoid)
            found = contact_regions(obj, given_regions(touch, known), given_regions(avoid, known))
            return found or ContactRegions()

        self._change(change)

    def clear(self) -> None:
        """Let links touch the object anywhere."""
        self._change(lambda obj, now: ContactRegions())

    def paint(self, camera: Camera) -> None:
        """Paint the faces that a camera sees in its rectangle."""
        state = self._store.state
        if state.brush == "off" or state.motion is not None:
            return

        def change(obj: Object, now: ContactRegions) -> ContactRegions:
            faces = self.painted_faces(obj)
            hit = seen_faces(faces.triangles, state.T_world_object, camera)
            if not hit.any():
                raise GraspRefineError("no face has its centre in the rectangle: draw a larger one over the object")
            painted = faces.stroke(now, state.brush, hit)
            return contact_regions(obj, painted.touch, painted.avoid) or ContactRegions()

        self._change(change)

    def painted_faces(self, obj: Object) -> PaintedFaces:
        """Return the faces of an object, read once."""
        if self._faces is None or self._faces.obj is not obj:
            self._faces = PaintedFaces.of(obj)
        return self._faces

    def _change(self, change: Callable[[Object, ContactRegions], ContactRegions]) -> None:
        """Change the regions of the shown object; where they are refused, notify the user."""
        with self._changing:
            scene = self._store.state.scene
            before = scene.regions or ContactRegions()
            after = self._store.checked(lambda: change(scene.object, before))
            if after is None or (after.touch, after.avoid) == (before.touch, before.avoid):
                return
            with self._store.lock:
                if self._store.state.scene.object is scene.object:
                    self._editor.edit_regions(after)
