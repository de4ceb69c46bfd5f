"""Collection as it is now: measures and verdicts of edited and refined grasps replace the file's."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

import numpy as np

from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import HERE, OF_REFINEMENT, Column, numeric_columns
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.model.work import Work, Works

EDITED = "edited"
"""Text on a grasp that was moved since it was read or refined."""


def present(state: State) -> Collection:
    """Return the open grasps with columns of their work; the collection itself if there is none."""
    collection, made = state.collection, _made(state.works)
    if not made:
        return collection
    moved = {number: work for number, work in made.items() if work.changed or work.outcome is not None}
    columns = _measures(collection, moved) if moved else {}
    columns[HERE.key] = HERE.with_values(_texts(len(collection), {n: here_text(work) for n, work in made.items()}))
    # A grasp that was moved has no result of its file.
    trials = {number: work.trial for number, work in made.items() if number in moved or work.trial is not None}
    return collection.with_columns(*columns.values()).with_trials(trials)


def signature(state: State) -> Hashable:
    """Return a value that is equal for states with equal `present`, by identity of results; much faster than that."""
    made = _made(state.works)
    # Iterations of a running refinement and dragged joints change nothing that is listed.
    works = tuple((n, w.changed, w.outcome, w.trial, w.refined_at, w.tested_at) for n, w in made.items())
    return state.collection, works


def here_text(work: Work) -> str:
    """Return text on the work done here on a grasp, with times; empty: none."""
    parts = []
    if work.outcome is not None and work.refined_at is not None:
        parts.append(f"refined {work.refined_at:%H:%M}")
    elif work.changed:
        parts.append(EDITED)
    if work.trial is not None and work.tested_at is not None:
        parts.append(f"tested {work.tested_at:%H:%M}")
    return ", ".join(parts)


def _made(works: Works) -> dict[int, Work]:
    """The works with results, or with another pose than in the file."""
    return {n: w for n, w in works.items() if w.outcome is not None or w.tested_at is not None or w.changed}


def _measures(collection: Collection, works: Mapping[int, Work]) -> dict[str, Column]:
    """Columns of measures and texts, replaced for moved grasps."""
    entries = {
        number: {} if work.outcome is None else {key: float(v[0]) for key, v in work.outcome.entries().items()}
        for number, work in works.items()
    }
    known = {key for values in entries.values() for key in values}
    columns = {}
    for column in numeric_columns():
        before = collection.columns.get(column.key)
        if before is None and column.key not in known:
            continue
        values = np.full(len(collection), np.nan) if before is None else before.values.copy()
        for number, found in entries.items():
            values[number] = found.get(column.key, np.nan)
        columns[column.key] = column.with_values(values)
    for word in OF_REFINEMENT:
        texts = {
            number: "" if work.outcome is None else str(work.outcome.texts()[word.key][0])
            for number, work in works.items()
        }
        before = collection.columns.get(word.key)
        if before is not None or any(texts.values()):
            columns[word.key] = word.with_values(
                _texts(len(collection), texts, None if before is None else before.values)
            )
    return columns


def _texts(count: int, texts: Mapping[int, str], before: np.ndarray | None = None) -> np.ndarray:
    """Texts of `count` grasps: the given ones, else the previous ones."""
    found = np.full(count, "", dtype=object) if before is None else before.astype(object)
    for number, text in texts.items():
        found[number] = text
    return found.astype(str)
