"""Lines for people on the fidelity of transferred grasps: how many are the same grasp, and what happened to fingers."""

from __future__ import annotations

from collections import Counter

import numpy as np
from rich.text import Text

from grasp_refine.core.plurals import count_text, whole
from grasp_refine.measures.fidelity import Likeness
from grasp_refine.results.outcome import Outcome

COLORS = {Likeness.SAME: "green", Likeness.MOVED: "yellow", Likeness.DROPPED: "yellow", Likeness.OTHER: "red"}


def fidelity_lines(outcome: Outcome) -> list[Text]:
    """Return lines on the fidelity of transferred grasps; none where grasps were not transferred."""
    of = outcome.fidelity != ""
    if not of.any():
        return []
    count = Counter(outcome.fidelity[of].tolist())
    each = [(f"{whole(count[one])} {one}", COLORS[one]) for one in Likeness if count[one]]
    parts = [part for text in each for part in (", ", text)][1:]
    lines = [Text.assemble(f"{count_text(int(of.sum()), 'grasp')} transferred: ", *parts)]
    fingers = Counter(part.replace(": ", " ") for text in outcome.fingers[of].tolist() for part in text.split("; "))
    gone = {text: n for text, n in fingers.items() if text.endswith(("dropped", "does not touch"))}
    if gone:
        lines.append(Text("  " + ", ".join(f"{text} in {whole(n)}" for text, n in sorted(gone.items()))))
    pinch, turn = outcome["original_pinch_shift_m"], np.degrees(outcome["original_turn_rad"])
    if np.isfinite(pinch).any():
        lines.append(
            Text(
                "  thumb and opposing finger from the original's contacts: "
                f"{1e3 * np.nanmedian(pinch):.1f} mm (median), {1e3 * np.nanmax(pinch):.1f} mm (most); "
                f"approach turned {np.nanmedian(turn):.0f}°"
            )
        )
    return lines
