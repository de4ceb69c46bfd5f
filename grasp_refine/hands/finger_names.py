"""What the fingers of a hand are called, read from the names of their links and joints."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

WORDS = {
    "thumb": r"thumb|^th(?=distal|tip|base|hub|middle|proximal|j?\d)",
    "index": r"index|fore_?finger|^(ff|if)(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "ring": r"(?<![a-z])ring|^rf(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "little": r"little|pinky|^(lf|pf)(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "middle": r"middle|^mf(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
}
"""Finger -> what its links and joints are called. The middle one is last: the bones of every finger have a middle."""


def finger_names(branches: Sequence[Sequence[str]]) -> list[str | None]:
    """The finger that each branch is; None where its names do not say it, or say it of several branches.

    Args:
        branches: Names of links and joints of each branch, from the tip on; the first name that tells a finger counts.
    """
    told = [_told(names) for names in branches]
    count = Counter(told)
    return [finger if finger is not None and count[finger] == 1 else None for finger in told]


def _told(names: Sequence[str]) -> str | None:
    for name in names:
        for finger, pattern in WORDS.items():
            if re.search(pattern, name.lower()):
                return finger
    return None
