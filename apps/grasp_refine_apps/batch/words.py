"""Numbers as people read them in the report, the table and the progress of a batch."""

from __future__ import annotations

from math import isfinite

from grasp_refine.core.plurals import count_text, whole

NONE = "–"
"""Text for a missing value."""


def grasps(number: int) -> str:
    """Number of grasps as text."""
    return count_text(number, "grasp")


def share(part: int, of: int) -> str:
    """Share in percent; `NONE` of an empty set."""
    if not of:
        return NONE
    percent = 100.0 * part / of
    # Nearly all is not all, and hardly any is some.
    if 0 < part < of:
        percent = min(max(percent, 0.1), 99.9)
    return f"{percent:.0f} %" if part in (0, of) else f"{percent:.1f} %"


def millimetres(metres: float) -> str:
    """Length in mm with three digits; digits below a tenth of a micrometre are meaningless."""
    if not isfinite(metres):
        return NONE
    if metres < 0.95e-7:
        return "0" if metres == 0 else "< 0.0001"
    value = 1e3 * metres
    return f"{value:.4f}".rstrip("0") if value < 9.5e-4 else _three(value)


def degrees(radians: float) -> str:
    """Angle in degrees with three digits."""
    return _three(57.29577951308232 * radians)


def plain(value: float) -> str:
    """Number with three digits."""
    return _three(value)


def axis_length(metres: float) -> str:
    """Length that is a power of ten, as a label of an axis."""
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if metres > 0.99 * size * (0.1 if unit == "mm" else 1.0):
            return f"{metres / size:.3g} {unit}"
    return f"{metres * 1e9:.3g} nm"


def _three(value: float) -> str:
    if not isfinite(value):
        return NONE
    if value == 0 or 1e-3 <= abs(value) < 9.995e2:
        digits = 3 - len(f"{abs(value):.0f}") if abs(value) >= 0.9995 else 3
        return f"{value:.{digits}f}" if abs(value) >= 0.0995 or value == 0 else f"{value:.2g}"
    return f"{value:.0f}" if 1e3 <= abs(value) + 0.5 < 1e5 else f"{value:.1e}"


def duration(seconds: float) -> str:
    """Time in its two largest units, or in milliseconds where it is short."""
    if not isfinite(seconds):
        return NONE
    if seconds < 0.9995:
        return f"{1e3 * seconds:.0f} ms"
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole_s = round(seconds)
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if whole_s >= size:
            return f"{whole_s // size} {unit} {whole_s % size // smaller} {name}"
    return f"{whole_s} s"


def rate(per_second: float) -> str:
    """Grasps per second, minute or hour, by the smallest unit that gives about 1 or more."""
    for factor, unit in ((1, "s"), (60, "min"), (3600, "h")):
        if per_second * factor >= 0.995 or unit == "h":
            return f"{_three(per_second * factor)} grasps/{unit}"
    raise AssertionError


def mebibytes(count: int) -> str:
    """Memory in MiB."""
    return f"{whole(round(count / 2**20))} MiB"
