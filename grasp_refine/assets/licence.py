"""Licences that restrict use, or are unclear: the user accepts them once, by name, before anything is fetched."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol, runtime_checkable

from grasp_refine.assets.cache import path_inside
from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import AssetError
from grasp_refine.geometry.cache import default_cache

RECORD = "accepted.json"
"""Record beside the files of an asset: the accepted wording of its licence, and the time."""


@runtime_checkable
class Licensed(Protocol):
    """Something with a licence: an asset, or a data set of the Hub."""

    @property
    def kind(self) -> str:
        """Folder of its record."""
        ...

    @property
    def name(self) -> str:
        """Name in that folder."""
        ...

    @property
    def full_name(self) -> str:
        """Name on the command line."""
        ...

    @property
    def licence(self) -> str:
        """Wording of its licence."""
        ...

    @property
    def terms(self) -> str:
        """Terms of the licence: open, non-commercial or unclear."""
        ...


def is_accepted(asset: Licensed) -> bool:
    """Return whether an asset may be fetched: its licence is open, or was accepted in its present wording."""
    if asset.terms == "open":
        return True
    try:
        record = json.loads(path_inside(_folder(asset), RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(record, dict) and record.get("licence") == asset.licence


def accept(asset: Licensed) -> None:
    """Record that the licence of an asset was accepted.

    Raises:
        AssetError: the cache is not writable.
    """
    if asset.terms == "open":
        return
    record = {"asset": asset.full_name, "licence": asset.licence, "terms": asset.terms}
    record["accepted"] = datetime.now(UTC).isoformat(timespec="seconds")
    with written_whole(path_inside(_folder(asset), RECORD), AssetError) as partial:
        partial.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def check_accepted(asset: Licensed) -> None:
    """Refuse an asset whose licence is not accepted.

    Raises:
        AssetError: the licence has to be accepted first; names its wording and the command.
    """
    if not is_accepted(asset):
        what = "restricts use" if asset.terms == "non-commercial" else "is not clear"
        raise AssetError(
            f"{asset.full_name}: its licence {what} ({asset.licence}); if you may use it, "
            f"refine-grasp assets fetch {asset.full_name} `accept_license`"
        )


def _folder(asset: Licensed) -> Path:
    return default_cache("assets") / asset.kind / asset.name
