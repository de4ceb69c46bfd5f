"""Licences that restrict use, or are not clear: a person accepts them once, by name, before anything is fetched."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

from grasp_refine.assets.cache import inside
from grasp_refine.assets.manifest import Asset
from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import AssetError
from grasp_refine.geometry.cache import default_cache

RECORD = "accepted.json"
"""Beside the files of an asset: the words that were accepted, and when."""


def is_accepted(asset: Asset) -> bool:
    """Whether an asset may be fetched without asking: its licence is open, or was accepted in its present words."""
    if asset.terms == "open":
        return True
    try:
        record = json.loads(inside(_folder(asset), RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(record, dict) and record.get("licence") == asset.licence


def accept(asset: Asset) -> None:
    """Remember that the licence of an asset was accepted.

    Raises:
        AssetError: the cache cannot be written to.
    """
    if asset.terms == "open":
        return
    record = {"asset": asset.full_name, "licence": asset.licence, "terms": asset.terms}
    record["accepted"] = datetime.now(UTC).isoformat(timespec="seconds")
    with written_whole(inside(_folder(asset), RECORD), AssetError) as partial:
        partial.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def check_accepted(asset: Asset) -> None:
    """Nothing, when the asset may be fetched.

    Raises:
        AssetError: its licence has to be accepted first; says its words and how.
    """
    if not is_accepted(asset):
        what = "restricts use" if asset.terms == "non-commercial" else "is not clear"
        raise AssetError(
            f"{asset.full_name}: its licence {what} ({asset.licence}); if you may use it, "
            f"refine-grasp assets fetch {asset.full_name} --accept-license"
        )


def _folder(asset: Asset) -> Path:
    return default_cache("assets") / asset.kind / asset.name
