"""Contacts of the shown grasp, for the scene and for all texts: one definition of the links that count."""

from __future__ import annotations

from threading import Lock
from typing import Any

import numpy as np

from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.contacts import Contacts, contacts_of
from grasp_refine_apps.viewer.counted import Counted
from grasp_refine_apps.viewer.pose import Pose
from grasp_refine_apps.viewer.state import State


class ContactMeter:
    """Contacts of the shown grasp, for the scene and for all texts: one definition of which links count.

    They are those of the shown iteration, of the file or of the last refinement; without either, those with a target
    or, without targets, those within reach where the file has the hand, also if they were moved away since.
    """

    def __init__(self) -> None:
        """Start without a hand."""
        self._lock = Lock()
        self._prepared: HandObject | None = None
        self._near: tuple[Pose, Counted | None] | None = None
        self._last: tuple[tuple[Any, ...], Contacts] | None = None
        self._other: tuple[Pose, Contacts] | None = None

    def prepared(self, scene: Scene) -> HandObject:
        """Return hand and object of a scene; other threads may look at them, but not query them."""
        with self._lock:
            return self._of(scene)

    def __call__(self, state: State) -> Contacts:
        """Return the contacts of the shown grasp; in a simulation, those from before."""
        pose, work = state.standing, state.work
        with self._lock:
            prepared = self._of(state.scene)
            counted = counted_of(state)
            if counted is None and not work.targets and work.of_file is not None:
                if self._near is None or self._near[0] is not work.of_file:
                    self._near = work.of_file, _within_reach(prepared, work.of_file)
                counted = self._near[1]
            # A counted iteration is made anew each time, its arrays are not.
            key = (prepared, pose.T_object_root, pose.q, work.targets, counted and counted.touching)
            if self._last is None or not _same(self._last[0], key):
                touching, margin = (None, 0.0) if counted is None else (counted.touching, counted.margin)
                found = contacts_of(
                    prepared, pose.T_object_root, pose.q, touching=touching, targets=work.targets, margin=margin
                )
                self._last = key, found
            return self._last[1]

    def at(self, scene: Scene, pose: Pose, counted: Counted | None) -> Contacts:
        """Return the contacts of another pose of the hand; without `counted`, those of links within reach there."""
        with self._lock:
            prepared = self._of(scene)
            if self._other is None or self._other[0] is not pose or self._other[1].prepared is not prepared:
                touching, margin = (None, 0.0) if counted is None else (counted.touching, counted.margin)
                found = contacts_of(prepared, pose.T_object_root, pose.q, touching=touching, margin=margin)
                self._other = pose, found
            return self._other[1]

    def _of(self, scene: Scene) -> HandObject:
        known = self._prepared
        if known is None or known.hand is not scene.hand or known.object is not scene.object:
            known = self._prepared = HandObject(scene.hand, scene.object)
            self._near = self._last = None
        return known


def counted_of(state: State) -> Counted | None:
    """Return the links that count in the shown pose by a refinement or the file; None: by neither."""
    work, trace = state.work, state.work.trace
    if trace is None or work.outcome is not None:
        return work.counted
    refining = state.job is not None and state.job.kind == "refine"
    if work.frame is not None:
        return Counted(trace.touching[min(work.frame, len(trace) - 1)], trace.margin)
    last = len(trace) - 1
    return Counted(trace.touching[last], trace.margin) if refining or work.pose.same(trace.pose(last)) else work.counted


def _within_reach(prepared: HandObject, pose: Pose) -> Counted | None:
    """Links (L,) that a refinement would choose at a pose; None: there is none."""
    links = prepared.chain.links
    found = contacts_of(prepared, pose.T_object_root, pose.q)
    wanted = [link for link, should in zip(found.link, found.should, strict=True) if should]
    first = np.array([links.index(link) == column for column, link in enumerate(links)])
    return Counted(np.isin(links, wanted) & first) if wanted else None


def _same(one: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Return whether two keys hold the very same objects, or equal arrays."""
    return all(
        a is b or (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and np.array_equal(a, b))
        for a, b in zip(one, other, strict=True)
    )
