"""Contacts of the shown grasp, for the scene and for all texts: one definition of the links that count."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from grasp_refine.collision.query import query
from grasp_refine.measures.measures import MEASURES
from grasp_refine.scene.contact_links import contact_gaps
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.model.contacts import Contacts, contacts_of
from grasp_refine_apps.viewer.model.counted import Counted
from grasp_refine_apps.viewer.model.pose import Pose, posed_scene
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.work import Work

Made = TypeVar("Made")


class ContactMeter:
    """Contacts of the shown grasp, for the scene and for all texts: one selection of links that count.

    They are the contact links of the grasp as it was opened (`contact_gaps`), also if it was moved since; after a
    refinement, the links of its result. An iteration has the links that it closes.
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

    def using(self, scene: Scene, use: Callable[[HandObject], Made]) -> Made:
        """Return the result of `use`, which may query hand and object of a scene."""
        with self._lock:
            return use(self._of(scene))

    def __call__(self, state: State) -> Contacts:
        """Return the contacts of the shown grasp; in a simulation, the contacts before it."""
        pose, work = state.standing, state.work
        with self._lock:
            prepared = self._of(state.scene)
            counted = self._counted(state, prepared)
            # A counted iteration is made anew each time, its arrays are not.
            key = (prepared, pose.T_object_root, pose.q, work.targets, counted and counted.gap)
            if self._last is None or not _same(self._last[0], key):
                gap = None if counted is None else counted.gap
                found = contacts_of(prepared, pose.T_object_root, pose.q, gap=gap, targets=work.targets)
                self._last = key, found
            return self._last[1]

    def counted(self, state: State) -> Counted | None:
        """Return the links that count in the shown pose; None: links with a target."""
        with self._lock:
            return self._counted(state, self._of(state.scene))

    def near(self, scene: Scene, pose: Pose) -> Counted | None:
        """Return the contact links of a grasp without recorded ones, by proximity; None: there are none."""
        with self._lock:
            return _near(self._of(scene), scene, pose)

    def _counted(self, state: State, prepared: HandObject) -> Counted | None:
        work, counted = state.work, counted_of(state)
        if counted is not None or work.targets or work.of_file is None:
            return counted
        if self._near is None or self._near[0] is not work.of_file:
            self._near = work.of_file, _near(prepared, state.scene, work.of_file)
        return self._near[1]

    def at(self, scene: Scene, pose: Pose, counted: Counted | None) -> Contacts:
        """Return the contacts of another pose of the hand; without `counted`, of links near the object there."""
        with self._lock:
            prepared = self._of(scene)
            if self._other is None or self._other[0] is not pose or self._other[1].prepared is not prepared:
                counted = counted or _near(prepared, scene, pose)
                gap = None if counted is None else counted.gap
                found = contacts_of(prepared, pose.T_object_root, pose.q, gap=gap)
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
    return counted_in(state.work, refining=state.job is not None and state.job.kind == "refine")


def counted_in(work: Work, *, refining: bool = False) -> Counted | None:
    """Return the links that count in a grasp as it stands, by a refinement or the file; None: by neither."""
    trace = work.trace
    if trace is None:
        return work.counted
    last = len(trace) - 1
    if work.frame == 0:
        return trace.start
    if work.frame is not None and (work.frame < last or work.outcome is None):
        return Counted(trace.gap[min(work.frame, last)], iteration=True)
    if work.outcome is not None:
        return work.counted
    at_last = refining or work.pose.same(trace.pose(last))
    return Counted(trace.gap[last], iteration=True) if at_last else work.counted


def title_of(state: State) -> str:
    """Return the name of the largest gap of the links that count in the shown pose."""
    counted = counted_of(state)
    return MEASURES["contact_error_m"].title if counted is None else counted.title


def _near(prepared: HandObject, scene: Scene, pose: Pose) -> Counted | None:
    """Return the contact links of a grasp without recorded ones, by proximity; None: there are none."""
    alone = posed_scene(scene, pose)
    T = prepared.chain(alone.T_world_root, alone.q).T_world_link
    cutoff = ContactSelection().cutoff(prepared.hand, prepared.chain.links)
    (gap,) = contact_gaps(alone, query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff))
    return None if np.isnan(gap).all() else Counted(gap)


def _same(one: tuple[Any, ...], other: tuple[Any, ...]) -> bool:
    """Return whether two keys hold the very same objects, or equal arrays."""
    return all(
        a is b or (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and np.array_equal(a, b))
        for a, b in zip(one, other, strict=True)
    )
