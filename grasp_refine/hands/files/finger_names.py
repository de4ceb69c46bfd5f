"""Names of the fingers of a hand, read from the names of their links and joints."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

FINGER_PATTERNS = {
    "thumb": r"thumb|(?:^|^[lr]h_)th(?=distal|tip|base|hub|middle|proximal|_|j?\d)",
    "index": r"index|fore_?finger|(?:^|^[lr]h_)(ff|if)(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "ring": r"(?<![a-z])ring|(?:^|^[lr]h_)rf(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "little": r"little|pinky|(?:^|^[lr]h_)(lf|pf)(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
    "middle": r"middle|(?:^|^[lr]h_)mf(?=distal|tip|knuckle|middle|proximal|_|j?\d)",
}
"""Finger -> pattern of its links' and joints' names. The middle one is last: every finger has a middle phalanx."""


def finger_names(branches: Sequence[Sequence[str]]) -> list[str | None]:
    """The finger of each branch; None where its names give none, or several branches have the same.

    Args:
        branches: Names of links and joints of each branch, from the tip on; the first match counts.
    """
    fingers = [_finger_of(names) for names in branches]
    count = Counter(fingers)
    return [finger if finger is not None and count[finger] == 1 else None for finger in fingers]


def _finger_of(names: Sequence[str]) -> str | None:
    for name in names:
        for finger, pattern in FINGER_PATTERNS.items():
            if re.search(pattern, name.lower()):
                return finger
    return None
