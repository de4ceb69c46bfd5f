"""Table of all measures of grasps: result files, JSON, indices, tables, histograms and the viewer iterate over it.

A measure has one name everywhere. A new measure is one entry of `MEASURES` and its formula; a
script adds its own by `add_measure`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import degrees
from typing import Any, Literal

import numpy as np

from grasp_refine.core.arguments import check_fields, check_kind, describe_value
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.registry import Registry
from grasp_refine.forces.quality import CONFIDENCE
from grasp_refine.measures.formulas import (
    arm_dexterity,
    contact_distance,
    contact_error,
    contact_error_mean,
    contact_number,
    contacts_seen,
    largest_mass,
    likely_quality,
    of_fidelity,
    quality_value,
    region_miss,
    scene_penetration,
    self_penetration_depth,
    wrench_residual,
)
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M

Better = Literal["higher", "lower", ""]
"""Direction in which a measure is better; empty: neither."""

SIDES = ("before", "after")
"""Grasps that a measure is of: before refinement, and after it."""


@dataclass(frozen=True)
class Unit:
    """Unit of a measure, inside and for people."""

    suffix: str
    """Suffix of names of measures, the SI unit of their values."""
    symbol: str
    """Unit that people read; empty: none."""
    factor: float
    """Factor from SI units to displayed units."""
    format: str
    """Format specification of numbers that people read."""
    span: tuple[float, float]
    """Range that histograms resolve, SI units: logarithmic, or linear from 0."""
    negligible: float = 0.0
    """Values up to this one, SI units, are not worth a line in a summary."""


METRE = Unit("_m", "mm", 1e3, ".2f", (1e-7, 1.0), 1e-5)
SQUARE_METRE = Unit("_m2", "mm²", 1e6, ".3g", (1e-14, 1.0), 1e-10)
RADIAN = Unit("_rad", "°", degrees(1.0), ".1f", (1e-5, 10.0), 1e-3)
SECOND = Unit("_s", "s", 1.0, ".2f", (1e-4, 1e4))
COUNT = Unit("", "", 1.0, ".0f", (1.0, 1e5))
KILOGRAM = Unit("_kg", "kg", 1.0, ".2f", (1e-2, 1e2))
RATIO = Unit("", "", 1.0, ".3f", (1e-5, 10.0), 1e-3)
SHARE = Unit("", "", 1.0, ".3f", (0.0, 1.0), 1e-3)
"""Number from 0 to 1."""


@dataclass(frozen=True)
class Measure:
    """One number per grasp; NaN where it is not known."""

    name: str
    """Name in memory and in all files, which ends in the suffix of the unit, such as "penetration_m"."""
    title: str
    """Name for people, in lower case."""
    hint: str
    """Explanation in one sentence without its full stop."""
    unit: Unit
    """Unit of the values."""
    formula: Callable[[Any], np.ndarray]
    """Values (N,) of `MeasuredGrasps`; of a refinement, of `MeasuredRefinement`."""
    better: Better = "lower"
    """Direction in which it is better."""
    of_grasps: bool = True
    """Whether it is of grasps at any poses; False: of their refinement."""
    compared: bool = True
    """Whether it is recorded before and after refinement; False: after it alone."""
    recorded: bool = True
    """Whether refinements record it; others are measured where they are shown."""
    validated: bool = True
    """Whether validations, which know no refinement, have it."""
    shown: bool = True
    """Whether people see it, in tables, charts and the viewer; False: it is in files only."""
    head: tuple[str, str] = ("", "")
    """Two lines above its column in the table of `validate`, where space is short; empty: no column there."""

    def __post_init__(self) -> None:
        """Refuse a measure that cannot stand in files and tables.

        Raises:
            GraspRefineError: a field of another type, or a name that is no identifier or does not end in its unit.
        """
        check_fields(self)
        if not (self.name.isidentifier() and self.name.endswith(self.unit.suffix)):
            such = f"palm_height{self.unit.suffix}"
            raise GraspRefineError(
                f"Measure: name must be one such as {such}, which ends in its unit, got '{self.name}'"
            )

    def values(self, measured: Any) -> np.ndarray:
        """Return the values of the formula (N,), SI units.

        Args:
            measured: `MeasuredGrasps`; of a measure of a refinement, `MeasuredRefinement`.

        Raises:
            GraspRefineError: the formula returns no numbers, or another shape.
        """
        found = self.formula(measured)
        if not (isinstance(found, np.ndarray) and found.dtype.kind in "fiub" and found.shape == (len(measured),)):
            raise GraspRefineError(
                f"measure {self.name}: its formula must return a NumPy array of numbers of shape ({len(measured)},), "
                f"got {describe_value(found)}"
            )
        return found

    @property
    def entries(self) -> dict[str, str]:
        """Side -> name of its values on that side, such as "penetration_m_before"; after alone, it is `name`."""
        return {side: f"{self.name}_{side}" for side in SIDES} if self.compared else {"after": self.name}

    @property
    def headline(self) -> str:
        """Title and unit for people, such as "penetration, mm"."""
        return f"{self.title}, {self.unit.symbol}" if self.unit.symbol else self.title

    def text(self, value: float, format: str = "") -> str:
        """Return a value in SI units as people read it, without its unit; `format` instead of that of the unit."""
        return f"{value * self.unit.factor:{format or self.unit.format}}"


QUALITY = Measure(
    name="quality",
    title="quality",
    hint="estimated probability that the grasp holds when it is simulated, from 0 to 1",
    unit=SHARE,
    formula=quality_value,
    better="higher",
    head=("", "qual."),
)
LIKELY_QUALITY = Measure(
    name="likely_quality",
    title="quality if it is what it seems",
    hint="quality on the first completion of a scanned object, where the quality is over all of them",
    unit=SHARE,
    formula=likely_quality,
    better="higher",
)


def _refinement(
    name: str, title: str, hint: str, unit: Unit, formula: Callable[[Any], np.ndarray], better: Better = ""
) -> Measure:
    """Return a measure of a refinement, which has one value for both sides."""
    return Measure(name, title, hint, unit, formula, better, of_grasps=False, compared=False, validated=False)


DISPLACEMENT = _refinement(
    "displacement_m",
    "displacement",
    "root mean square displacement of the hand's surface from the input grasp",
    METRE,
    lambda of: of.displacement,
    "lower",
)
CONTACTS_MOVED = _refinement(
    "contacts_moved_m",
    "contacts moved",
    "movement of the input grasp's contact points on the object, mean over the links that touch before and after",
    METRE,
    lambda of: of.contacts_moved,
    "lower",
)
MOVEMENTS = (
    DISPLACEMENT,
    CONTACTS_MOVED,
    _refinement(
        "links_kept",
        "links kept",
        "share of the contact links of the input grasp that still are contact links",
        SHARE,
        lambda of: of.links_kept,
        "higher",
    ),
    _refinement(
        "moved_palm_m",
        "hand moved",
        "distance of its base link from the input grasp",
        METRE,
        lambda of: of.movement.palm_m,
    ),
    _refinement(
        "moved_palm_rad",
        "hand turned",
        "rotation of its base link from the input grasp",
        RADIAN,
        lambda of: of.movement.palm_rad,
    ),
    _refinement(
        "moved_joints_rad",
        "joints moved",
        "the joint that turned most",
        RADIAN,
        lambda of: of.movement.joints_rad,
    ),
    _refinement(
        "moved_slides_m",
        "slides moved",
        "the joint that slid most, of hands that have some",
        METRE,
        lambda of: of.movement.slides_m,
    ),
)
"""Measures of the change of a grasp by its refinement."""

_OF_TRANSFERS: dict[str, Any] = {"compared": False, "validated": False}
"""Measures of transferred grasps against their originals."""

_FIDELITY: tuple[tuple[str, str, str, Unit, Better], ...] = (
    (
        "original_shift_m",
        "contacts from the original's",
        "median distance on the object between the contacts of a transferred grasp and those of its original",
        METRE,
        "lower",
    ),
    ("original_shift_most_m", "farthest from the original's", "the largest of these distances", METRE, "lower"),
    (
        "original_pinch_shift_m",
        "thumb and opposing finger off",
        "the larger of these distances of the thumb and of the finger that presses against it",
        METRE,
        "lower",
    ),
    (
        "original_kept",
        "contacts of the original kept",
        "share of the fingers that touch in the original whose place a finger takes that touches",
        SHARE,
        "higher",
    ),
    (
        "original_turn_rad",
        "approach turned",
        "angle between the approach directions of a transferred grasp and of its original",
        RADIAN,
        "lower",
    ),
)
"""Name, title, hint, unit and direction of the measures of transferred grasps."""

_OURS = (
    _refinement("starts", "starts", "number of starts of the refinement", COUNT, lambda of: of.starts),
    _refinement("iterations", "iterations", "of all starts together", COUNT, lambda of: of.iterations, "lower"),
    _refinement("queries", "queries", "narrow-phase queries", COUNT, lambda of: of.queries, "lower"),
    QUALITY,
    LIKELY_QUALITY,
    Measure(
        name="contacts_seen",
        title="contacts seen",
        hint="share of the links in contact that touch the object where its scan has points; none without a scan",
        unit=SHARE,
        formula=contacts_seen,
        better="higher",
    ),
    Measure(
        name="largest_mass_kg",
        title="largest mass",
        hint=f"mass of the object up to which the quality is {CONFIDENCE:g} or more, with the friction of the task",
        unit=KILOGRAM,
        formula=largest_mass,
        better="higher",
    ),
    Measure(
        name="wrench_residual",
        title="wrench residual",
        hint="part of the load that the best contact forces leave unbalanced, without unit",
        unit=RATIO,
        formula=wrench_residual,
        head=("wrench", "resid."),
    ),
    Measure(
        name="contact_error_m",
        title="contact error",
        hint="the worst gap, or miss of a target, of the grasp's contact links, the links that should touch",
        unit=METRE,
        formula=contact_error,
        head=("contact", "err. mm"),
    ),
    Measure(
        name="contact_error_mean_m",
        title="mean contact error",
        hint="mean over the contact links of the gap, or miss of a target",
        unit=METRE,
        formula=contact_error_mean,
        shown=False,
    ),
    Measure(
        name="penetration_m",
        title="penetration",
        hint="the deepest penetration of any link into the object",
        unit=METRE,
        formula=lambda grasps: grasps.geometry.penetration,
        head=("penetr.", "mm"),
    ),
    Measure(
        name="self_penetration_m",
        title="self-penetration",
        hint="the deepest penetration of links into each other",
        unit=METRE,
        formula=self_penetration_depth,
        head=(" self", "mm"),
    ),
    Measure(
        name="scene_penetration_m",
        title="scene penetration",
        hint="the deepest penetration of any link into a body of the scene; none where no scene is given",
        unit=METRE,
        formula=scene_penetration,
    ),
    Measure(
        name="region_miss_m",
        title="contacts outside",
        hint="the largest distance of the surface in contact from where hands should touch; none without regions",
        unit=METRE,
        formula=region_miss,
    ),
    *(
        Measure(name, title, hint, unit, of_fidelity(name.removesuffix(unit.suffix)), better, **_OF_TRANSFERS)
        for name, title, hint, unit, better in _FIDELITY
    ),
    Measure(
        name="contact_distance_m",
        title="contact distance",
        hint="mean over the fingers, each of its nearest contact link",
        unit=METRE,
        formula=contact_distance,
        recorded=False,
    ),
    Measure(
        name="contact_number",
        title="links in contact",
        hint=f"number of links within {1e3 * CONTACT_DISTANCE_M:g} mm of the object",
        unit=COUNT,
        formula=contact_number,
        better="higher",
        recorded=False,
        head=("", "links"),
    ),
    _refinement(
        "loss_m2",
        "loss",
        "value that refinement minimises, after it",
        SQUARE_METRE,
        lambda of: np.where(np.isfinite(of.loss), of.loss, np.nan),
        "lower",
    ),
    *MOVEMENTS,
    Measure(
        name="arm_dexterity_m",
        title="arm dexterity",
        hint="least movement of the palm per radian of the arm's joints, in any direction; 0 where it is singular",
        unit=METRE,
        formula=arm_dexterity,
        better="higher",
    ),
    Measure(
        name="limits_violated",
        title="joints beyond limits",
        hint="number of joint values beyond their limits",
        unit=COUNT,
        formula=lambda grasps: grasps.geometry.limits_violated,
        compared=False,
    ),
    _refinement("cpu_s", "CPU time", "share of that of the refinement", SECOND, lambda of: of.cpu_s, "lower"),
    _refinement("wall_s", "wall time", "share of that of the refinement", SECOND, lambda of: of.wall_s, "lower"),
)
RESERVED = frozenset(
    {
        *("schema", "hand", "base_link", "joint_names", "object", "scale", "hand_pose", "q", "status", "change"),
        "provenance",
        "certificate",
        *("pregrasp_pose", "pregrasp_q", "squeeze_pose", "squeeze_q", "forces"),
        *("target_link", "target_point_link", "target_point_object", "contact_links", "contact_gaps", "contact_link"),
        *("fidelity", "fingers", "contact_point_link", "contact_point_object", "contact_normal", "contact_distance"),
        "contact_probability",
        *(f"forces_{name}" for name in ("grasp", "link", "point", "normal", "vector")),
        *("simulation", "simulation_label", "simulation_reason", "simulation_direction"),
        *("simulation_displacement_m", "simulation_angle_rad", "held", "reason", "success", "good"),
        *("advice", "file", "grasp", "index", "job", "row", "row_in_file", "shard", "source"),
    }
)
"""Names of other entries and columns of result files, JSON and indices, which no measure may have."""
OF_ENGINES = ("held_", "reason_")
"""Beginnings of the names of verdicts of each engine."""


def _check(measure: object) -> None:
    """Refuse other types, and names that mean something else in files.

    Raises:
        GraspRefineError: names the measure.
    """
    check_kind("measure", measure, Measure)
    assert isinstance(measure, Measure)
    taken = RESERVED | {entry for one in _OURS for entry in _entries(one)}
    if not taken.isdisjoint(_entries(measure)) or measure.name.startswith(OF_ENGINES):
        raise GraspRefineError(f"the name of measure '{measure.name}' is taken: files have an entry of this name")


def _entries(measure: Measure) -> set[str]:
    """Return the names that stand for a measure in files and tables."""
    return {measure.name, *measure.entries.values()}


MEASURES = Registry("measure", "grasp_refine.measures", _OURS, name_of=lambda measure: measure.name, check=_check)
"""All measures, in the order of reports; times, which differ between two runs of the same command, come last of ours.
"""

add_measure = MEASURES.add

RECORDED = MEASURES.view(lambda every: (measure for measure in every if measure.recorded))
"""Measures that result files, their JSON, indices and reports of batches have."""

COMPARED = MEASURES.view(
    lambda every: (measure for measure in every if measure.recorded and measure.compared and measure.shown)
)
"""Measures that people see before and after refinement."""

VALIDATED = MEASURES.view(
    lambda every: sorted(
        (measure for measure in every if measure.validated),
        key=lambda measure: (measure.unit in (RATIO, SHARE), measure.better == "higher"),
    )
)
"""Measures of validations: geometry first, then statics, and last the quality, which sums up all others."""
