"""Schema of all measures of grasps: result files, JSON, indices, tables, histograms and the viewer iterate over it.

A new measure is one entry of `MEASURES` and its formula; a script adds its own by `add_measure`.
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
from grasp_refine.measures.formulas import (
    arm_dexterity,
    contact_distance,
    contact_number,
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
    """Suffix of keys of values in SI units."""
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
RATIO = Unit("", "", 1.0, ".3f", (1e-5, 10.0), 1e-3)
SHARE = Unit("", "", 1.0, ".3f", (0.0, 1.0), 1e-3)
"""Number from 0 to 1."""


@dataclass(frozen=True)
class Measure:
    """One number per grasp, or per link of it; NaN where it is not known."""

    key: str
    """Name of its values in memory, and prefix in files."""
    title: str
    """Name for people, in lower case."""
    hint: str
    """Explanation in one sentence without its full stop."""
    unit: Unit
    """Unit of the values."""
    formula: Callable[[Any], np.ndarray]
    """Values (N,), or (N, L) of a measure per link, of `MeasuredGrasps`; of a refinement, of `MeasuredRefinement`."""
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
    per_link: bool = False
    """Whether it has a value for each link; reports have the worst, and files also the mean over the links."""
    head: tuple[str, str] = ("", "")
    """Two lines above its column in the table of `validate`, where space is short; empty: no column there."""

    def __post_init__(self) -> None:
        """Refuse a measure that cannot stand in files and tables.

        Raises:
            GraspRefineError: a field of another type, or a key that is no identifier.
        """
        check_fields(self)
        if not self.key.isidentifier():
            raise GraspRefineError(f"Measure: key must be a name such as palm_height, got '{self.key}'")

    def values(self, measured: Any) -> np.ndarray:
        """Return the values of the formula (N,), or (N, L) of a measure per link, SI units.

        Args:
            measured: `MeasuredGrasps`; of a measure of a refinement, `MeasuredRefinement`.

        Raises:
            GraspRefineError: the formula returns no numbers, or another shape.
        """
        found, count = self.formula(measured), len(measured)
        is_numeric = isinstance(found, np.ndarray) and found.dtype.kind in "fiub"
        if not (is_numeric and found.shape[:1] == (count,) and found.ndim == 1 + self.per_link):
            raise GraspRefineError(
                f"measure {self.key}: its formula must return a NumPy array of numbers of shape "
                f"({count},{' links' if self.per_link else ''}), got {describe_value(found)}"
            )
        return found

    @property
    def name(self) -> str:
        """Key of its values in SI units, such as "penetration_m"."""
        return self.key.removesuffix(self.unit.suffix) + self.unit.suffix

    @property
    def entries(self) -> dict[str, str]:
        """Side -> key of its values in result files."""
        return {side: f"{self.key}_{side}" for side in SIDES} if self.compared else {"after": self.key}

    @property
    def columns(self) -> dict[str, str]:
        """Key in result files -> name of the column of an index, which ends in the unit."""
        suffix = self.unit.suffix
        return {entry: entry.removesuffix(suffix) + suffix for entry in self.entries.values()}

    def mean_entry(self, entry: str) -> str:
        """Return the key in result files of the mean over the links, given that of the worst of them."""
        return f"{self.key}_mean{entry.removeprefix(self.key)}"

    @property
    def headline(self) -> str:
        """Title and unit for people, such as "penetration, mm"."""
        return f"{self.title}, {self.unit.symbol}" if self.unit.symbol else self.title

    def text(self, value: float, format: str = "") -> str:
        """Return a value in SI units as people read it, without its unit; `format` instead of that of the unit."""
        return f"{value * self.unit.factor:{format or self.unit.format}}"


QUALITY = Measure(
    key="quality",
    title="quality",
    hint="estimated probability that the grasp holds when it is simulated, from 0 to 1",
    unit=SHARE,
    formula=quality_value,
    better="higher",
    head=("", "qual."),
)


def _refinement(
    key: str, title: str, hint: str, unit: Unit, formula: Callable[[Any], np.ndarray], better: Better = ""
) -> Measure:
    """Return a measure of a refinement, which has one value for both sides."""
    return Measure(key, title, hint, unit, formula, better, of_grasps=False, compared=False, validated=False)


_OURS = (
    _refinement("starts", "starts", "number of starts of the refinement", COUNT, lambda of: of.refinement.starts),
    _refinement(
        "iterations", "iterations", "of all starts together", COUNT, lambda of: of.refinement.iterations, "lower"
    ),
    _refinement("queries", "queries", "narrow-phase queries", COUNT, lambda of: of.refinement.queries, "lower"),
    QUALITY,
    Measure(
        key="wrench_residual",
        title="wrench residual",
        hint="part of the load that the best contact forces leave unbalanced, without unit",
        unit=RATIO,
        formula=wrench_residual,
        head=("wrench", "resid."),
    ),
    Measure(
        key="contact_error",
        title="contact error",
        hint="the worst gap, or miss of a target, of the grasp's contact links, the links that should touch",
        unit=METRE,
        formula=lambda grasps: grasps.geometry.contact_error,
        per_link=True,
        head=("contact", "err. mm"),
    ),
    Measure(
        key="penetration",
        title="penetration",
        hint="the deepest penetration of any link into the object",
        unit=METRE,
        formula=lambda grasps: grasps.geometry.penetration,
        head=("penetr.", "mm"),
    ),
    Measure(
        key="self_penetration",
        title="self-penetration",
        hint="the deepest penetration of links into each other",
        unit=METRE,
        formula=self_penetration_depth,
        head=(" self", "mm"),
    ),
    Measure(
        key="scene_penetration",
        title="scene penetration",
        hint="the deepest penetration of any link into a body of the scene; none where no scene is given",
        unit=METRE,
        formula=scene_penetration,
    ),
    Measure(
        key="region_miss",
        title="contacts outside",
        hint="the largest distance of the surface in contact from where hands should touch; none without regions",
        unit=METRE,
        formula=region_miss,
    ),
    Measure(
        key="contact_distance",
        title="contact distance",
        hint="mean over the fingers, each of its nearest contact link",
        unit=METRE,
        formula=contact_distance,
        recorded=False,
    ),
    Measure(
        key="contact_number",
        title="links in contact",
        hint=f"number of links within {1e3 * CONTACT_DISTANCE_M:g} mm of the object",
        unit=COUNT,
        formula=contact_number,
        better="higher",
        recorded=False,
        head=("", "links"),
    ),
    _refinement(
        "loss", "loss", "value that refinement minimises, after it", SQUARE_METRE, lambda of: of.final_loss, "lower"
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
    Measure(
        key="arm_dexterity",
        title="arm dexterity",
        hint="least movement of the palm per radian of the arm's joints, in any direction; 0 where it is singular",
        unit=METRE,
        formula=arm_dexterity,
        better="higher",
    ),
    Measure(
        key="limits_violated",
        title="joints beyond limits",
        hint="number of joint values beyond their limits",
        unit=COUNT,
        formula=lambda grasps: grasps.geometry.limits_violated,
        compared=False,
    ),
    _refinement(
        "cpu_s", "CPU time", "share of that of the refinement", SECOND, lambda of: of.refinement.cpu_s, "lower"
    ),
    _refinement(
        "wall_s", "wall time", "share of that of the refinement", SECOND, lambda of: of.refinement.wall_s, "lower"
    ),
)
RESERVED = frozenset(
    {
        *("schema", "hand", "base_link", "joint_names", "object", "scale", "hand_pose", "q", "status", "provenance"),
        *("pregrasp_pose", "pregrasp_q", "squeeze_pose", "squeeze_q", "forces"),
        *("target_link", "target_point_link", "target_point_object", "contact_links", "contact_gaps", "contact_link"),
        *("contact_point_link", "contact_point_object", "contact_normal", "contact_distance"),
        *(f"forces_{name}" for name in ("grasp", "link", "point", "normal", "vector")),
        *("simulation", "simulation_label", "simulation_reason", "simulation_direction"),
        *("simulation_displacement_m", "simulation_angle_rad", "held", "reason", "success", "good"),
        *("advice", "file", "grasp", "index", "job", "moved", "row", "row_in_file", "shard", "source"),
    }
)
"""Names of other entries and columns of result files, JSON and indices, which no measure may have."""


def _check(measure: Measure) -> None:
    """Refuse what is no measure, and keys that mean something else in files.

    Raises:
        GraspRefineError: names the key.
    """
    check_kind("measure", measure, Measure)
    taken = RESERVED | {entry for one in _OURS for entry in _entries(one)}
    if not taken.isdisjoint(_entries(measure)):
        raise GraspRefineError(f"the name of measure '{measure.key}' is taken: files have an entry of this name")


def _entries(measure: Measure) -> set[str]:
    """Return the names that stand for a measure in files and tables."""
    return {measure.key, measure.name, *measure.columns, *measure.columns.values()}


MEASURES = Registry("measure", "grasp_refine.measures", _OURS, name_of=lambda measure: measure.key, check=_check)
"""All measures, in the order of reports; times, which differ between two runs of the same command, come last of ours.
"""

add_measure = MEASURES.add

RECORDED = MEASURES.view(lambda every: (measure for measure in every if measure.recorded))
"""Measures that result files, their JSON, indices and reports of batches have."""

COMPARED = MEASURES.view(lambda every: (measure for measure in every if measure.recorded and measure.compared))
"""Recorded measures that are known before and after refinement."""

MOVEMENTS = MEASURES.view(
    lambda every: (measure for measure in every if measure.key.startswith("moved_") and not measure.of_grasps)
)
"""Recorded measures of the distance by which refinement moved a grasp."""

VALIDATED = MEASURES.view(
    lambda every: sorted(
        (measure for measure in every if measure.validated),
        key=lambda measure: (measure.unit in (RATIO, SHARE), measure.better == "higher"),
    )
)
"""Measures of validations: geometry first, then statics, and last the quality, which sums up all others."""
