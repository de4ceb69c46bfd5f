"""Work that pages share: what one changes in the open grasps, the others have at once; what they show is their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TypeVar

from grasp_refine_apps.viewer.model.state import Shelved, State
from grasp_refine_apps.viewer.model.work import Work

Holder = TypeVar("Holder", State, Shelved)

OWN = "frame"
"""Field of a work that each page chooses: the iteration that it shows."""


def for_another_page(state: State) -> State:
    """Return the state with which another page begins: the same grasp as shown, with nothing running or chosen."""
    live = state.motion is not None and state.motion.live
    return replace(
        state,
        job=None,
        notice=None,
        gizmo="none",
        brush="off",
        picking=False,
        picked=None,
        motion=None if live else state.motion,
    )


def with_shared(mine: State, before: State, after: State) -> State:
    """Return the state of a page with what another page changed from `before` to `after`; itself if that is nothing."""
    same = after.works is before.works and after.collection is before.collection
    if same or not after.collection.same_grasps(before.collection):
        return mine
    changed = {n: work for n, work in after.works.items() if before.works.get(n) is not work}
    if not changed and after.collection is before.collection:
        return mine
    found = _adopted(mine, after, changed)
    scene = found.collection.scene(found.number)
    if scene.object is not mine.scene.object or scene.regions is not mine.scene.regions:
        found = replace(found, scene=scene)
    shelf = tuple(_adopted(each, after, changed) for each in mine.shelf)
    if any(one is not other for one, other in zip(shelf, mine.shelf, strict=True)):
        found = replace(found, shelf=shelf)
    if mine.compared is not None and (compared := _adopted(mine.compared, after, changed)) is not mine.compared:
        found = replace(found, compared=compared)
    return found


def _adopted(holder: Holder, after: State, changed: Mapping[int, Work]) -> Holder:
    """Return the open or shelved grasps of a page with changed works, if they are the same grasps."""
    if not holder.collection.same_grasps(after.collection):
        return holder
    works = {n: _with_own_frame(holder.works.get(n), work) for n, work in changed.items()}
    if after.collection is holder.collection and all(holder.works.get(n) is work for n, work in works.items()):
        return holder
    return replace(holder, collection=after.collection, works={**holder.works, **works})


def _with_own_frame(mine: Work | None, work: Work) -> Work:
    """Return a work with the iteration that this page shows, while its refinement is the same."""
    if mine is None or mine.trace is not work.trace:
        return work
    others = (field.name for field in fields(Work) if field.name != OWN)
    if all(getattr(mine, name) is getattr(work, name) for name in others):
        return mine
    return replace(work, frame=mine.frame)
