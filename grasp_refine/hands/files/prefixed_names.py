"""Names of the same thing in two files of a hand; one may have a prefix, such as rh_FFJ4 or hand/FFJ4."""

from __future__ import annotations

from collections.abc import Collection


def prefixed_names(name: str, there: Collection[str]) -> list[str]:
    """Return the name itself where it is `there`, else the names with a prefix."""
    if name in there:
        return [name]
    return [other for other in there if other.endswith(name) and not other.removesuffix(name)[-1].isalnum()]
