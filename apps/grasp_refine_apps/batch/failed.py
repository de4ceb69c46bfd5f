"""Counts of the failed and unfinished shards and jobs of a batch, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from grasp_refine.core.plurals import count_text


def failed_text(failed: Sequence[Mapping[str, Any]]) -> str:
    """Text for the numbers of failed shards, and of jobs refused before they had shards."""
    shards = sum(one["shard"] is not None for one in failed)
    counts = (shards, "shard"), (len(failed) - shards, "job")
    return " and ".join(count_text(number, word) for number, word in counts if number)


def suspected(failed: Sequence[Mapping[str, Any]]) -> int:
    """Number of shards that failed because their grasps are most likely in another convention."""
    return sum(one["reason"] == "suspected" for one in failed)


def suspected_text(failed: Sequence[Mapping[str, Any]]) -> str:
    """Text for their number, after `failed_text`; empty where there are none."""
    number = suspected(failed)
    return f" ({number} of them in a suspected convention)" if number else ""


def left_over(totals: Mapping[str, Any], failed: Sequence[Mapping[str, Any]]) -> int:
    """Number of shards neither complete nor failed: of an interrupted run, or of other parts of a batch."""
    if totals.get("shards") is None or totals.get("complete") is None:
        return 0
    return max(totals["shards"] - totals["complete"] - sum(one["shard"] is not None for one in failed), 0)
