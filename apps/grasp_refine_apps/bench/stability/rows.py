"""What came of one cell of the benchmark: a flat entry with counts, the same for queries and for derivatives."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

Row = dict[str, Any]

Measure = Literal["forward", "derivative"]

WRONG = (
    "failed",
    "not_finite",
    "wrong_distance",
    "wrong_sign",
    "wrong_points",
    "derivative_not_finite",
    "derivative_unbounded",
    "derivative_wrong_sign",
    "derivative_unscaled",
)
"""Counts that should be 0. A refusal says what is wrong with the input, and faults of MuJoCo are its own."""


@dataclass(frozen=True)
class Cell:
    """Counts of all queries of one body kind, size and state, asked in one way."""

    kind: str
    """Which bodies."""
    diagonal: float
    """Diagonal of the bounding box of the larger body in metres."""
    state: str
    """How the bodies lie to each other."""
    measure: Measure
    """Whether distances and points were judged, or how points move."""
    dtype: str
    """Of the poses: float64 or float32."""
    queries: int
    """Pairs of poses that were asked."""
    batch: int | None = None
    """Poses in one call; None: not what varies here."""
    engine: str | None = None
    """Who answered: native or python; None: not what varies here."""
    method: str | None = None
    """How points were differentiated; None: they were not."""
    neighborhood: str | None = None
    """Which candidates stood for the surface; None: none were needed."""
    translation: float = 0.0
    """How far from the origin of the world both bodies are, in metres."""
    refused: int = 0
    """Queries of bodies that could not be built, or of an engine that is not there, see `refusal`."""
    failed: int = 0
    """Queries without an answer, as the status or an error says."""
    not_finite: int = 0
    """Answers with a distance, point or normal that is no number, or finite poses that are called not finite."""
    wrong_distance: int = 0
    """Distances further from the reference than the tolerance."""
    wrong_sign: int = 0
    """Distances of the wrong sign where the reference exceeds the tolerance."""
    wrong_points: int = 0
    """Witness points further from the reference than the tolerance, of those compared; or, of all, not on the bodies,
    or not as far apart along the normal as the answer says."""
    points_compared: int = 0
    """Queries whose witness points are unique."""
    collapsed: int = 0
    """Answers within the tolerance whose sign or status is not that of the reference, though that exceeds rounding by
    far: gaps that are told as contact. No fault."""
    error_max: float | None = None
    """Largest error of a distance over its tolerance; None: nothing was compared."""
    distance_error_max_m: float | None = None
    """Largest error of a distance in metres; None: nothing was compared."""
    points_error_max: float | None = None
    """Largest error of witness points and normal over its tolerance; None: nothing was compared."""
    mujoco_queries: int = 0
    """Queries that MuJoCo was asked too."""
    mujoco_wrong: int = 0
    """Of these, distances of MuJoCo that are wrong by the same measure. They say nothing about ours."""
    derivative_not_finite: int = 0
    """Queries with an entry of the derivative that is no number."""
    derivative_unbounded: int = 0
    """Queries whose derivative exceeds its bound."""
    derivative_wrong_sign: int = 0
    """Queries whose derivative is not the true one where that is known: points that move the wrong way, too."""
    derivative_unscaled: int = 0
    """Queries whose derivative does not follow a change of the unit of length."""
    derivative_error_max: float | None = None
    """Largest error of a derivative over its tolerance; None: nothing was compared."""
    refusal: str | None = None
    """Why queries were refused, in one line."""
    where: str | None = None
    """Which answers are wrong, the first of each pair of bodies; or the error that there was instead of answers."""

    def row(self) -> Row:
        """The entry of the table."""
        return asdict(self)
